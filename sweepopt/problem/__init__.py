"""The two problems of the theory, how C(t) moves as data, and the norms of a process (MATH 1)."""

from __future__ import annotations

from sweepopt.problem.interpolation import (
    DERIVATIVE,
    GAUSS,
    TO_BERNSTEIN,
    WEIGHTS,
    Interpolated,
    Intervals,
    increments,
    interpolate,
    smooth_intervals,
)
from sweepopt.problem.motion import (
    Motion,
    Terms,
    TimeFunction,
    histories_of,
    motion,
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

__all__ = [
    "DERIVATIVE",
    "GAUSS",
    "TO_BERNSTEIN",
    "WEIGHTS",
    "EvolutionVI",
    "Interpolated",
    "Intervals",
    "Motion",
    "Norms",
    "SweepingProcess",
    "Terms",
    "TimeFunction",
    "applied",
    "histories_of",
    "increments",
    "interpolate",
    "motion",
    "proportion",
    "smooth_intervals",
    "squares",
    "sweeping",
]
