"""The two problems of the theory, how C(t) moves as data, and the norms of a process (MATH 1)."""

from sweepopt.problem.motion import (
    ONE,
    Motion,
    Terms,
    TimeFunction,
    histories_of,
    motion,
    variations,
)
from sweepopt.problem.norms import (
    Norms,
    applied,
    squares,
)
from sweepopt.problem.process import (
    EvolutionVI,
    SweepingProcess,
    proportion,
    sweeping,
)
