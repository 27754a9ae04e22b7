"""Components of a solution over time, and what all pictures share: figures, colours, stick phases.

What users ask of a `Solution` is a figure of pyplot, which notebooks show; the files of scenes and
studies are drawn without pyplot, so that no window system and no global state is touched.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from sweepopt.checks import choice, times_inside
from sweepopt.display import COLOURS, evenly
from sweepopt.errors import InputError, brought_by, shown
from sweepopt.io import replacing, writable
from sweepopt.problem import SweepingProcess

if TYPE_CHECKING:
    from sweepopt.results import Solution
    from sweepopt.sets import ConvexSet

STICK = "#8C8C8C"
STYLES = ("-", "--", "-.", ":")
LOOKS = [
    {"color": colour, "linestyle": style}
    for colour, style in zip(2 * COLOURS, 2 * STYLES, strict=False)
]
"""Eight lines that differ in colour or style, the first four in both."""
MOST_FRAMES = 50
"""Of an animation, a GIF of at most 1.8 MB and 10 s, and of VTU files of a run."""


def plot_solution(solution: Solution, ax: Any = None) -> Any:
    """Components of u_n over time; where a component is stuck its line is wide and pale.

    Of one unknown there are its velocity and the force A u' + B u inside of C(t) too; two unknowns
    are drawn as a path, beside that of the force with C(t), where it is bounded, at five times.

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
    if ax is not None:
        if not hasattr(ax, "plot"):
            raise InputError(
                f"ax must be Axes of matplotlib, got {shown(ax)}; a file is written by "
                "sol.plot().figure.savefig(path)"
            )
        return _components(solution, ax)
    with brought_by("plot"):
        import matplotlib.pyplot as pyplot
    panels = _panels(solution, pyplot.figure(figsize=(8.0, 4.5), layout="constrained"))
    if len(panels) == 2:
        _, t = _middles(solution, 5)
        _, sets = _forces(solution, t)
        for look, time, C in zip(LOOKS[1:], t, sets, strict=False):
            if (points := C.outline()).size:
                panels[1].plot(*points.T, **look, lw=1.0, label=f"C(t), t = {time:.3g}")
        legend_above(panels[1], 2)
    return panels[0]


def animate_solution(solution: Solution, path: str | Path) -> Path:
    """Write `plot_solution` as an animation in which the time, u, the force and C(t) move.

    Parameters
    ----------
    solution : Solution
    path : str or Path
        A ``.gif``, or an ``.mp4``, which needs the program ffmpeg.

    Returns
    -------
    Path

    Raises
    ------
    InputError
        If the path cannot be written, or ffmpeg is not there for an MP4.
    """
    path, figure, moving = writable("path", path), new_figure((8.0, 4.5)), list[Any]()
    panels = _panels(solution, figure)
    t = solution.t[1:][even_steps(solution)]
    if paths := len(panels) == 2:
        u, (force, sets) = solution(t), _forces(solution, t)
        outlines = [C.outline() for C in sets]
        panels[1].update_datalim(np.concatenate(outlines))

    def draw(i: int) -> None:
        while moving:
            moving.pop().remove()
        figure.suptitle(f"t = {t[i]:.4g}", fontsize="medium")
        if not paths:
            moving.extend(panel.axvline(t[i], color=COLOURS[1]) for panel in panels)
            return
        moving.extend(panels[1].plot(*outlines[i].T, color=STICK))
        for panel, values in zip(panels, (u, force), strict=True):
            moving.extend(panel.plot(*values[i], "o", color=COLOURS[1]))

    write_animation(figure, path, draw, len(t))
    return path


def even_steps(solution: Solution, most: int | None = None) -> np.ndarray:
    """At most so many of the kept steps, by their numbers among them; their ends are even times.

    By default those of the frames of an animation.
    """
    times = np.linspace(solution.t[0], solution.t[-1], (most or MOST_FRAMES) + 1)[1:]
    # one that misses a node by rounding is that node
    return np.unique(np.searchsorted(solution.t[1:], times_inside(times, solution.t)))


def _panels(solution: Solution, figure: Any) -> Any:
    """The panels of `plot_solution` on a figure; those of two unknowns without C(t)."""
    dim = solution.u.shape[1]
    if len(solution.t) < 2:
        raise InputError("the run has no complete step to draw")
    if dim > 2 or not isinstance(solution.process, SweepingProcess):
        return [_components(solution, figure.subplots())]
    ends, t = _middles(solution, 1000)
    force, sets = _forces(solution, t)
    if dim == 2:
        panels = figure.subplots(1, 2)
        for panel, path, name in zip(panels, (solution.u, force), ("u", "force"), strict=True):
            panel.plot(*path.T, "-o", markevery=[0], color=COLOURS[0], label=f"{name}, o: start")
            panel.set(xlabel=f"{name}[0]", ylabel=f"{name}[1]")
            panel.set_aspect("equal", adjustable="datalim")
            legend_above(panel, 2)
        return panels
    panels = figure.subplots(3, sharex=True)
    _components(solution, panels[0])
    line = {"baseline": None, "color": COLOURS[0], "lw": 1.5}
    panels[1].stairs(solution.velocity[:, 0], solution.t, **line)
    # over all of a step what it has in its middle, as u' jumps between steps
    panels[2].stairs(force[:, 0], ends, label="A u' + B u", **line)
    if all(C.exact for C in sets):
        bounds = [(-C.support(-np.ones(1)), C.support(np.ones(1))) for C in sets]
        bottom, top = panels[2].get_ylim()  # where C(t) has no bound the band ends with the axes
        low, high = np.nan_to_num(np.transpose(bounds), neginf=bottom, posinf=top)
        panels[2].stairs(high, ends, baseline=low, color=STICK, fill=True, alpha=0.3, label="C(t)")
    legend_above(panels[2], 2)
    for panel, name in zip(panels, ("u", "u'", "force"), strict=True):
        panel.set(xlabel="t", ylabel=name)
        panel.label_outer()
    return panels


