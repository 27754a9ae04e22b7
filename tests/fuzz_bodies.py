"""Antiplane bodies as Python builds them: meshes, effects and settings that are nearly right."""

from __future__ import annotations

from typing import Any

import numpy as np
import skfem
from fuzz_inputs import ANYTHING, NAN, ODD_NUMBERS, Call, history, positive, rarely, vector
from fuzz_judge import check_run
from hypothesis import strategies as st

from sweepopt import fem

SQUARES = [skfem.MeshTri().refined(k).with_defaults() for k in (1, 2)]
CURVED = skfem.MeshTri2.init_circle(1).with_boundaries({"top": lambda x: x[1] > 0.5})
ODD_MESHES = [CURVED, skfem.MeshTri, skfem.MeshTri().refined(1), "no.msh", "folder.msh"]
MESH = rarely(st.sampled_from(SQUARES), st.sampled_from(ODD_MESHES) | ANYTHING, 30)
SIDES = st.sampled_from(["left", "right", "bottom"])
ON = rarely(
    SIDES | st.lists(SIDES, min_size=1, max_size=2, unique=True),
    st.sampled_from(["x", "top"]) | ANYTHING,
    40,
)


def of_x(x: Any) -> Any:
    return 1.0 + x[0] * x[1]


def wrong_shape(x: Any) -> Any:
    return np.ones(3)


def undefined(x: Any) -> Any:
    return NAN * x[0]


ODD_FIELDS = st.sampled_from([wrong_shape, undefined, {"all": 1.0}, *ODD_NUMBERS])
FIELD = rarely(positive(strange=False) | st.just(of_x), ODD_FIELDS | ANYTHING | vector(2), 40)
PHI = rarely(history(), st.sampled_from([np.sin, float]) | ANYTHING, 40)


def effect(name: str, *arguments: Any) -> Any:
    return st.tuples(*arguments).map(lambda drawn: Call(f"fem.{name}", getattr(fem, name), drawn))


EFFECT = st.one_of(
    effect("Elasticity", FIELD),
    effect("Friction", ON, FIELD),
    effect("BodyForce", PHI, FIELD),
    effect("Traction", ON, PHI, FIELD),
)
EFFECTS = st.builds(
    lambda first, more: [first, *more],
    effect("Viscosity", FIELD),
    st.lists(rarely(EFFECT, ANYTHING, 40), max_size=4),
)
BODY = st.fixed_dictionaries(
    {
        "clamped": rarely(st.just("top"), ON, 30),
        "effects": rarely(EFFECTS, ANYTHING, 40),
        "element": rarely(st.sampled_from(["P1", "P2"]), ANYTHING, 20),
        "t_end": positive(),
        "steps": rarely(st.integers(1, 4), ANYTHING, 24),
    },
    optional={
        "u0": rarely(st.none(), vector(6) | ANYTHING, 3),
        "scheme": rarely(st.sampled_from(["auto", "implicit-euler", "sdirk2"]), ANYTHING, 24),
        "solver": rarely(st.sampled_from(["auto", "osqp", "clarabel"]), ANYTHING, 24),
        "tol": rarely(st.just(1e-6), st.sampled_from(ODD_NUMBERS), 24),
        "units": rarely(st.just("SI"), ANYTHING, 24),
    },
)
PATH = st.sampled_from(["auto", "auto", "full", "eliminated", "proportional"])


def ask_body(mesh: Any, body: dict[str, Any], path: str) -> None:
    """A body that is built moves for a few steps, each of them certified."""
    scene = fem.antiplane(mesh, **body)
    if not isinstance(scene.steps, int) or scene.steps <= 4:
        check_run(scene.solve(path=path))
