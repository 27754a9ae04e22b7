"""Multigrid in place of a factorisation: its solves, its bounds, and friction solved with it."""

from __future__ import annotations

import sys

import numpy as np
import pytest
import scipy.sparse as sp

pytest.importorskip("skfem")

import skfem

import sweepopt as so
from sweepopt.fem import Elasticity, Friction, Scene, Traction, Viscosity, antiplane
from sweepopt.integrate.schemes import SCHEMES
from sweepopt.linalg import Factor
from sweepopt.linalg.multigrid import Multigrid
from sweepopt.velocity.elimination import Solved
from sweepopt.velocity.plan import make_plan
from sweepopt.velocity.solvers.multigrid import MultigridProgram, Step


def patches(contrast: float):
    """A coefficient that jumps along curves that no mesh follows."""
    return lambda x: np.where(np.sin(7 * x[0]) * np.sin(9 * x[1] + 1) > 0.1, contrast, 1.0)


def scene(n: int, *, eta=1.0, element: str = "P1", power: float = 1.0) -> Scene:
    x = np.linspace(0, 1, n + 1)
    return antiplane(
        skfem.MeshTri.init_tensor(x**power, x).with_defaults(),
        clamped="top",
        element=element,
        effects=[
            Viscosity(eta),
            Elasticity(lambda x: 1 + x[0]),
            Friction("bottom", g=0.5),
            Traction("right", history=so.Sine(2.0, 4.0)),
        ],
    )


def chain(n: int, mass: float) -> sp.csc_array:
    rows = [np.full(n - 1, -1.0), np.full(n, 2.0 + mass), np.full(n - 1, -1.0)]
    return sp.csc_array(sp.diags_array(rows, offsets=[-1, 0, 1]))


def in_three_dimensions(n: int) -> sp.csc_array:
    one, eye = chain(n, 0.0), sp.eye_array(n)
    kron = sp.kron
    return sp.csc_array(
        kron(kron(one, eye), eye) + kron(kron(eye, one), eye) + kron(eye, kron(eye, one))
    )


def in_other_units(n: int) -> sp.csc_array:
    units = sp.diags_array(10.0 ** np.random.default_rng(1).uniform(-6, 6, n))
    return sp.csc_array(units @ chain(n, 0.01) @ units)


MATRICES = {
    "P1": lambda: scene(50).problem.as_sweeping().A,
    "P2": lambda: scene(25, element="P2").problem.as_sweeping().A,
    "jumps": lambda: scene(50, eta=patches(1e4)).problem.as_sweeping().A,
    "graded": lambda: scene(50, power=2.0).problem.as_sweeping().A,
    "3D": lambda: in_three_dimensions(12),
    "units": lambda: in_other_units(400),
    "mass": lambda: chain(400, 100.0),
    "diagonal": lambda: sp.csc_array(sp.diags_array(np.geomspace(1e-8, 1e8, 300))),
    "dense level only": lambda: chain(30, 0.0),
    "one unknown": lambda: sp.csc_array([[2.0]]),
}


@pytest.fixture(params=MATRICES)
def pair(request: pytest.FixtureRequest) -> tuple[Multigrid, Factor]:
    M = MATRICES[request.param]()
    return Multigrid(M), Factor(M)


