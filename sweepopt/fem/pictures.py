"""Pictures of a run: fields, what a contact does in space and time, loops of load and motion."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sweepopt.checks import Array, choice
from sweepopt.errors import InputError
from sweepopt.fem import snapshots
from sweepopt.fem.contact import Slip
from sweepopt.fem.effects import released
from sweepopt.fem.snapshots import (
    STATE_COLOURS,
    colours_of,
    legend_of,
    name_axis,
    states_of,
)
from sweepopt.io import writable
from sweepopt.plot import (
    LOOKS,
    STICK,
    STYLES,
    draw_histories,
    even_steps,
    legend_above,
    new_figure,
    spread,
)

if TYPE_CHECKING:
    from sweepopt.fem.output import Report
    from sweepopt.fem.scene import Scene
    from sweepopt.results import Solution

AUTOMATIC = ("flow", "displacement", "surface", "stress", "contact")
"""Pictures of a scene that names none: those of them that fit."""


def refusal(scene: Scene, name: str) -> str:
    """What a picture needs and the scene does not have; empty if it fits."""
    dimension, contact = scene.discretisation.mesh.dim(), scene.contact
    one = contact is not None and contact.unknown.ndim == 1
    along = "friction along a boundary", one and contact and contact.on_curve
    flows = any(getattr(effect, "flows", False) for effect in scene.effects)
    plastic = any(hasattr(effect, "plastic_strain") for effect in scene.effects)
    needs = {
        "displacement": ("a body in the plane or along a line", dimension < 3),
        "surface": ("a solid", dimension == 3),
        "flow": ("a section with a yield stress", dimension == 2 and flows),
        "stress": (
            "a body in the plane or a solid whose strains tell it",
            dimension > 1 and scene.stress_laws(),
        ),
        "yielding": ("a body in the plane with plasticity", dimension == 2 and plastic),
        "arrows": ("friction where two components slip", contact is not None and not one),
        "contact": along,
        "profiles": along,
        "space_time": ("friction of one component", one),
        "loop": ("a load or a motion that is prescribed", scene.force is not None),
    }
    what, fits = needs[choice("picture", name, needs)]
    return "" if fits else f"{name} needs {what}"


def pictures_of(scene: Scene) -> list[str]:
    """The names of the scene's pictures: those it asks for, or all of AUTOMATIC that fit.

    An effect that is left out of a scene takes its pictures with it.

    Raises
    ------
    InputError
        If one that it asks for does not fit.
    """
    asked = scene.pictures or ()
    reasons = {name: refusal(scene, name) for name in (*asked, *AUTOMATIC)}
    fitting = [name for name in asked if not reasons[name]]
    if len(fitting) < len(asked) and not any("without" in one for one in scene.changes):
        reason = next(filter(None, map(reasons.get, asked)))
        raise InputError(f"pictures: {reason}; leave it out")
    if scene.pictures is not None and not asked:
        return []
    return fitting or [name for name in AUTOMATIC if not reasons[name]]


def choose(scene: Scene, name: str, known: Iterable[str]) -> str:
    """The picture of that name; without one the first of the scene's own, or of all, that fits.

    Raises
    ------
    InputError
        If the one that is named does not fit.
    """
    if name and (reason := refusal(scene, choice("picture", name, known))):
        raise InputError(f"picture: {reason}")
    asked = [one for one in scene.pictures or () if one in known]
    return name or next(one for one in (*asked, *known) if not refusal(scene, one))


def draw(report: Report, name: str = "") -> Any:
    """A picture of a run, as a matplotlib Figure; see `choose`."""
    name = choose(report.scene, name, PICTURES)
    figure = snapshots.picture(report, FIELDS[name]) if name in FIELDS else DRAWN[name](report)
    figure.suptitle(report.scene.title, fontsize="medium")
    return figure


def animate(report: Report, path: str | Path, name: str = "") -> Path:
    """Write a field of a run as an animation: a GIF or, by ffmpeg, an MP4, as its ending says.

    Raises
    ------
    InputError
        If ffmpeg is not there for an MP4; as `choose`.
    """
    path, field = writable("path", path), choose(report.scene, name, FIELDS)
    snapshots.animation(report, FIELDS[field], path)
    return path


def contact(report: Report) -> Any:
    """What the contact does over time: slip zone, displacement, traction over bound, load."""
    from matplotlib.colors import ListedColormap

    slip = report.slip
    figure, loaded = new_figure((8.5, 9.0)), not refusal(report.scene, "loop")
    _, seconds = report.clock
    panels = figure.subplots(3 + loaded, 1, sharex=True)
    zone, displacement, traction = panels[:3]
    colours = ListedColormap(list(STATE_COLOURS.values()))
    _over_time(report, slip, zone, slip.state, cmap=colours, vmin=-1.5, vmax=1.5)
    # points that slip from little to far
    nodes, arc = spread(slip.total, len(STYLES)), slip.contact.arc
    for node, look in zip(nodes, LOOKS, strict=False):
        zone.axhline(arc[node], **look)
        traction.plot(slip.stage_t / seconds, slip.use[:, node], **look)
    # in the unit of the axis that shows them
    length = zone.yaxis.get_major_formatter() if report.suffix("length") else "{:g}".format
    names = slip.contact.boundary
    places = [f"{names[node]}, {length(float(f'{arc[node]:.3g}'))}" for node in nodes]
    draw_histories(
        displacement,
        slip.t / seconds,
        slip.displacement[:, nodes],
        slip.state[:, nodes] == 0,
        places,
    )
    name_axis(report, displacement.yaxis, "displacement", "length")
    legend_above(displacement, 5)
    traction.set(ylabel="traction / bound\n(above 1: error of the step)", ylim=(-1.15, 1.15))
    if loaded:
        _, load, (_, name) = driven(report.scene, report.solution)
        panels[3].plot(slip.t / seconds, load, color="black")
        name_axis(report, panels[3].yaxis, name, "force")
    name_axis(report, panels[-1].xaxis, "time", "time")
    legend_of(figure, states_of(slip))
    return figure


def space_time(report: Report) -> Any:
    """The slip rate along the contact, or over x, and time; grey where it sticks."""
    slip = report.slip
    figure = new_figure((8.5, 5.0))
    panel = figure.subplots()
    rate = np.ma.masked_equal(slip.velocity, 0.0)
    image = _over_time(report, slip, panel, rate, **colours_of(slip.velocity))
    name_axis(report, figure.colorbar(image, ax=panel).ax.yaxis, "slip rate", "velocity")
    low, high, name = _slip_range(slip)
    panel.set_ylim(low, high)
    name_axis(report, panel.yaxis, name, "length")
    name_axis(report, panel.xaxis, "time", "time")
    legend_of(figure, {STICK: "sticks"} if rate.mask.any() else {})
    return figure


def profiles(report: Report) -> Any:
    """Slip and friction along the contact at five even times; the bound of t = 0 is dashed."""
    slip = report.slip
    figure = new_figure((8.5, 6.5))
    displacement, traction = figure.subplots(2, 1, sharex=True)
    (low, high, name), arc = _slip_range(slip), slip.contact.arc
    inside = np.flatnonzero((low <= arc) & (arc <= high))
    arc, bound = arc[inside], slip.contact.bound[inside]
    chosen = even_steps(report.solution, 5)
    for i, look in zip(chosen.tolist(), LOOKS, strict=False):
        displacement.plot(arc, slip.displacement[i + 1, inside], **look)
        traction.plot(arc, slip.traction[i, inside], label=report.moment(slip.t[i + 1]), **look)
    names = ["bound, t = 0", "_"]  # of two lines one is in the legend
    traction.plot(arc, np.transpose([bound, -bound]), color="black", ls="--", lw=0.8, label=names)
    legend_above(traction, 3)
    name_axis(report, displacement.yaxis, "displacement", "length")
    name_axis(report, traction.xaxis, name, "length")
    name_axis(report, traction.yaxis, "friction traction", "traction")
    return figure


def loop(report: Report) -> Any:
    """The load over the displacement that it works on: the area of a loop is what is lost."""
    figure = new_figure((6.0, 5.0))
    panel = figure.subplots()
    x, load, words = driven(report.scene, report.solution)
    panel.plot(x, load, "k-o", markevery=[0])
    name_axis(report, panel.xaxis, f"{words[0]} (dot: start)", "length")
    name_axis(report, panel.yaxis, words[1], "force")
    panel.grid(alpha=0.3)
    return figure


def driven(scene: Scene, solution: Solution) -> tuple[Array, Array, tuple[str, str]]:
    """Displacement and load of what drives the scene at the times, with their names.

    Of a prescribed displacement phi d, the first, phi |d| with |d| its largest length, and the
    force on the body <d, A u' + B u - f> / |d|, without friction at the nodes that are moved; else
    the sum of the forces at free nodes along the largest load, and the mean displacement along
    them.
    """
    body, t = scene.discretisation, solution.t
    if scene.lifts:
        history, d = scene.lifts[0]
        size = np.linalg.norm(d[body.nodes], axis=0).max() or 1.0
        words = "prescribed displacement", "force on the body along\nthe prescribed motion"
        return history(t) * size, _reaction(scene, solution, d) / size, words
    forces = np.array([scene.load(time)[: body.dim] for time in t])
    largest = forces[np.linalg.norm(forces, axis=1).argmax()]
    nodal = body.expand(largest).reshape(-1, body.components)
    along = largest / (np.linalg.norm(nodal, axis=1).sum() or 1.0)
    load = forces @ along / (along @ along or 1.0)
    return (
        solution.u[:, : body.dim] @ along,
        load,
        ("mean displacement along the load", "load on free nodes"),
    )


def _reaction(scene: Scene, solution: Solution, d: Array) -> Any:
    """<d, A u' + B u - f> at the times, with u and f at all nodes."""
    rate, u = scene.velocity(solution, solution.t), scene.displacement(solution)
    A, B, loads = released(scene.discretisation, scene.effects)
    motions, nodes = ((A, rate), (B, u)), scene.discretisation.nodes
    resistance = sum(
        motion.reshape(len(motion), -1) @ (M @ d)[nodes.T].ravel()
        for M, motion in motions
        if M is not None
    )
    return resistance - [
        sum(phi(t) * (f(t) if callable(f) else f) @ d for phi, f in loads) for t in solution.t
    ]


