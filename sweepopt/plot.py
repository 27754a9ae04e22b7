"""Pictures: the displacement field with its slip zone, contact histories, trajectories.

Drawn on matplotlib's Figure without pyplot, so that no window system and no global state is
touched. Colours are told apart with every common colour vision (Okabe and Ito).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from sweepopt.errors import InputError, brought_by
from sweepopt.slip import STATES, Slip

if TYPE_CHECKING:
    from sweepopt.fem import Scene
    from sweepopt.solution import Solution

FORWARD, BACKWARD, STICK = "#D55E00", "#0072B2", "#8C8C8C"
STATE_COLOURS = {-1: BACKWARD, 0: STICK, 1: FORWARD}
LINE_COLOURS = ("#000000", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#F0E442")
LINE_STYLES = ("-", "--", "-.", (0, (1, 1)))
MOST_PICTURES = 6
MOST_COMPONENTS = 8
MOST_POINTS = 4
DPI = 150


def plot_solution(solution: Solution, ax: Any = None) -> Any:
    """Components of u_n over time; where a component is stuck its line is wide and pale.

    Parameters
    ----------
    solution : Solution
        Of many components eight are drawn, from the one that moves least to the one that moves
        furthest.
    ax : matplotlib Axes, optional
        Where to draw; a new figure otherwise, to be reached as the result's `figure`.

    Returns
    -------
    matplotlib Axes
    """
    if ax is None:
        ax = new_figure((7.0, 4.0)).add_subplot()
    dim = solution.u.shape[1]
    drawn = _spread(np.ptp(solution.u, axis=0), MOST_COMPONENTS)
    stuck = solution.velocity == 0.0
    for k, i in enumerate(drawn):
        colour = (LINE_COLOURS * 2)[k]
        style = LINE_STYLES[k // len(LINE_COLOURS)]
        label = f"$u_{{{i}}}$"
        ax.plot(solution.t, solution.u[:, i], color=colour, linestyle=style, lw=1.5, label=label)
        t, u = _only(stuck[:, i], solution.t, solution.u[:, i])
        if t.size:
            ax.plot(t, u, color=colour, lw=6.0, alpha=0.25, solid_capstyle="butt")
    if stuck[:, drawn].any():
        ax.plot([], [], color=STICK, lw=6.0, alpha=0.25, label="stuck: velocity exactly 0")
    title = f"{len(drawn)} of {dim} components" if dim > len(drawn) else None
    ax.legend(title=title, fontsize="small", ncols=1 + len(drawn) // 5)
    ax.set(xlabel="t", ylabel="$u_n$", xlim=(solution.t[0], solution.t[-1]))
    ax.grid(alpha=0.3)
    return ax


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
    moments = _nearest(solution.t, times) if times is not None else _moments(solution, slip)
    body = scene.discretisation
    fields = body.expand(solution.u[moments])
    factor, unit = _prefix(np.abs(fields).max(), _unit(scene, "m"))
    limit = factor * float(np.abs(fields).max()) or 1.0
    scale, length = _prefix(np.abs(body.points).max(), _unit(scene, "m"))
    points = scale * body.points
    rows, columns, size = _grid(points, len(moments))
    figure = new_figure(size)
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    outline = points[_boundary_edges(body.triangles)]
    for panel in panels.flat[len(moments) :]:
        panel.set_axis_off()
    for panel, i, field in zip(panels.flat, moments, fields, strict=False):
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
        title = f"t = {solution.t[i]:.4g}{_unit(scene, ' s')}"
        if slip is not None:
            state = slip.state[max(i - 1, 0)]
            _draw_states(panel, scene, scale, state)
            share = f"{100 * slip.share[max(i - 1, 0)]:.0f} % slips"
            title += f", {share if state.any() else 'all sticks'}"
        panel.set_title(title, fontsize="medium")
        panel.set_aspect("equal")
        panel.margins(0.05)
    for panel in panels[-1]:
        panel.set_xlabel(f"x{_in(length)}")
    for panel in panels[:, 0]:
        panel.set_ylabel(f"y{_in(length)}")
    bar = figure.colorbar(image, ax=panels, label=f"displacement{_in(unit)}", shrink=0.8)
    if fields.any():
        bar.ax.set_ylim(factor * fields.min(), factor * fields.max())
    if slip is not None:
        _state_legend(figure, loc="outside upper center", title="contact boundary")
    return figure


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
    _state_legend(zone, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    factor, unit = _prefix(np.abs(slip.displacement).max(), _unit(scene, "m"))
    scale, length = _prefix(slip.position.max(), _unit(scene, "m"))
    for k, node in enumerate(_telling_nodes(slip)):
        look: dict[str, Any] = {"color": LINE_COLOURS[k], "linestyle": LINE_STYLES[k]}
        label = _place(slip, node, scale, length)
        zone.axhline(scale * slip.position[node], lw=2.6, color="white")
        zone.axhline(scale * slip.position[node], lw=1.4, **look)
        u = factor * slip.displacement[:, node]
        moved.plot(slip.t, u, lw=1.5, label=label, **look)
        t, u = _only(slip.state[:, node] == 0, slip.t, u)
        if t.size:
            moved.plot(t, u, color=LINE_COLOURS[k], lw=6.0, alpha=0.25, solid_capstyle="butt")
        share = slip.traction[:, node] / slip.contact.bound[node]
        traction.plot(slip.stage_t, share, lw=1.5, **look)
    moved.plot([], [], color=STICK, lw=6.0, alpha=0.25, label="sticks")
    for level in (-1.0, 1.0):
        traction.axhline(level, color="black", lw=1.0, linestyle=":", zorder=0)
    moved.set_ylabel(f"displacement{_in(unit)}")
    moved.legend(fontsize="small", ncols=5, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    traction.set(
        ylabel="friction traction / bound", ylim=(-1.15, 1.15), xlim=(slip.t[0], slip.t[-1])
    )
    traction.set_xlabel(f"time{_in(_unit(scene, 's'))}")
    for panel in (moved, traction):
        panel.grid(alpha=0.3)
    return figure


def _draw_zone(panel: Any, scene: Scene, slip: Slip) -> None:
    """Slip state over arc length and time."""
    from matplotlib.colors import ListedColormap

    scale, length = _prefix(slip.position.max(), _unit(scene, "m"))
    names = slip.contact.boundary[slip.boundary_starts]
    panel.pcolormesh(
        slip.t,
        scale * _cell_edges(slip),
        slip.state.T,
        cmap=ListedColormap([STATE_COLOURS[state] for state in STATES]),
        vmin=-1.5,
        vmax=1.5,
        rasterized=True,
    )
    for start in slip.boundary_starts[1:]:
        panel.axhline(scale * _cell_edges(slip)[start], color="white", lw=2.0)
    where = ", ".join(str(name) for name in names)
    panel.set_ylabel(f"arc length of {where}{_in(length)}")


def _draw_states(panel: Any, scene: Scene, scale: float, state: np.ndarray) -> None:
    """The contact boundary in the colours of its states, with a casing against the field."""
    segments, owner = _half_edges(scene)
    colours = [STATE_COLOURS[int(state[node])] for node in owner]
    _draw_lines(panel, scale * segments, "white", 6.5)
    _draw_lines(panel, scale * segments, colours, 4.0)


def _draw_lines(panel: Any, segments: np.ndarray, colours: Any, width: float) -> None:
    from matplotlib.collections import LineCollection

    panel.add_collection(LineCollection(list(segments), colors=colours, lw=width, capstyle="round"))


def _state_legend(parent: Any, **where: Any) -> None:
    from matplotlib.patches import Patch

    handles = [
        Patch(color=STATE_COLOURS[state], label=name.replace("_", " "))
        for state, name in STATES.items()
    ]
    parent.legend(handles=handles, ncols=3, fontsize="small", **where)


def _half_edges(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
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


def _cell_edges(slip: Slip) -> np.ndarray:
    """Limits of each contact node's share of the arc length, shape (m+1,)."""
    position = slip.position
    inner = (position[1:] + position[:-1]) / 2.0
    ends = slip.contact.weight[[0, -1]] / (2.0 if len(position) == 1 else np.inf)
    return np.concatenate([[position[0] - ends[0]], inner, [position[-1] + ends[1]]])


