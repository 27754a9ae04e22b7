"""Pictures of a run: the displacement with its slip zone, the contact's histories, and flow."""

from __future__ import annotations

from collections.abc import Callable
from itertools import cycle
from typing import Any

import numpy as np

from sweepopt.errors import InputError
from sweepopt.fem.contact import STATES, Slip
from sweepopt.fem.effects import Foundation, YieldStress
from sweepopt.fem.output import Report
from sweepopt.plot import LOOKS, STICK, STYLES, draw_histories, new_figure, spread
from sweepopt.results import Solution

PLUG = "#E69F00"
STATE_COLOURS = {-1: "#0072B2", 0: STICK, 1: "#D55E00"}


def drawn_of(report: Report) -> dict[str, Callable[[Report], Any]]:
    """The functions that draw the scene's pictures, by name; all that fit if it names none."""
    scene, slip = report.scene, report.slip
    flows = any(isinstance(effect, YieldStress) for effect in scene.effects)
    fits = {
        "displacement": scene.discretisation.mesh.dim() == 2,
        "flow": scene.discretisation.mesh.dim() == 2 and flows,
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


def flow_figure(report: Report) -> Any:
    """The velocity of an antiplane body at a few times, what is rigid in it, and the flux.

    A triangle is a part of a plug if its corners have one velocity, and at rest if that is 0: both
    exactly, as the steps leave them.

    Returns
    -------
    matplotlib Figure
    """
    from matplotlib.patches import Patch

    body, t = report.scene.discretisation, report.solution.t
    velocity, middle = report.scene.velocity(report.solution), (t[1:] + t[:-1]) / 2
    triangles = body.triangles
    a, b, c = body.points[triangles].transpose(1, 2, 0)
    area = np.abs((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])) / 2
    flux = velocity[:, triangles].mean(axis=2) @ area
    moving = np.flatnonzero(velocity.any(axis=1))
    extremes = {int(flux.argmax()), int(flux.argmin())} & set(moving.tolist())
    even = (
        moving[np.linspace(0, moving.size - 1, 6 - len(extremes)).astype(int)]
        if moving.size
        else [0]
    )
    chosen = sorted(extremes | set(map(int, even)))
    size = np.ptp(body.points, axis=0)
    figure = new_figure((9.5, 3.1 * size[1] / size[0] * -(-len(chosen) // 3) + 3.0))
    grid = figure.add_gridspec(2, 1, height_ratios=[-(-len(chosen) // 3) * size[1] / size[0], 0.75])
    fields = (
        grid[0]
        .subgridspec(-(-len(chosen) // 3), min(len(chosen), 3))
        .subplots(squeeze=False, sharex=True, sharey=True)
    )
    limit = float(np.abs(velocity).max()) or 1.0
    least = -limit if velocity.min() < 0 else 0.0
    colours = {"cmap": "PRGn" if least else "Blues", "vmin": least, "vmax": limit}
    for panel in fields.flat[len(chosen) :]:
        panel.set_axis_off()
    for panel, i in zip(fields.flat, chosen, strict=False):
        at = velocity[i, triangles]
        rigid = (at == at[:, :1]).all(axis=1)
        image = panel.tripcolor(
            *body.points.T, triangles, velocity[i], shading="gouraud", rasterized=True, **colours
        )
        for still, colour in ((False, PLUG), (True, STICK)):
            part = triangles[rigid & ((at[:, 0] == 0) == still)]
            panel.fill(*body.points[part].transpose(2, 1, 0), color=colour, lw=0.4)
        panel.set(aspect="equal", xlabel="x", ylabel="y")
        panel.set_title(f"t = {middle[i]:.4g}{report.suffix('time')}", fontsize="medium")
        panel.label_outer()
    bar = figure.colorbar(image, ax=fields, label="velocity", shrink=0.8)
    _show_units(report, "length", fields[0, 0].xaxis, fields[0, 0].yaxis)
    _show_units(report, "velocity", bar.ax.yaxis)
    history = figure.add_subplot(grid[1])
    history.plot(middle, flux, color="black", lw=1.5)
    history.plot(middle[chosen], flux[chosen], "o", color="black", ms=5)
    at_rest = np.where(velocity.any(axis=1), np.nan, 0.0)
    history.plot(middle, at_rest, color=STICK, lw=6.0, solid_capstyle="butt")
    history.set(xlabel="time", xlim=(t[0], t[-1]))
    history.set_ylabel("flux" + (" (m³/s)" if report.suffix("length") else ""))
    history.grid(alpha=0.3)
    _show_units(report, "time", history.xaxis)
    handles = [Patch(color=PLUG, label="moves as a rigid body"), Patch(color=STICK, label="rests")]
    figure.legend(handles=handles, ncols=2, fontsize="small", loc="outside upper center")
    return figure


def space_time_figure(report: Report) -> Any:
    """How fast each point with friction slips, over place and time; what sticks is white.

    Along the boundary where friction acts on one, else over x.

    Parameters
    ----------
    report : Report
        Of a scene with friction of one component.

    Returns
    -------
    matplotlib Figure
    """
    slip = report.slip
    if slip is None or slip.velocity.ndim > 2:
        raise InputError("pictures: 'space_time' needs friction of one component; leave it out")
    contact = slip.contact
    along = contact.on_curve
    order = np.argsort(contact.arc if along else contact.points[:, 0], kind="stable")
    x = (contact.arc if along else contact.points[:, 0])[order]
    edges = np.hstack([x[0], (x[1:] + x[:-1]) / 2.0, x[-1]])
    speed = np.ma.masked_equal(slip.velocity[:, order], 0.0)
    limit = float(np.abs(speed).max() or 1.0)
    signed = bool((speed < 0).any())
    figure = new_figure((8.5, 5.0))
    panel = figure.subplots()
    image = panel.pcolormesh(
        slip.t,
        edges,
        speed.T,
        cmap="coolwarm" if signed else "viridis",
        vmin=-limit if signed else 0.0,
        vmax=limit,
        rasterized=True,
    )
    names = ", ".join(dict.fromkeys(contact.boundary))
    panel.set(xlabel="time", ylabel=f"arc length of {names}" if along else "x")
    bar = figure.colorbar(image, ax=panel, label="velocity of slip; white sticks")
    _show_units(report, "length", panel.yaxis)
    _show_units(report, "time", panel.xaxis)
    _show_units(report, "velocity", bar.ax.yaxis)
    return figure


def loop_figure(report: Report) -> Any:
    """The force of each foundation whose far end moves, over how far it has moved.

    Parameters
    ----------
    report : Report
        Of a scene with a foundation that says `moved`.

    Returns
    -------
    matplotlib Figure
    """
    scene, solution = report.scene, report.solution
    space = scene.discretisation
    driven = [one for one in scene.effects if isinstance(one, Foundation) and one.moved]
    if not driven:
        raise InputError("pictures: 'loop' needs a foundation with `moved`; leave it out")
    figure = new_figure((6.5, 5.5))
    panel = figure.subplots()
    for effect, look in zip(driven, cycle(LOOKS)):
        term: Any = effect.contribute(space).loads[0]
        history, k = term
        d = np.array([history(t) for t in solution.t])
        force = d * (k @ space.restrict(effect.shift(space))) - solution.u[:, : space.dim] @ k
        panel.plot(d, force, lw=1.4, **look)
    panel.axhline(0.0, color="black", lw=0.5)
    panel.axvline(0.0, color="black", lw=0.5)
    panel.set(xlabel="displacement of the far end", ylabel="force of the foundation")
    _show_units(report, "length", panel.xaxis)
    _show_units(report, "force", panel.yaxis)
    return figure


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

    arc, half = slip.contact.arc, slip.contact.weight / 2.0
    edges = np.hstack([arc[0] - half[0], (arc[1:] + arc[:-1]) / 2.0, arc[-1] + half[-1]])
    colours = ListedColormap([STATE_COLOURS[state] for state in STATES])
    panel.pcolormesh(
        slip.t, edges, slip.state.T, cmap=colours, vmin=-1.5, vmax=1.5, rasterized=True
    )
    panel.set_ylabel(f"arc length of {', '.join(dict.fromkeys(slip.contact.boundary))}")


def _show_units(report: Report, quantity: str, *axes: Any) -> None:
    """Ticks with units, such as 20 mm; plain numbers in a dimensionless scene."""
    from matplotlib.ticker import EngFormatter

    if report.suffix(quantity):
        for axis in axes:
            axis.set_major_formatter(EngFormatter(report.units[quantity]))


def _state_legend(figure: Any) -> None:
    """What the colours of the contact boundary mean."""
    from matplotlib.patches import Patch

    handles = [
        Patch(color=STATE_COLOURS[state], label=name.replace("_", " "))
        for state, name in STATES.items()
    ]
    figure.legend(handles=handles, ncols=3, fontsize="small", loc="outside upper center")


DRAWN = {
    "displacement": displacement_figure,
    "contact": contact_figure,
    "flow": flow_figure,
    "space_time": space_time_figure,
    "loop": loop_figure,
}
"""What draws each of PICTURES."""
