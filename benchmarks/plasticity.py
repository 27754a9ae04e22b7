"""A thick ring with kinematic hardening: return mapping beside a loop with cvxpy.

    python benchmarks/plasticity.py [cells along the radius] [every how many steps cvxpy takes one]

Plane strain, P2 displacements u, and at each quadrature point three plastic strains p in an
orthonormal basis of the deviators. Each step of both is certified alike, with the same factors.
The loop states one cvxpy problem whose parameter is the linear term; where that does not fit in
memory (cvxpy 1.9 makes dense matrices of the square of the unknowns: 22 GB for 7,680 points), a
problem of constants for each step.
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
PARAMETERS = 20_000  # unknowns: a dense matrix of so many takes 3 GB
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
    volume: Any,
    strains: Any,
    w: np.ndarray,
    two_G: float,
    moduli: tuple[float, float],
    radii: np.ndarray,
    load: Any,
) -> so.EvolutionVI:
    """(u, p) with the energy 1/2 <volume u, u> + int two_G/2 |strains u - p|^2 + Hk/2 |p|^2.

    For Hi > 0 each point also has a with theta a' >= |p'|, sqrt(3/2) alpha = theta a, and the
    energy Hi/2 alpha^2. theta^2 >= 1 + 2 (two_G + Hk) / (2/3 Hi) leaves at least half of it with p
    after the exchange of stiffness between a and p (`ConvexSet.exchange`).
    """
    Hk, Hi = moduli
    n, block, points = strains.shape[1], w.size // radii.size, radii.size
    size, theta = block + (Hi > 0), 1.0
    at = n + np.arange(size * points).reshape(points, size)
    p, dim = at[:, size - block :].ravel(), n + size * points
    diagonal = np.zeros(dim)
    diagonal[p] = (two_G + Hk) * w
    if Hi:
        theta = 2.0 ** np.ceil(0.5 * np.log2(1 + 3 * (two_G + Hk) / Hi))
        diagonal[at[:, 0]] = 2 / 3 * Hi * theta**2 * w[::block]
    G = sp.diags_array(two_G * w) @ strains
    coupling = sp.csr_array(sp.csc_array(sp.eye_array(dim))[:, p] @ G)
    coupling.resize(dim, dim)
    K = sp.block_diag([volume + strains.T @ G, sp.csr_array((dim - n, dim - n))])
    D: Any = so.Balls(radii, block)
    if Hi:
        apex = np.zeros((points, size))
        apex[:, 0] = theta * radii
        D = apex.ravel() - so.SecondOrderCone(size, np.full(points, 1 / theta))
    return so.EvolutionVI(
        sp.csc_array((dim, dim)),
        sp.csc_array(K + sp.diags_array(diagonal) - coupling - coupling.T),
        load=lambda t: np.pad(load(t), (0, dim - n)),
        dissipation=so.image(sp.eye_array(dim, format="csc")[:, n:], D),
        u0=np.zeros(dim),
    )


def deviators(grad: np.ndarray) -> np.ndarray:
    """A plane strain in an orthonormal basis of the deviators, shape (3, ...)."""
    xx, yy, xy = grad[0, 0], grad[1, 1], grad[0, 1] + grad[1, 0]
    return np.array([(xx - yy) / np.sqrt(2), (xx + yy) / np.sqrt(6), xy / np.sqrt(2)])


def antiplane_pipe(refinements: int, Hk: float = 0.1, Hi: float = 0.0) -> Body:
    """A clamped disc under a body force: G = 1, yield stress 0.2, force 1, then -1."""
    mesh = skfem.MeshTri.init_circle(refinements)
    basis = skfem.Basis(mesh, skfem.ElementTriP1(), intorder=0)
    strains, w = internal(basis, lambda grad: grad)
    free = basis.complement_dofs(basis.get_dofs())
    f = skfem.LinearForm(lambda v, _: v).assemble(basis)[free]
    process = hardening(
        sp.csr_array((free.size, free.size)),
        *(strains[:, free], w, 1.0, (Hk, 1.5 * Hi), 0.2 * w[::2]),
        lambda t: np.interp(t, [0, 1, 3], [0, 1, -1]) * f,
    )
    return Body(process, w.size // 2, int(np.argmin(np.hypot(*mesh.p[:, free]))))


def ring(cells: int, isotropic: bool = False) -> Body:
    """A quarter of the ring under pressure on its inner side, which moves by u_watched."""
    mesh = skfem.MeshTri.init_tensor(
        np.linspace(INNER, OUTER, cells + 1), np.linspace(0, np.pi / 2, 5 * cells + 1)
    )
    mesh = skfem.MeshTri2.from_mesh(mesh)
    radius, angle = mesh.doflocs
    mesh = skfem.MeshTri2(radius * np.array([np.cos(angle), np.sin(angle)]), mesh.t)
    basis = skfem.Basis(mesh, skfem.ElementVector(skfem.ElementTriP2()), intorder=2)
    two_G, modulus = E / (1 + NU), E * E_T / (E - E_T)
    moduli = (0.0, modulus) if isotropic else (2 / 3 * modulus, 0.0)
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
        *(strains[:, free], w, two_G, moduli, np.sqrt(2 / 3) * SIGMA_Y * w[::3]),
        lambda t: LIMIT * np.interp(t, range(4), CYCLE) * push[free],
    )
    watched = np.flatnonzero((np.abs(x - INNER) < 1e-9) & on_x & ~second)
    return Body(process, w.size // 3, int(np.searchsorted(free, watched[0])))


def by_cvxpy(process: so.EvolutionVI, mu: float) -> Any:
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
    process, points, watched = ring(cells)
    seconds = time.perf_counter() - start
    print(f"{points} points, {process.dim} unknowns, assembled in {seconds:.2f} s")
    solution = so.solve(process, t_end=1.0, steps=22, scheme="implicit-euler", tol=1e-10)
    print(solution.plan)
    stats, step = solution.stats, by_cvxpy(process, 1 / 22)
    print(f"inner side at 1.0 and 1.1 of the limit: {solution.u[[20, 22], watched]}")
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
