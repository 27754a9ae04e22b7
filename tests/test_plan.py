"""What a process really needs: plans, the exact elimination, and work that is not done."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse as sp
from cases import SQUARE, isotropic, springs, worst_certificate

import sweepopt as so
from sweepopt.integrate.schemes import SCHEMES
from sweepopt.linalg import Factor
from sweepopt.velocity import compile_projection, make_plan


def chain(stiffness=1.0):
    rows = [-1.0, 2.05, -1.0]
    return sp.csc_array(stiffness * sp.diags_array(rows, offsets=[-1, 0, 1], shape=(40, 40)))


SMALL_SETS = {
    "box": ([3, 17, 30, 39], so.Box([-0.5, -1, -0.1, -2], [0.5, 1, 0.3, 2])),
    "balls": ([3, 17, 30, 39], so.Balls([0.5, 1.0], 2)),
    "half-lines": ([3, 17, 30, 39], so.Orthant(4)),
    "polytope": ([5, 9], so.Polytope([[1, 0], [-1, 1], [-1, -1]])),
    "ellipsoid": ([5, 9], so.Ellipsoid([0.1, 0], [[1, 0.3], [0.3, 0.5]])),
}


def process(name, dense=False):
    unknowns, part = SMALL_SETS[name]

    def load(t):
        return np.sin(np.arange(40) + 3 * t) * np.sin(5 * t)

    A, B = chain(), chain(stiffness=2.0) + sp.diags_array(np.linspace(0, 1, 40), format="csc")
    if dense:
        A, B = A.toarray(), B.toarray()
    C = so.Moving(-so.image(sp.eye_array(40, format="csc")[:, unknowns], part), load)
    return so.SweepingProcess(A, B, C, np.zeros(40))


@pytest.mark.parametrize("dense", [False, True], ids=["sparse", "dense"])
@pytest.mark.parametrize("name", SMALL_SETS)
def test_eliminating_the_rest_changes_no_answer(name, dense):
    this = process(name, dense)
    C = this.C.at(0.3)
    plan = make_plan(this, [(0.3, C)], SCHEMES["midpoint"], "auto", 1e-6)
    assert plan.eliminated == 40 - SMALL_SETS[name][1].dim
    kept = replace(plan, contact=None, solver=so.Clarabel(tol=1e-11))
    M = this.A + 0.1 * this.B
    q = np.cos(np.arange(40.0))
    small, full = (compile_projection(one, Factor(M))(q, C) for one in (plan, kept))
    assert small.relative <= 1e-6
    difference = small.z - full.z
    apart = np.sqrt(difference @ (M @ difference))
    assert apart <= small.certificate + full.certificate
    # the certificate of the small program is that of the large one: never below the error
    assert full.relative <= 1e-5


@pytest.mark.parametrize("name", ["box", "balls"])
def test_stuck_contacts_of_a_large_body_are_exactly_zero(name):
    sol = so.solve(process(name), t_end=2.0, steps=100)
    contact = sol.velocity[:, SMALL_SETS[name][0]]
    assert 0.02 < (contact == 0.0).mean() < 0.98
    assert worst_certificate(sol) <= 1e-10


def test_the_plan_prints_what_is_simulated_and_what_is_not():
    shown = str(so.solve(process("box"), t_end=0.1, steps=1, solver="osqp").plan)
    for line in (
        "unknowns            40",
        "nonsmooth unknowns  4",
        "eliminated          36",
        "osqp",
    ):
        assert line in shown
    bare = so.SweepingProcess(chain(), None, so.Point(np.zeros(40)), np.zeros(40))
    shown = str(so.solve(bare, t_end=0.1, steps=1).plan)
    assert "no optimiser" in shown
    assert "velocities do not depend on history" in shown


def no_solver(monkeypatch):
    for solver in (so.Clarabel, so.OSQP, so.DAQP, so.Newton, so.Cvxpy):
        monkeypatch.setattr(solver, "compile", lambda *_: pytest.fail("a solver was compiled"))


def test_without_a_nonsmooth_part_no_solver_and_without_elasticity_no_product_with_b(
    monkeypatch,
):
    no_solver(monkeypatch)
    load = so.Separable([(so.Sine(1.0, 2.0), np.ones(40))])
    free = so.EvolutionVI(chain(), chain(), load=load, u0=np.zeros(40)).as_sweeping()
    assert so.solve(free, t_end=1.0, steps=10).success
    dry = so.EvolutionVI(chain(), 0 * chain(), load=load, u0=np.zeros(40)).as_sweeping()
    assert dry.B is None
    assert so.solve(dry, t_end=1.0, steps=10).success


@pytest.mark.parametrize(
    "C",
    [
        so.Box([-1, -0.5, 0.0], [1, 0.5, np.inf]),
        so.Ball([0.1, 0, 0], 0.7),
        so.product(so.Ball([0, 0], 0.5), so.Orthant(1)),
    ],
    ids=["box", "ball", "product"],
)
def test_diagonal_processes_are_solved_by_a_formula_that_agrees_with_the_solvers(C, monkeypatch):
    A, B = 0.5 * np.eye(3), 2.0 * np.eye(3)
    moving = so.Moving(C, lambda t: np.sin([3 * t, 2 * t, t]))
    this = so.SweepingProcess(A, B, moving, np.zeros(3))
    solved = so.solve(this, t_end=4.0, steps=80, solver=so.Clarabel(tol=1e-11))
    no_solver(monkeypatch)
    sol = so.solve(this, t_end=4.0, steps=80)
    assert worst_certificate(sol) <= 1e-14
    assert "closed form" in str(sol.plan)
    carried = (sol.stats["certificate"] + solved.stats["certificate"]).sum() * 0.05
    assert max(map(this.metric.norm, sol.u - solved.u)) <= 5 * carried + 1e-12


def test_a_set_that_starts_as_a_point_becomes_a_set_when_it_grows():
    # C(t) = [0, 2t] holds 0 at all times: nothing ever moves
    C = so.Moving(so.Box(-1, 1), center=lambda t: [t], scale=lambda t: t)
    this = isotropic(C, 0.5, 2.0)
    for scheme in ("implicit-euler", "midpoint"):
        assert not so.solve(this, t_end=2.0, steps=20, scheme=scheme).u.any()


def test_a_contact_zone_that_moves_is_followed():
    axes, interval = np.eye(3), so.Box(-1, 1)

    def as_image(t):
        return so.image(axes[:, [0]] if t < 1 else axes[:, [2]], interval) + [3 * t, 0, 3 * t]

    def as_box(t):
        g = axes[0] if t < 1 else axes[2]
        return so.Box(-g, g) + [3 * t, 0, 3 * t]

    ends = []
    for member in (as_image, as_box):
        this = isotropic(so.MovingSet(member))
        ends.append(so.solve(this, t_end=2.0, steps=20).u[-1])
    assert ends[0] == pytest.approx(ends[1], abs=1e-12)


def test_sets_of_several_kinds_are_solved_each_in_its_way_or_refused_before_the_run():
    kinds = [
        SQUARE,
        so.Point([0.0, 0.0]),
        so.Ball([0, 0], 1),
        so.image([[1.0], [0.0]], so.Box(-1, 1)),
    ]
    C = so.MovingSet(lambda t: kinds[int(t)] + [2 * np.sin(3 * t), t])
    this = so.SweepingProcess([[2, 0.5], [0.5, 1]], np.eye(2), C, [0, 0])
    sol = so.solve(this, t_end=3.99, steps=40)
    assert worst_certificate(sol) <= 1e-6
    assert {"linear", "newton"} <= set(sol.stats["solver"])
    with pytest.raises(so.SolverRefusedError, match=r"Ball.*t = 2"):
        so.solve(this, t_end=3.99, steps=40, solver="osqp")


def test_a_solver_that_is_refused_names_the_users_set():
    C = so.Moving(so.Polyhedron(np.eye(2), np.ones(2)), center=np.ones(2), scale=2.0)
    with pytest.raises(so.SolverRefusedError, match="newton cannot treat Polyhedron"):
        so.solve(isotropic(C), t_end=1.0, solver="newton")


@pytest.mark.parametrize("scale", [None, so.Table([0.0, 1.0, 2.0], [1.0, 0.2, 1.0])])
def test_a_box_with_equal_bounds_away_from_the_contact_acts_on_the_contact_alone(
    scale,
):
    n, few = 24, np.array([0, 7, 14, 21])
    random = np.random.default_rng(0)
    A = 3 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    lower = random.normal(size=n)  # equal bounds need not be 0
    upper = lower.copy()
    upper[few] += 0.5
    load = so.Separable([(so.Sine(2.0, 1.5), random.normal(size=n))])
    process = so.SweepingProcess(A, 2 * A, so.Moving(so.Box(lower, upper), load, scale), 0 * lower)
    how = {"t_end": 2.0, "steps": 40, "tol": 1e-9, "scheme": "midpoint"}
    with pytest.warns(so.InitialStateWarning):
        sol, full = (so.solve(process, **how, path=path) for path in ("auto", "full"))
    assert "eliminated          20" in str(sol.plan)
    np.testing.assert_allclose(sol.u, full.u, rtol=0, atol=1e-8 * np.abs(full.u).max())
    assert sol.error_bound().guaranteed
    assert sol.error_bound() == pytest.approx(full.error_bound(), rel=1e-3)


EULER = {"t_end": 2.0, "steps": 20, "tol": 1e-9, "scheme": "implicit-euler"}


@pytest.mark.parametrize("always", [True, False], ids=["at all times", "at some times"])
@pytest.mark.parametrize("n", [6, 40])
def test_opposite_rows_are_the_equal_bounds_of_a_box(n, always):
    random = np.random.default_rng(n)
    T = springs(n)
    size, phase = random.uniform(0.1, 0.5, n), random.uniform(0, 6, n)
    middle, both = random.normal(size=n), np.vstack([np.eye(n), -np.eye(n)])
    size[::2] *= not always

    def radius(t):
        return size if always else np.maximum(0.0, size * np.sin(2 * t + phase))

    def box(t):
        return so.Box(t * middle - radius(t), t * middle + radius(t))

    def h(t):
        return np.concatenate([t * middle + radius(t), radius(t) - t * middle])

    rows, bounds = (
        so.solve(so.SweepingProcess(0.1 * T, T, C, np.zeros(n)), **EULER)
        for C in (so.Polyhedron(both, h), so.MovingSet(box))
    )
    assert rows.plan.path == ("eliminated" if always else "full")
    assert rows.stats["attempts"].max() <= 2
    np.testing.assert_allclose(rows.u, bounds.u, rtol=0, atol=2e-9 * np.abs(bounds.u).max())


@pytest.mark.parametrize("double", [False, True], ids=["once", "twice"])
def test_equations_that_couple_unknowns_are_those_of_the_rotated_unknowns(double):
    """{ w : E w = E w0, |N (w - w0)| <= 1 } is w0 + Y { y : |N Y y| <= 1 }, Y a basis of ker E."""
    n, random = 12, np.random.default_rng(3)
    E, N, w0 = random.normal(size=(5, n)), random.normal(size=(n, n)), random.normal(size=n)
    sides, Y = np.vstack([N, -N]), scipy.linalg.null_space(E)
    G = np.vstack([sides, E, -2 * E, *([4 * E, -E] if double else [])])
    h = G @ w0 + (np.arange(len(G)) < 2 * n)
    rotated = so.image(Y, so.Polyhedron(sides @ Y, np.ones(2 * n))) + w0
    load, one = so.Separable([(so.Sine(2.0, 3.0), random.normal(size=n))]), np.eye(n)
    sol, other = (
        so.solve(so.SweepingProcess(2 * one, 3 * one, so.Moving(C, load), w0 / 3), **EULER)
        for C in (so.Polyhedron(G, h), rotated)
    )
    np.testing.assert_allclose(sol.u, other.u, rtol=0, atol=1e-9 * np.abs(other.u).max())
    assert worst_certificate(sol) <= 1e-9
