"""A thick ring with hardening: return mapping beside a loop with cvxpy.

    python benchmarks/plasticity.py [cells along the radius] [every how many steps cvxpy takes one]

Plane strain, P2 displacements and plastic strains at each quadrature point. All steps are certified
alike. The loop states one cvxpy problem whose parameter is the linear term; where that does not fit
in memory (cvxpy 1.9 makes dense matrices of the square of the unknowns of it: 22 GB for 7,680
points), a problem of constants for each step.
"""

from __future__ import annotations

import sys
import time
from typing import Any

import numpy as np
import skfem

import sweepopt as so
from sweepopt.fem import Discretisation, Elasticity, Plasticity, Scene, Traction, body
from sweepopt.linalg import Factor
from sweepopt.loads import Table
from sweepopt.velocity import certify

E, NU, SIGMA_Y, E_T = 70_000.0, 0.3, 250.0, 700.0
INNER, OUTER = 1.0, 1.3
LIMIT = 2 / np.sqrt(3) * SIGMA_Y * np.log(OUTER / INNER)  # pressure at E_T = 0
CYCLE = Table([0.0, 1.0, 2.0, 3.0], [0.0, 1.1, 0.0, -1.1])  # times LIMIT; tension first
MODULUS = E * E_T / (E - E_T)  # of the stress over the plastic strain in tension
KINEMATIC, ISOTROPIC = {"Hk": 2 / 3 * MODULUS}, {"Hi": MODULUS}
PARAMETERS = 20_000  # unknowns: a dense matrix of so many takes 3 GB


def ring(cells: int, **hardening: float) -> Scene:
    """A quarter of the ring under pressure on its inner side; 66 steps are those of the goldens."""
    mesh = skfem.MeshTri.init_tensor(
        np.linspace(INNER, OUTER, cells + 1), np.linspace(0, np.pi / 2, 5 * cells + 1)
    )
    mesh = skfem.MeshTri2.from_mesh(mesh)
    radius, angle = mesh.doflocs
    mesh = skfem.MeshTri2(radius * np.array([np.cos(angle), np.sin(angle)]), mesh.t)
    sides = {
        "inner": lambda x: np.hypot(*x) < INNER + 1e-3,
        "x axis": lambda x: np.abs(x[1]) < 1e-9,
        "y axis": lambda x: np.abs(x[0]) < 1e-9,
    }
    space = Discretisation(
        mesh.with_boundaries(sides),
        element="P2",
        kind="plane strain",
        held={"x axis": "y", "y axis": "x"},
    )
    effects = [
        Elasticity(E=E, nu=NU),
        Plasticity(SIGMA_Y, **(hardening or KINEMATIC)),
        Traction("inner", CYCLE, f2=-LIMIT),
    ]
    return body(space, effects, t_end=3.0, steps=66, scheme="implicit-euler", tol=1e-10)


def inner_displacement(scene: Scene, u: np.ndarray) -> np.ndarray:
    """Of the ring's inner side, where it meets the x axis."""
    x = scene.discretisation.points
    node = np.argmin(np.hypot(x[:, 0] - INNER, x[:, 1]))
    return scene.discretisation.expand(u[:, : scene.discretisation.dim])[:, node, 0]


def by_cvxpy(process: so.SweepingProcess, mu: float) -> Any:
    """(u, t) -> seconds and relative certificate of a step from u to t, warm."""
    import cvxpy as cp

    B, C = mu * process.B, process.C.at(0.0)
    few, balls = C.selection.unknowns, process.dissipation.selection.part
    z = cp.Variable(process.dim)
    norms = cp.norm(cp.reshape(z[few], (balls.radii.size, balls.block), order="C"), axis=1)
    energy = 0.5 * cp.quad_form(z, cp.psd_wrap(B)) + balls.radii @ norms
    parameter = cp.Parameter(process.dim) if process.dim <= PARAMETERS else None
    metric = Factor(B)
    problem = cp.Problem(cp.Minimize(energy + z @ parameter)) if parameter is not None else None

    def step(u: np.ndarray, t: float) -> tuple[float, float]:
        q = process.times_B(u) - process.load(t)
        one = problem or cp.Problem(cp.Minimize(energy + z @ q))
        if parameter is not None:
            parameter.value = q
            if not one.status:
                one.solve(solver=cp.CLARABEL)  # which compiles it
        start = time.perf_counter()
        one.solve(solver=cp.CLARABEL)
        seconds = time.perf_counter() - start
        return seconds, certify(metric, process.times_B(u), process.C.at(t), z.value).relative

    return step


def main(cells: int = 8, every: int = 3) -> None:
    """Steps of 0.05 of the limit pressure up to 1.1 of it, the first one left out of the times."""
    start = time.perf_counter()
    scene = ring(cells)
    process, seconds = scene.problem, time.perf_counter() - start
    points = process.C.at(0.0).nonsmooth_dim // 3
    print(f"{points} points, {process.dim} unknowns, assembled in {seconds:.2f} s")
    solution = scene.solve(t_end=1.0, steps=22)
    print(solution.plan)
    stats, step = solution.stats, by_cvxpy(process, 1 / 22)
    displacements = inner_displacement(scene, solution.u[[20, 22]])
    print(f"inner side at 1.0 and 1.1 of the limit: {displacements}")
    print(f"relative certificate, worst: {stats['relative'].max():.1e}")
    print("step  Newton  seconds  cvxpy and Clarabel, to  ratio")
    ratios = []
    for k in range(1, 22, every):
        theirs, relative = step(solution.u[k], float(solution.t[k + 1]))
        ours = stats["seconds"][k]
        ratios.append((theirs, ours))
        print(
            f"{k:4d}  {stats['iterations'][k]:6d}  {ours:7.3f}  {theirs:8.3f}  {relative:.0e}"
            f"  {theirs / ours:10.1f}"
        )
    theirs, ours = np.sum(ratios, axis=0)
    print(f"all of these: {theirs / ours:.1f} times faster")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
