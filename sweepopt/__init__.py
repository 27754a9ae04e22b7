"""sweepopt: implicit sweeping processes and quasistatic evolution variational inequalities.

-u'(t) in N_{C(t)}(A u'(t) + B u(t)),   u(0) = u0

`SweepingProcess` or `EvolutionVI` states a problem, `solve` integrates it to a `Solution`; `scene`
and `fem` build bodies of finite elements, `study` compares methods. What a name needs is imported
when it is first used.
"""

from __future__ import annotations

from importlib import import_module
from inspect import signature, unwrap
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sweepopt import fem
    from sweepopt.driver import resume, solve
    from sweepopt.errors import (
        AccuracyError,
        BoundWarning,
        CheckpointError,
        CheckpointWarning,
        DamagedFileError,
        EmptySetError,
        IndefiniteError,
        InitialStateWarning,
        InputError,
        MissingExtraError,
        PathError,
        SaveError,
        SolverRefusedError,
        StabilityWarning,
        Status,
        StepError,
        SweepoptError,
        SweepoptWarning,
        TouchingError,
        UnstableStepError,
        VariationWarning,
        VelocityError,
    )
    from sweepopt.integrate import (
        Adaptive,
        Checkpoint,
        StepInfo,
        compatible_start,
        step_program,
        velocity_field,
    )
    from sweepopt.io import list_scenes
    from sweepopt.loads import (
        Constant,
        Modulated,
        Polynomial,
        Separable,
        Sine,
        Table,
        Triangle,
        VectorTable,
    )
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
        StateDependent,
        WholeSpace,
        image,
        product,
    )
    from sweepopt.velocity import DAQP, OSQP, ActiveSet, Clarabel, Cvxpy, Newton, Plan, StepProgram

__version__ = "0.1.0"


__all__ = [
    "DAQP",
    "OSQP",
    "AccuracyError",
    "ActiveSet",
    "Adaptive",
    "Ball",
    "Balls",
    "BoundWarning",
    "Box",
    "Checkpoint",
    "CheckpointError",
    "CheckpointWarning",
    "Clarabel",
    "Constant",
    "Constraints",
    "ConvexSet",
    "Cvxpy",
    "DamagedFileError",
    "Ellipsoid",
    "EmptySetError",
    "Energy",
    "ErrorBound",
    "EvolutionVI",
    "HalfSpace",
    "IndefiniteError",
    "InitialStateWarning",
    "InputError",
    "MissingExtraError",
    "Modulated",
    "Moving",
    "MovingSet",
    "Newton",
    "Orthant",
    "Pass",
    "PathError",
    "Plan",
    "Point",
    "Polyhedron",
    "Polynomial",
    "Polytope",
    "SaveError",
    "SecondOrderCone",
    "Separable",
    "Sine",
    "Solution",
    "SolverRefusedError",
    "StabilityWarning",
    "StateDependent",
    "Status",
    "StepError",
    "StepInfo",
    "StepProgram",
    "SweepingProcess",
    "SweepoptError",
    "SweepoptWarning",
    "Table",
    "TouchingError",
    "Triangle",
    "UnstableStepError",
    "VariationWarning",
    "VectorTable",
    "VelocityError",
    "WholeSpace",
    "compatible_start",
    "image",
    "list_scenes",
    "product",
    "resume",
    "scene",
    "solve",
    "step_program",
    "velocity_field",
]

_ROOMS = (
    *("errors", "io", "loads", "sets", "problem", "velocity", "integrate", "results", "driver"),
    *("fem", "study", "plot"),
)
"""Where the names are, those first that need little; the last three are names themselves."""


_MEANT = {
    **dict.fromkeys(("interval", "segment", "rectangle", "cube"), "Box"),
    **dict.fromkeys(("circle", "disc", "disk", "sphere"), "Ball"),
}
"""Names under which users look for sets, and what they are called here."""


def __getattr__(name: str) -> Any:
    """The public names, each imported when it is first asked for (PEP 562)."""
    if name in _ROOMS:
        try:
            return import_module(f"{__name__}.{name}")
        except ImportError as error:  # a missing extra: hasattr, dir and help go on
            raise AttributeError(str(error)) from error
    if name in __all__:
        from sweepopt.checks import public

        for room in map(import_module, (f"{__name__}.{room}" for room in _ROOMS[:-3])):
            if name in getattr(room, "__all__", vars(room)):
                globals()[name] = public(getattr(room, name))
                return globals()[name]
    from sweepopt.errors import suggestion

    near = suggestion(_MEANT.get(name.lower(), name), __all__)
    raise AttributeError(
        f"sweepopt has no attribute {name!r}{near}; effects and meshes of bodies are in "
        "sweepopt.fem"
    )


def __dir__() -> list[str]:
    return [*__all__, *_ROOMS[-3:], "__doc__", "__version__"]


def scene(*source: Any, **options: Any) -> fem.Scene:
    """Read a scene: `sweepopt.fem.read_scene`, whose help lists all keys of scene files.

    Parameters
    ----------
    source : str, Path or mapping
        A name from `list_scenes`, the path of a TOML file, or TOML text.
    folder, changes, without
        Those of `read_scene`, such as ``changes={"effects.friction.g": 0.5}``.

    Returns
    -------
    Scene

    Examples
    --------
    >>> import sweepopt as so
    >>> so.scene("pipe").problem.dim > 100
    True
    """
    from sweepopt.checks import with_checks
    from sweepopt.fem import read_scene

    return with_checks(unwrap(read_scene), scene)(*source, **options)


scene.__signature__ = signature(  # type: ignore[attr-defined]  # that of read_scene, for help
    lambda source, *, folder=".", changes=None, without=(): None
)
