"""Peak memory, each contestant in a process of its own: a peak cannot be told apart afterwards."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path

from sweepopt.study.cases import square
from sweepopt.study.contestants import CONTESTANTS

STATUS = Path("/proc/self/status")  # ru_maxrss would count the process that started this one


def peak(cells: int, steps: int, path: str | None = None) -> float | None:
    """Peak resident memory of a process that builds a square and runs one contestant, in MB.

    Parameters
    ----------
    cells, steps : int
    path : str, optional
        Without it the scene is built only.

    Returns
    -------
    float or None
        None where the system does not tell, or where the process was killed for its size.
    """
    code = f"from sweepopt.study.memory import run; run({cells}, {steps}, {path!r})"
    told = subprocess.run([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    found = float(told.stdout) if told.returncode == 0 else math.nan
    return None if math.isnan(found) else found


def run(cells: int, steps: int, path: str | None) -> None:
    """Do the work in this process and print its peak."""
    case = square(cells, steps)
    for contestant in CONTESTANTS:
        if contestant.path == path:
            contestant.run(case)
    lines = STATUS.read_text().splitlines() if STATUS.exists() else []
    kilobytes = [float(line.split()[1]) for line in lines if line.startswith("VmHWM")]
    print(kilobytes[0] * 1024 / 1e6 if kilobytes else math.nan)
