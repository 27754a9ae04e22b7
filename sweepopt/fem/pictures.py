"""Pictures of bodies: the displacement with its slip zone, and the contact's histories."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from sweepopt.errors import InputError
from sweepopt.fem.contact import STATES, Slip
from sweepopt.plot import LINE_COLOURS, LINE_STYLES, STICK, draw_stick, new_figure

if TYPE_CHECKING:
    from sweepopt.fem.scene import Scene
    from sweepopt.results import Solution

STATE_COLOURS = {-1: "#0072B2", 0: STICK, 1: "#D55E00"}
MOST_PICTURES = 6
"""Panels of a page that are still large enough to see the slip zone."""
MOST_POINTS = 4
"""Contact points whose histories are drawn; a fifth is one that never slips."""


def displacement_figure(
    scene: Scene, solution: Solution, slip: Slip | None, times: Sequence[float] | None = None
) -> Any:
    """The displacement at a few times, with the slip zone on the contact boundary.

    Parameters
    ----------
    scene : Scene
    solution : Solution
    slip : Slip or None
        Of the same run; None without friction.
    times : sequence of float, optional
        The nearest grid times are drawn. Otherwise up to six that tell most: when slip starts,
        when it reaches furthest, the largest displacement, the end, and some between.

    Returns
    -------
    matplotlib Figure
    """
    shown = _nearest(solution.t, times) if times is not None else steps_shown(solution, slip)
    body = scene.discretisation
    fields = body.expand(solution.u[shown])
    factor, unit = prefix(np.abs(fields).max(), unit_of(scene, "m"))
    limit = factor * float(np.abs(fields).max()) or 1.0
    scale, length = prefix(np.abs(body.points).max(), unit_of(scene, "m"))
    points = scale * body.points
    rows, columns, size = _grid(points, len(shown))
    figure = new_figure(size)
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    outline = points[_boundary_edges(body.triangles)]
    for panel in panels.flat[len(shown) :]:
        panel.set_axis_off()
    for panel, i, field in zip(panels.flat, shown, fields, strict=False):
        image = panel.tripcolor(
            *points.T,
            body.triangles,
            factor * field,
            vmin=-limit,
            vmax=limit,
            cmap="PRGn",
            shading="gouraud",
            rasterized=True,
        )
        _draw_lines(panel, outline, "black", 0.6)
        title = f"t = {solution.t[i]:.4g}{unit_of(scene, ' s')}"
        if slip is not None:
            state = slip.state[max(i - 1, 0)]
            _draw_states(panel, scene, scale, state)
            share = f"{100 * slip.share[max(i - 1, 0)]:.0f} % slips"
            title += f", {share if state.any() else 'all sticks'}"
        panel.set_title(title, fontsize="medium")
        panel.set_aspect("equal")
        panel.margins(0.05)
    for panel in panels[-1]:
        panel.set_xlabel(f"x{bracketed(length)}")
    for panel in panels[:, 0]:
        panel.set_ylabel(f"y{bracketed(length)}")
    bar = figure.colorbar(image, ax=panels, label=f"displacement{bracketed(unit)}", shrink=0.8)
    if fields.any():
        bar.ax.set_ylim(factor * fields.min(), factor * fields.max())
    if slip is not None:
        state_legend(figure, loc="outside upper center", title="contact boundary")
    return figure


def _draw_states(panel: Any, scene: Scene, scale: float, state: np.ndarray) -> None:
    """The contact boundary in the colours of its states, with a casing against the field."""
    segments, owner = half_edges(scene)
    colours = [STATE_COLOURS[int(state[node])] for node in owner]
    _draw_lines(panel, scale * segments, "white", 6.5)
    _draw_lines(panel, scale * segments, colours, 4.0)


def _draw_lines(panel: Any, segments: np.ndarray, colours: Any, width: float) -> None:
    from matplotlib.collections import LineCollection

    panel.add_collection(LineCollection(list(segments), colors=colours, lw=width, capstyle="round"))


def half_edges(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Each edge between contact nodes as two halves, and the contact node that each belongs to."""
    body, contact = scene.discretisation, scene.contact
    assert contact is not None
    number = np.full(len(body.points), -1)
    number[body.free[contact.unknown]] = np.arange(len(contact))
    edges = _boundary_edges(body.triangles)
    edges = edges[(number[edges] >= 0).all(axis=1)]
    ends = body.points[edges]
    middle = ends.mean(axis=1)
    halves = np.concatenate([np.stack([ends[:, k], middle], axis=1) for k in (0, 1)])
    return halves, number[edges.T.ravel()]


def _boundary_edges(triangles: np.ndarray) -> np.ndarray:
    """Edges of one triangle only, shape (k, 2)."""
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, count = np.unique(edges, axis=0, return_counts=True)
    return np.asarray(edges[count == 1])


def steps_shown(solution: Solution, slip: Slip | None) -> list[int]:
    """Time indices of the panels: at most six, not close together, increasing."""
    last = len(solution.steps)
    wanted = [last, int(np.argmax(np.abs(solution.u).max(axis=1)))]
    if slip is not None and slip.share.any():
        wanted += [int(np.argmax(slip.share)) + 1, int(np.argmax(slip.share > 0.0)) + 1]
        signs = (slip.state * slip.contact.weight).sum(axis=1)
        wanted += [int(np.argmax(signs)) + 1, int(np.argmin(signs)) + 1]
    wanted += np.linspace(0, last, 2 * MOST_PICTURES + 1).round().astype(int).tolist()[1:]
    chosen: list[int] = []
    for i in wanted:
        near = last / (2 * MOST_PICTURES)
        if i > 0 and all(abs(i - other) >= near for other in chosen):
            chosen.append(i)
    return sorted(chosen[:MOST_PICTURES])


