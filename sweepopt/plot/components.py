"""Components of a solution over time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from sweepopt.plot.canvas import LINE_COLOURS, LINE_STYLES, STICK, new_figure, stretches

if TYPE_CHECKING:
    from sweepopt.results import Solution

MOST_COMPONENTS = 8


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
        t, u = stretches(stuck[:, i], solution.t, solution.u[:, i])
        if t.size:
            ax.plot(t, u, color=colour, lw=6.0, alpha=0.25, solid_capstyle="butt")
    if stuck[:, drawn].any():
        ax.plot([], [], color=STICK, lw=6.0, alpha=0.25, label="stuck: velocity exactly 0")
    title = f"{len(drawn)} of {dim} components" if dim > len(drawn) else None
    ax.legend(title=title, fontsize="small", ncols=1 + len(drawn) // 5)
    ax.set(xlabel="t", ylabel="$u_n$", xlim=(solution.t[0], solution.t[-1]))
    ax.grid(alpha=0.3)
    return ax


def _spread(values: np.ndarray, count: int) -> list[int]:
    """Indices of the smallest and the largest value and of some between, increasing."""
    order = np.argsort(values, kind="stable")
    ranks = np.linspace(0, len(order) - 1, min(count, len(order))).round().astype(int)
    return sorted({int(i) for i in order[ranks]})
