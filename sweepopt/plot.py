"""Components of a solution over time, and what all pictures share: figures, colours, stick phases.

What users ask of a `Solution` is a figure of pyplot, which notebooks show; the files of scenes and
studies are drawn without pyplot, so that no window system and no global state is touched.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from sweepopt.display import COLOURS
from sweepopt.errors import brought_by
from sweepopt.problem import SweepingProcess

if TYPE_CHECKING:
    from sweepopt.results import Solution
    from sweepopt.sets import ConvexSet

STICK = "#8C8C8C"
STYLES = ("-", "--", "-.", (0, (1, 1)))
LOOKS = [
    {"color": colour, "linestyle": style}
    for colour, style in zip(2 * COLOURS, 2 * STYLES, strict=False)
]
"""Eight lines that differ in colour or style, the first four in both."""


def plot_solution(solution: Solution, ax: Any = None) -> Any:
    """Components of u_n over time; where a component is stuck its line is wide and pale.

    Of one unknown there are its velocity and the force A u' + B u inside of C(t) too; two unknowns
    are drawn as a path, beside that of the force with C(t) at five times.

    Parameters
    ----------
    solution : Solution
        Of many components eight are drawn, from the one that moves least to the one that moves
        furthest.
    ax : matplotlib Axes, optional
        Where to draw the components; a new figure of pyplot otherwise, the result's `figure`.

    Returns
    -------
    matplotlib Axes
        That of u.
    """
    dim = solution.u.shape[1]
    known = ax is None and isinstance(solution.process, SweepingProcess)
    if known and dim == 2:
        return _plot_paths(solution)
    panels = [ax]
    if ax is None:
        rows = 3 if known and dim == 1 else 1
        figure = _shown_figure((7.0, 2.5 + 1.5 * rows))
        panels = figure.subplots(rows, sharex=True, squeeze=False)[:, 0]
    drawn = spread(np.ptp(solution.u, axis=0), len(LOOKS))
    stuck = solution.velocity[:, drawn] == 0.0
    names = [f"u[{i}]" for i in drawn]
    draw_histories(panels[0], solution.t, solution.u[:, drawn], stuck, names)
    title = f"{len(drawn)} of {dim} components" if dim > len(drawn) else None
    panels[0].legend(title=title, fontsize="small", ncols=1 + len(drawn) // 5)
    panels[0].set(ylabel="u", xlim=(solution.t[0], solution.t[-1]))
    panels[-1].set(xlabel="t")
    if len(panels) == 3:
        t, velocity, force, sets = _forces(solution, 1000)
        panels[1].plot(t, velocity, color=COLOURS[0])
        panels[1].set(ylabel="u'")
        panels[2].plot(t, force, color=COLOURS[0], label="A u' + B u")
        if all(C.exact for C in sets):
            ends = np.array([[-C.support(np.array([-1.0])), C.support(np.ones(1))] for C in sets])
            panels[2].fill_between(t, *ends.T, color=STICK, alpha=0.3, label="C(t)")
        panels[2].legend(fontsize="small")
        panels[2].set(ylabel="force")
    return panels[0]


def _shown_figure(size: tuple[float, float]) -> Any:
    """A figure of pyplot, which a notebook shows and `pyplot.show` opens."""
    with brought_by("plot"):
        import matplotlib.pyplot as pyplot
    return pyplot.figure(figsize=size, layout="constrained")


def _forces(solution: Solution, most: int) -> tuple[Any, Any, Any, list[ConvexSet]]:
    """Velocity, A u' + B u and C(t) in the middle of at most so many of the kept steps."""
    process, k = solution.process, len(solution.steps)
    some = np.unique(np.linspace(0, k - 1, most).round().astype(int))
    mu = np.diff(solution.stats["t"], prepend=solution.t[0])[solution.steps[some]]
    t, velocity = solution.t[1:][some] - mu / 2, solution.velocity[some]
    u = solution.u[1:][some] - mu[:, None] / 2 * velocity
    force = [process.A @ z + process.times_B(x) for z, x in zip(velocity, u, strict=True)]
    sets = [process.set_at(float(time), x) for time, x in zip(t, u, strict=True)]
    return t, velocity, np.array(force), sets


def _plot_paths(solution: Solution) -> Any:
    """The path of two unknowns, and that of the force with C(t) around it."""
    left, right = _shown_figure((8.0, 4.0)).subplots(1, 2)
    left.plot(*solution.u.T, color=COLOURS[0])
    left.plot(*solution.u[0], "o", color=COLOURS[0], label=f"t = {solution.t[0]:g}")
    left.set(xlabel="u[0]", ylabel="u[1]")
    _, _, force, _ = _forces(solution, 1000)
    right.plot(*force.T, color=COLOURS[0], label="A u' + B u")
    for look, time, C in zip(LOOKS[1:], *_forces(solution, 5)[::3], strict=False):
        right.plot(*C.outline().T, **look, lw=1.0, label=f"C({time:.3g})")
    right.set(xlabel="force[0]", ylabel="force[1]")
    for panel in (left, right):
        panel.set_aspect("equal", adjustable="datalim")
        panel.grid(alpha=0.3)
        panel.legend(fontsize="small")
    return left


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