def _nearest(grid: np.ndarray, times: Sequence[float]) -> list[int]:
    for t in times:
        if not grid[0] <= t <= grid[-1]:
            raise InputError(f"t = {t:g} is outside of [{grid[0]:g}, {grid[-1]:g}]")
    return sorted({int(np.argmin(np.abs(grid - t))) for t in times})


def _grid(points: np.ndarray, count: int) -> tuple[int, int, tuple[float, float]]:
    """Rows, columns and size of a figure of equal panels that fits a page."""
    width, height = np.ptp(points, axis=0)
    shape = float(np.clip(height / width, 0.2, 5.0))
    columns = min(range(1, count + 1), key=lambda c: abs(np.log(-(-count // c) * shape / c / 0.7)))
    rows = -(-count // columns)
    panel = min(9.0 / columns, 8.0 / (rows * shape))
    return rows, columns, (panel * columns + 2.0, panel * shape * rows + 0.35 * rows + 1.0)


def contact_figure(scene: Scene, slip: Slip) -> Any:
    """What the contact does over time: slip zone, displacement and traction over friction bound.

    Parameters
    ----------
    scene : Scene
    slip : Slip

    Returns
    -------
    matplotlib Figure
    """
    figure = new_figure((8.5, 9.0))
    zone, moved, traction = figure.subplots(3, 1, sharex=True, height_ratios=[1.3, 1.0, 1.0])
    _draw_zone(zone, scene, slip)
    state_legend(zone, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    factor, unit = prefix(np.abs(slip.displacement).max(), unit_of(scene, "m"))
    scale, length = prefix(slip.position.max(), unit_of(scene, "m"))
    for k, node in enumerate(nodes_shown(slip)):
        look: dict[str, Any] = {"color": LINE_COLOURS[k], "linestyle": LINE_STYLES[k]}
        label = _place(slip, node, scale, length)
        zone.axhline(scale * slip.position[node], lw=2.6, color="white")
        zone.axhline(scale * slip.position[node], lw=1.4, **look)
        u = factor * slip.displacement[:, node]
        moved.plot(slip.t, u, lw=1.5, label=label, **look)
        draw_stick(moved, slip.state[:, node] == 0, slip.t, u, LINE_COLOURS[k])
        share = slip.traction[:, node] / slip.contact.bound[node]
        traction.plot(slip.stage_t, share, lw=1.5, **look)
    moved.plot([], [], color=STICK, lw=6.0, alpha=0.25, label="sticks")
    for level in (-1.0, 1.0):
        traction.axhline(level, color="black", lw=1.0, linestyle=":", zorder=0)
    moved.set_ylabel(f"displacement{bracketed(unit)}")
    moved.legend(fontsize="small", ncols=5, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    traction.set(
        ylabel="friction traction / bound", ylim=(-1.15, 1.15), xlim=(slip.t[0], slip.t[-1])
    )
    traction.set_xlabel(f"time{bracketed(unit_of(scene, 's'))}")
    for panel in (moved, traction):
        panel.grid(alpha=0.3)
    return figure


def _draw_zone(panel: Any, scene: Scene, slip: Slip) -> None:
    """Slip state over arc length and time."""
    from matplotlib.colors import ListedColormap

    scale, length = prefix(slip.position.max(), unit_of(scene, "m"))
    names = slip.contact.boundary[slip.boundary_starts]
    panel.pcolormesh(
        slip.t,
        scale * cell_edges(slip),
        slip.state.T,
        cmap=ListedColormap([STATE_COLOURS[state] for state in STATES]),
        vmin=-1.5,
        vmax=1.5,
        rasterized=True,
    )
    for start in slip.boundary_starts[1:]:
        panel.axhline(scale * cell_edges(slip)[start], color="white", lw=2.0)
    where = ", ".join(str(name) for name in names)
    panel.set_ylabel(f"arc length of {where}{bracketed(length)}")


def cell_edges(slip: Slip) -> np.ndarray:
    """Limits of each contact node's share of the arc length, shape (m+1,)."""
    position = slip.position
    if len(position) == 1:
        half = slip.contact.weight[0] / 2.0
        return np.array([position[0] - half, position[0] + half])
    inner = (position[1:] + position[:-1]) / 2.0
    return np.concatenate([position[:1], inner, position[-1:]])


def nodes_shown(slip: Slip) -> list[int]:
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


def _place(slip: Slip, node: int, scale: float, length: str) -> str:
    several = len(slip.boundary_starts) > 1
    where = f"{slip.contact.boundary[node]} " if several else ""
    return f"at {where}{scale * slip.contact.arc[node]:.3g}{length and f' {length}'}"


def state_legend(parent: Any, **where: Any) -> None:
    """What the colours of the contact boundary mean."""
    from matplotlib.patches import Patch

    handles = [
        Patch(color=STATE_COLOURS[state], label=name.replace("_", " "))
        for state, name in STATES.items()
    ]
    parent.legend(handles=handles, ncols=3, fontsize="small", **where)


def prefix(largest: float, unit: str) -> tuple[float, str]:
    """Factor and unit that bring metres to readable numbers."""
    if unit != "m" or not largest > 0.0:
        return 1.0, unit
    for factor, name in ((1.0, "m"), (1e3, "mm"), (1e6, "µm")):
        if largest * factor >= 0.1:
            return factor, name
    return 1e9, "nm"


def unit_of(scene: Scene, unit: str) -> str:
    """The unit; nothing for a dimensionless scene."""
    return unit if scene.units == "SI" else ""


def bracketed(unit: str) -> str:
    """A unit behind the name of an axis."""
    return f" ({unit})" if unit else ""
