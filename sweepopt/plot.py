"""Components of a solution over time, and what all pictures share: figures, colours, stick phases.

Drawn on matplotlib's Figure without pyplot, so that no window system and no global state is
touched.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from sweepopt.display import COLOURS
from sweepopt.errors import brought_by

if TYPE_CHECKING:
    from sweepopt.results import Solution

STICK = "#8C8C8C"
STYLES = ("-", "--", "-.", (0, (1, 1)))
LOOKS = [
    {"color": colour, "linestyle": style}
    for colour, style in zip(2 * COLOURS, 2 * STYLES, strict=False)
]
"""Eight lines that differ in colour or style, the first four in both."""


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
    drawn = spread(np.ptp(solution.u, axis=0), len(LOOKS))
    stuck = solution.velocity[:, drawn] == 0.0
    draw_histories(ax, solution.t, solution.u[:, drawn], stuck, [f"$u_{{{i}}}$" for i in drawn])
    title = f"{len(drawn)} of {dim} components" if dim > len(drawn) else None
    ax.legend(title=title, fontsize="small", ncols=1 + len(drawn) // 5)
    ax.set(xlabel="t", ylabel="$u_n$", xlim=(solution.t[0], solution.t[-1]))
    return ax


def new_figure(size: tuple[float, float]) -> Any:
    """A figure of so many inches, without pyplot and its global state."""
    with brought_by("plot"):
        from matplotlib.figure import Figure
    return Figure(figsize=size, dpi=150, layout="constrained")


def spread(sizes: np.ndarray, most: int) -> np.ndarray:
    """Indices of at most `most` entries, evenly spread by the rank of their sizes."""
    ranks = np.linspace(0, len(sizes) - 1, most).round().astype(int)
    return np.unique(np.argsort(sizes, kind="stable")[ranks])


def draw_histories(
    ax: Any, t: np.ndarray, u: np.ndarray, stuck: np.ndarray, labels: Sequence[str]
) -> None:
    """Lines for the columns of u, each with a wide pale line over the steps in which it is stuck.

    Parameters
    ----------
    t : ndarray, shape (n+1,)
    u : ndarray, shape (n+1, k)
        At most eight columns.
    stuck : ndarray of bool, shape (n, k)
    labels : sequence of k str
    """
    wide = {"lw": 6.0, "alpha": 0.25, "solid_capstyle": "butt"}
    for values, steps, label, look in zip(u.T, stuck.T, labels, LOOKS, strict=False):
        ax.plot(t, values, lw=1.5, label=label, **look)
        ends = np.flatnonzero(steps)[:, None] + [0, 1]
        gaps = ((0, 0), (0, 1))  # a nan behind each pair of ends
        band = (np.pad(x[ends], gaps, constant_values=np.nan).ravel() for x in (t, values))
        ax.plot(*band, color=look["color"], **wide)
    if stuck.any():
        ax.plot([], [], color=STICK, label="sticks", **wide)
    ax.grid(alpha=0.3)
