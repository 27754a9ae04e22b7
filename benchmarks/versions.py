"""Two installed versions of the library beside each other, case by case, in one run.

    python benchmarks/versions.py --python OLD_PYTHON --python NEW_PYTHON [--only NAME ...]

An interpreter may have variables before it: ``--python 'PYTHONPATH=/tree /venv/bin/python'``.
Each case of `version_cases.py` runs in a process of its own, the versions in turn, `--rounds`
times. What counts is the ratio new/old, the median of those of the rounds: the machine's speed
changes from hour to hour. "step" is the median of the steps' own times, "else" the rest of the run
(checks, factors, reading u), "cpu" the processor's time for all of it, "peak" the memory of the
process; certificates are relative, "apart" is the difference of the last states.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import shlex
import statistics
import subprocess
from pathlib import Path
from typing import Any

CASES = Path(__file__).resolve().with_name("version_cases.py")
COLUMNS = {"step": ("step ms", 1e3), "rest": ("else s", 1.0), "cpu": ("cpu s", 1.0),
           "peak": ("peak MB", 1.0)}  # fmt: skip


def run(python: str, name: str = "") -> Any:
    """What a case says that an interpreter runs, or the last line of its error."""
    *variables, executable = shlex.split(python)
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    given = dict(word.split("=", 1) for word in variables)
    done = subprocess.run(
        [executable, str(CASES), name],
        env={**os.environ, **threads, **given},
        capture_output=True,
        text=True,
    )
    if done.returncode:
        return (done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1]
    return json.loads(done.stdout.splitlines()[-1])


def row(name: str, rounds: list[tuple[Any, Any]]) -> str:
    """A line of the table from pairs of runs."""
    failed = {text for pair in rounds for text in pair if isinstance(text, str)}
    if failed:
        return f"{name:<20}failed: {'; '.join(sorted(failed))}"
    cells = []
    for key, (_, scale) in COLUMNS.items():
        pairs = [(old[key], new[key]) for old, new in rounds]
        if any(not value for pair in pairs for value in pair):
            cells.append(" " * 25)
            continue
        old, new = (scale * statistics.median(side) for side in zip(*pairs, strict=True))
        ratio = statistics.median(b / a for a, b in pairs)
        cells.append(f"{old:>9.4g}{new:>9.4g}{ratio:>7.2f}")
    old, new = rounds[-1]
    apart = math.dist(old["sums"], new["sums"]) / (math.hypot(*old["sums"]) or 1.0)
    value = "" if new["value"] is None else f"  {old['value']:.4g} {new['value']:.4g}"
    proof = f"{old['certificate']:>8.0e} {new['certificate']:>8.0e}"
    return f"{name:<20}{' '.join(cells)} {proof} {apart:>7.0e}{value}"


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--python", action="append", required=True, help="twice: old, then new")
    parser.add_argument("--only", nargs="+", metavar="NAME", help="cases whose names have this")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--large", action="store_true", help="cases of 1e6 unknowns too")
    chosen = parser.parse_args()
    if len(chosen.python) != 2:
        parser.error("--python is needed twice: for the old and for the new version")
    names = run(chosen.python[1])
    if isinstance(names, str):
        parser.error(f"{chosen.python[1]}: {names}")
    if chosen.only:
        names = [name for name in names if any(part in name for part in chosen.only)]
    if not chosen.large:
        names = [name for name in names if "1e6" not in name]
    heads = (f"{f'{head}: old, new, ratio':>25}" for head, _ in COLUMNS.values())
    print(f"{'':<20}{' '.join(heads)} {'certificates':>17} {'apart':>7}  value", flush=True)
    for name in names:
        rounds = []
        for number in range(chosen.rounds):
            order = (0, 1) if number % 2 == 0 else (1, 0)
            found = {k: run(chosen.python[k], name) for k in order}
            rounds.append((found[0], found[1]))
            if any(isinstance(text, str) for text in rounds[-1]):
                break
        print(row(name, rounds), flush=True)


if __name__ == "__main__":
    main()