def _telling_nodes(slip: Slip) -> list[int]:
    """A few nodes that slip little to far, and of those that never slip the one nearest to it."""
    sticking = np.flatnonzero(slip.total == 0.0)
    order = np.argsort(slip.total, kind="stable")[sticking.size :]
    ranks = np.linspace(0, max(len(order) - 1, 0), MOST_POINTS).round().astype(int)
    # the one that slips least looks like the one that sticks
    nodes = {int(i) for i in order[ranks[bool(sticking.size) :]]} if order.size else set()
    if sticking.size:
        load = np.abs(slip.traction[:, sticking] / slip.contact.bound[sticking]).max(axis=0)
        nodes.add(int(sticking[np.argmax(load)]))
    return sorted(nodes)


def _spread(values: np.ndarray, count: int) -> list[int]:
    """Indices of the smallest and the largest value and of some between, increasing."""
    order = np.argsort(values, kind="stable")
    ranks = np.linspace(0, len(order) - 1, min(count, len(order))).round().astype(int)
    return sorted({int(i) for i in order[ranks]})


def _place(slip: Slip, node: int, scale: float, length: str) -> str:
    several = len(slip.boundary_starts) > 1
    where = f"{slip.contact.boundary[node]} " if several else ""
    return f"at {where}{scale * slip.contact.arc[node]:.3g}{length and f' {length}'}"


