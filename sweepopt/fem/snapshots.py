"""Fields of a body at times: a few side by side in a picture, many in turn in an animation."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import skfem

from sweepopt.fem.contact import STATES, Slip, signed_lengths
from sweepopt.fem.effects import Traction
from sweepopt.fem.output import Report
from sweepopt.plot import STICK, new_figure, write_animation

Array = np.ndarray
PLUG, PULLED = "#E69F00", "#CC79A7"
SMOOTH: dict[str, Any] = {"shading": "gouraud", "rasterized": True}
STATE_COLOURS = {-1: "#0072B2", 0: STICK, 1: "#D55E00"}
LENGTH = "displacement, its length"
EXAGGERATED = 0.05
"""A solid is drawn deformed so that its largest displacement is at least this share of its size."""


class Snapshots(NamedTuple):
    """A field at the times of a run; what belongs to steps is that of the step that ends there.

    Attributes
    ----------
    values : ndarray, shape (n+1, ...)
        Of which the extremes are shown.
    draw : callable (panel, i) -> what the bar of colours belongs to, if there is one
    points : ndarray, shape (N, d)
        What is drawn lies in their box; over a line it is a curve, with the label beside it.
    label, quantity : str
        Of the bar, and whose units it has.
    history : tuple of (ndarray of shape (n+1,), str)
        A line over time below, and its name; where it grows something happens.
    legend : mapping of str to str
        What colours mean.
    axes : str
        Names of the coordinates of the points.
    """

    values: Array
    draw: Callable[[Any, int], Any]
    points: Array
    label: str
    quantity: str
    history: tuple[Array, str]
    legend: Mapping[str, str] = {}
    axes: str = "xyz"


def picture(report: Report, field: Snapshots) -> Any:
    """The field at up to six times, and a line over the whole run.

    The times are those at which the line first reaches a quarter, a half and three quarters of its
    largest size, those of the largest and of a negative least value of the field, and the end.

    Returns
    -------
    matplotlib Figure
    """
    t, reached = report.solution.t, np.maximum.accumulate(np.abs(field.history[0]))
    quarters = np.searchsorted(reached, reached[-1] * np.arange(1, 4) / 4)
    chosen, flat = {*quarters.tolist(), len(t) - 1}, field.values.reshape(len(t), -1)
    chosen |= {int(one.max(axis=1).argmax()) for one in (flat, -flat) if one.max() > 0}
    figure, _, history = _page(report, field, sorted(chosen))
    for i in chosen:
        history.axvline(t[i], color="black", lw=0.8, ls=":")
    return figure


def animation(report: Report, field: Snapshots, path: Path) -> None:
    """Write the field at up to 40 even times as a GIF or, by ffmpeg, as an MP4."""
    figure, ((panel,),), history = _page(report, field, [0])
    line = history.axvline(0.0, color="black", lw=1.2)

    def draw(i: int) -> None:
        for artist in [*panel.collections, *panel.lines]:
            artist.remove()
        _draw(report, field, panel, i)
        line.set_xdata([report.solution.t[i]] * 2)

    write_animation(figure, path, report.solution.t, draw)


def displacement(report: Report) -> Snapshots:
    """The displacement of a body in the plane, and where it slips."""
    body = report.scene.discretisation
    u = signed_lengths(report.scene.displacement(report.solution))
    label = "displacement" if body.components == 1 else LENGTH
    if body.mesh.dim() == 1:
        return _along_a_line(report, u, label)
    label += " out of the plane" if body.kind == "antiplane" else ""

    def lines(facets: Array) -> Array:
        edges = body.points[body.facet_nodes(facets).T]
        return np.pad(edges, ((0, 0), (0, 1), (0, 0)), constant_values=np.nan).reshape(-1, 2)

    pulled = [name for one in report.scene.effects if isinstance(one, Traction) for name in one.on]
    arcs = {"clamped": (body.clamped, "black"), "pulled": (pulled, PULLED)}
    drawn = {what: (lines(body.facets(what, on)[0]), c) for what, (on, c) in arcs.items() if on}
    outline, look = lines(body.mesh.boundary_facets()), SMOOTH | colours_of(u)

    def draw(panel: Any, i: int) -> Any:
        panel.plot(*outline.T, color="black", lw=0.6, zorder=1)
        for arc, colour in drawn.values():
            panel.plot(*arc.T, color=colour, lw=3.0, zorder=1.5, solid_capstyle="butt")
        _mark(report, panel, i, body.points)
        return panel.tripcolor(*body.points.T, body.triangles, u[i], **look)

    line, legend = _slip_history(report, u)
    legend = legend | {colour: what for what, (_, colour) in drawn.items()}
    return Snapshots(u, draw, body.points, label, "length", line, legend)


def _along_a_line(report: Report, u: Array, label: str) -> Snapshots:
    """The displacement of a bar or of a chain over x."""
    x = report.scene.discretisation.points[:, 0]
    order, edge = np.argsort(x), 0.08 * (np.ptp(u) or 1.0)

    def draw(panel: Any, i: int) -> None:
        panel.plot(x[order], u[i, order], color="black", lw=1.0, zorder=1)
        _mark(report, panel, i, np.column_stack([x, u[i]]))
        panel.set_ylim(u.min() - edge, u.max() + edge)
        name_axis(report, panel.yaxis, "", "length")

    return Snapshots(u, draw, x[:, None], label, "length", *_slip_history(report, u))


def surface(report: Report) -> Snapshots:
    """The deformed surface of a solid with the length of its displacement, seen from its contact.

    Small displacements are drawn larger, by a power of ten that the bar of colours names.
    """
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    body, contact = report.scene.discretisation, report.scene.contact
    u = report.scene.displacement(report.solution)
    length = signed_lengths(u)
    share = float(length.max() / np.ptp(body.points, axis=0).max()) or 1.0
    factor = 10.0 ** max(int(np.ceil(np.log10(EXAGGERATED / share))), 0)
    label = LENGTH + (f"; drawn {factor:g} times as large" if factor > 1 else "")
    moved, look = body.points + factor * u, colours_of(length)
    below = contact is not None and contact.points[:, 2].mean() < body.points[:, 2].mean()

    def draw(panel: Any, i: int) -> Any:
        look3 = {"edgecolor": "0.3", "lw": 0.2, "cmap": look["cmap"]}
        faces = Poly3DCollection(moved[i, body.triangles], **look3)
        faces.set(array=length[i, body.triangles].mean(axis=1), clim=(0.0, look["vmax"]))
        panel.add_collection3d(faces)
        _mark(report, panel, i, moved[i], depthshade=False)
        panel.view_init(elev=-30 if below else 30, azim=-60)
        panel.set_box_aspect(np.ptp(moved, axis=(0, 1)), zoom=1.07)
        return faces

    box = moved.reshape(-1, 3)
    return Snapshots(length, draw, box, label, "length", *_slip_history(report, length))


def flow(report: Report) -> Snapshots:
    """The velocity of a section, what is rigid in it, and the flux.

    A triangle is a part of a plug if its corners have one velocity, and at rest if that is 0: both
    exactly, as the steps leave them.
    """
    from matplotlib.colors import ListedColormap

    body = report.scene.discretisation
    velocity, triangles = _by_ends(report.scene.velocity(report.solution)), body.triangles
    look, flat = SMOOTH | colours_of(velocity), {"cmap": ListedColormap([STICK, PLUG])}

    def draw(panel: Any, i: int) -> Any:
        image = panel.tripcolor(*body.points.T, triangles, velocity[i], **look)
        corners = velocity[i, triangles]
        rigid = np.ma.array(corners[:, 0] != 0, mask=np.ptp(corners, axis=1) > 0)
        panel.tripcolor(*body.points.T, triangles, facecolors=rigid, vmin=0, vmax=1, **flat)
        return image

    flux = velocity @ skfem.LinearForm(lambda v, _: v).assemble(body.scalar)
    line = flux, "flux" + (" (m³/s)" if report.suffix("length") else "")
    legend = {PLUG: "moves as a rigid body", STICK: "rests"}
    return Snapshots(velocity, draw, body.points, "velocity", "velocity", line, legend)


def yielding(report: Report) -> Snapshots:
    """Plastic strains of a body in the plane; grey where there is none yet, to show their front."""
    body, strain = report.scene.discretisation, report.scene.plastic_strain(report.solution)
    assert strain is not None
    cells, look = body.scalar.element_dofs[:3].T, colours_of(strain, "plasma_r")

    def draw(panel: Any, i: int) -> Any:
        plastic = np.ma.masked_equal(strain[i], 0.0)
        return panel.tripcolor(*body.points.T, cells, facecolors=plastic, **look)

    share = 100 * np.maximum.accumulate(strain > 0, axis=0).mean(axis=1)
    line, legend = (share, "% of the cells\nhave yielded"), {STICK: "elastic so far"}
    return Snapshots(strain, draw, body.points, "plastic strain", "", line, legend)


def arrows(report: Report) -> Snapshots:
    """Slip arrows in the plane of contact, and the friction traction over its bound, of vectors."""
    slip = report.slip
    assert slip is not None
    plane = np.sort(np.argsort(-np.ptp(slip.contact.points, axis=0), kind="stable")[:2])
    x, use = slip.contact.points[:, plane], _by_ends(slip.use)
    speed = _by_ends(slip.speed)
    velocity = _by_ends(report.scene.velocity(report.solution)[:, slip.contact.node][..., plane])
    scale = (speed.max() or 1.0) / (0.08 * np.ptp(x[:, 0]))
    look = {"angles": "xy", "scale_units": "xy", "scale": scale, "width": 0.003}

    def draw(panel: Any, i: int) -> Any:
        moves = speed[i] > 0
        panel.quiver(*x[moves].T, *velocity[i, moves].T, **look)
        return panel.scatter(*x.T, c=use[i], s=14, vmin=0.0, vmax=1.0, cmap="viridis")

    label, axes = "friction traction / bound", "".join("xyz"[k] for k in plane)
    return Snapshots(speed, draw, x, label, "", _slip_history(report, speed)[0], axes=axes)


def colours_of(values: Array, rising: str = "Greens") -> dict[str, Any]:
    """Colours from 0, or on both sides of 0, to the largest value; grey where there is none."""
    from matplotlib import colormaps

    limit, signed = float(np.abs(values).max()) or 1.0, values.min() < 0
    colours = colormaps["PRGn" if signed else rising].with_extremes(bad=STICK)
    return {"cmap": colours, "vmin": -limit * signed, "vmax": limit}


def name_axis(report: Report, axis: Any, label: str, quantity: str) -> None:
    """The label of an axis, and ticks with units, such as 20 mm; without units plain numbers."""
    from matplotlib.ticker import EngFormatter

    axis.set_label_text(label)
    if quantity and report.suffix(quantity):
        axis.set_major_formatter(EngFormatter(report.units[quantity]))


def draw_zone(report: Report, slip: Slip, panel: Any) -> None:
    """Slip state over arc length and time."""
    from matplotlib.colors import ListedColormap

    colours = ListedColormap([STATE_COLOURS[state] for state in STATES])
    image = panel.pcolormesh(slip.t, between(slip.contact.arc), slip.state.T, cmap=colours)
    image.set(clim=(-1.5, 1.5), rasterized=True)
    name_axis(report, panel.yaxis, along(slip), "length")


def along(slip: Slip) -> str:
    """The axis along boundaries with friction."""
    return f"arc length of {', '.join(dict.fromkeys(slip.contact.boundary))}"


def between(x: Array) -> Array:
    """Ends of the shares of increasing places."""
    return np.hstack([x[0], (x[1:] + x[:-1]) / 2.0, x[-1]])


def legend_of(figure: Any, names: Mapping[str, str]) -> None:
    """What colours mean, above all panels."""
    from matplotlib.patches import Patch

    handles = [Patch(color=colour, label=name) for colour, name in names.items()]
    if handles:
        figure.legend(handles=handles, ncols=3, fontsize="small", loc="outside upper center")


def states_of(slip: Slip) -> dict[str, str]:
    """What the colours of nodes with friction mean; of vectors slip has no sign."""
    if slip.velocity.ndim > 2:
        return {STATE_COLOURS[0]: "sticks", STATE_COLOURS[1]: "slips"}
    return {STATE_COLOURS[state]: name.replace("_", " ") for state, name in STATES.items()}


def _slip_history(report: Report, values: Array) -> tuple[tuple[Array, str], dict[str, str]]:
    """The share of the contact that slips, and colours; without friction the largest value."""
    slip = report.slip
    if slip is None:
        return (np.abs(values).max(axis=1), "largest"), {}
    return (100 * _by_ends(slip.share), "% of the\ncontact slip"), states_of(slip)


def _by_ends(values: Array) -> Array:
    """Of steps, at their ends and at the start."""
    return np.concatenate([values[:1], values])


def _mark(report: Report, panel: Any, i: int, points: Array, **look: Any) -> None:
    """Nodes with friction in the colours of their states, with a casing against the field."""
    if (slip := report.slip) is not None:
        x, state = points[slip.contact.node].T, slip.state[max(i - 1, 0)]
        panel.scatter(*x, s=40, c="white", zorder=2, **look)
        panel.scatter(*x, s=16, c=[STATE_COLOURS[k] for k in state], zorder=3, **look)


def _draw(report: Report, field: Snapshots, panel: Any, i: int) -> Any:
    """The field on a panel, and the time."""
    panel.set_title(f"t = {report.solution.t[i]:.4g}{report.suffix('time')}", fontsize="medium")
    return field.draw(panel, i)


def _page(report: Report, field: Snapshots, indices: list[int]) -> tuple[Any, Array, Any]:
    """A figure, its panels, up to three in a row, and one with the history below."""
    size, count = np.ptp(field.points, axis=0), len(indices)
    flat, solid = len(size) == 2, len(size) == 3
    columns, shape = 2 if count == 4 else min(count, 3), size[1] / size[0] if flat else 0.75
    rows, width = -(-count // columns), min(9.0 / max(columns, 2), 4.0 / shape)
    heights = [(width * shape + 0.3) * rows + 0.8, 1.7]
    figure = new_figure((width * columns + 2.0, sum(heights)))
    grid = figure.add_gridspec(2, 1, height_ratios=heights)
    kind: dict[str, Any] = {"subplot_kw": {"projection": "3d"}} if solid else {}
    share = {"sharex": not solid, "sharey": not solid, "squeeze": False}
    panels = grid[0].subgridspec(rows, columns).subplots(**share, **kind)
    for panel in panels.flat[count:]:
        panel.set_axis_off()
    for panel, i in zip(panels.flat, indices, strict=False):
        image = _draw(report, field, panel, i)
        for own, name, x in zip("xyz", field.axes, field.points.T, strict=False):
            edge = 0.08 * np.ptp(x)
            panel.set(**{f"{own}lim": (x.min() - edge, x.max() + edge)})
            name_axis(report, getattr(panel, f"{own}axis"), name, "length")
        panel.locator_params(nbins=4)
        if flat:
            panel.set_aspect("equal")
        if not solid:
            panel.label_outer()
    history, slip, t = figure.add_subplot(grid[1]), report.slip, report.solution.t
    if slip is not None and slip.velocity.ndim == 2 and slip.contact.on_curve:
        draw_zone(report, slip, history)
    else:
        history.plot(t, field.history[0], color="black", lw=1.5)
        history.set_ylabel(field.history[1])
    history.set_xlim(t[[0, -1]])
    history.grid(alpha=0.3)
    name_axis(report, history.xaxis, "time", "time")
    if len(size) == 1:
        figure.supylabel(field.label)
    else:
        bar = figure.colorbar(image, ax=panels, shrink=0.8)
        name_axis(report, bar.ax.yaxis, field.label, field.quantity)
    legend_of(figure, field.legend)
    return figure, panels, history
