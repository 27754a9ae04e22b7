"""Hard trajectories: the judge against closed forms and the inclusion, every scheme against it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from play import Play

import sweepopt as so
from sweepopt.integrate import SCHEMES
from sweepopt.study.hard import suite, trajectories
from sweepopt.study.hard.suite import GOOD
from sweepopt.study.hard.trajectories import (
    TRAJECTORIES,
    Case,
    TrajectoryRow,
    TrajectoryStudy,
)

SHORT = sorted({*TRAJECTORIES} - {"thousand_cycles"})


def runs(name: str, seed: int, schemes: Sequence[str]) -> Iterator[TrajectoryRow]:
    return TrajectoryStudy([seed], [name], schemes).rows()


def checked(name: str, seed: int, schemes: tuple[str, ...] = ("auto", *SCHEMES)) -> None:
    for row in runs(name, seed, schemes):
        assert row.verdict in GOOD, row
        # those that rest falsely are known, and say so; "auto" is none of them
        ringing = row.scheme in ("midpoint", "trapezoid", "sdirk2")
        assert (row.verdict == "warned") <= (
            row.mu_Lam > 1 and (ringing or row.scheme == "catching-up")
        ), row


# ---- the judge --------------------------------------------------------------------------------


def test_the_play_is_that_of_closed_forms() -> None:
    flat = ([0.0, 20.0], [0.0, 0.0])
    times = np.linspace(0.0, 20.0, 101).tolist()
    # no friction: 2 u' + 3 u = 5 sin(4 t)
    free = Play(2.0, 3.0, 0.7, flat, flat, (5.0, 4.0)).states(times)
    t = np.array(times)
    steady = 5 * (3 * np.sin(4 * t) - 8 * np.cos(4 * t)) / 73
    assert free == pytest.approx(steady + (0.7 + 40 / 73) * np.exp(-1.5 * t), abs=1e-14)
    # no viscosity, a triangle of amplitude 3: 2 u stays 1 behind the load
    load, one = ([0.0, 3.0, 9.0, 15.0, 20.0], [0.0, 3.0, -3.0, 3.0, -2.0]), ([0.0, 20.0], [1.0] * 2)
    play = Play(0.0, 2.0, 0.0, load, one).states([0.0, 1.0, 2.0, 3.0, 5.0, 7.0, 9.0, 11.0, 15.0])
    assert 2 * play == pytest.approx([0, 0, 1, 2, 2, 0, -2, -2, 2], abs=1e-14)
    # no spring: A u' = f - 1 while the load of slope 1 is above it
    slide = Play(0.5, 0.0, 0.0, ([0.0, 4.0, 8.0], [0.0, 4.0, 0.0]), one).states(
        [0.0, 4.0, 7.0, 8.0]
    )
    assert slide == pytest.approx([0.0, 9.0, 18.0, 18.0], abs=1e-14)


def points(load: Any, end: float) -> Any:
    """A load as lines between points, and a wave."""
    if isinstance(load, so.Sine):
        return ([0.0, end], [0.0, 0.0]), (load.amplitude, 2 * np.pi / load.period)
    return (load.times.tolist(), load.values.tolist()), (0.0, 1.0)


@pytest.mark.filterwarnings("ignore::sweepopt.InitialStateWarning")
@pytest.mark.parametrize("name", sorted({*SHORT} - {"singular", "no_viscosity_outside"}))
def test_the_exact_trajectory_is_that_of_an_independent_code(name: str) -> None:
    case = Case(TRAJECTORIES[name], np.random.default_rng(5))
    t = case.t.tolist()
    scale = case.scale if isinstance(case.scale, so.Table) else so.Table([0, t[-1]], [1, 1])
    for k, load in enumerate(case.loads):
        line, wave = points(load, t[-1])
        friction = scale.times.tolist(), (case.g[k] * scale.values).tolist()
        numbers = (float(x[k]) for x in (case.A, case.B, case.starts))
        play = Play(*numbers, line, friction, wave).states(t)
        # of loads that hardly leave the bounds the differences go
        forces = abs(load(case.t)).max() / max(case.B[k], case.A[k] / t[-1])
        atol = 1e-12 * abs(play).max() + 1e-14 * forces
        np.testing.assert_allclose(case.exact[::2, k], play, rtol=0, atol=atol)


# ---- every scheme -----------------------------------------------------------------------------


@pytest.mark.parametrize(("turn", "name"), [*enumerate(SHORT)])
def test_every_scheme_has_the_error_that_it_should_have(
    turn: int, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(trajectories, "BOUNDED", 0)  # bounds take ten times as long as all the rest
    named = [*SCHEMES]  # "auto" and one of them in turn here, all of them with -m slow
    checked(name, 0, ("auto", named[turn % len(named)]))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("name", TRAJECTORIES)
def test_every_scheme_has_the_error_that_it_should_have_for_every_seed(
    name: str, seed: int
) -> None:
    checked(name, seed)


def test_midpoint_rests_falsely_on_stiff_bodies_and_warns_from_ten_thirds_on() -> None:
    for stiffness, warned in ((3.3, False), (3.4, True), (1e3, True)):
        with pytest.MonkeyPatch.context() as patch:
            changed = TRAJECTORIES["ordinary"] | {"mu_Lam": stiffness}
            patch.setitem(TRAJECTORIES, "ordinary", changed)
            midpoint, auto = runs("ordinary", 0, ("midpoint", "auto"))
        assert midpoint.verdict == ("warned" if warned else "met")
        assert (auto.verdict, auto.false_sticks) == ("met", 0)
    assert midpoint.false_sticks > 0


def test_bounds_are_above_the_error_of_few_steps() -> None:
    names = ["ordinary", "stiff", "no_viscosity", "closing"]
    schemes = ["catching-up", "implicit-euler", "sdirk2"]
    rows = [row for name in names for row in runs(name, 3, schemes)]
    ratios = [row.bound for row in rows if row.verdict != "refused"]
    assert len(ratios) >= 10
    assert min(ratios) >= 1.0


def test_the_judge_sees_what_is_wrong(monkeypatch: pytest.MonkeyPatch) -> None:
    def lie(scheme: str = "implicit-euler", **changes: Any) -> TrajectoryRow:
        """A run of which something is not that of the library."""

        def lying(*process: Any, **settings: Any) -> Any:
            sol = so.solve(*process, **settings)
            said = {name: getattr(sol, name) for name in ("u", "velocity", "energy", "error_bound")}
            said |= {name: getattr(sol, name) for name in ("plan", "stats", "success", "message")}
            return SimpleNamespace(**said | {name: f(sol) for name, f in changes.items()})

        monkeypatch.setattr(suite, "solve", lying)
        return next(runs("ordinary", 0, [scheme]))

    def euler(sol: so.Solution) -> np.ndarray:
        how: Any = {"t_end": sol.t[-1], "steps": len(sol.velocity)}
        return so.solve(sol.process, **how, scheme="implicit-euler").u

    def at_rest(sol: so.Solution) -> np.ndarray:
        return np.where(np.arange(len(sol.velocity))[:, None] % 7, sol.velocity, 0.0)

    def never_at_rest(sol: so.Solution) -> np.ndarray:
        return np.where(sol.velocity == 0, 1e-3, sol.velocity)

    def low_bound(sol: so.Solution) -> Any:
        bound = sol.error_bound()
        return lambda: type(bound).make("", bound.t, 0.5 * bound.of_t, bound.B, 0.0)

    def unbalanced(sol: so.Solution) -> Any:
        energy = sol.energy()
        return lambda: energy._replace(viscous=1.5 * energy.viscous)

    assert lie().verdict == "met"
    assert lie(u=lambda sol: 1.5 * sol.u).verdict == "error above that of the scheme"
    assert lie("midpoint", u=euler).verdict == "error above that of the scheme"
    assert lie(velocity=at_rest).verdict == "false stick"
    assert lie(velocity=never_at_rest).verdict == "false slip"
    assert lie(error_bound=low_bound).verdict == "bound below the error"
    assert lie(energy=unbalanced).verdict == "energy out of balance"
    assert lie(success=lambda _: False).verdict.startswith("stopped: ")


def test_what_must_be_refused_is_missed_if_it_is_not(monkeypatch: pytest.MonkeyPatch) -> None:
    keys = TRAJECTORIES["ordinary"] | {"steps": 5, "refused": "IndefiniteError"}
    monkeypatch.setitem(TRAJECTORIES, "ordinary", keys)
    (row,) = runs("ordinary", 0, ["midpoint"])
    assert row.verdict == "not refused with IndefiniteError" not in GOOD
    (row,) = runs("singular", 0, ["midpoint"])
    assert row.verdict == "refused"