def _place(slip: Slip) -> tuple[Array, str]:
    """Where the nodes of a contact are, along its boundaries or over x, and the name of that."""
    if not slip.contact.on_curve:
        return slip.contact.points[:, 0], "x"
    return slip.contact.arc, f"arc length along {', '.join(dict.fromkeys(slip.contact.boundary))}"


def _over_time(report: Report, slip: Slip, panel: Any, values: Array, **look: Any) -> Any:
    """A map of values of steps and nodes over time and place, and where each boundary begins."""
    place, name = _place(slip)
    order = np.argsort(place, kind="stable")
    x = place[order]
    edges = np.hstack([x[0], (x[1:] + x[:-1]) / 2.0, x[-1]])
    name_axis(report, panel.yaxis, name, "length")
    names, first = np.unique(slip.contact.boundary, return_index=True)
    if slip.contact.on_curve and len(names) > 1:
        for begin in place[first]:
            panel.axhline(begin, color="white")
        panel.secondary_yaxis("right").set_yticks(place[first], names, va="bottom")
    t = slip.t / report.clock[1]
    return panel.pcolormesh(t, edges, values[:, order].T, rasterized=True, **look)


def _slip_range(slip: Slip) -> tuple[float, float, str]:
    """The place between the outermost nodes that ever slip, and some more, with its axis's name."""
    place, name = _place(slip)
    where = place[slip.total > 0] if slip.total.any() else place
    more = 0.15 * np.ptp(where)
    low, high = max(where.min() - more, place.min()), min(where.max() + more, place.max())
    if high - low < np.ptp(place):
        name += "\n(where it slips at some time)"
    return low, high, name


FIELDS = {
    "flow": snapshots.flow,
    "displacement": snapshots.displacement,
    "surface": snapshots.surface,
    "stress": snapshots.stress,
    "yielding": snapshots.yielding,
    "arrows": snapshots.arrows,
}
"""Pictures of a field at times, which can be animated."""
DRAWN = {"contact": contact, "space_time": space_time, "profiles": profiles, "loop": loop}
"""The others."""
PICTURES = (*FIELDS, *DRAWN)
"""What a scene can ask for."""
