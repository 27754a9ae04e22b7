"""Proportional materials: the contact alone enters the steps, all unknowns are reconstructed."""

import numpy as np
import pytest
import scipy.sparse as sp
from cases import refuses, worst_certificate

import sweepopt as so

pytestmark = pytest.mark.filterwarnings("ignore::sweepopt.InitialStateWarning")
RHO, CONTACT = 1.7, [3, 17, 30, 39]
SCHEMES = ["catching-up", "implicit-euler", "midpoint", "trapezoid", "sdirk2"]
SELECT = np.eye(40)[:, CONTACT]
SETS = {
    "intervals": so.Box([-1, -0.5, -0.2, -1], [1, 0.5, 0.2, 0.4]),
    "balls": so.Balls([0.7, 0.4], 2),
    "half-lines": so.Orthant(4),
}
INTERVALS = so.image(SELECT, SETS["intervals"])


def springs(k):
    """Springs of these stiffnesses in a row between two walls."""
    return sp.csc_array(sp.diags_array([k[:-1] + k[1:], -k[1:-1], -k[1:-1]], offsets=[0, -1, 1]))


CHAIN = springs(np.ones(41)) + 0.01 * sp.eye_array(40, format="csc")


TWO_TERMS = so.Separable([(so.Constant(), [1.5]), (so.Sine(1.0, 1.0), [1.0])])


def load(terms=2):
    histories = [so.Sine(2.0, 3.0), so.Triangle(1.0, 2.0), so.Constant(0.3)]
    shapes = [np.sin(np.arange(40) * (k + 1.0)) for k in range(terms)]
    return so.Separable(list(zip(histories, shapes, strict=False)))


def pressed(center, part=SETS["intervals"]):
    """Minus the set on the contact, moved by a load or by its terms."""
    center = center if isinstance(center, so.Separable) else so.Separable(center)
    return so.Moving(-so.image(SELECT, part), center)


def process(**changes):
    C = pressed(load(), changes.pop("part", SETS["intervals"]))
    data = {"A": CHAIN, "B": RHO * CHAIN, "C": C, "u0": 0.1 * np.cos(np.arange(40))}
    return so.SweepingProcess(**(data | changes))


def runs(this, **options):
    """By the proportional path, and with all unknowns in each step; to rounding."""
    few = so.solve(this, path="proportional", **{"tol": 1e-9, **options})
    assert worst_certificate(few) <= 1e-9
    return few, so.solve(this, path="eliminated", **{"tol": 1e-11, **options})


def difference(this, a, b):
    """The largest |a_i - b_i|_A, relative to b."""
    norm = this.metric.norm
    return max(map(norm, a - b)) / max(map(norm, b))


@pytest.mark.parametrize("rho", [1e-4, 1e-60])
def test_a_body_that_hardly_remembers_loses_no_digits(rho):
    # a load of 1 beside rho: an equilibrium that is 1 / rho away must enter nothing
    this = process(B=rho * CHAIN, C=pressed(load(3)))
    few, general = runs(this, t_end=3.0, steps=30)
    assert difference(this, few.u, general.u) <= 1e-11
    exact = so.solve(this, t_end=3.0, steps=1, scheme="exact").exact
    assert few.error_bound() >= max(map(this.metric.norm, few.u - exact(few.t)))


@pytest.mark.parametrize(
    "part, scheme",
    [
        *(("intervals", scheme) for scheme in SCHEMES),
        ("balls", "sdirk2"),
        ("half-lines", "midpoint"),
    ],
)
def test_the_contact_alone_gives_the_trajectory_of_all_unknowns(part, scheme):
    this = process(part=SETS[part])
    grid = 4 * np.linspace(0, 1, 30) ** 2
    few, general = runs(this, steps=grid, scheme=scheme, on_unstable="ignore")
    assert (few.plan.path, few.plan.entering) == (
        "proportional",
        4 + 3,
    )  # two loads, and what is left at the start
    assert difference(this, few.u, general.u) <= 1e-10
    assert difference(this, few.velocity, general.velocity) <= 1e-9


