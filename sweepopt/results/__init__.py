"""Solutions that can prove how good they are: error bounds, energy (MATH 4)."""

from __future__ import annotations

from sweepopt.results.dataset import (
    StateFiles,
    field_names,
    netcdf_package,
    open_run,
    software,
    solver_name,
    write_dataset,
)
from sweepopt.results.error_bound import ErrorBound, require_bound
from sweepopt.results.solution import Energy, Pass, Solution
