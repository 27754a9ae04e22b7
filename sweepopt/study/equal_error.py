"""What every way costs at one error: its cheapest setting is looked for, then all run in turn.

    python -m sweepopt.study.equal_error S03 --error 1e-6

Nothing is extrapolated in silence: where a run would take too many steps, the table says so.
"""

from __future__ import annotations

import argparse
import gc
import math
import sys
import time
from collections.abc import Callable, Sequence
from statistics import median
from typing import NamedTuple

from sweepopt.checks import count, number
from sweepopt.errors import InputError
from sweepopt.study.problems import problem
from sweepopt.study.rows import aligned, machine
from sweepopt.study.ways import REPORTS, Ladder, Run, Steps, Task, Way, all_ways

LOOSE, TRIES = 1.25, 20
"""Steps are cheapest when a power law between two runs says that 1 / LOOSE of them is too few."""
GROWTH, MARGIN = 10.0, 1.02
SLOW = 2.0
"""Seconds from which on a run is timed once."""
MOST = 20_000_000


class Cost(NamedTuple):
    """What a way costs.

    Attributes
    ----------
    way, setting : str
    error : float
        The largest |u - exact|_A of the reports, of the run that was timed.
    seconds : float
        Median over the rounds.
    ratio : float
        seconds / those of the fastest way that reached the error without extrapolation.
    note : str
        "" | "one run" | "extrapolated ..." | "not reached".
    """

    way: str
    setting: str
    error: float
    seconds: float
    ratio: float = math.nan
    note: str = ""


class Found(NamedTuple):
    """The cheapest run that was found, how long it took then, and by what a cost is multiplied."""

    way: str
    run: Run
    error: float
    seconds: float
    factor: float = 1.0
    note: str = ""


def equal_error(
    task: Task,
    wanted: float,
    *,
    ways: Sequence[Way] | None = None,
    rounds: int = 5,
    most: int = MOST,
    progress: Callable[[str], object] | None = None,
) -> list[Cost]:
    """Time each way at its cheapest setting whose error is at most `wanted`.

    Parameters
    ----------
    task : Task
    wanted : float
        In |.|_A.
    ways : sequence of Way, optional
        By default all that `ways.all_ways` knows; of several with one name the fastest counts.
    rounds : int
        In each of them all ways run once, in turn.
    most : int
        Steps of the longest run; what needs more is extrapolated from it, and says so.
    progress : callable, optional

    Returns
    -------
    list of Cost
        The fastest first, what did not reach the error last.
    """
    wanted = number("wanted", wanted, minimum=0.0, strict=True)
    rounds, most = count("rounds", rounds), count("most", most)
    if most < REPORTS:
        raise InputError(f"most must be at least {REPORTS}, the times at which u is reported")
    say = progress or (lambda _: None)
    found = []
    for way in all_ways(task) if ways is None else ways:
        found.append(cheapest(task, way, wanted, most))
        say(f"{way.name}: {found[-1].run.setting}, error {found[-1].error:.1e}")
    return timed(_fastest(found), rounds)


def cheapest(task: Task, way: Way, wanted: float, most: int = MOST) -> Found:
    """The cheapest setting of a way that reaches an error."""
    if isinstance(way, Steps):
        return _by_steps(task, way, wanted, most)
    return _by_ladder(task, way, wanted)


def _by_ladder(task: Task, way: Ladder, wanted: float) -> Found:
    best: Found | None = None
    for run in way.rungs(wanted):
        found = _tried(task, way, run)
        if found.error <= wanted:
            return found
        best = found if best is None or found.error < best.error else best
    assert best is not None  # a ladder has rungs
    return best._replace(note="not reached")


def _by_steps(task: Task, way: Steps, wanted: float, most: int) -> Found:
    """Secants on the logarithms, until passing and failing runs say that fewer would not do."""
    fails: list[tuple[int, float]] = []
    passing: tuple[int, Found] | None = None
    steps = REPORTS
    for _ in range(TRIES):
        found = _tried(task, way, way.run(steps))
        if found.error <= wanted:
            passing = steps, found
        else:
            fails.append((steps, found.error))
        need = _needed(fails, passing, wanted)
        if passing and (not fails or passing[0] <= LOOSE * need):
            break
        if not passing and need > most and fails[-1][0] * LOOSE > most:
            return _extrapolated(fails, found, need, most)
        steps = _multiple(min(need * MARGIN, GROWTH * fails[-1][0], most))
        if steps <= fails[-1][0] or (passing and steps >= passing[0]):
            break
    return passing[1] if passing else found._replace(note="not reached")


