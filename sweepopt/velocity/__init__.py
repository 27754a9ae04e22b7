"""One step: the program, its certificate, the plan that chooses a path, the solvers (MATH 2, 5)."""

from __future__ import annotations

from sweepopt.velocity.cascade import (
    Factors,
)
from sweepopt.velocity.certificate import (
    Velocity,
    certify,
    certify_point,
)
from sweepopt.velocity.compiled import (
    StateVelocity,
    VelocityOf,
    compile_projection,
    compile_velocity,
    factors,
    matrix,
)
from sweepopt.velocity.plan import (
    PATHS,
    Plan,
    make_plan,
)
from sweepopt.velocity.program import (
    Canonical,
    VelocityProgram,
    untranslated,
)
from sweepopt.velocity.proportional import (
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
    "REGISTRY",
    "ActiveSet",
    "Answer",
    "Canonical",
    "Clarabel",
    "Cvxpy",
    "Factors",
    "Newton",
    "Plan",
    "Reduction",
    "Solve",
    "Solver",
    "StateVelocity",
    "Velocity",
    "VelocityOf",
    "VelocityProgram",
    "certify",
    "certify_point",
    "compile_projection",
    "compile_velocity",
    "factors",
    "installed",
    "make_plan",
    "matrix",
    "untranslated",
]
