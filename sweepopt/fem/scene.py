"""From effects to a problem: what a scene declares is assembled, and nothing else."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import skfem
from numpy.typing import ArrayLike

from sweepopt.checks import choice, listed, number
from sweepopt.errors import InputError, shown
from sweepopt.fem.contact import Contact
from sweepopt.fem.effects import Contribution, Effect
from sweepopt.fem.spaces import Discretisation
from sweepopt.integrate import schemes
from sweepopt.loads import Separable
from sweepopt.problem import EvolutionVI
from sweepopt.sets import Point
from sweepopt.velocity import solvers

if TYPE_CHECKING:
    from sweepopt.results import Solution

UNITS = ("dimensionless", "SI")


@dataclass(frozen=True, eq=False)
class Scene:
    """An antiplane problem with its mesh and settings, as `antiplane` and `read_scene` build it.

    Attributes
    ----------
    problem : EvolutionVI
        A, B, load, dissipation and u0 on the unknowns.
    discretisation : Discretisation
    contact : Contact or None
        The unknowns with friction; None without friction.
    effects : tuple of Effect
    left_out : tuple of str
        A sentence for each thing the scene does not name and the problem therefore does not have.
    t_end, steps
        Duration and number of steps; None if the scene does not say.
    scheme, solver, tol
        Arguments of `sweepopt.solve`.
    units : {"dimensionless", "SI"}
    title : str
    """

    problem: EvolutionVI
    discretisation: Discretisation
    contact: Contact | None
    effects: tuple[Effect, ...]
    left_out: tuple[str, ...]
    t_end: float | None = None
    steps: int | None = None
    scheme: str = "auto"
    solver: str = "auto"
    tol: float = 1e-6
    units: str = "dimensionless"
    title: str = ""

    def solve(self, **changes: Any) -> Solution:
        """`sweepopt.solve` with the scene's settings; keywords replace or add arguments."""
        from sweepopt.solve import solve

        names = ("t_end", "steps", "scheme", "solver", "tol")
        settings = {name: one for name in names if (one := getattr(self, name)) is not None}
        return solve(self.problem, **(settings | changes))


def antiplane(
    mesh: skfem.MeshTri | str | Path,
    *,
    clamped: str | Sequence[str],
    effects: Sequence[Effect],
    element: str = "P1",
    refinements: int = 0,
    u0: ArrayLike | None = None,
    t_end: float | None = None,
    steps: int | None = None,
    scheme: str = "auto",
    solver: str = "auto",
    tol: float = 1e-6,
    units: str = "dimensionless",
    title: str = "",
) -> Scene:
    """Antiplane shear of a section: u(x, t) is the displacement out of its plane.

    Parameters
    ----------
    mesh : skfem.MeshTri, str or Path
        With named boundaries; a path is read by `read_mesh`. `skfem.MeshTri2` has curved edges.
    clamped : str or sequence of str
        Names of the boundaries that make up Gamma_1.
    effects : sequence of Effect
        A viscosity, and at most one friction; all others are optional.
    element : {"P1", "P2"}
    refinements : int
        How often each triangle of the mesh is divided into four.
    u0 : array_like of shape (dim,), optional
        Initial values of the unknowns; zero by default.
    t_end, steps, scheme, solver, tol, units, title
        Kept in the scene. Histories must cover [0, t_end].

    Returns
    -------
    Scene

    Raises
    ------
    InputError
        Naming the argument, or the effect and its field, at fault.

    Examples
    --------
    >>> import skfem
    >>> from sweepopt.fem import Elasticity, Friction, Viscosity, antiplane
    >>> square = skfem.MeshTri().refined(2).with_defaults()
    >>> scene = antiplane(
    ...     square, clamped="top", effects=[Viscosity(1.0), Friction("bottom", g=0.5)]
    ... )
    >>> len(scene.contact), float(scene.contact.weight.sum())
    (5, 1.0)
    >>> scene.left_out
    ('no elasticity: B is not formed', 'no load: f = 0')
    """
    labelled = {f"effects[{k}]": effect for k, effect in enumerate(listed("effects", effects))}
    if t_end is not None:
        t_end = number("t_end", t_end, minimum=0.0, strict=True)
    body = Discretisation(mesh, clamped, element, refinements)
    settings = {"t_end": t_end, "steps": steps, "units": units, "title": title}
    return build(body, labelled, u0, settings | method(scheme, solver, tol))


def method(scheme: str = "auto", solver: str = "auto", tol: float = 1e-6) -> dict[str, Any]:
    """Arguments of `sweepopt.solve`; a scheme or a solver that is not known is refused."""
    schemes.choose(scheme, coercive=True)
    solvers.choose(solver, Point([0.0]))
    return {"scheme": scheme, "solver": solver, "tol": number("tol", tol, 0.0, strict=True)}


def build(
    body: Discretisation,
    effects: Mapping[str, Effect],
    u0: ArrayLike | None,
    settings: Mapping[str, Any],
) -> Scene:
    """A scene from effects by the label that errors shall give them."""
    choice("units", settings["units"], UNITS)
    title = settings["title"]
    if not isinstance(title, str) or not title.replace("\n", " ").isprintable():
        raise InputError(f"title must be text, got {shown(title)}; leave out control characters")
    parts = [_contribution(label, effects[label], body, settings["t_end"]) for label in effects]
    A, B, loads, contacts = (
        [one for part in parts if (one := getattr(part, name)) is not None]
        for name in ("A", "B", "load", "contact")
    )
    if not A:
        raise InputError("effects must hold a viscosity: without it a is not coercive")
    if len(contacts) > 1:
        raise InputError("effects hold friction twice; name all boundaries in one, g by boundary")
    problem = EvolutionVI(
        sum(A),
        sum(B) if B else None,
        load=Separable(loads) if loads else None,
        dissipation=contacts[0].dissipation(body.dim) if contacts else None,
        u0=np.zeros(body.dim) if u0 is None else u0,
    )
    terms = {
        "no elasticity: B is not formed": B,
        "no friction: no set and no optimiser, a step is one linear solve": contacts,
        "no load: f = 0": loads,
    }
    return Scene(
        problem=problem,
        discretisation=body,
        contact=contacts[0] if contacts else None,
        effects=tuple(effects.values()),
        left_out=tuple(sentence for sentence, present in terms.items() if not present),
        **settings,
    )


def _contribution(
    label: str, effect: Effect, body: Discretisation, t_end: float | None
) -> Contribution:
    """What an effect adds; its history must cover the run."""
    if isinstance(effect, type) or not hasattr(effect, "contribute"):
        raise InputError(f"{label} is no effect such as Viscosity(1.0): {shown(effect)}")
    with at_path(label):
        part = effect.contribute(body)
    if part.load is not None and t_end is not None:
        with at_path(f"{label}.history"):
            for t in (0.0, t_end):
                part.load[0](t)
    return part


@contextmanager
def at_path(path: str) -> Iterator[None]:
    """Put a path in front of the messages of input errors, which start with a field's name."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{path}.{error}") from error