def _components(solution: Solution, ax: Any) -> Any:
    """Components of u over time."""
    components = spread(np.ptp(solution.u, axis=0), len(LOOKS))
    stuck = solution.velocity[:, components] == 0.0
    draw_histories(
        ax, solution.t, solution.u[:, components], stuck, [f"u[{i}]" for i in components]
    )
    dim = solution.u.shape[1]
    title = None
    if dim > len(components):
        title = f"{len(components)} of {dim} unknowns, evenly\nfrom least to furthest moved"
    ax.legend(title=title, fontsize="small", ncols=1 + len(components) // 5)
    ax.set(xlabel="t", ylabel="u", xlim=solution.t[[0, -1]])
    return ax


def _middles(solution: Solution, most: int) -> tuple[np.ndarray, np.ndarray]:
    """The start and the ends of at most so many of the kept steps, and their middles.

    In the middle of a step the force is in C(t) to order two.
    """
    some = evenly(len(solution.steps), most)
    mu = np.diff(solution.stats["t"], prepend=solution.t[0])[solution.steps[some]]
    return solution.t[np.append(0, some + 1)], solution.t[1:][some] - mu / 2


def _forces(solution: Solution, t: np.ndarray) -> tuple[np.ndarray, list[ConvexSet]]:
    """A u' + B u and C(t) at times in kept steps; of a node the velocity is that before it."""
    process, u = solution.process, solution(t)
    velocity = solution.velocity[np.maximum(np.searchsorted(solution.t, t) - 1, 0)]
    force = [process.A @ z + process.times_B(x) for z, x in zip(velocity, u, strict=True)]
    sets = [process.set_at(float(time), x) for time, x in zip(t, u, strict=True)]
    return np.array(force), sets


def new_figure(size: tuple[float, float]) -> Any:
    """A figure of so many inches, without pyplot and its global state."""
    with brought_by("plot"):
        from matplotlib.figure import Figure
    return Figure(figsize=size, dpi=150, layout="constrained")


def write_animation(figure: Any, path: Path, draw: Callable[[int], Any], frames: int) -> None:
    """Write a figure on which `draw(i)` draws frame i."""
    writer = writer_of(path)
    draw(0)
    for _ in range(2):  # the second time with the room that ticks need
        figure.draw_without_rendering()
    figure.set_layout_engine("none")  # what is around the panels stays where it is
    with replacing(path) as part, writer.saving(figure, part, dpi=80):
        for i in range(frames):
            draw(i)
            writer.grab_frame()


def writer_of(path: Path) -> Any:
    """What writes an animation, by the ending of its name.

    Raises
    ------
    InputError
        If it is none of .gif and .mp4, or ffmpeg is not installed, which makes an MP4.
    """
    with brought_by("plot"):
        from matplotlib.animation import FFMpegWriter, PillowWriter

    writers: dict[str, Any] = {".gif": PillowWriter, ".mp4": FFMpegWriter}
    writer = writers[choice("the ending of an animation", path.suffix.lower(), writers)]
    if not writer.isAvailable():
        raise InputError(
            f"{path.name}: an MP4 is made by ffmpeg, which is not installed; install it, or write "
            "a .gif"
        )
    return writer()


def spread(sizes: np.ndarray, most: int) -> np.ndarray:
    """Indices of at most `most` entries, evenly spread by the rank of their sizes."""
    return np.sort(np.argsort(sizes, kind="stable")[evenly(len(sizes), most)])


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


def legend_above(panel: Any, columns: int) -> None:
    """A legend of the panel's lines above it, where it covers none of them."""
    panel.legend(fontsize="small", ncols=columns, loc="lower center", bbox_to_anchor=(0.5, 1.0))


def __dir__() -> list[str]:
    return ["animate_solution", "plot_solution"]


class _Called(ModuleType):
    """This module, called by who looks for a function."""

    def __call__(self, *_: Any, **__: Any) -> None:
        raise InputError(
            "plot is a module; a run is drawn by sol.plot(), a body by scene.plot(sol)"
        )


sys.modules[__name__].__class__ = _Called
