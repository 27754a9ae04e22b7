"""The suites of cases that are judged, by the names of their tables in a study's file."""

from __future__ import annotations

from sweepopt.study.hard.suite import HardStudy
from sweepopt.study.hard.trajectories import TrajectoryStudy
from sweepopt.study.hard.verdicts import Suite
from sweepopt.study.stiff import StiffStudy

SUITES: dict[str, type[Suite]] = {
    "hard": HardStudy,
    "trajectories": TrajectoryStudy,
    "stiff": StiffStudy,
}
"""Their rows are files of that name too: the .jsonl has each as soon as it is finished."""
