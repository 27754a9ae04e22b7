"""Pictures of a run: the displacement with its slip zone, the contact's histories, and flow."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from sweepopt.errors import InputError
from sweepopt.fem.contact import STATES, Slip
from sweepopt.fem.effects import YieldStress
from sweepopt.fem.output import Report
from sweepopt.fem.spaces import Discretisation
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


def arrows_figure(report: Report) -> Any:
    """Slip arrows in the plane of contact, and the friction traction over its bound, of vectors.

    Parameters
    ----------
    report : Report
        Of a scene in which two components slip.

    Returns
    -------
    matplotlib Figure
    """
    solution, slip = report.solution, report.slip
    if slip is None or slip.velocity.ndim == 2:
        raise InputError("pictures: 'arrows' needs friction where two components slip")
    points, bound = slip.contact.points, slip.contact.bound
    plane = np.sort(np.argsort(-np.ptp(points, axis=0), kind="stable")[:2])
    x, last = points[:, plane], len(solution.steps) - 1
    steps = sorted({last, *(int(np.argmin(np.abs(slip.share - q))) for q in (0.25, 0.5, 1.0))})
    velocity = report.scene.velocity(solution)[:, slip.contact.node][:, :, plane]
    fastest = float(np.linalg.norm(velocity[steps], axis=2).max()) or 1.0
    ratio = np.linalg.norm(slip.traction, axis=2)
    ratio = np.divide(ratio, bound, out=np.zeros_like(ratio), where=bound > 0)
    figure = new_figure((9.0, 1.0 + 4.2 * np.ptp(x[:, 1]) / np.ptp(x[:, 0]) * -(-len(steps) // 2)))
    panels = figure.subplots(-(-len(steps) // 2), 2, squeeze=False, sharex=True, sharey=True)
    for panel in panels.flat[len(steps) :]:
        panel.set_axis_off()
    for panel, k in zip(panels.flat, steps, strict=False):
        panel.margins(0.1)
        image = panel.scatter(*x.T, c=ratio[k], s=14, vmin=0.0, vmax=1.0, cmap="viridis")
        arrows = velocity[k] * (0.09 * np.ptp(x[:, 0]) / fastest)
        moves = slip.speed[k] > 0
        panel.quiver(
            *x[moves].T, *arrows[moves].T, angles="xy", scale_units="xy", scale=1.0, width=0.003
        )
        time = f"t = {solution.t[k + 1]:.4g}{report.suffix('time')}"
        panel.set_title(f"{time}, {100 * slip.share[k]:.0f} % slips", fontsize="medium")
        panel.set(aspect="equal", xlabel="xyz"[plane[0]], ylabel="xyz"[plane[1]])
        panel.label_outer()
    figure.colorbar(image, ax=panels, label="friction traction / bound", shrink=0.8)
    _show_units(report, "length", panels[0, 0].xaxis, panels[0, 0].yaxis)
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
    chosen = _telling(velocity, flux)
    rows = -(-len(chosen) // 3)
    size = np.ptp(body.points, axis=0)
    height = rows * size[1] / size[0]
    figure = new_figure((9.5, 3.1 * height + 3.0))
    grid = figure.add_gridspec(2, 1, height_ratios=[height, 0.75])
    parts = grid[0].subgridspec(rows, min(len(chosen), 3))
    fields = parts.subplots(squeeze=False, sharex=True, sharey=True)
    fields[0, 0].locator_params(nbins=4)
    limit = float(np.abs(velocity).max()) or 1.0
    least = -limit if velocity.min() < 0 else 0.0
    colours = {"cmap": "PRGn" if least else "Blues", "vmin": least, "vmax": limit}
    for panel in fields.flat[len(chosen) :]:
        panel.set_axis_off()
    for panel, i in zip(fields.flat, chosen, strict=False):
        image = _draw_flow(panel, body, velocity[i], colours)
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


def yielding_figure(report: Report) -> Any:
    """Plastic strains at a few times; what has none yet is grey, so that their front is seen.

    The times are those at which a quarter, a half, three quarters and all of the cells that ever
    yield have done so, that of the largest strain and the end.

    Parameters
    ----------
    report : Report
        Of a body in the plane with plasticity.

    Returns
    -------
    matplotlib Figure
    """
    from matplotlib import colormaps

    solution, body = report.solution, report.scene.discretisation
    strain = report.scene.plastic_strain(solution)
    if strain is None or body.mesh.dim() != 2:
        raise InputError("pictures: yielding is of a body in the plane with plasticity")
    share = np.maximum.accumulate(strain > 0, axis=0).mean(axis=1)
    indices = [int(np.argmax(share >= k / 4 * share[-1])) for k in range(1, 5)]
    indices += [int(strain.max(axis=1).argmax()), len(solution.steps)]
    indices = sorted(set(indices))
    triangles = np.asarray(body.scalar.element_dofs[:3].T)
    colours = colormaps["plasma_r"].with_extremes(bad="0.85")
    figure, panels = _page(np.ptp(body.points, axis=0), len(indices))
    for panel, i in zip(panels.flat, indices, strict=False):
        image = panel.tripcolor(
            *body.points.T,
            triangles,
            facecolors=np.ma.masked_equal(strain[i], 0.0),
            cmap=colours,
            vmin=0.0,
            vmax=float(strain.max()) or 1.0,
            rasterized=True,
        )
        panel.set_title(f"t = {solution.t[i]:.4g}{report.suffix('time')}", fontsize="medium")
        panel.set(aspect="equal", xlabel="x", ylabel="y")
        panel.label_outer()
    figure.colorbar(image, ax=panels, label="plastic strain", shrink=0.8)
    _show_units(report, "length", panels[0, 0].xaxis, panels[0, 0].yaxis)
    return figure


def loop_figure(report: Report) -> Any:
    """The load over the displacement that it works on: the area of a loop is what is lost.

    The displacement is the mean of that of the body along the nodal forces of the largest load, the
    load is the sum of these.

    Parameters
    ----------
    report : Report
        Of a scene with a load.

    Returns
    -------
    matplotlib Figure
    """
    solution, scene = report.solution, report.scene
    body, t = scene.discretisation, solution.t
    forces = np.array([scene.load(time)[: body.dim] for time in t])
    largest = forces[np.linalg.norm(forces, axis=1).argmax()]
    if not largest.any():
        raise InputError("pictures: loop needs a load; the scene has none")
    nodal = body.expand(largest).reshape(-1, body.components)
    along = largest / np.linalg.norm(nodal, axis=1).sum()
    load = forces @ along / (along @ along)
    figure = new_figure((6.0, 4.5))
    panel = figure.subplots()
    panel.plot(solution.u[:, : body.dim] @ along, load, color="#0072B2", lw=1.5)
    panel.set(xlabel="mean displacement along the load", ylabel="load")
    panel.grid(alpha=0.3)
    panel.locator_params(axis="x", nbins=6)
    _show_units(report, "length", panel.xaxis)
    _show_units(report, "force", panel.yaxis)
    return figure


def _telling(velocity: np.ndarray, flux: np.ndarray) -> list[int]:
    """Up to six steps, increasing: extremes of the flux and an even choice of those that move."""
    moving = np.flatnonzero(velocity.any(axis=1))
    if not moving.size:
        return [0]
    extremes = {int(flux.argmax()), int(flux.argmin())} & set(moving.tolist())
    even = np.linspace(0, moving.size - 1, 6 - len(extremes)).astype(int)
    return sorted(extremes | set(moving[even].tolist()))


def _draw_flow(
    panel: Any, body: Discretisation, velocity: np.ndarray, colours: dict[str, Any]
) -> Any:
    """The velocity at the nodes, and in flat colours what moves as a rigid body or rests."""
    points, triangles = body.points, body.triangles
    look = {"shading": "gouraud", "rasterized": True} | colours
    image = panel.tripcolor(*points.T, triangles, velocity, **look)
    at = velocity[triangles]
    rigid = (at == at[:, :1]).all(axis=1)
    for still, colour in ((False, PLUG), (True, STICK)):
        part = triangles[rigid & ((at[:, 0] == 0) == still)]
        panel.fill(*points[part].transpose(2, 1, 0), color=colour, lw=0.4)
    return image


def _informative(solution: Solution, slip: Slip | None) -> list[int]:
    """Time indices, increasing: extreme displacements, start and extremes of slip, the end."""
    u, last = solution.u[:, : solution.process.fields["u"].stop], len(solution.steps)
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
    "yielding": yielding_figure,
    "loop": loop_figure,
    "arrows": arrows_figure,
}
"""What draws each of PICTURES."""
