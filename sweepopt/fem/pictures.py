"""Pictures of a run: the displacement with its slip zone, and the contact's histories."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from sweepopt.errors import InputError
from sweepopt.fem.contact import STATES, Slip
from sweepopt.fem.output import Report
from sweepopt.fem.scene import Scene
from sweepopt.plot import LINE_COLOURS, LINE_STYLES, STICK, draw_stick, new_figure

STATE_COLOURS = {-1: "#0072B2", 0: STICK, 1: "#D55E00"}
MOST_PICTURES = 6
"""Panels of a page that are still large enough to see the slip zone."""
MOST_POINTS = 4
"""Contact points whose histories are drawn; a fifth is one that never slips."""


class Scale(NamedTuple):
    """A factor that makes numbers readable, and their unit then; "" is dimensionless."""

    factor: float
    unit: str

    def label(self, quantity: str) -> str:
        """The quantity with its unit, for an axis."""
        return f"{quantity} ({self.unit})" if self.unit else quantity


def displacement_figure(report: Report, times: Sequence[float] | None = None) -> Any:
    """The displacement at a few times, with the slip zone on the contact boundary.

    Parameters
    ----------
    report : Report
    times : sequence of float, optional
        The nearest grid times are drawn. Otherwise up to six: when slip starts, when it reaches
        furthest, the largest displacement, the end, and some between.

    Returns
    -------
    matplotlib Figure
    """
    solution, slip, body = report.solution, report.slip, report.scene.discretisation
    indices = _informative(report) if times is None else _nearest(solution.t, times)
    fields = body.expand(solution.u[indices])
    height, length = _length(report, fields), _length(report, body.points)
    fields, points = height.factor * fields, length.factor * body.points
    limit = float(np.abs(fields).max()) or 1.0
    rows, columns, size = _page(points, len(indices))
    figure = new_figure(size)
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    outline = points[_boundary_edges(body.triangles)]
    for panel in panels.flat[len(indices) :]:
        panel.set_axis_off()
    for panel, i, field in zip(panels.flat, indices, fields, strict=False):
        image = panel.tripcolor(
            *points.T,
            body.triangles,
            field,
            vmin=-limit,
            vmax=limit,
            cmap="PRGn",
            shading="gouraud",
            rasterized=True,
        )
        _draw_lines(panel, outline, "black", 0.6)
        title = f"t = {solution.t[i]:.4g}{' s' if length.unit else ''}"
        if slip is not None:
            step = max(i - 1, 0)  # the one that ends there; at the start the first
            _draw_states(panel, report.scene, length.factor, slip.state[step])
            share = f"{100 * slip.share[step]:.0f} % slips"
            title += f", {share if slip.state[step].any() else 'all sticks'}"
        panel.set_title(title, fontsize="medium")
        panel.set_aspect("equal")
        panel.margins(0.05)
    for panel in panels[-1]:
        panel.set_xlabel(length.label("x"))
    for panel in panels[:, 0]:
        panel.set_ylabel(length.label("y"))
    bar = figure.colorbar(image, ax=panels, label=height.label("displacement"), shrink=0.8)
    if fields.any():
        bar.ax.set_ylim(fields.min(), fields.max())
    if slip is not None:
        _state_legend(figure, loc="outside upper center", title="contact boundary")
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
    height, length = _length(report, slip.displacement), _length(report, slip.position)
    figure = new_figure((8.5, 9.0))
    zone, moved, traction = figure.subplots(3, 1, sharex=True, height_ratios=[1.3, 1.0, 1.0])
    _draw_zone(zone, slip, length)
    for k, node in enumerate(_nodes_shown(slip)):
        look: dict[str, Any] = {"color": LINE_COLOURS[k], "linestyle": LINE_STYLES[k]}
        zone.axhline(length.factor * slip.position[node], lw=2.6, color="white")
        zone.axhline(length.factor * slip.position[node], lw=1.4, **look)
        several = len(slip.boundary_starts) > 1
        boundary = f"{slip.contact.boundary[node]} " if several else ""
        place = f"at {boundary}{length.factor * slip.contact.arc[node]:.3g} {length.unit}".rstrip()
        u = height.factor * slip.displacement[:, node]
        moved.plot(slip.t, u, lw=1.5, label=place, **look)
        draw_stick(moved, slip.state[:, node] == 0, slip.t, u, LINE_COLOURS[k])
        share = slip.traction[:, node] / slip.contact.bound[node]
        traction.plot(slip.stage_t, share, lw=1.5, **look)
    moved.plot([], [], color=STICK, lw=6.0, alpha=0.25, label="sticks")
    moved.set_ylabel(height.label("displacement"))
    moved.legend(fontsize="small", ncols=5, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    for level in (-1.0, 1.0):
        traction.axhline(level, color="black", lw=1.0, linestyle=":", zorder=0)
    traction.set(ylabel="friction traction / bound", ylim=(-1.15, 1.15))
    traction.set(xlabel="time (s)" if length.unit else "time", xlim=(slip.t[0], slip.t[-1]))
    for panel in (moved, traction):
        panel.grid(alpha=0.3)
    return figure


def _length(report: Report, values: np.ndarray) -> Scale:
    """Metres, or a thousandth, so that the largest number is 0.1 or more."""
    largest = float(np.abs(values).max())
    if report.units.length == "1":
        return Scale(1.0, "")
    for factor, unit in ((1.0, "m"), (1e3, "mm"), (1e6, "µm")):
        if largest * factor >= 0.1 or largest == 0.0:
            return Scale(factor, unit)
    return Scale(1e9, "nm")


def _informative(report: Report) -> list[int]:
    """Time indices of the panels: at most six, not close together, increasing."""
    solution, slip = report.solution, report.slip
    last = len(solution.steps)
    wanted = [last, int(np.argmax(np.abs(solution.u).max(axis=1)))]
    if slip is not None and slip.share.any():
        signed = (slip.state * slip.contact.weight).sum(axis=1)
        steps = (slip.share.argmax(), (slip.share > 0.0).argmax(), signed.argmax(), signed.argmin())
        wanted += [int(step) + 1 for step in steps]
    wanted += np.linspace(0, last, 2 * MOST_PICTURES + 1).round().astype(int).tolist()[1:]
    near = last / (2 * MOST_PICTURES)
    chosen: list[int] = []
    for i in wanted:
        if i > 0 and all(abs(i - other) >= near for other in chosen):
            chosen.append(i)
    return sorted(chosen[:MOST_PICTURES])


def _nearest(grid: np.ndarray, times: Sequence[float]) -> list[int]:
    for t in times:
        if not grid[0] <= t <= grid[-1]:
            raise InputError(f"t = {t:g} is outside of [{grid[0]:g}, {grid[-1]:g}]")
    return sorted({int(np.argmin(np.abs(grid - t))) for t in times})


def _page(points: np.ndarray, count: int) -> tuple[int, int, tuple[float, float]]:
    """Rows, columns and size of a figure of equal panels that fits a page."""
    width, height = np.ptp(points, axis=0)
    shape = float(np.clip(height / width, 0.2, 5.0))
    # as near as possible to a page of 10 to 7
    columns = min(range(1, count + 1), key=lambda c: abs(np.log(-(-count // c) * shape / c / 0.7)))
    rows = -(-count // columns)
    panel = min(9.0 / columns, 8.0 / (rows * shape))
    return rows, columns, (panel * columns + 2.0, panel * shape * rows + 0.35 * rows + 1.0)


def _boundary_edges(triangles: np.ndarray) -> np.ndarray:
    """Edges of one triangle only, shape (k, 2)."""
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, count = np.unique(edges, axis=0, return_counts=True)
    return np.asarray(edges[count == 1])


def _draw_states(panel: Any, scene: Scene, scale: float, state: np.ndarray) -> None:
    """The contact boundary: each edge in two halves, in the colours of the states of its ends."""
    body, contact = scene.discretisation, scene.contact
    assert contact is not None
    number = np.full(len(body.points), -1)
    number[body.free[contact.unknown]] = np.arange(len(contact))
    edges = _boundary_edges(body.triangles)
    edges = edges[(number[edges] >= 0).all(axis=1)]
    ends = scale * body.points[edges]
    middle = ends.mean(axis=1)
    halves = np.concatenate([np.stack([ends[:, k], middle], axis=1) for k in (0, 1)])
    colours = [STATE_COLOURS[int(state[node])] for node in number[edges.T.ravel()]]
    _draw_lines(panel, halves, "white", 6.5)  # a casing against the field
    _draw_lines(panel, halves, colours, 4.0)


def _draw_lines(panel: Any, segments: np.ndarray, colours: Any, width: float) -> None:
    from matplotlib.collections import LineCollection

    panel.add_collection(LineCollection(list(segments), colors=colours, lw=width, capstyle="round"))


def _draw_zone(panel: Any, slip: Slip, length: Scale) -> None:
    """Slip state over arc length and time."""
    from matplotlib.colors import ListedColormap

    edges = length.factor * _cell_edges(slip)
    panel.pcolormesh(
        slip.t,
        edges,
        slip.state.T,
        cmap=ListedColormap([STATE_COLOURS[state] for state in STATES]),
        vmin=-1.5,
        vmax=1.5,
        rasterized=True,
    )
    for start in slip.boundary_starts[1:]:
        panel.axhline(edges[start], color="white", lw=2.0)
    names = ", ".join(str(name) for name in slip.contact.boundary[slip.boundary_starts])
    panel.set_ylabel(length.label(f"arc length of {names}"))
    _state_legend(panel, loc="lower center", bbox_to_anchor=(0.5, 1.0))


def _cell_edges(slip: Slip) -> np.ndarray:
    """Limits of each contact node's share of the arc length, shape (m+1,)."""
    position = slip.position
    if len(position) == 1:
        half = slip.contact.weight[0] / 2.0
        return np.array([position[0] - half, position[0] + half])
    inner = (position[1:] + position[:-1]) / 2.0
    return np.concatenate([position[:1], inner, position[-1:]])


def _nodes_shown(slip: Slip) -> list[int]:
    """Nodes that slip from little to far, and of those that never slip the one nearest to it."""
    sticking = np.flatnonzero(slip.total == 0.0)
    order = np.argsort(slip.total, kind="stable")[sticking.size :]
    ranks = np.linspace(0, max(len(order) - 1, 0), MOST_POINTS).round().astype(int)
    # the one that slips least looks like the one that sticks
    nodes = {int(i) for i in order[ranks[bool(sticking.size) :]]} if order.size else set()
    if sticking.size:
        load = np.abs(slip.traction[:, sticking] / slip.contact.bound[sticking]).max(axis=0)
        nodes.add(int(sticking[np.argmax(load)]))
    return sorted(nodes)


def _state_legend(parent: Any, **where: Any) -> None:
    """What the colours of the contact boundary mean."""
    from matplotlib.patches import Patch

    handles = [
        Patch(color=STATE_COLOURS[state], label=name.replace("_", " "))
        for state, name in STATES.items()
    ]
    parent.legend(handles=handles, ncols=3, fontsize="small", **where)
