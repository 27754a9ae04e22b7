"""Time stepping: schemes, the loop over time, what is kept of it, adaptive steps (MATH 3)."""

from __future__ import annotations

from sweepopt.integrate.adaptive import (
    Adaptive,
    AdaptiveResult,
    Pass,
    Segments,
    adapt,
)
from sweepopt.integrate.checkpoint import (
    Checkpoint,
    Continued,
    Stored,
    about_computer,
    decoded,
    read_stored,
)
from sweepopt.integrate.checkpoint_writer import (
    Checkpoints,
    checkpoints,
)
from sweepopt.integrate.exact import (
    Trajectory,
    mover,
)
from sweepopt.integrate.field import (
    velocity_field,
)
from sweepopt.integrate.fingerprint import (
    fingerprint,
)
from sweepopt.integrate.grid import (
    check_stability,
    divided,
    evaluation_times,
    time_grid,
    warn_of_overshoot,
)
from sweepopt.integrate.loop import (
    march,
)
from sweepopt.integrate.netcdf_writer import (
    netcdf_package,
)
from sweepopt.integrate.observers import (
    Bar,
    Callback,
    Observers,
    StepInfo,
)
from sweepopt.integrate.reconstruction import (
    Lift,
)
from sweepopt.integrate.schemes import (
    SCHEMES,
    Scheme,
    choose,
)
from sweepopt.integrate.states import (
    MEMORY,
    Keeper,
    States,
    saving,
)
from sweepopt.integrate.statistics import (
    Statistics,
)

__all__ = [
    "MEMORY",
    "SCHEMES",
    "Adaptive",
    "AdaptiveResult",
    "Bar",
    "Callback",
    "Checkpoint",
    "Checkpoints",
    "Continued",
    "Keeper",
    "Lift",
    "Observers",
    "Pass",
    "Scheme",
    "Segments",
    "States",
    "Statistics",
    "StepInfo",
    "Stored",
    "Trajectory",
    "about_computer",
    "adapt",
    "check_stability",
    "checkpoints",
    "choose",
    "decoded",
    "divided",
    "evaluation_times",
    "fingerprint",
    "march",
    "mover",
    "netcdf_package",
    "read_stored",
    "saving",
    "time_grid",
    "velocity_field",
    "warn_of_overshoot",
]
