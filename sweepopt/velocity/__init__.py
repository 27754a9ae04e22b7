"""One step: the program, its proof, the plan that chooses a path, the solvers (MATH 2, 5)."""

from __future__ import annotations

from sweepopt.velocity.elimination import (
    Solved,
    VelocityOf,
)
from sweepopt.velocity.exact_residual import (
    StateVelocity,
    matrix,
    of_state,
)
from sweepopt.velocity.interval import (
    interval_of,
    velocity_in,
)
from sweepopt.velocity.plan import (
    PATHS,
    Factors,
    Plan,
    make_plan,
)
from sweepopt.velocity.program import (
    POLISHED,
    Canonical,
    Velocity,
    VelocityProgram,
    rate,
    untranslated,
)
from sweepopt.velocity.proportional import (
    ReconstructionResiduals,
    Reduction,
)
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
)
from sweepopt.velocity.solvers.reference import (
    installed,
)

__all__ = [
    "DAQP",
    "OSQP",
    "PATHS",
    "POLISHED",
    "REGISTRY",
    "ActiveSet",
    "Answer",
    "Canonical",
    "Clarabel",
    "Cvxpy",
    "Factors",
    "Newton",
    "Plan",
    "ReconstructionResiduals",
    "Reduction",
    "Solve",
    "Solved",
    "Solver",
    "StateVelocity",
    "Velocity",
    "VelocityOf",
    "VelocityProgram",
    "installed",
    "interval_of",
    "make_plan",
    "matrix",
    "of_state",
    "rate",
    "untranslated",
    "velocity_in",
]
