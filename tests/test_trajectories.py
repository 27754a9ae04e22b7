"""Hard trajectories: the judge against the inclusion, every scheme against the judge."""

import numpy as np
import pytest
from study_table import lie
from test_exact import exact, integral_error, residual

import sweepopt as so
from sweepopt.integrate import SCHEMES
from sweepopt.study.hard import trajectories
from sweepopt.study.hard.suite import GOOD
from sweepopt.study.hard.trajectories import (
    TRAJECTORIES,
    Case,
    hard_trajectories,
)

SHORT = sorted({*TRAJECTORIES} - {"thousand_cycles", "chatter_stiff"})  # which -m slow has


@pytest.fixture(autouse=True)
def _a_few_periods(request, monkeypatch):
    """Of each trajectory; those that are marked slow have all of it."""
    if not request.node.get_closest_marker("slow"):
        for name, keys in TRAJECTORIES.items():
            steps = max(0.4 * keys["steps"], 30)
            monkeypatch.setitem(TRAJECTORIES, name, keys | {"steps": steps})


def runs(name, seed, schemes):
    return hard_trajectories([seed], [name], schemes)


def checked(name, seed, schemes=("auto", *SCHEMES)):
    for row in runs(name, seed, schemes):
        assert row.verdict in GOOD, row
        # those that rest falsely are known, and say so; "auto" is none of them
        ringing = row.scheme in ("midpoint", "trapezoid", "sdirk2")
        assert (row.verdict == "warned") <= (
            row.mu_Lam > 1 and (ringing or row.scheme == "catching-up")
        ), row


# ---- the judge --------------------------------------------------------------------------------


@pytest.mark.filterwarnings("ignore::sweepopt.InitialStateWarning")
@pytest.mark.parametrize(
    "name", sorted({*SHORT} - {"singular", "indefinite", "no_viscosity_outside", "chatter"})[::3]
)
def test_the_exact_trajectory_satisfies_the_inclusion_and_is_what_runs_are_judged_by(
    name,
):
    case, random = Case(TRAJECTORIES[name], np.random.default_rng(5)), np.random.default_rng(0)
    process = case.process()
    found = exact(process, None, steps=case.t)
    assert residual(process, found, random.uniform(case.t[0], case.t[-1], 20)) <= 1e-12
    size = np.abs(found(case.t)).max()
    if len(found.phases) < 100:
        assert integral_error(found) <= 1e-11 * size
    judged = (case.exact[::2] + case.center) @ case.axes.T
    np.testing.assert_allclose(judged, found(case.t), rtol=0, atol=1e-12 * size)


# ---- every scheme -----------------------------------------------------------------------------


@pytest.mark.parametrize("turn, name", [*enumerate(SHORT)])
def test_every_scheme_has_the_error_that_it_should_have(turn, name, monkeypatch):
    monkeypatch.setattr(trajectories, "BOUNDED", 0)  # bounds take ten times as long as all the rest
    named = [*SCHEMES]  # one of them in turn here, but for "many" all; all of all with -m slow
    checked(name, 0, ("auto", *(named if name == "many" else [named[turn % len(named)]])))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("name", TRAJECTORIES)
def test_every_scheme_has_the_error_that_it_should_have_for_every_seed(name, seed):
    checked(name, seed)


def test_bounds_are_above_the_error_of_few_steps():
    names = ["ordinary", "no_viscosity"]  # the others with -m slow
    rows = [row for name in names for row in runs(name, 3, ["catching-up", "sdirk2"])]
    ratios = [row.bound for row in rows if row.verdict != "refused"]
    assert len(ratios) == 3  # catching-up takes no A = 0
    assert min(ratios) >= 1.0


def test_the_judge_sees_what_is_wrong(monkeypatch):
    def judged(scheme="implicit-euler", **changes):
        lie(monkeypatch, **changes)
        return next(runs("ordinary", 0, [scheme])).verdict

    def euler(sol):
        how = {"t_end": sol.t[-1], "steps": len(sol.velocity)}
        return so.solve(sol.process, **how, scheme="implicit-euler").u

    def at_rest(sol):
        return np.where(np.arange(len(sol.velocity))[:, None] % 7, sol.velocity, 0.0)

    def never_at_rest(sol):
        return np.where(sol.velocity == 0, 1e-3, sol.velocity)

    def low_bound(sol):
        bound = sol.error_bound()
        return lambda: type(bound).make("", bound.t, 0.5 * bound.of_t, bound.B, 0.0)

    def unbalanced(sol):
        energy = sol.energy()
        return lambda: energy._replace(viscous=1.5 * energy.viscous)

    assert judged() == "met"
    assert judged(error_bound=low_bound) == "bound below the error"
    monkeypatch.setattr(trajectories, "BOUNDED", 0)
    assert judged(u=lambda sol: 1.5 * sol.u) == "error above that of the scheme"
    assert judged("midpoint", u=euler) == "error above that of the scheme"
    assert judged(velocity=at_rest) == "false stick"
    assert judged(velocity=never_at_rest) == "false slip"
    assert judged(energy=unbalanced) == "energy out of balance"
    assert judged(success=lambda _: False).startswith("stopped: ")


def test_what_must_be_refused_is_missed_if_it_is_not(monkeypatch):
    keys = TRAJECTORIES["ordinary"] | {"steps": 5, "refused": "IndefiniteError"}
    monkeypatch.setitem(TRAJECTORIES, "ordinary", keys)
    (row,) = runs("ordinary", 0, ["midpoint"])
    assert row.verdict == "not refused with IndefiniteError" not in GOOD
    (row,) = runs("indefinite", 0, ["midpoint"])
    assert row.verdict == "refused"
