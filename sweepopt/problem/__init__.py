"""The two problems of the theory, how C(t) moves as data, and the norms of a process (MATH 1)."""

from __future__ import annotations

from sweepopt.problem.motion import (
    DERIVATIVE,
    GAUSS,
    TO_BERNSTEIN,
    WEIGHTS,
    Between,
    Grid,
    Motion,
    increments,
    motion,
)
from sweepopt.problem.norms import (
    Norms,
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
    "Between",
    "EvolutionVI",
    "Grid",
    "Motion",
    "Norms",
    "SweepingProcess",
    "increments",
    "motion",
    "proportion",
    "squares",
    "sweeping",
]
