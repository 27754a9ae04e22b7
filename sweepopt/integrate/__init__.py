"""Time stepping: schemes, the loop over time, what is kept of it, adaptive steps (MATH 3)."""

from sweepopt.checks import MEMORY
from sweepopt.integrate.adaptive import adapt, first_grid, with_breakpoints
from sweepopt.integrate.checkpoint import (
    Checkpoint,
    CheckpointWriter,
    StoredRun,
    checkpoint_writer,
    differences,
    fingerprint,
    newest,
    require_same_problem,
)
from sweepopt.integrate.exact import Trajectory
from sweepopt.integrate.field import (
    compatible_start,
    program_of_stage,
    step_program,
    velocity_field,
)
from sweepopt.integrate.grid import (
    Adaptive,
    check_resolution,
    check_stability,
    divided,
    time_grid,
)
from sweepopt.integrate.loop import integrate, observer, progress_bar
from sweepopt.integrate.options import SolveOptions
from sweepopt.integrate.record import (
    ROW,
    Callback,
    Index,
    Pass,
    Run,
    SaveFunction,
    States,
    Statistics,
    StepInfo,
    saving,
)
from sweepopt.integrate.schemes import SCHEMES, Scheme, implicit_euler, stiffly_accurate
from sweepopt.integrate.step import BY_EULER, Velocities, combination, compensated_sum
