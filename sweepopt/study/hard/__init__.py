"""Suites of cases that are judged: `sweepopt study hard` and `sweepopt study stiff`.

Each makes cases from seeds, nothing is tuned to a seed: programs on which solvers alone fail,
judged by exact velocities; trajectories, judged by exact ones; stiff bodies, on which the default
scheme is judged by the best of three.
"""

from sweepopt.study.hard.exact import Program
from sweepopt.study.hard.stiff import StiffStudy
from sweepopt.study.hard.suite import GOOD, Suite, each, suite_summary
from sweepopt.study.hard.trajectories import TrajectoryStudy
from sweepopt.study.hard.velocities import FAMILIES, HardStudy

SUITES: dict[str, type[Suite]] = {
    "hard": HardStudy,
    "trajectories": TrajectoryStudy,
    "stiff": StiffStudy,
}
"""By the names of their tables in a study's file, which are those of the files of their rows."""

__all__ = ["FAMILIES", "GOOD", "SUITES", "Program", "each", "suite_summary"]
