"""Pictures of a run: fields, what a contact does in space and time, loops of load and motion."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from sweepopt.errors import InputError
from sweepopt.fem.contact import STATES, Slip
from sweepopt.fem.output import Report
from sweepopt.loads import Separable
from sweepopt.plot import LOOKS, STICK, STYLES, draw_histories, new_figure, spread
from sweepopt.results import Solution

if TYPE_CHECKING:
    from sweepopt.fem.scene import Scene

STATE_COLOURS = {-1: "#0072B2", 0: STICK, 1: "#D55E00"}


def drawn_of(report: Report) -> dict[str, Callable[[Report], Any]]:
    """The functions that draw the scene's pictures, by name; all that fit if it names none."""
    scene, slip = report.scene, report.slip
    fits = {
        "displacement": scene.discretisation.mesh.dim() == 2,
        "contact": slip is not None and slip.velocity.ndim == 2 and slip.contact.on_curve,
    }
    names = scene.pictures or [name for name, fit in fits.items() if fit]
    return {name: DRAWN[name] for name in names}


def displacement_figure(report: Report) -> Any:
    """The displacement at a few times, with the slip zone, of a body in the plane.

    Up to six: when slip starts, when most of the contact slips forward or backward, the largest and
    the least displacement, and the end.

    Returns
    -------
    matplotlib Figure
    """
    solution, slip, body = report.solution, report.slip, report.scene.discretisation
    indices = _informative(solution, slip)
    fields = report.scene.displacement(solution)[indices]
    name = "displacement"
    colours: dict[str, Any] = {"cmap": "PRGn", "vmin": -1.0, "shading": "gouraud"}
    if body.components > 1:
        fields, name = np.linalg.norm(fields, axis=2), "displacement, its length"
        colours |= {"cmap": "viridis", "vmin": 0.0}
    limit = float(np.abs(fields).max()) or 1.0
    colours |= {"vmin": limit * colours["vmin"], "vmax": limit}
    edges = body.points[body.facet_nodes(body.mesh.boundary_facets()).T]
    outline = np.pad(edges, ((0, 0), (0, 1), (0, 0)), constant_values=np.nan).reshape(-1, 2)
    figure, panels = _page(np.ptp(body.points, axis=0), len(indices))
    for panel, i, field in zip(panels.flat, indices, fields, strict=False):
        image = panel.tripcolor(*body.points.T, body.triangles, field, rasterized=True, **colours)
        panel.plot(*outline.T, color="black", lw=0.6, zorder=1)
        title = f"t = {solution.t[i]:.4g}{report.suffix('time')}"
        if slip is not None:
            step = max(i - 1, 0)  # the one that ends there; at the start the first
            states = [STATE_COLOURS[state] for state in slip.state[step]]
            panel.scatter(*slip.contact.points.T, s=40, c="white")  # a casing against the field
            panel.scatter(*slip.contact.points.T, s=16, c=states)
            title += f", {100 * slip.share[step]:.0f} % slips"
        panel.set_title(title, fontsize="medium")
        panel.set(aspect="equal", xlabel="x", ylabel="y")
        panel.label_outer()
    bar = figure.colorbar(image, ax=panels, label=name, shrink=0.8)
    _show_units(report, "length", panels[0, 0].xaxis, panels[0, 0].yaxis, bar.ax.yaxis)
    if slip is not None:
        _state_legend(figure)
    return figure