def _needed(
    fails: Sequence[tuple[int, float]], passing: tuple[int, Found] | None, wanted: float
) -> float:
    """Steps for the wanted error by the power law through the last two runs."""
    if not fails:
        return REPORTS
    steps, error = fails[-1]
    order = observed(fails, passing)
    return steps * (error / wanted) ** (1.0 / order)


def observed(fails: Sequence[tuple[int, float]], passing: tuple[int, Found] | None) -> float:
    """The order between the last two runs, kept within 0.5 and 4; 1 of a single run."""
    points = list(fails[-2:])
    if passing:
        points = [fails[-1], (passing[0], max(passing[1].error, 1e-300))]
    if len(points) < 2:
        return 1.0
    (few, large), (many, small) = points
    return min(max(math.log(large / small) / math.log(many / few), 0.5), 4.0)


def _extrapolated(
    fails: Sequence[tuple[int, float]], found: Found, need: float, most: int
) -> Found:
    steps = fails[-1][0]
    note = (
        f"extrapolated to {need:.2g} steps, order {observed(fails, None):.2f}: the limit is {most}"
    )
    return found._replace(factor=need / steps, note=note)


def _multiple(steps: float) -> int:
    return REPORTS * math.ceil(steps / REPORTS)


def _tried(task: Task, way: Way, run: Run) -> Found:
    started = time.perf_counter()
    u = run.states()
    seconds = time.perf_counter() - started
    return Found(way.name, run, task.error(u), seconds)


def _fastest(found: Sequence[Found]) -> list[Found]:
    """One of each name: the fastest of those that reached the error."""
    chosen: dict[str, Found] = {}
    for one in found:
        other = chosen.get(one.way)
        if other is None or (bool(one.note), one.seconds) < (bool(other.note), other.seconds):
            chosen[one.way] = one
    return list(chosen.values())


def timed(found: Sequence[Found], rounds: int) -> list[Cost]:
    """All in turn, several rounds; slow ones keep the time they took when they were found."""
    seconds: dict[str, list[float]] = {
        one.way: [one.seconds] if one.seconds > SLOW else [] for one in found
    }
    for _ in range(rounds):
        for one in found:
            if one.seconds <= SLOW:
                gc.collect()
                started = time.perf_counter()
                one.run.states()
                seconds[one.way].append(time.perf_counter() - started)
    best = min(
        (one for one in found if not one.note),
        key=lambda one: median(seconds[one.way]),
        default=None,
    )
    rows = []
    for one in found:
        took = [one.factor * each for each in seconds[one.way]]
        note = one.note or ("one run" if one.seconds > SLOW else "")
        row = Cost(one.way, one.run.setting, one.error, median(took), math.nan, note)
        rows.append(row._replace(ratio=_ratio(took, seconds[best.way]) if best else math.nan))
    return sorted(rows, key=lambda row: (row.note == "not reached", row.seconds))


def _ratio(one: Sequence[float], other: Sequence[float]) -> float:
    """Each round for itself, as what slows the machine slows both; of medians if one ran once."""
    if len(one) != len(other):
        return median(one) / median(other)
    return median(a / b for a, b in zip(one, other, strict=True))


def cost_table(costs: Sequence[Cost], wanted: float) -> str:
    """The costs as text."""
    lines = [["way", "setting", "error", "ms", "x best", ""]]
    lines += [
        [
            cost.way,
            cost.setting,
            f"{cost.error:.1e}",
            f"{1e3 * cost.seconds:.4g}",
            f"{cost.ratio:.3g}",
            cost.note,
        ]
        for cost in costs
    ]
    return f"error at most {wanted:g} at {REPORTS} equal times\n{aligned(lines)}"


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table of a problem."""
    parser = argparse.ArgumentParser(description="What every way costs at one error.")
    parser.add_argument("problem", help="one with a block on a dashpot, as S01, S02, S03 or block")
    parser.add_argument("--error", type=float, nargs="+", default=[1e-6])
    parser.add_argument("--t-end", type=float, help="shorter than the problem")
    parser.add_argument("--most", type=int, default=MOST, help="steps of the longest run")
    parser.add_argument("--rounds", type=int, default=5)
    chosen = parser.parse_args(arguments)
    posed = problem(chosen.problem)
    task = Task(posed.process(), chosen.t_end or posed.t_end)
    print(f"{machine()}\n{posed.name}: {posed.title}, t_end {task.t_end:g}")
    for wanted in chosen.error:
        costs = equal_error(
            task,
            wanted,
            rounds=chosen.rounds,
            most=chosen.most,
            progress=lambda words: print(words, file=sys.stderr, flush=True),
        )
        print(f"\n{cost_table(costs, wanted)}", flush=True)


if __name__ == "__main__":
    main()