def forces(M: Factor) -> list[np.ndarray]:
    rough = np.random.default_rng(2).normal(size=M.dim) * M.root
    point = np.zeros(M.dim)
    point[M.dim // 3] = 1.0
    return [rough, M.M @ (rough / M.diagonal), M.diagonal * M.solve(rough), point]


# ---- the matrix ---------------------------------------------------------------------------------


def test_solves_and_norms_agree_with_a_factorisation(pair: tuple[Multigrid, Factor]) -> None:
    many, one = pair
    assert many.is_diagonal == one.is_diagonal
    assert many.smallest_eigenvalue() == pytest.approx(one.smallest_eigenvalue(), rel=1e-6)
    for w in forces(one):
        z = one.solve(w)
        # what rounding leaves of both grows with the contrast of the coefficients
        assert one.norm(many.solve(w) - z) <= 2e-9 * one.norm(z)
        assert many.norm(z) == pytest.approx(one.norm(z))
        assert many.dual_norm(w) == pytest.approx(one.dual_norm(w))


def test_the_bound_is_never_below_the_dual_norm(pair: tuple[Multigrid, Factor]) -> None:
    many, one = pair
    for w in forces(one):
        exact = one.dual_norm(w)
        assert exact <= many.dual_norm_bound(w) <= 3 * exact
        assert 0.3 * exact <= many.dual_norm_floor(w) <= exact * (1 + 1e-12)
    assert many.dual_norm_bound(np.zeros(many.dim)) == 0.0


def test_the_residual_of_a_solve_is_small_and_a_start_helps() -> None:
    M = Multigrid(MATRICES["P1"]())
    w = np.random.default_rng(3).normal(size=M.dim)
    z = M.solve(w)
    assert np.linalg.norm(M.M @ z - w) <= 1e-12 * np.linalg.norm(w)
    assert M.norm(M.solve(w, start=z) - z) <= 1e-13 * M.norm(z)
    assert not M.solve(np.zeros(M.dim)).any()
    assert M.norm(M.solve(np.zeros(M.dim), start=z)) <= 1e-12 * M.norm(z)


def test_every_run_gives_the_same_numbers() -> None:
    A = MATRICES["jumps"]()
    w = np.random.default_rng(4).normal(size=A.shape[0])
    found = []
    for seed in (0, 1):
        np.random.seed(seed)  # noqa: NPY002 (pyamg draws from the global generator)
        M = Multigrid(A)
        found.append((M.solve(w), M.dual_norm_bound(w)))
    assert np.array_equal(found[0][0], found[1][0])
    assert found[0][1] == found[1][1]


@pytest.mark.parametrize("eta", [1.0, patches(1e4)], ids=["even", "jumps"])
def test_holding_contacts_costs_few_more_steps_on_every_mesh(eta) -> None:
    for n in (30, 60, 120):
        model = scene(n, eta=eta)
        M = Multigrid(model.problem.as_sweeping().A)
        w = np.random.default_rng(5).normal(size=M.dim) * M.root
        contact = model.contact.unknown
        for held in (contact[:0], contact, contact[: n // 2], contact[::2]):
            z, steps = M.correct(w, M.cycle(held), 1e-12)
            rest = (M.M @ z - w) / M.root
            rest[held] = 0.0
            assert not z[held].any()
            assert np.linalg.norm(rest) <= 1e-8 * np.linalg.norm(w / M.root)
            assert steps <= 28


def test_what_is_not_positive_definite_is_refused() -> None:
    neumann = chain(400, 0.0).tolil()
    neumann[0, 0] = neumann[-1, -1] = 1.0
    hidden = chain(400, 0.0).tolil()
    hidden[100, 101] = hidden[101, 100] = -2.5
    for bad in (
        neumann,
        neumann - 1e-6 * sp.eye_array(400),
        hidden,
        np.ones((2, 2)),
        np.array([[1.0, 2.0], [2.0, 1.0]]),
        np.diag([1.0, -1.0]),
    ):
        with pytest.raises(so.InputError, match="M must be positive definite"):
            Multigrid(sp.csc_array(bad))


def test_a_missing_pyamg_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyamg", None)
    with pytest.raises(so.MissingExtraError, match=r'pyamg.*pip install "sweepopt\[speed\]"'):
        Multigrid(chain(10, 0.0))


# ---- the velocity program -----------------------------------------------------------------------


def march(
    process: so.SweepingProcess, steps: int, t_end: float
) -> tuple[Factor, list[tuple[Step, Solved]]]:
    """The midpoint scheme with multigrid; beside each step the eliminated path's answer to it."""
    mu = t_end / steps
    M = process.A + 0.5 * mu * process.B
    C = process.C.at(0.5 * mu)
    selection = C.selection
    program = MultigridProgram(Multigrid(M), selection.unknowns)
    plan = make_plan(process, [(0.5 * mu, C)], SCHEMES["midpoint"], "auto", 1e-6)
    reference = plan.velocity(M)
    u, found = process.u0, []
    for i in range(steps):
        q, C = process.B @ u, process.C.at((i + 0.5) * mu)
        found.append((program(q, C.selection), reference(q, C)))
        u = u + mu * found[-1][0].velocity.z
    return Factor(M), found


def agree(M: Factor, found: list[tuple[Step, Solved]], relative: float) -> None:
    """Certified, and no farther from the other answer than the two certificates say."""
    size = max(M.norm(step.velocity.z) for step, _ in found)
    for step, other in found:
        assert step.velocity.relative <= relative
        apart = M.norm(step.velocity.z - other.velocity.z)
        assert apart <= step.velocity.certificate + other.velocity.certificate + 1e-14 * size


def test_friction_agrees_with_the_eliminated_path_while_the_load_rises_and_falls() -> None:
    model = scene(30)
    M, found = march(model.problem.as_sweeping(), 30, 4.0)
    agree(M, found, 1e-10)
    contact = model.contact.unknown
    size = max(M.norm(step.velocity.z) for step, _ in found)
    sticking = []
    for step, other in found:
        z = step.velocity.z
        assert M.norm(z - other.velocity.z) <= 1e-8 * size
        # stuck is 0.0 to the last bit, and never -0.0
        assert np.array_equal(z[contact] == 0.0, other.velocity.z[contact] == 0.0)
        assert not np.signbit(z[z == 0.0]).any()
        sticking.append((z[contact] == 0.0).sum())
    # all stick, some slip, all slip; and it turns more than once
    assert min(sticking) == 0
    assert max(sticking) == contact.size
    assert len(set(sticking)) > 6
    assert (np.diff(np.sign([step.velocity.z.sum() for step, _ in found])) != 0).sum() >= 2
    assert max(step.iterations for step, _ in found) <= 12


def test_a_run_ends_where_the_library_ends() -> None:
    process = scene(20).problem.as_sweeping()
    M, found = march(process, 40, 2.0)
    sol = so.solve(process, t_end=2.0, steps=40, scheme="midpoint", tol=1e-10)
    size = max(map(M.norm, sol.velocity))
    for (step, _), z in zip(found, sol.velocity, strict=True):
        assert M.norm(step.velocity.z - z) <= 1e-8 * size


@pytest.mark.parametrize(
    "change",
    [{"eta": patches(1e4)}, {"power": 2.0}, {"element": "P2"}],
    ids=["jumps", "graded", "P2"],
)
def test_friction_is_certified_on_hard_meshes_too(change: dict) -> None:
    # with jumps plain Newton steps cycle for ever: one contact at a time ends that
    n = 20 if "element" in change else 60 if "eta" in change else 40
    M, found = march(scene(n, **change).problem.as_sweeping(), 40, 4.0)
    agree(M, found, 1e-9)


@pytest.mark.parametrize(
    "part",
    [so.Box([-0.5, -1, -0.1, -2], [0.5, 1, 0.3, 2]), so.Orthant(4), 2 * so.Box([0] * 4, [1] * 4)],
    ids=["box", "half-lines", "0 on the rim"],
)
def test_other_separable_sets_that_move_and_scale(part: so.Box) -> None:
    n, unknowns = 200, [20, 80, 81, 199]
    E = sp.csc_array((np.ones(4), (unknowns, np.arange(4))), shape=(n, 4))
    C = so.Moving(
        -so.image(E, part),
        lambda t: np.sin(np.arange(n) / 30 + 3 * t) * np.sin(5 * t),
        lambda t: 1.5 + np.cos(t),
    )
    B = chain(n, 0.05) + sp.diags_array(np.linspace(0, 1, n), format="csc")
    M, found = march(so.SweepingProcess(chain(n, 0.05), B, C, np.zeros(n)), 40, 4.0)
    agree(M, found, 1e-10)
    assert len({tuple(step.velocity.z[unknowns] == 0.0) for step, _ in found}) > 2


def test_a_force_inside_the_set_moves_nothing_and_costs_nothing() -> None:
    model = scene(10)
    process = model.problem.as_sweeping()
    M, contact = Multigrid(process.A), model.contact.unknown
    program = MultigridProgram(M, contact)
    C = process.C.at(0.7)
    pushed = program(np.zeros(M.dim), C.selection)
    assert pushed.cycles > 0
    inside = C.project(np.zeros(M.dim))
    rest = program(inside, C.selection)
    assert not rest.velocity.z.any()
    assert (rest.velocity.certificate, rest.velocity.relative, rest.cycles) == (0.0, 0.0, 0)
    again = program(np.zeros(M.dim), C.selection)
    difference = again.velocity.z - pushed.velocity.z
    assert M.norm(difference) <= again.velocity.certificate + pushed.velocity.certificate


def test_too_few_iterations_give_an_honest_certificate() -> None:
    model = scene(20)
    process = model.problem.as_sweeping()
    contact, q, C = model.contact.unknown, np.zeros(process.dim), process.C.at(0.1)
    M = Multigrid(process.A)
    exact = MultigridProgram(M, contact, tol=1e-12)(q, C.selection).velocity
    for max_iter in range(5):
        found = MultigridProgram(M, contact, max_iter=max_iter)(q, C.selection)
        assert found.iterations <= max_iter
        apart = M.norm(found.velocity.z - exact.z)
        assert apart <= found.velocity.certificate + exact.certificate
    loose = MultigridProgram(M, contact, tol=1e-4)(q, C.selection)
    assert 1e-12 < loose.velocity.relative <= 1e-4
    assert M.norm(loose.velocity.z - exact.z) <= loose.velocity.certificate + exact.certificate


def test_sets_that_couple_unknowns_are_refused() -> None:
    E = sp.csc_array((np.ones(4), ([1, 2, 5, 6], np.arange(4))), shape=(60, 4))
    selection = so.image(E, so.Balls([0.1, 0.2], 2)).selection
    program = MultigridProgram(Multigrid(chain(60, 0.1)), selection.unknowns)
    with pytest.raises(so.SolverRefusedError, match="Balls"):
        program(np.ones(60), selection)


# ---- the path of a plan -------------------------------------------------------------------------


def refuse(*_: object, **__: object) -> None:
    raise AssertionError("something was factorised")


def test_the_path_moves_a_body_as_the_eliminated_one_does() -> None:
    problem = scene(24).problem
    this = problem.as_sweeping()
    ours, theirs = (
        so.solve(problem, t_end=4.0, steps=30, path=path) for path in ("multigrid", "eliminated")
    )
    assert ours.plan.path == "multigrid"
    assert ours.plan.eliminated == 0
    assert set(ours.stats["solver"]) <= {"multigrid", "at rest"}
    assert ours.stats["relative"].max() <= 1e-9
    size = max(map(this.metric.norm, theirs.u))
    assert max(map(this.metric.norm, ours.u - theirs.u)) <= 1e-8 * size
    assert np.array_equal(ours.velocity == 0.0, theirs.velocity == 0.0)


def test_what_does_not_fit_is_never_factorised(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = scene(16).problem
    dry = so.EvolutionVI(problem.A, problem.B, load=problem.load, u0=problem.u0)
    expected = [so.solve(one, t_end=2.0, steps=10).u for one in (problem, dry)]
    monkeypatch.setattr("sweepopt.linalg.multigrid._physical_memory", lambda: 1e5)
    for way in ("whole", "halves"):
        monkeypatch.setattr(f"sweepopt.linalg.factor.{way}", refuse)
    for one, u in zip((problem, dry), expected, strict=True):
        process = one.as_sweeping()
        assert isinstance(process.metric, Multigrid)
        sol = so.solve(process, t_end=2.0, steps=10)
        assert sol.plan.path == "multigrid"
        assert sol.u == pytest.approx(u, abs=1e-8 * np.abs(u).max())
        assert sol.viability(1.0) <= 0.1


def test_sets_that_multigrid_does_not_treat_are_refused_before_the_run() -> None:
    A, ball = chain(40, 0.1), so.image(np.eye(40)[:, [3, 5]], so.Ball([0, 0], 1.0))
    for A_, C, words in (
        (A, ball, "acts on few unknowns, each alone"),
        (A, so.Box(-np.ones(40), np.ones(40)), "acts on few unknowns"),
        (A.toarray(), so.Point(np.ones(40)), "sparse matrix"),
    ):
        with pytest.raises(so.InputError, match=words):
            so.solve(so.SweepingProcess(A_, None, C, np.zeros(40)), t_end=1.0, path="multigrid")


def test_factors_that_memory_refuses_name_the_way_out(monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise MemoryError

    monkeypatch.setattr("sweepopt.linalg.factor.whole", full)
    with pytest.raises(so.SolverRefusedError, match=r"do not fit in memory.*multigrid"):
        Factor(chain(10, 0.0))