def test_sdirk32_agrees_where_nothing_stops():
    # which steps implicit Euler takes instead depends on the unknowns that enter
    ramp = so.Separable([(so.Polynomial([0.0, 3.0]), SELECT.sum(axis=1))])
    this = process(C=pressed(ramp), u0=np.zeros(40))
    few, general = runs(this, t_end=4.0, steps=40, scheme="sdirk32")
    assert not any("implicit-euler" in solver for solver in few.stats["solver"])
    assert difference(this, few.u, general.u) <= 1e-10


@pytest.mark.parametrize(
    "changes",
    [
        {"B": None, "u0": np.zeros(40)},
        {"A": CHAIN.toarray(), "B": RHO * CHAIN.toarray()},
        {"C": so.Moving(-INTERVALS, load(3), scale=lambda t: 1 + 0.5 * np.sin(t))},
        {"C": so.Moving(-INTERVALS, load(), scale=TWO_TERMS)},
        {"C": so.Moving(INTERVALS + np.ones(40), load(1))},
        {"C": INTERVALS + np.sin(np.arange(40))},
        {"C": -so.image(SELECT, SETS["balls"])},
    ],
    ids=["without elasticity", "dense", "scaled", "scaled by two terms",
         "a part of the load stands still", "no motion", "no load"],
)  # fmt: skip
def test_every_kind_of_proportional_process_is_found_and_agrees(changes):
    this = process(**changes)
    assert so.solve(this, t_end=3.0, steps=30).plan.path == "proportional"
    few, general = runs(this, t_end=3.0, steps=30)
    assert difference(this, few.u, general.u) <= 1e-10


WEAK = springs(np.r_[1e-9, np.ones(39), 1e-9])  # it hardly hangs on the walls
REFUSED = [
    ({"B": RHO * CHAIN + sp.diags_array(np.linspace(0, 1e-9, 40))}, "not a multiple"),
    ({"C": so.Moving(INTERVALS, lambda t: np.full(40, t))}, "not a Separable"),
    (
        {"C": so.Moving(INTERVALS + np.ones(40), load(), scale=lambda t: 1 + t)},
        "is scaled is not centred",
    ),
    # bool(np.poly1d([2.0])) is False
    ({"C": so.Moving(INTERVALS + np.ones(40), load(), scale=np.poly1d([2.0]))}, "not centred"),
    ({"A": 0 * CHAIN, "u0": np.zeros(40)}, "A is singular"),
    ({"C": so.Moving(so.Box(-np.ones(40), np.ones(40)), load())}, "few unknowns"),
    ({"A": WEAK, "B": RHO * WEAK, "u0": np.zeros(40)}, "too badly conditioned"),
]


@pytest.mark.parametrize("changes, reason", REFUSED, ids=[reason for _, reason in REFUSED])
def test_what_is_not_proportional_takes_another_path_and_says_why_it_cannot_be_forced(
    changes, reason
):
    this = process(**changes)
    assert so.solve(this, t_end=1.0, steps=4).plan.path in ("eliminated", "full")
    with refuses(reason):
        so.solve(this, t_end=1.0, steps=4, path="proportional")


def test_callbacks_and_failures_see_all_unknowns():
    this, seen = process(u0=np.zeros(40)), list[so.StepInfo]()
    sol = so.solve(this, t_end=4.0, steps=30, callback=seen.append)
    assert np.array_equal([info.u for info in seen], sol.u[1:])
    assert np.array_equal([info.velocity for info in seen], sol.velocity)
    assert repr(seen[3]).startswith(f"StepInfo(step=3, t={float(sol.t[4])}, u=(40,) in [")
    with pytest.raises(so.StepError) as caught:
        so.solve(this, t_end=4.0, steps=30, tol=1e-30)
    assert caught.value.u.shape == (40,)


