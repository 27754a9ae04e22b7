"""Solutions that can prove how good they are: error bounds, energy (MATH 4)."""

from __future__ import annotations

from sweepopt.results.dataset import (
    Dataset,
    StateFiles,
    dataset_of,
    field_names,
    netcdf_package,
    open_run,
    read,
    software,
    solver_name,
    variable,
    write_dataset,
)
from sweepopt.results.error_bound import ErrorBound, require_bound
from sweepopt.results.solution import Energy, Pass, Solution, guaranteed_bound