def contact_figure(report: Report) -> Any:
    """What the contact does over time: slip zone, displacement and traction over friction bound.

    Parameters
    ----------
    report : Report
        Of a scene with friction.

    Returns
    -------
    matplotlib Figure
    """
    slip = report.slip
    assert slip is not None
    contact = slip.contact
    figure = new_figure((8.5, 9.0))
    zone, moved, traction = figure.subplots(3, 1, sharex=True, height_ratios=[1.3, 1.0, 1.0])
    _draw_zone(zone, slip)
    # points that slip from little to far
    nodes = spread(slip.total, len(STYLES))
    for node, look in zip(nodes, LOOKS, strict=False):
        zone.axhline(contact.arc[node], lw=2.6, color="white")
        zone.axhline(contact.arc[node], lw=1.4, **look)
        traction.plot(slip.stage_t, slip.traction[:, node] / contact.bound[node], lw=1.5, **look)
    places = [
        f"{contact.boundary[node]}, {contact.arc[node]:.3g}{report.suffix('length')}"
        for node in nodes
    ]
    draw_histories(moved, slip.t, slip.displacement[:, nodes], slip.state[:, nodes] == 0, places)
    moved.set_ylabel("displacement")
    moved.legend(fontsize="small", ncols=5, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    traction.set(xlabel="time", ylabel="friction traction / bound")
    traction.set(xlim=(slip.t[0], slip.t[-1]), ylim=(-1.15, 1.15))
    traction.grid(alpha=0.3)
    _show_units(report, "length", zone.yaxis, moved.yaxis)
    _show_units(report, "time", traction.xaxis)
    _state_legend(figure)
    return figure


def space_time_figure(report: Report) -> Any:
    """The slip rate along the contact over time; grey where it sticks.

    Returns
    -------
    matplotlib Figure

    Raises
    ------
    InputError
        If the scene has no friction along a boundary.
    """
    from matplotlib import colormaps

    slip = _along_a_curve(report, "space_time")
    figure = new_figure((8.5, 5.0))
    panel = figure.subplots()
    velocity = np.ma.masked_equal(slip.velocity.T, 0.0)
    colours = colormaps["PuOr"].with_extremes(bad=STICK)
    limit = float(np.abs(slip.velocity).max()) or 1.0
    image = panel.pcolormesh(
        slip.t, _edges(slip), velocity, cmap=colours, vmin=-limit, vmax=limit, rasterized=True
    )
    bar = figure.colorbar(image, ax=panel, label=f"slip rate{_in(report, 'velocity')}")
    bar.formatter.set_powerlimits((-2, 3))
    panel.set(xlabel="time", ylabel=_along(slip), ylim=_slipped(slip))
    _show_units(report, "time", panel.xaxis)
    _show_units(report, "length", panel.yaxis)
    _legend(figure, {STICK: "sticks"})
    return figure


def profiles_figure(report: Report) -> Any:
    """Slip and friction along the contact at five even times; the bound of t = 0 is dashed.

    Returns
    -------
    matplotlib Figure

    Raises
    ------
    InputError
        If the scene has no friction along a boundary.
    """
    slip = _along_a_curve(report, "profiles")
    figure = new_figure((8.5, 6.5))
    moved, traction = figure.subplots(2, 1, sharex=True)
    arc, steps = slip.contact.arc, len(slip.stage_t)
    for i, look in zip(np.unique(np.arange(1, 6) * steps // 5).tolist(), LOOKS, strict=False):
        if i:
            label = f"t = {slip.t[i]:.4g}{report.suffix('time')}"
            moved.plot(arc, slip.displacement[i], lw=1.5, label=label, **look)
            traction.plot(arc, slip.traction[i - 1], lw=1.5, **look)
    low, high = _slipped(slip)
    inside = (arc >= low) & (arc <= high)
    limit = 1.1 * float(slip.contact.bound[inside].max())
    for sign in (-1, 1):
        traction.plot(arc, sign * slip.contact.bound, color="black", ls="--", lw=0.8)
    moved.set_ylabel("displacement")
    moved.legend(fontsize="small", ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    traction.set(xlabel=_along(slip), ylabel="friction traction", xlim=(low, high))
    traction.set_ylim(-limit, limit)
    for panel in (moved, traction):
        panel.grid(alpha=0.3)
    _show_units(report, "length", traction.xaxis, moved.yaxis)
    _show_units(report, "traction", traction.yaxis)
    return figure


def loop_figure(report: Report) -> Any:
    """The first load over the displacement on which it does work.

    Returns
    -------
    matplotlib Figure
    """
    displacement, force, words = loop(report.scene, report.solution)
    figure = new_figure((6.0, 5.0))
    panel = figure.subplots()
    panel.plot(displacement, force, color="#0072B2", lw=1.5)
    panel.plot(displacement[-1], force[-1], "o", color="#0072B2")
    panel.set(xlabel=words[0], ylabel=words[1])
    panel.grid(alpha=0.3)
    if report.scene.lifts:
        _show_units(report, "length", panel.xaxis)
        _show_units(report, "force", panel.yaxis)
    return figure


def loop(scene: Scene, solution: Solution) -> tuple[Any, Any, tuple[str, str]]:
    """The first load of a scene at the times, its conjugate displacement, and their names.

    Of a prescribed displacement phi d the work is ``int R dphi`` with the reaction
    ``R = <d, A u' + B u>``; of a force phi f it is ``int phi d<f, u>``.

    Returns
    -------
    displacement, force : ndarray, shape (n+1,)
    words : pair of str

    Raises
    ------
    InputError
        If the scene has no load that is data in time.
    """
    if scene.lifts:
        history, d = scene.lifts[0]
        free = scene.discretisation.released()
        rate = scene.velocity(solution)
        motions = {"A": np.concatenate([rate[:1], rate]), "B": scene.displacement(solution)}
        force = np.zeros(len(solution.t))
        for effect in scene.effects:
            own = effect.contribute(scene.discretisation)
            if own.A is None and own.B is None:
                continue
            part = effect.contribute(free)
            for name, motion in motions.items():
                if (matrix := getattr(part, name)) is not None:
                    row = (matrix @ d)[free.nodes.T]
                    force += motion.reshape(len(force), -1) @ row.ravel()
        return history(solution.t), force, ("prescribed displacement", "force of its support")
    if not isinstance(scene.force, Separable):
        raise InputError("pictures: loop needs a load that is data in time; leave it out")
    phi, f = scene.force.terms[0]
    load = np.array([phi(t) for t in solution.t])
    return solution.u @ f, load, ("work at load 1", "load")


def _along_a_curve(report: Report, name: str) -> Slip:
    """The slip of a scene with friction along boundaries, where one component slips."""
    slip = report.slip
    if slip is None or slip.velocity.ndim > 2 or not slip.contact.on_curve:
        raise InputError(f"pictures: {name} needs friction along a boundary; leave it out")
    return slip


def _slipped(slip: Slip) -> tuple[float, float]:
    """The arc between the outermost nodes that ever slip, and some more."""
    arc = slip.contact.arc
    where = arc[slip.total > 0] if slip.total.any() else arc
    more = 0.15 * float(np.ptp(where))
    return max(float(where.min()) - more, 0.0), min(float(where.max()) + more, float(arc[-1]))


def _along(slip: Slip) -> str:
    return f"arc length of {', '.join(dict.fromkeys(slip.contact.boundary))}"


def _edges(slip: Slip) -> np.ndarray:
    """Ends of the nodes' shares of the arc."""
    arc, half = slip.contact.arc, slip.contact.weight / 2.0
    return np.hstack([arc[0] - half[0], (arc[1:] + arc[:-1]) / 2.0, arc[-1] + half[-1]])


def _in(report: Report, quantity: str) -> str:
    """The unit of an axis, such as " (m)"."""
    unit = report.suffix(quantity).strip()
    return f" ({unit})" if unit else ""


def _informative(solution: Solution, slip: Slip | None) -> list[int]:
    """Time indices, increasing: extreme displacements, start and extremes of slip, the end."""
    u, last = solution.u, len(solution.steps)
    indices = {int(u.max(axis=1).argmax()), int(u.min(axis=1).argmin()), last}
    if slip is not None and slip.state.any():
        share = slip.state @ slip.contact.weight
        steps = (slip.share > 0).argmax(), share.argmax(), share.argmin()
        indices |= {int(step) + 1 for step in steps}
    return sorted(indices)


def _page(size: np.ndarray, count: int) -> tuple[Any, np.ndarray]:
    """A figure of equal panels, three in a row, for a body of a width and a height."""
    shape, columns, rows = size[1] / size[0], min(count, 3), -(-count // 3)
    width = min(3.0, 4.0 / shape)
    figure = new_figure((width * columns + 3.0, (width * shape + 0.3) * rows + 0.8))
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    panels[0, 0].locator_params(nbins=4)
    for panel in panels.flat[count:]:
        panel.set_axis_off()
    return figure, panels


def _draw_zone(panel: Any, slip: Slip) -> None:
    """Slip state over arc length and time."""
    from matplotlib.colors import ListedColormap

    colours = ListedColormap([STATE_COLOURS[state] for state in STATES])
    panel.pcolormesh(
        slip.t, _edges(slip), slip.state.T, cmap=colours, vmin=-1.5, vmax=1.5, rasterized=True
    )
    panel.set_ylabel(_along(slip))


def _show_units(report: Report, quantity: str, *axes: Any) -> None:
    """Ticks with units, such as 20 mm; plain numbers in a dimensionless scene."""
    from matplotlib.ticker import EngFormatter

    if report.suffix(quantity):
        for axis in axes:
            axis.set_major_formatter(EngFormatter(report.units[quantity]))


def _state_legend(figure: Any) -> None:
    """What the colours of the contact boundary mean."""
    names = {STATE_COLOURS[state]: name.replace("_", " ") for state, name in STATES.items()}
    _legend(figure, names)


def _legend(figure: Any, names: dict[str, str]) -> None:
    from matplotlib.patches import Patch

    handles = [Patch(color=colour, label=name) for colour, name in names.items()]
    figure.legend(handles=handles, ncols=3, fontsize="small", loc="outside upper center")


DRAWN = {
    "displacement": displacement_figure,
    "contact": contact_figure,
    "space_time": space_time_figure,
    "profiles": profiles_figure,
    "loop": loop_figure,
}
"""What draws each of PICTURES."""