@pytest.mark.parametrize("contrast", [1.0, 1e2, 1e3])
def test_the_certificate_bounds_the_error_of_all_unknowns_of_each_step(contrast):
    A = springs(np.where(np.arange(41) < 3, 1 / contrast, 1.0))
    this = process(A=A, B=RHO * A, u0=np.zeros(40))
    options = {"scheme": "implicit-euler", "tol": 1e-9}
    sol = so.solve(this, t_end=4.0, steps=60, path="proportional", **options)
    M = A + 4.0 / 60 * RHO * A
    for i in range(0, 60, 3):
        # the same step with all unknowns in it
        step = so.SweepingProcess(A, RHO * A, this.C, sol.u[i])
        one = so.solve(step, steps=sol.t[i : i + 2], path="eliminated", **options)
        z, error = one.velocity[0], sol.velocity[i] - one.velocity[0]
        stated = sol.stats["certificate"][i] + one.stats["certificate"][0]
        apart, size = np.sqrt(error @ (M @ error)), np.sqrt(z @ (M @ z))
        assert apart <= min(stated + 1e-14 * size, 1e-9)


# the motion has come to rest after steps of many periods
@pytest.mark.filterwarnings("ignore:the load has a period:sweepopt.StabilityWarning")
def test_short_steps_long_after_the_start_of_a_stiff_body_are_not_rounding():
    # the load's response is at rest but for 1e-11 of it, and then looked at closely
    grid = np.append(0.0, np.cumsum([400.0, 3000.0, 5e-6, 0.2, 1e-5, 6e-7]))
    this = process(B=1e8 * CHAIN, C=pressed(load(), so.Orthant(4)))
    sol = so.solve(this, steps=grid, scheme="implicit-euler", tol=1e-9)
    assert sol.plan.path == "eliminated"
    assert "short ones would be rounding" in str(sol.plan)
    assert worst_certificate(sol) <= 1e-9
    forced = so.solve(this, steps=grid, scheme="implicit-euler", path="proportional")
    assert difference(this, forced.u, sol.u) <= 1e-12
    norm, roots = this.metric.norm, np.sqrt(1 + 1e8 * np.diff(grid))  # |z|_M = root |z|_A
    apart = [norm(z) for z in forced.velocity - sol.velocity] * roots
    assert (apart <= forced.stats["certificate"] + sol.stats["certificate"]).all()
    assert apart[-1] > 1e-6 * norm(sol.velocity[-1]) * roots[-1]
    equal = so.solve(this, t_end=grid[-1], steps=1000, scheme="implicit-euler")
    assert equal.plan.path == "proportional"


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_body_held_for_a_while_is_u0_to_the_last_bit_and_then_moves_as_it_should(
    scheme,
):
    u0 = 1e3 * np.cos(np.arange(40))
    table = so.Table([0.0, 1.0, 2.0, 4.0], [-0.1, 0.1, 3.0, -3.0])
    late = so.Table([0.0, 2.0, 3.0, 4.0], [0.0, 0.0, 1.0, 0.0])
    # from t = 1: the contact slips, nothing else feels it but through it
    terms = [(so.Constant(1.0), RHO * CHAIN @ u0), (table, SELECT.sum(axis=1))]
    C = pressed([*terms, (late, np.sin(np.arange(40)))])
    this = process(u0=u0, C=C)
    few, general = runs(this, t_end=4.0, steps=40, scheme=scheme)
    held = few.t <= 1.0
    assert (few.u[held] == u0).all()
    assert (few.velocity[held[1:]] == 0.0).all()
    assert max(map(this.metric.norm, general.u - u0)) > 0.1
    assert difference(this, few.u, general.u) <= 1e-12


def test_a_body_that_sticks_under_no_load_is_certified():
    press = so.Table([0.0, 1.0, 2.0, 4.0], [0.0, 6.0, 0.0, 0.0])
    this = process(u0=np.zeros(40), B=0.01 * CHAIN, C=pressed([(press, SELECT.sum(axis=1))]))
    few, general = runs(this, t_end=4.0, steps=80)
    assert (few.velocity[-5:] == 0.0).all()
    assert few.u[-1, CONTACT].any()
    assert difference(this, few.u, general.u) <= 1e-12
