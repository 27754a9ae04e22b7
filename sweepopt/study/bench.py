"""The benchmark: all contestants in one run, in turn, with the accuracy beside every time."""

from __future__ import annotations

import gc
from collections.abc import Callable, Mapping, Sequence
from importlib.util import find_spec

import numpy as np

from sweepopt.checks import count
from sweepopt.errors import InputError
from sweepopt.study.by_hand import Run
from sweepopt.study.cases import Case, blocks, square
from sweepopt.study.contestants import CONTESTANTS, TINY, Contestant, reference
from sweepopt.study.memory import peak
from sweepopt.study.rows import Row

NAIVE, LINEAR = "cvxpy-rebuilt", "frictionless"
BLOCKS = (1, 200)
BLOCK_STEPS = 20  # a block's step is so short that each round takes more of them

Say = Callable[[str], object]


def bench(
    cells: Sequence[int] = (32, 100),
    *,
    steps: int = 50,
    rounds: int = 3,
    only: Sequence[str] | None = None,
    tiny: bool = True,
    memory: bool = False,
    progress: Say | None = None,
) -> list[Row]:
    """Time the library's paths and the loops by hand on squares of several sizes.

    Parameters
    ----------
    cells : sequence of int
        Cells a side: 32, 100, 316, 1000 give 1,056, 10,100, 100,172 and 1,001,000 unknowns. Slow
        contestants leave out the large ones (`limit` in their table).
    steps : int
        At least 3, the same for everyone.
    rounds : int
        Each round runs every contestant once, set-up included.
    only : sequence of str, optional
        Paths to run; all by default.
    tiny : bool
        Also time one block and 200 blocks on springs, 20 times the steps, set-up in the steps.
    memory : bool
        Also run each contestant in a process of its own for its peak memory (Linux).
    progress : callable, optional
        Told what runs next, for example `print`.

    Returns
    -------
    list of Row
        By case; in each the reference comes first.

    Raises
    ------
    InputError
        If `only` names a path that is not there, or a number is out of range.
    """
    steps, rounds = count("steps", steps), count("rounds", rounds)
    if steps < 3:
        raise InputError("steps must be at least 3: two of them belong to the set-up")
    sizes = [count("cells", size) for size in cells]
    known = [contestant.path for contestant in (*CONTESTANTS, *TINY)]
    for path in only or ():
        if path not in known:
            raise InputError(f"only: there is no path {path!r}; there are: {', '.join(known)}")
    say = progress or (lambda _: None)
    rows: list[Row] = []
    for size in sizes:
        case = square(size, steps)
        measured = measure(case, entrants(CONTESTANTS, case.dim, only), rounds, say)
        rows += _with_memory(measured, size, say) if memory and measured else measured
    for dim in BLOCKS if tiny else ():
        case = blocks(dim, BLOCK_STEPS * steps)
        rows += measure(case, entrants(TINY, dim, only), rounds, say)
    return rows


def entrants(
    contestants: Sequence[Contestant], dim: int, only: Sequence[str] | None
) -> list[Contestant]:
    """Those that were chosen, can bear `dim` unknowns and have their package."""
    return [
        contestant
        for contestant in contestants
        if dim <= contestant.limit
        and (only is None or contestant.path in only)
        and find_spec(contestant.needs) is not None
    ]


def measure(case: Case, contestants: Sequence[Contestant], rounds: int, say: Say) -> list[Row]:
    """Run the contestants in turn, several rounds, and compare each with its reference."""
    if not contestants:
        return []
    say(f"{case.name}: reference")
    kinds = sorted({contestant.friction for contestant in contestants}, reverse=True)
    references = {friction: reference(case, friction) for friction in kinds}
    runs: dict[str, list[Run]] = {contestant.path: [] for contestant in contestants}
    differences = dict.fromkeys(runs, 0.0)
    for number in range(1, rounds + 1):
        for contestant in contestants:
            say(f"{case.name}: round {number} of {rounds}: {contestant.path}")
            gc.collect()
            run = contestant.run(case)
            away = difference(case, run.u, references[contestant.friction].u)
            differences[contestant.path] = max(differences[contestant.path], away)
            runs[contestant.path].append(run._replace(u=np.empty(0)))

    blank = Row(case.name, case.dim, case.contact.size, case.steps, rounds, "")
    rows = [
        blank._replace(
            path="reference" if friction else "reference, frictionless",
            attempts=found.attempts,
            certificate=found.certificate,
        )
        for friction, found in references.items()
    ]
    for contestant in contestants:
        row = _measured(blank, contestant, runs)
        rows.append(row._replace(difference=differences[contestant.path]))
    return rows


def _measured(blank: Row, contestant: Contestant, runs: Mapping[str, list[Run]]) -> Row:
    """The row of a contestant, beside the others' runs."""
    found = runs[contestant.path]
    steps = [run.step for run in found]
    naive = _compared(found, runs.get(NAIVE, []))
    return blank._replace(
        path=contestant.path,
        ms=1e3 * float(np.median(steps)),
        spread=float(np.ptp(steps) / np.median(steps)),
        setup=max(float(np.median([run.setup for run in found])), 0.0),
        recover=1e3 * float(np.median([run.recover for run in found])),
        attempts=found[0].attempts,
        certificate=found[0].certificate,
        naive=None if naive is None else 1 / naive,
        linear=_compared(found, runs.get(LINEAR, [])),
        overhead=_compared(found, runs.get(contestant.floor, [])),
    )


def _compared(ones: Sequence[Run], others: Sequence[Run]) -> float | None:
    """A ratio of times, each round for itself: what slows the machine slows both."""
    ratios = [one.step / other.step for one, other in zip(ones, others, strict=False)]
    return float(np.median(ratios)) if ratios else None


def difference(case: Case, u: np.ndarray, reference: np.ndarray) -> float:
    """max_i |u_i - r_i|_A / max_i |r_i|_A."""
    A = case.problem.A
    squares = [
        max(float(x @ (A @ x)) for x in rows)
        for rows in ((a - b for a, b in zip(u, reference, strict=True)), reference)
    ]
    return float(np.sqrt(squares[0] / squares[1]))


def _with_memory(rows: Sequence[Row], cells: int, say: Say) -> list[Row]:
    """The rows with their peak memory, after one of the scene alone."""
    paths = {contestant.path for contestant in CONTESTANTS}
    say(f"{cells} cells a side: memory of the scene")
    found = [Row(*rows[0][:5], "scene alone", peak=peak(cells, rows[0].steps))]
    for row in rows:
        if row.path in paths:
            say(f"{row.case}: memory of {row.path}")
            row = row._replace(peak=peak(cells, row.steps, row.path))
        found.append(row)
    return found
