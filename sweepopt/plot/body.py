"""The displacement field at a few times, with the slip zone on the contact boundary."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from sweepopt.errors import InputError
from sweepopt.fem.slip import Slip
from sweepopt.plot.canvas import (
    STATE_COLOURS,
    bracketed,
    new_figure,
    prefix,
    state_legend,
    unit_of,
)

if TYPE_CHECKING:
    from sweepopt.fem import Scene
    from sweepopt.results import Solution

MOST_PICTURES = 6


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
    moments = _nearest(solution.t, times) if times is not None else moments_of(solution, slip)
    body = scene.discretisation
    fields = body.expand(solution.u[moments])
    factor, unit = prefix(np.abs(fields).max(), unit_of(scene, "m"))
    limit = factor * float(np.abs(fields).max()) or 1.0
    scale, length = prefix(np.abs(body.points).max(), unit_of(scene, "m"))
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


def moments_of(solution: Solution, slip: Slip | None) -> list[int]:
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


def _grid(points: np.ndarray, count: int) -> tuple[int, int, tuple[float, float]]:
    """Rows, columns and size of a figure of equal panels that fits a page."""
    width, height = np.ptp(points, axis=0)
    shape = float(np.clip(height / width, 0.2, 5.0))
    columns = min(range(1, count + 1), key=lambda c: abs(np.log(-(-count // c) * shape / c / 0.7)))
    rows = -(-count // columns)
    panel = min(9.0 / columns, 8.0 / (rows * shape))
    return rows, columns, (panel * columns + 2.0, panel * shape * rows + 0.35 * rows + 1.0)
