"""Bingham's fluid in a pipe: balls on a gradient beside a loop with cvxpy.

    python benchmarks/cones.py [rings of triangles]

P1 velocities of an antiplane flow under a pressure gradient P, a yield stress g on each triangle.
Both take the same steps one after the other, each from the state of the last one; the loop states
one cvxpy problem whose parameter is the linear term.
"""

from __future__ import annotations

import sys
import time
import warnings
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
import skfem

import sweepopt as so
from sweepopt.linalg import Factor

MU, G, R = 1.0, 0.2, 1.0  # viscosity, yield stress, radius of the pipe


class Flow(NamedTuple):
    """A process, int v for velocities v, the gradient's rows, areas and the free nodes (2, dim)."""

    process: so.EvolutionVI
    mean: np.ndarray
    gradient: sp.csr_array
    areas: np.ndarray
    nodes: np.ndarray


def disc(rings: int) -> skfem.MeshTri:
    """6 rings^2 triangles of nearly one size."""
    turns = [np.arange(6 * k) / (6 * k) for k in range(1, rings + 1)]
    radius = np.repeat(np.arange(1, rings + 1) / rings, 6 * np.arange(1, rings + 1))
    angle = 2 * np.pi * np.concatenate(turns)
    points = R * np.hstack([np.zeros((2, 1)), radius * np.array([np.cos(angle), np.sin(angle)])])
    triangles = []
    for k in range(1, rings + 1):
        inner, outer = (3 * i * (i - 1) + 1 if i else 0 for i in (k - 1, k))
        for side in range(6):
            for j in range(k):
                at = [outer + (side * k + j + i) % (6 * k) for i in (0, 1)]
                near = [inner + (side * (k - 1) + j + i) % max(6 * (k - 1), 1) for i in (0, 1)]
                triangles.append([*at, near[0]])
                if j < k - 1:
                    triangles.append([near[0], at[1], near[1]])
    return skfem.MeshTri(points, np.array(triangles).T.copy())


def square(n: int, L: float = 1.0) -> skfem.MeshTri:
    """4 n^2 triangles, each square cut by its diagonals."""
    x = L * np.linspace(0, 1, n + 1)
    middle = (x[1:] + x[:-1]) / 2
    corners, centres = (np.array(np.meshgrid(a, a, indexing="ij")) for a in (x, middle))
    points = np.hstack([corners.reshape(2, -1), centres.reshape(2, -1)])
    i, j = (a.ravel() for a in np.indices((n, n)))
    a, b = i * (n + 1) + j, (i + 1) * (n + 1) + j
    centre = (n + 1) ** 2 + i * n + j
    sides = [(a, b), (b, b + 1), (b + 1, a + 1), (a + 1, a)]
    return skfem.MeshTri(points, np.hstack([[p, q, centre] for p, q in sides]))


def flow(
    mesh: skfem.MeshTri, pressure: Callable[[float], float], kappa: float = 0.0, mu: float = MU
) -> Flow:
    """The velocity is 0 on the wall; with kappa > 0 a gel that is elastic beside its viscosity."""
    basis = skfem.Basis(mesh, skfem.ElementTriP1(), intorder=1)
    free, areas = basis.complement_dofs(basis.get_dofs()), basis.dx.sum(axis=1)
    values = np.array([phi[0].grad[:, :, 0] for phi in basis.basis])  # of node, component, triangle
    rows = 2 * np.arange(areas.size) + np.arange(2)[:, None]
    at = np.broadcast_to(rows, values.shape), np.repeat(mesh.t[:, None], 2, axis=1)
    E = sp.coo_array((values.ravel(), (at[0].ravel(), at[1].ravel())))
    E = sp.csr_array(E)[:, free]
    laplace = sp.csc_array(E.T @ (sp.diags_array(np.repeat(areas, 2)) @ E))
    mean = skfem.LinearForm(lambda v, _: v).assemble(basis)[free]
    process = so.EvolutionVI(
        mu * laplace,
        kappa * laplace if kappa else None,
        load=lambda t: pressure(t) * mean,
        dissipation=so.image(E.T, so.Balls(G * areas, 2)),
        u0=np.zeros(free.size),
    )
    return Flow(process, mean, E, areas, mesh.p[:, free])


def flux(P: float) -> float:
    """Of the pipe; 0 below P = 2 G/R."""
    phi = min(2 * G / (P * R), 1.0)
    return float(np.pi * P * R**4 / (8 * MU) * (1 - 4 * phi / 3 + phi**4 / 3))


def stated(case: Flow) -> Callable[[np.ndarray], np.ndarray]:
    """From the linear term to the velocity by one parametrised problem of cvxpy."""
    import cvxpy as cp

    dim, m = case.process.dim, case.areas.size
    z, q = cp.Variable(dim), cp.Parameter(dim)
    norms = cp.norm(cp.reshape(case.gradient @ z, (m, 2), order="C"), axis=1)
    energy = 0.5 * cp.quad_form(z, cp.psd_wrap(case.process.A)) + q @ z
    problem = cp.Problem(cp.Minimize(energy + (G * case.areas) @ norms))

    def velocity(linear: np.ndarray) -> Any:
        q.value = linear
        problem.solve(solver=cp.CLARABEL)
        return np.asarray(z.value)

    return velocity


def main(rings: int = 29) -> None:
    """A cycle of the pressure gradient from 1 to 2 and back; the first step is not counted."""
    warnings.simplefilter("ignore", so.errors.InitialStateWarning)
    start = time.perf_counter()
    case = flow(disc(rings), lambda t: 1.5 - 0.5 * np.cos(2 * np.pi * t))
    assembled = time.perf_counter()
    print(f"{case.areas.size} discs, {case.process.dim} unknowns: {assembled - start:.2f} s")
    M, by_loop, each, steps = Factor(case.process.A), stated(case), [], 40

    def beside(info: Any) -> None:
        linear = -case.process.load(info.t)
        begin = time.perf_counter()
        z = by_loop(linear)
        each.append((time.perf_counter() - begin, M.norm(z - info.velocity) / M.norm(z)))

    run = so.solve(
        case.process,
        t_end=1.0,
        steps=steps,
        scheme="implicit-euler",
        tol=1e-6,
        callback=beside,
        save=None,
    )
    print(run.plan)
    seconds, ours = np.array(each)[1:].T[0], run.stats["seconds"][1:]
    print(f"a step, mean / worst: {ours.mean():.3f} / {ours.max():.3f} s")
    print(f"relative certificate, worst: {run.stats['relative'].max():.1e}")
    print(f"first step: {run.stats['seconds'][0]:.2f} s, cvxpy's {each[0][0]:.2f} s")
    print(f"with cvxpy and Clarabel, mean / worst: {seconds.mean():.3f} / {seconds.max():.3f} s")
    print(f"distance of its velocities from ours, worst: {max(x for _, x in each):.1e}")
    print(f"times as fast: {seconds.mean() / ours.mean():.1f}")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
