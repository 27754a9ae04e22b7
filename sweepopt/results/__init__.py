"""Solutions that can prove how good they are: error bounds, energy (MATH 4)."""

from __future__ import annotations

from sweepopt.results.dataset import (
    NetCDFSink,
    last_state,
    netcdf_bytes,
    software,
    solver_name,
)
from sweepopt.results.energy import Energy
from sweepopt.results.error_bound import ErrorBound
from sweepopt.results.solution import Pass, Solution

__all__ = [
    "Energy",
    "ErrorBound",
    "NetCDFSink",
    "Pass",
    "Solution",
    "last_state",
    "netcdf_bytes",
    "software",
    "solver_name",
]
