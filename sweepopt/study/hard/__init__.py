"""Hard cases: families of programs on which solvers alone fail, their exact answers, one table.

Each family makes a case from a seed; nothing is tuned to a seed. `sweepopt study hard` runs them
through every path and solver, and judges each step by its exact velocity.
"""

from sweepopt.study.hard.exact import Exact, Program
from sweepopt.study.hard.families import FAMILIES

__all__ = ["FAMILIES", "Exact", "Program"]
