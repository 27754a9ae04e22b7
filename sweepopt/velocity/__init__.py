"""One step: the program, its certificate, the plan that chooses a path, the solvers (MATH 2, 5)."""

from sweepopt.velocity.certificate import Velocity, certify, certify_point, of_fixed_point
from sweepopt.velocity.compiled import (
    StateVelocity,
    VelocityOf,
    compile_projection,
    compile_velocity,
)
from sweepopt.velocity.plan import PATHS, Plan, make_plan
from sweepopt.velocity.program import StepProgram, VelocityProgram, untranslated
from sweepopt.velocity.solvers import (
    DAQP,
    OSQP,
    REGISTRY,
    ActiveSet,
    Answer,
    Clarabel,
    Cvxpy,
    Newton,
    Solve,
    Solver,
    installed,
)
