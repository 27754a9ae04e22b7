"""Bodies of any stiffness: "auto" beside the best of three, without ringing and false stick."""

import math
from itertools import cycle

import numpy as np
import pytest
from cases import block, slope, slow
from reference_cases import case

import sweepopt as so
from sweepopt.study.hard.stiff import BEST_OF, BODIES, LOADS, make, stiff_bodies


def check(row, over_best=2.0):
    assert row.over_best <= over_best, row
    assert row.verdict == "met", row  # no false stick, no ringing


SOME = [4.0, 1e2, 1e6, math.inf]
SEEDS = dict.fromkeys(BODIES, (1, 2, 3, 4, 5)) | {"discs": (1, 2)}
# mu Lam, seeds and steps where "auto" had 2.0 to 5.2 times the best error on whole steps
UNLUCKY = [
    ("one mass", "tables", 0.0377, [94916], [79], 1.0),
    ("one mass", "tables", 0.99, [29268], [64], 1.0),
    ("chain", "tables", 0.189, [23028], [52], 1.0),
    ("chain", "tables", 1.65, [73904], [88], 1.0),
    ("mixed", "tables", 0.0293, [12204], [39], 1.0),
    ("mixed", "tables", 0.0129, [64279], [40], 1.0),
    ("discs", "tables", math.inf, [11141], [38], 1.0),
]
MANY = [2.1, 5.0, 1e2, 1e4, 1e6, 1e8, math.inf]


@pytest.mark.parametrize(
    "body, load, stiffness, seeds, steps, over_best",
    [
        *(
            (*each, [0], [20], 2.0)
            for each in zip((one for one in SEEDS if one != "discs"), cycle(LOADS), SOME)
        ),
        # one mass of seven turns in the step in which four others start
        ("chain", "sines", math.inf, [42], [150], 0.5),
        # below two it neither rings nor is far from the best
        slow("chain", "sines", 0.01, [0], [25], 2.0),
        slow("chain", "tables", 1.9, [0], [25], 2.0),
        *(slow(*one) if k else one for k, one in enumerate(UNLUCKY)),
        # what rests in an earlier stage and starts is not carried too far: 2.3 if it counts as such
        ("mixed", "sines", 1e6, [7104], [100], 1.2),
        # one mass of seven was carried too far, and began its next slip a step late
        ("mixed", "sines", 1e6, [7], [60], 1.0),
        *(
            slow(body, load, stiffness, seeds, [60, 150], 2.0)
            for load in LOADS
            for body, seeds in SEEDS.items()
            for stiffness in MANY
        ),
    ],
)
def test_auto_is_at_most_twice_the_best_of_three(body, load, stiffness, seeds, steps, over_best):
    for row in stiff_bodies(seeds, [body], [load], [stiffness], steps, bounds=False):
        assert row.scheme == "sdirk32"
        check(row, over_best)


def test_auto_is_near_the_best_of_three_where_few_switches_of_a_soft_mass_count():
    # of 150 sines and 150 tables sdirk2 was above twice the best in 16, 29, 16, 24, 27, 32 of them
    for load, seeds in (("sines", (0,)), ("tables", (0, 16))):
        for seed in seeds:
            process, how = make("one mass", load, seed, 1e-2, 30), {"t_end": 1.0, "steps": 30}
            exact = so.solve(process, **how, scheme="exact").u
            auto, *best = (
                np.abs(so.solve(process, **how, scheme=scheme).u - exact).max()
                for scheme in ("auto", *BEST_OF)
            )
            assert auto <= 2 * min(best)


@pytest.mark.parametrize("load, seed", [("sines", 1), slow("tables", 13)])
def test_auto_is_near_the_best_of_three_in_the_mean_of_neighbouring_grids(load, seed):
    # on single grids errors of a soft mass cancel by chance: up to 3.2 times the best
    process, errors = make("one mass", load, seed, 1e-2, 30), []
    for steps in range(25, 37):
        how = {"t_end": 1.0, "steps": steps}
        *runs, exact = (
            so.solve(process, scheme=scheme, **how).u for scheme in ("auto", *BEST_OF, "exact")
        )
        errors.append([max(map(process.metric.norm, u - exact)) for u in runs])
    auto, *others = np.mean(errors, axis=0)
    assert auto <= 1.25 * min(others)


def test_a_bound_that_is_a_thousandth_above_the_error_is_not_below_that_of_the_reference():
    # a fine run in place of the exact one is off by more
    for row in stiff_bodies([2], ["one mass"], ["sines"], (0.5,), [150]):
        check(row)
        assert 1.0 <= row.bound_over_error <= 1.002


