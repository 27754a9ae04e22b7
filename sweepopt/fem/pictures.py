"""Pictures of a run: fields, what a contact does in space and time, loops of load and motion."""

from __future__ import annotations

from collections.abc import Callable
from itertools import cycle
from typing import Any

import numpy as np

from sweepopt.errors import InputError
from sweepopt.fem.contact import STATES, Slip
from sweepopt.fem.effects import Foundation, YieldStress
from sweepopt.fem.output import Report
from sweepopt.fem.scene import Scene
from sweepopt.fem.spaces import Discretisation
from sweepopt.plot import LOOKS, STICK, STYLES, draw_histories, new_figure, spread
from sweepopt.results import Solution

Array = np.ndarray
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
    body, t = report.scene.discretisation, report.solution.t
    if body.components > 1 or body.mesh.dim() != 2:
        raise InputError("pictures: flow is of an antiplane body in the plane; leave it out")
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
    _legend(figure, {PLUG: "moves as a rigid body", STICK: "rests"})
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


def space_time_figure(report: Report) -> Any:
    """The slip rate along the contact, or over x, and time; grey where it sticks.

    Parameters
    ----------
    report : Report
        Of a scene in which one component slips.

    Returns
    -------
    matplotlib Figure
    """
    from matplotlib import colormaps

    slip = report.slip
    if slip is None or slip.velocity.ndim > 2:
        raise InputError("pictures: space_time needs friction of one component; leave it out")
    contact = slip.contact
    curve = contact.on_curve
    order = np.argsort(contact.arc if curve else contact.points[:, 0], kind="stable")
    edges = _edges(slip) if curve else _between(contact.points[order, 0])
    rate = np.ma.masked_equal(slip.velocity[:, order], 0.0).T
    limit, least = float(np.abs(rate).max() or 1.0), float(rate.min() or 0.0)
    colours = colormaps["PuOr" if least < 0 else "YlOrBr"].with_extremes(bad=STICK)
    figure = new_figure((8.5, 5.0))
    panel = figure.subplots()
    look: dict[str, Any] = {"cmap": colours, "vmin": -limit if least < 0 else 0.0, "vmax": limit}
    image = panel.pcolormesh(slip.t, edges, rate, rasterized=True, **look)
    bar = figure.colorbar(image, ax=panel, label=f"slip rate{_in(report, 'velocity')}")
    bar.formatter.set_powerlimits((-2, 3))
    panel.set(xlabel="time", ylabel=_along(slip) if curve else "x")
    if curve:
        panel.set_ylim(_slipped(slip))
    _show_units(report, "time", panel.xaxis)
    _show_units(report, "length", panel.yaxis)
    _legend(figure, {STICK: "sticks"})
    return figure


def profiles_figure(report: Report) -> Any:
    """Slip and friction along the contact at five even times; the bound of t = 0 is dashed.

    Returns
    -------
    matplotlib Figure
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


def loop_figure(report: Report) -> Any:
    """Loads over the displacements that they work on: the area of a loop is what is lost.

    Returns
    -------
    matplotlib Figure
    """
    figure = new_figure((6.0, 5.0))
    panel = figure.subplots()
    for (x, load, words), look in zip(loops(report.scene, report.solution), cycle(LOOKS)):
        panel.plot(x, load, lw=1.5, **look)
        panel.set(xlabel=words[0], ylabel=words[1])
    panel.grid(alpha=0.3)
    panel.locator_params(axis="x", nbins=6)
    _show_units(report, "length", panel.xaxis)
    _show_units(report, "force", panel.yaxis)
    return figure


def loops(scene: Scene, solution: Solution) -> list[tuple[Array, Array, tuple[str, str]]]:
    """Displacement and load at the times with their names, one pair for each of what drives.

    Of each foundation whose far end moves, its displacement and force. Else of a prescribed
    displacement phi d, phi and the reaction <d, A u' + B u>; else the sum of the nodal forces along
    the largest load, and the mean displacement along them.
    """
    body, t = scene.discretisation, solution.t
    u = solution.u[:, : body.dim]
    driven = [one for one in scene.effects if isinstance(one, Foundation) and one.moved]
    found = []
    for effect in driven:
        term: Any = effect.contribute(body).loads[0]
        history, k = term
        d = np.array([history(time) for time in t])
        force = d * (k @ body.restrict(effect.shift(body))) - u @ k
        found.append((d, force, ("displacement of the far end", "force of the foundation")))
    if found:
        return found
    if scene.lifts:
        history, d = scene.lifts[0]
        return [
            (history(t), _reaction(scene, solution, d), ("prescribed displacement", "reaction"))
        ]
    forces = np.array([scene.load(time)[: body.dim] for time in t])
    largest = forces[np.linalg.norm(forces, axis=1).argmax()]
    if not largest.any():
        raise InputError("pictures: loop needs a load or a far end that moves; leave it out")
    nodal = body.expand(largest).reshape(-1, body.components)
    along = largest / np.linalg.norm(nodal, axis=1).sum()
    load = forces @ along / (along @ along)
    return [(u @ along, load, ("mean displacement along the load", "load"))]


def _reaction(scene: Scene, solution: Solution, d: Array) -> Array:
    """<d, A u' + B u> at the times, with u at all nodes."""
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
    return force


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


def _between(x: Array) -> Array:
    """Ends of the shares of increasing places."""
    return np.hstack([x[0], (x[1:] + x[:-1]) / 2.0, x[-1]])


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
    "arrows": arrows_figure,
    "flow": flow_figure,
    "yielding": yielding_figure,
    "loop": loop_figure,
}
"""What draws each of PICTURES."""
