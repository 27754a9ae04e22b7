"""sweepopt: implicit sweeping processes and quasistatic evolution variational inequalities.

-u'(t) in N_{C(t)}(A u'(t) + B u(t)),   u(0) = u0
"""

from __future__ import annotations

from sweepopt.errors import (
    AccuracyError,
    CheckpointError,
    CheckpointWarning,
    EmptySetError,
    InitialStateWarning,
    InputError,
    MissingExtraError,
    SolverRefusedError,
    StabilityWarning,
    Status,
    StepError,
    SweepoptError,
    SweepoptWarning,
    UnstableStepError,
    VariationWarning,
    VelocityError,
)
from sweepopt.integrate import Adaptive, Checkpoint, StepInfo, velocity_field
from sweepopt.loads import Constant, Polynomial, Separable, Sine, Table, Triangle
from sweepopt.problem import EvolutionVI, SweepingProcess
from sweepopt.results import Energy, ErrorBound, Pass, Solution
from sweepopt.sets import (
    Ball,
    Balls,
    Box,
    Constraints,
    ConvexSet,
    Ellipsoid,
    HalfSpace,
    Moving,
    MovingSet,
    Orthant,
    Point,
    Polyhedron,
    Polytope,
    SecondOrderCone,
    WholeSpace,
    image,
    product,
)
from sweepopt.solve import resume, solve
from sweepopt.velocity import DAQP, OSQP, ActiveSet, Clarabel, Cvxpy, Newton, Plan

__version__ = "0.1.0"

__all__ = [
    "DAQP",
    "OSQP",
    "AccuracyError",
    "ActiveSet",
    "Adaptive",
    "Ball",
    "Balls",
    "Box",
    "Checkpoint",
    "CheckpointError",
    "CheckpointWarning",
    "Clarabel",
    "Constant",
    "Constraints",
    "ConvexSet",
    "Cvxpy",
    "Ellipsoid",
    "EmptySetError",
    "Energy",
    "ErrorBound",
    "EvolutionVI",
    "HalfSpace",
    "InitialStateWarning",
    "InputError",
    "MissingExtraError",
    "Moving",
    "MovingSet",
    "Newton",
    "Orthant",
    "Pass",
    "Plan",
    "Point",
    "Polyhedron",
    "Polynomial",
    "Polytope",
    "SecondOrderCone",
    "Separable",
    "Sine",
    "Solution",
    "SolverRefusedError",
    "StabilityWarning",
    "Status",
    "StepError",
    "StepInfo",
    "SweepingProcess",
    "SweepoptError",
    "SweepoptWarning",
    "Table",
    "Triangle",
    "UnstableStepError",
    "VariationWarning",
    "VelocityError",
    "WholeSpace",
    "image",
    "product",
    "resume",
    "solve",
    "velocity_field",
]