def test_a_body_that_never_moves_has_no_error_to_compare():
    for row in stiff_bodies([274411], ["one mass"], ["sines"], (1e6,), [60]):
        check(row)
        assert row.error == 0.0
        assert row.over_best == row.ringing == 1.0


@pytest.mark.parametrize("viscosity", [0.0, 1.0])
def test_auto_is_of_order_two_where_breakpoints_lie_in_steps(viscosity):
    turning = so.Table([0.0, 2.13, 6.31, 10.0], [0.0, 4.0, -4.0, 4.0])
    load = so.Separable([(turning, 1.0), (so.Sine(2.0, 3.3), 1.0)])
    process = block(load, viscosity, 1.0)
    grids, errors = (50, 100, 200, 400), []
    for steps in grids:
        how = {"t_end": 10.0, "steps": steps}
        sol = so.solve(process, **how, tol=1e-9)
        errors.append(np.abs(sol.u - so.solve(process, **how, scheme="exact").u).max())
        assert sol.plan.breakpoints.size == 2
    assert slope(grids, errors) >= 1.9
    assert errors[0] <= 0.02


@pytest.mark.filterwarnings("ignore::sweepopt.InitialStateWarning")  # it starts moving
@pytest.mark.parametrize("A", [1e-3, 1e-6])
def test_a_disc_that_is_pulled_round_turns_back_nowhere(A):
    """Steps of implicit Euler at each axis had 2.9 times the error of sdirk2.

    u = r (cos w t, sin w t) with A u' + u = f - u'/|u'|: r^2 + (1 + A r w)^2 = |f|^2, and f leads
    u by arccos(r / |f|).
    """
    w, size = 2 * math.pi, 2.0
    k = A * w  # (1 + k^2) r^2 + 2 k r + 1 = size^2
    r = (math.sqrt(k**2 + (1 + k**2) * (size**2 - 1)) - k) / (1 + k**2)

    def circle(t, radius, lead=0.0):
        return radius * np.stack([np.cos(w * t + lead), np.sin(w * t + lead)], axis=-1)

    C = so.Moving(so.Ball(np.zeros(2), 1.0), lambda t: circle(t, size, math.acos(r / size)))
    process = so.SweepingProcess(A * np.eye(2), np.eye(2), C, np.array([r, 0.0]))
    error = {}
    for scheme in ("auto", *BEST_OF):
        sol = so.solve(process, t_end=1.0, steps=40, scheme=scheme, on_unstable="ignore")
        error[scheme] = np.abs(sol.u - circle(sol.t, r)).max()
    assert error["auto"] <= 0.5 * min(error[scheme] for scheme in BEST_OF), error


def test_which_steps_are_stiff_is_asked_of_each():
    process = make("chain", "sines", 0, 4.0, 60)  # mu Lam of 4 and 1
    times = np.append(np.arange(30) / 60, 0.5 + np.arange(121) / 240)
    sol = so.solve(process, steps=times, on_unstable="ignore")
    euler = ["implicit-euler" in solver for solver in sol.stats["solver"]]
    assert any(euler[:30])
    assert not any(euler[30:])


@pytest.mark.filterwarnings("ignore::sweepopt.InitialStateWarning")
@pytest.mark.parametrize("name", ["S02", slow("V05"), slow("P09")])
def test_sdirk32_is_of_order_two(name):
    this = case(name)
    how = {"t_end": this.t_end, "scheme": "sdirk32", "tol": 1e-9}
    grids = (101, 211, 503, 1009, 2003)[: 5 if name == "P09" else 4]
    errors = [this.error(so.solve(this.process, steps=n, **how)) for n in grids]
    order = slope(grids, errors)
    assert order >= 1.9
    assert errors[0] <= 1.9 * min(this.errors[scheme]["101"] for scheme in BEST_OF)


@pytest.mark.filterwarnings("ignore::sweepopt.InitialStateWarning")
def test_sdirk32_overshoots_by_what_its_stability_function_says_and_by_6_5_percent_at_most():
    def R(z):
        return (1 + 0.4 * z + 0.02 * z**2) / (1 - z / 5) ** 3

    x = np.append(5.635, np.full(60, 1.9))  # of the first one alone: steps of implicit Euler
    process = so.SweepingProcess(np.eye(61), np.diag(x), so.Point(np.zeros(61)), np.ones(61))
    sol = so.solve(process, t_end=1.0, steps=1, scheme="sdirk32")
    assert sol.u[-1] == pytest.approx(R(-x), abs=1e-14)
    assert -0.065 <= R(-np.geomspace(1e-3, 1e6, 10_000)).min() == pytest.approx(R(-5.635))
