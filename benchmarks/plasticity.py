"""A thick ring with kinematic hardening: return mapping beside a loop with cvxpy.

    python benchmarks/plasticity.py [cells along the radius]

Plane strain, P2 displacements u, and at each quadrature point three plastic strains p in an
orthonormal basis of the deviators. Each step of both is certified alike, with the same factors.
The loop states one cvxpy problem whose parameter is the linear term.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
import skfem
from skfem.helpers import div

import sweepopt as so
from sweepopt.linalg import Factor
from sweepopt.velocity import certify

E, NU, SIGMA_Y, E_T = 70_000.0, 0.3, 250.0, 700.0
INNER, OUTER = 1.0, 1.3
LIMIT = 2 / np.sqrt(3) * SIGMA_Y * np.log(OUTER / INNER)  # pressure at E_T = 0
CYCLE = [0.0, 1.1, 0.0, -1.1]  # times LIMIT, at t = 0, 1, 2, 3; tension first


class Body(NamedTuple):
    """A process of (u, p), the number of its points, and the unknown whose motion is reported."""

    process: so.EvolutionVI
    points: int
    watched: int


def internal(
    basis: Any, components: Callable[[np.ndarray], np.ndarray]
) -> tuple[sp.csr_array, np.ndarray]:
    """The strain components at each quadrature point, one after the other, and their weights."""
    rows, columns, values = [], [], []
    for dofs, phi in zip(basis.element_dofs, basis.basis, strict=True):
        strain = components(np.asarray(phi[0].grad))
        strain = np.broadcast_to(strain, (len(strain), *basis.dx.shape)).transpose(1, 2, 0)
        values.append(strain.ravel())
        rows.append(np.arange(strain.size))
        columns.append(np.repeat(dofs, strain[0].size))
    entries = np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))
    strains = sp.csr_array(sp.coo_array(entries, (rows[0].size, basis.N)))
    return strains, np.repeat(basis.dx.ravel(), strains.shape[0] // basis.dx.size)


def hardening(
    volume: Any, strains: Any, w: np.ndarray, two_G: float, Hk: float, radii: np.ndarray, load: Any
) -> so.EvolutionVI:
    """(u, p) with the energy 1/2 <volume u, u> + int two_G/2 |strains u - p|^2 + Hk/2 |p|^2."""
    G = sp.diags_array(two_G * w) @ strains
    K = volume + strains.T @ G
    B = sp.csc_array(sp.block_array([[K, -G.T], [-G, sp.diags_array((two_G + Hk) * w)]]))
    dim, n = B.shape[0], strains.shape[1]
    D = so.image(sp.eye_array(dim, format="csc")[:, n:], so.Balls(radii, (dim - n) // radii.size))
    return so.EvolutionVI(
        sp.csc_array((dim, dim)),
        B,
        load=lambda t: np.pad(load(t), (0, dim - n)),
        dissipation=D,
        u0=np.zeros(dim),
    )


def deviators(grad: np.ndarray) -> np.ndarray:
    """A plane strain in an orthonormal basis of the deviators, shape (3, ...)."""
    xx, yy, xy = grad[0, 0], grad[1, 1], grad[0, 1] + grad[1, 0]
    return np.array([(xx - yy) / np.sqrt(2), (xx + yy) / np.sqrt(6), xy / np.sqrt(2)])


def antiplane_pipe(refinements: int) -> Body:
    """A clamped disc under a body force: G = 1, H = 0.1, yield stress 0.2, force 1, then -1."""
    mesh = skfem.MeshTri.init_circle(refinements)
    basis = skfem.Basis(mesh, skfem.ElementTriP1(), intorder=0)
    strains, w = internal(basis, lambda grad: grad)
    free = basis.complement_dofs(basis.get_dofs())
    f = skfem.LinearForm(lambda v, _: v).assemble(basis)[free]
    process = hardening(
        sp.csr_array((free.size, free.size)),
        *(strains[:, free], w, 1.0, 0.1, 0.2 * w[::2]),
        lambda t: np.interp(t, [0, 1, 3], [0, 1, -1]) * f,
    )
    return Body(process, w.size // 2, int(np.argmin(np.hypot(*mesh.p[:, free]))))


def ring(cells: int) -> Body:
    """A quarter of the ring under pressure on its inner side, which moves by u_watched."""
    mesh = skfem.MeshTri.init_tensor(
        np.linspace(INNER, OUTER, cells + 1), np.linspace(0, np.pi / 2, 5 * cells + 1)
    )
    mesh = skfem.MeshTri2.from_mesh(mesh)
    radius, angle = mesh.doflocs
    mesh = skfem.MeshTri2(radius * np.array([np.cos(angle), np.sin(angle)]), mesh.t)
    basis = skfem.Basis(mesh, skfem.ElementVector(skfem.ElementTriP2()), intorder=2)
    two_G, Hk = E / (1 + NU), 2 / 3 * E * E_T / (E - E_T)
    bulk = E / (3 * (1 - 2 * NU))
    # the part of 2 G |e|^2 that is no deviator is in the bulk modulus
    volume = skfem.BilinearForm(lambda u, v, _: bulk * div(u) * div(v)).assemble(basis)
    strains, w = internal(basis, deviators)
    inside = mesh.facets_satisfying(lambda x: np.hypot(*x) < INNER + 1e-9, boundaries_only=True)
    side = skfem.FacetBasis(mesh, basis.elem, facets=inside, intorder=4)
    push = skfem.LinearForm(lambda v, x: -v[0] * x.n[0] - v[1] * x.n[1]).assemble(side)
    (x, y), second = basis.doflocs, np.zeros(basis.N, dtype=bool)
    second[basis.nodal_dofs[1]] = second[basis.facet_dofs[1]] = True
    on_y, on_x = np.abs(x) < 1e-9, np.abs(y) < 1e-9
    free = np.flatnonzero(~((on_y & ~second) | (on_x & second)))
    process = hardening(
        sp.csr_array(volume)[free][:, free],
        *(strains[:, free], w, two_G, Hk, np.sqrt(2 / 3) * SIGMA_Y * w[::3]),
        lambda t: LIMIT * np.interp(t, range(4), CYCLE) * push[free],
    )
    watched = np.flatnonzero((np.abs(x - INNER) < 1e-9) & on_x & ~second)
    return Body(process, w.size // 3, int(np.searchsorted(free, watched[0])))


def by_cvxpy(process: so.EvolutionVI, u: np.ndarray, t: float, mu: float) -> tuple[float, float]:
    """Seconds and relative certificate of a step from u to t with one parametrised problem, warm.

    Compiled, and solved once, before the time is taken.
    """
    import cvxpy as cp

    assert process.B is not None
    B, C = mu * process.B, process.C.at(t)
    few, balls = C.selection.unknowns, process.dissipation.selection.part
    z, q = cp.Variable(process.dim), cp.Parameter(process.dim)
    norms = cp.norm(cp.reshape(z[few], (balls.radii.size, balls.block), order="C"), axis=1)
    energy = 0.5 * cp.quad_form(z, cp.psd_wrap(B)) + q @ z
    problem = cp.Problem(cp.Minimize(energy + balls.radii @ norms))
    q.value = process.times_B(u) - process.load(t)
    for _ in range(2):
        start = time.perf_counter()
        problem.solve(solver=cp.CLARABEL)
        seconds = time.perf_counter() - start
    return seconds, certify(Factor(B), process.times_B(u), C, np.asarray(z.value)).relative


def main(cells: int = 8) -> None:
    """Steps of 0.05 of the limit pressure; the loop takes the one in which most points yield."""
    start = time.perf_counter()
    process, points, watched = ring(cells)
    print(
        f"{points} points, {process.dim} unknowns, assembled in {time.perf_counter() - start:.2f} s"
    )
    solution = so.solve(process, t_end=1.0, steps=22, scheme="implicit-euler", tol=1e-10)
    print(solution.plan)
    stats = solution.stats
    print(f"inner side at 1.0 and 1.1 of the limit: {solution.u[[20, 22], watched]}")
    print(f"a step, mean / worst: {stats['seconds'].mean():.3f} / {stats['seconds'].max():.3f} s")
    print(f"relative certificate, worst: {stats['relative'].max():.1e}")
    k = int(stats["seconds"].argmax())
    seconds, relative = by_cvxpy(process, solution.u[k], float(solution.t[k + 1]), 1 / 22)
    print(f"the slowest of them with cvxpy and Clarabel, warm: {seconds:.2f} s, to {relative:.1e}")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
