"""Pictures of a run: the displacement with its slip zone, and the contact's histories."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from sweepopt.fem.contact import STATES, Slip
from sweepopt.fem.output import Report
from sweepopt.plot import LINE_COLOURS, LINE_STYLES, STICK, draw_stick, new_figure

STATE_COLOURS = {-1: "#0072B2", 0: STICK, 1: "#D55E00"}
MOST_PICTURES = 6
"""Panels of a page that are still large enough to see the slip zone."""
MOST_POINTS = 4
"""Contact points whose histories can still be told apart."""


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
    if times is None:
        indices = _informative(report)
    else:
        solution(times)  # refuses those outside of the run
        indices = [int(np.abs(solution.t - t).argmin()) for t in times]
    fields = body.expand(solution.u[indices])
    (height, unit), (length, meter) = _length(report, fields), _length(report, body.points)
    fields, points = height * fields, length * body.points
    limit = float(np.abs(fields).max()) or 1.0
    figure, panels = _page(np.ptp(points, axis=0), len(indices))
    colours = {"cmap": "PRGn", "vmin": -limit, "vmax": limit, "shading": "gouraud"}
    along = body.edge_nodes(body.mesh.boundary_facets())
    edges = np.column_stack([along[:-1].ravel(), along[1:].ravel()])
    for panel, i, field in zip(panels.flat, indices, fields, strict=False):
        image = panel.tripcolor(*points.T, body.triangles, field, rasterized=True, **colours)
        _draw_lines(panel, points[edges], "black", 0.6)
        title = f"t = {solution.t[i]:.4g}{' s' if meter else ''}"
        if slip is not None:
            step = max(i - 1, 0)  # the one that ends there; at the start the first
            _draw_states(panel, points, edges, body.free[slip.contact.unknown], slip.state[step])
            share = f"{100 * slip.share[step]:.0f} % slips"
            title += f", {share if slip.state[step].any() else 'all sticks'}"
        panel.set_title(title, fontsize="medium")
        panel.set_aspect("equal")
        panel.margins(0.05)
    for panel in panels[-1]:
        panel.set_xlabel(f"x{meter}")
    for panel in panels[:, 0]:
        panel.set_ylabel(f"y{meter}")
    bar = figure.colorbar(image, ax=panels, label=f"displacement{unit}", shrink=0.8)
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
    contact = slip.contact
    height, unit = _length(report, slip.displacement)
    length, meter = _length(report, contact.position)
    meters = meter.strip(" ()")
    figure = new_figure((8.5, 9.0))
    zone, moved, traction = figure.subplots(3, 1, sharex=True, height_ratios=[1.3, 1.0, 1.0])
    boundaries = list(dict.fromkeys(contact.boundary))
    _draw_zone(zone, slip, length)
    zone.set_ylabel(f"arc length of {', '.join(boundaries)}{meter}")
    for k, node in enumerate(_nodes_shown(slip)):
        look: dict[str, Any] = {"color": LINE_COLOURS[k], "linestyle": LINE_STYLES[k]}
        zone.axhline(length * contact.position[node], lw=2.6, color="white")
        zone.axhline(length * contact.position[node], lw=1.4, **look)
        boundary = f"{contact.boundary[node]} " if len(boundaries) > 1 else ""
        place = f"at {boundary}{length * contact.arc[node]:.3g} {meters}".rstrip()
        u = height * slip.displacement[:, node]
        moved.plot(slip.t, u, lw=1.5, label=place, **look)
        draw_stick(moved, slip.state[:, node] == 0, slip.t, u, LINE_COLOURS[k])
        traction.plot(slip.stage_t, slip.traction[:, node] / contact.bound[node], lw=1.5, **look)
    moved.plot([], [], color=STICK, lw=6.0, alpha=0.25, label="sticks")
    moved.set_ylabel(f"displacement{unit}")
    moved.legend(fontsize="small", ncols=5, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    for level in (-1.0, 1.0):
        traction.axhline(level, color="black", lw=1.0, linestyle=":", zorder=0)
    traction.set(ylabel="friction traction / bound", ylim=(-1.15, 1.15))
    traction.set(xlabel="time (s)" if meter else "time", xlim=(slip.t[0], slip.t[-1]))
    for panel in (moved, traction):
        panel.grid(alpha=0.3)
    return figure


def _length(report: Report, values: np.ndarray) -> tuple[float, str]:
    """A factor that makes the largest 0.1 or more, and its unit then; "" is dimensionless."""
    if report.units["length"] == "1":
        return 1.0, ""
    k = int(np.clip(np.ceil(-(1 + np.log10(np.abs(values).max() or 1.0)) / 3), 0, 3))
    return 1e3**k, f" ({('m', 'mm', 'µm', 'nm')[k]})"


def _informative(report: Report) -> list[int]:
    """Time indices of the panels: at most six, not close together, increasing."""
    solution, slip = report.solution, report.slip
    last = len(solution.steps)
    wanted = [last, int(np.abs(solution.u).max(axis=1).argmax())]
    if slip is not None and slip.state.any():
        direction = slip.state @ slip.contact.weight
        steps = (slip.share.argmax(), (slip.share > 0).argmax(), direction.argmax())
        wanted += [int(step) + 1 for step in (*steps, direction.argmin())]
    wanted += np.linspace(0, last, 2 * MOST_PICTURES + 1).round().astype(int).tolist()
    chosen: list[int] = []
    for i in wanted:
        if i > 0 and all(abs(i - other) >= last / (2 * MOST_PICTURES) for other in chosen):
            chosen.append(i)
    return sorted(chosen[:MOST_PICTURES])


def _page(size: np.ndarray, count: int) -> tuple[Any, np.ndarray]:
    """A figure of equal panels for a body of a width and a height, on a page of 10 to 7."""
    shape = float(np.clip(size[1] / size[0], 0.2, 5.0))
    columns = int(np.clip(round(np.sqrt(count * shape / 0.7)), 1, count))
    rows = -(-count // columns)
    width = min(9.0 / columns, 8.0 / (rows * shape))
    figure = new_figure((width * columns + 2.0, (width * shape + 0.35) * rows + 1.0))
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    for panel in panels.flat[count:]:
        panel.set_axis_off()
    return figure, panels


def _draw_states(
    panel: Any, points: np.ndarray, edges: np.ndarray, nodes: np.ndarray, state: np.ndarray
) -> None:
    """The contact boundary: each edge in two halves, in the colours of the states of its ends."""
    colour_of = {node: STATE_COLOURS[s] for node, s in zip(nodes, state, strict=True)}
    edges = edges[np.isin(edges, nodes).all(axis=1)]
    middle = points[edges].mean(axis=1)
    halves = np.concatenate([np.stack([points[ends], middle], axis=1) for ends in edges.T])
    _draw_lines(panel, halves, "white", 6.5)  # a casing against the field
    _draw_lines(panel, halves, [colour_of[node] for node in edges.T.ravel()], 4.0)


def _draw_lines(panel: Any, segments: np.ndarray, colours: Any, width: float) -> None:
    from matplotlib.collections import LineCollection

    panel.add_collection(LineCollection(list(segments), colors=colours, lw=width, capstyle="round"))


def _draw_zone(panel: Any, slip: Slip, factor: float) -> None:
    """Slip state over arc length and time."""
    from matplotlib.colors import ListedColormap

    position, names = factor * slip.contact.position, slip.contact.boundary
    half = factor * slip.contact.weight / 2.0
    middles = (position[1:] + position[:-1]) / 2.0
    colours = ListedColormap([STATE_COLOURS[state] for state in STATES])
    edges = [position[0] - half[0], *middles, position[-1] + half[-1]]
    panel.pcolormesh(
        slip.t, edges, slip.state.T, cmap=colours, vmin=-1.5, vmax=1.5, rasterized=True
    )
    for limit in middles[names[1:] != names[:-1]]:
        panel.axhline(limit, color="white", lw=2.0)
    _state_legend(panel, loc="lower center", bbox_to_anchor=(0.5, 1.0))


def _nodes_shown(slip: Slip) -> list[int]:
    """Nodes that slip from little to far; of those that never slip, the one nearest to it."""
    load = np.abs(slip.traction / slip.contact.bound).max(axis=0)
    order = np.lexsort((load, slip.total))[max(np.count_nonzero(slip.total == 0.0) - 1, 0) :]
    return sorted(set(order[np.linspace(0, len(order) - 1, MOST_POINTS).round().astype(int)]))


def _state_legend(parent: Any, **where: Any) -> None:
    """What the colours of the contact boundary mean."""
    from matplotlib.patches import Patch

    handles = [
        Patch(color=STATE_COLOURS[state], label=name.replace("_", " "))
        for state, name in STATES.items()
    ]
    parent.legend(handles=handles, ncols=3, fontsize="small", **where)