def _moments(solution: Solution, slip: Slip | None) -> list[int]:
    """Time indices worth a picture, at most six and not close together, increasing."""
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


def _only(wanted: np.ndarray, t: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The line through both ends of the wanted steps, with a gap (nan) before each of them."""
    start = np.flatnonzero(wanted)
    times = np.column_stack([t[start], t[start + 1], np.full(start.size, np.nan)])
    values = np.column_stack([u[start], u[start + 1], np.full(start.size, np.nan)])
    return times.ravel(), values.ravel()


def _grid(points: np.ndarray, count: int) -> tuple[int, int, tuple[float, float]]:
    """Rows, columns and size of a figure of equal panels that fits a page."""
    width, height = np.ptp(points, axis=0)
    shape = float(np.clip(height / width, 0.2, 5.0))
    columns = min(range(1, count + 1), key=lambda c: abs(np.log(-(-count // c) * shape / c / 0.7)))
    rows = -(-count // columns)
    panel = min(9.0 / columns, 8.0 / (rows * shape))
    return rows, columns, (panel * columns + 2.0, panel * shape * rows + 0.35 * rows + 1.0)


def _prefix(largest: float, unit: str) -> tuple[float, str]:
    """Factor and unit that bring metres to readable numbers."""
    if unit != "m" or not largest > 0.0:
        return 1.0, unit
    for factor, name in ((1.0, "m"), (1e3, "mm"), (1e6, "µm")):
        if largest * factor >= 0.1:
            return factor, name
    return 1e9, "nm"


def _unit(scene: Scene, unit: str) -> str:
    return unit if scene.units == "SI" else ""


def _in(unit: str) -> str:
    return f" ({unit})" if unit else ""


def new_figure(size: tuple[float, float]) -> Any:
    """A figure of so many inches, without pyplot and its global state."""
    with brought_by("plot"):
        from matplotlib.figure import Figure
    return Figure(figsize=size, dpi=DPI, layout="constrained")
