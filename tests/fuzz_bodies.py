"""Antiplane bodies as Python builds them: meshes, effects and settings that are nearly right."""

from __future__ import annotations

from typing import Any

import numpy as np
import skfem
from fuzz_inputs import ANYTHING, NAN, ODD_NUMBERS, Call, history, positive, rarely, vector
from fuzz_judge import check_run
from hypothesis import strategies as st

from sweepopt import fem


def curved(times: int) -> Any:
    return skfem.MeshTri2.init_circle(times).with_boundaries({"top": lambda x: x[1] > 0.5})


SQUARES = [skfem.MeshTri().refined(k).with_defaults() for k in (1, 2)]
BARE = [skfem.MeshTri, skfem.MeshTri().refined(1), "no.msh", "folder.msh"]
MESH = rarely(
    st.sampled_from(SQUARES),
    st.one_of(st.just(Call("curved(1)", curved, (1,))), st.sampled_from(BARE), ANYTHING),
    30,
)
SIDES = st.sampled_from(["left", "right", "bottom"])
ON = rarely(
    st.one_of(SIDES, st.lists(SIDES, min_size=1, max_size=2, unique=True)),
    st.one_of(st.sampled_from(["x", "top"]), ANYTHING),
    40,
)


def of_x(x: Any) -> Any:
    return 1.0 + x[0] * x[1]


def wrong_shape(x: Any) -> Any:
    return np.ones(3)


def undefined(x: Any) -> Any:
    return NAN * x[0]


FIELD = rarely(
    st.one_of(positive(strange=False), st.just(of_x)),
    st.one_of(
        st.sampled_from([wrong_shape, undefined, {"all": 1.0}, *ODD_NUMBERS]), ANYTHING, vector(2)
    ),
    40,
)
PHI = rarely(history(), st.one_of(st.sampled_from([np.sin, float]), ANYTHING), 40)
ARGUMENTS = {
    "Viscosity": (FIELD,),
    "Elasticity": (FIELD,),
    "Friction": (ON, FIELD),
    "BodyForce": (PHI, FIELD),
    "Traction": (ON, PHI, FIELD),
}
EFFECTS = {
    name: st.tuples(*drawn).map(
        lambda made, name=name: Call(f"fem.{name}", getattr(fem, name), made)
    )
    for name, drawn in ARGUMENTS.items()
}
SETTINGS = {
    "u0": rarely(st.none(), st.one_of(vector(6), ANYTHING), 3),
    "t_end": positive(),
    "steps": rarely(st.integers(1, 4), ANYTHING, 24),
    "scheme": rarely(st.sampled_from(["auto", "implicit-euler", "sdirk2"]), ANYTHING, 24),
    "solver": rarely(st.sampled_from(["auto", "osqp", "clarabel"]), ANYTHING, 24),
    "tol": rarely(st.just(1e-6), st.sampled_from(ODD_NUMBERS), 24),
    "units": rarely(st.just("SI"), ANYTHING, 24),
}


@st.composite
def bodies(draw: Any) -> tuple[Any, dict[str, Any], dict[str, Any]]:
    """Mesh, arguments of `antiplane`, arguments of its run."""
    names = [name for name in EFFECTS if draw(st.integers(0, 5)) or name == "Viscosity"]
    effects = [draw(EFFECTS[name]) for name in names]
    if not draw(st.integers(0, 12)):
        effects.append(draw(st.one_of(ANYTHING, *EFFECTS.values())))
    body = {
        "clamped": draw(rarely(st.just("top"), ON, 30)),
        "effects": draw(rarely(st.just(effects), ANYTHING, 40)),
        "element": draw(rarely(st.sampled_from(["P1", "P2"]), ANYTHING, 20)),
    }
    for name, values in SETTINGS.items():
        if name in ("t_end", "steps") or not draw(st.integers(0, 3)):
            body[name] = draw(values)
    run = {"path": draw(st.sampled_from(["auto", "auto", "full", "eliminated", "proportional"]))}
    return draw(MESH), body, run


def ask_body(mesh: Any, body: dict[str, Any], run: dict[str, Any]) -> None:
    """A body that is built moves for a few steps, each of them certified."""
    scene = fem.antiplane(mesh, **body)
    if not isinstance(scene.steps, int) or scene.steps <= 4:
        check_run(scene.solve(**run))
