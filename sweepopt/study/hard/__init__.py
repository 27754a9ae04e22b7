"""Suites of cases that are judged: `sweepopt study hard` and `sweepopt study stiff`.

Each makes cases from seeds, nothing is tuned to a seed: programs on which solvers alone fail,
judged by exact velocities; trajectories, judged by exact ones; stiff bodies, on which the default
scheme is judged by the best of three.
"""

from typing import Any

from sweepopt.study.hard.exact import Program
from sweepopt.study.hard.stiff import stiff_bodies
from sweepopt.study.hard.suite import GOOD, each, option, run_suite, suite_summary
from sweepopt.study.hard.trajectories import hard_trajectories
from sweepopt.study.hard.velocities import FAMILIES, hard_programs

SUITES: dict[str, Any] = {
    "hard": hard_programs,
    "trajectories": hard_trajectories,
    "stiff": stiff_bodies,
}
"""By the names of their tables in a study's file, which are those of the files of their rows."""
