"""Components of a solution over time, and what all pictures share: figures, colours, stick phases.

Drawn on matplotlib's Figure without pyplot, so that no window system and no global state is
touched. Colours are told apart with every common colour vision (Okabe and Ito).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from sweepopt.errors import brought_by

if TYPE_CHECKING:
    from sweepopt.results import Solution

STICK = "#8C8C8C"
LINE_COLOURS = ("#000000", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#F0E442")
LINE_STYLES = ("-", "--", "-.", (0, (1, 1)))
MOST_COMPONENTS = 8
"""Lines that a reader can still follow in one picture."""


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
    order = np.argsort(np.ptp(solution.u, axis=0), kind="stable")
    ranks = np.linspace(0, dim - 1, min(MOST_COMPONENTS, dim)).round().astype(int)
    drawn = sorted(order[ranks].tolist())
    stuck = solution.velocity == 0.0
    looks = ((colour, style) for style in LINE_STYLES for colour in LINE_COLOURS)
    for i, (colour, style) in zip(drawn, looks, strict=False):
        label = f"$u_{{{i}}}$"
        ax.plot(solution.t, solution.u[:, i], color=colour, linestyle=style, lw=1.5, label=label)
        draw_stick(ax, stuck[:, i], solution.t, solution.u[:, i], colour)
    if stuck[:, drawn].any():
        ax.plot([], [], color=STICK, lw=6.0, alpha=0.25, label="stuck: velocity exactly 0")
    title = f"{len(drawn)} of {dim} components" if dim > len(drawn) else None
    ax.legend(title=title, fontsize="small", ncols=1 + len(drawn) // 5)
    ax.set(xlabel="t", ylabel="$u_n$", xlim=(solution.t[0], solution.t[-1]))
    ax.grid(alpha=0.3)
    return ax


def new_figure(size: tuple[float, float]) -> Any:
    """A figure of so many inches, without pyplot and its global state."""
    with brought_by("plot"):
        from matplotlib.figure import Figure
    return Figure(figsize=size, dpi=150, layout="constrained")


def draw_stick(ax: Any, stuck: np.ndarray, t: np.ndarray, u: np.ndarray, colour: str) -> None:
    """A wide pale line through both ends of each stuck step, with gaps between them."""
    start = np.flatnonzero(stuck)
    if start.size:
        gap = np.full(start.size, np.nan)
        times = np.column_stack([t[start], t[start + 1], gap]).ravel()
        values = np.column_stack([u[start], u[start + 1], gap]).ravel()
        ax.plot(times, values, color=colour, lw=6.0, alpha=0.25, solid_capstyle="butt")
