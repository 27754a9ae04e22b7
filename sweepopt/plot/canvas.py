"""What all pictures share: the figure, colours, units.

Drawn on matplotlib's Figure without pyplot, so that no window system and no global state is
touched. Colours are told apart with every common colour vision (Okabe and Ito).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from sweepopt.errors import brought_by
from sweepopt.fem.slip import STATES

if TYPE_CHECKING:
    from sweepopt.fem import Scene

FORWARD, BACKWARD, STICK = "#D55E00", "#0072B2", "#8C8C8C"
STATE_COLOURS = {-1: BACKWARD, 0: STICK, 1: FORWARD}
LINE_COLOURS = ("#000000", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#F0E442")
LINE_STYLES = ("-", "--", "-.", (0, (1, 1)))
DPI = 150


def new_figure(size: tuple[float, float]) -> Any:
    """A figure of so many inches, without pyplot and its global state."""
    with brought_by("plot"):
        from matplotlib.figure import Figure
    return Figure(figsize=size, dpi=DPI, layout="constrained")


def state_legend(parent: Any, **where: Any) -> None:
    from matplotlib.patches import Patch

    handles = [
        Patch(color=STATE_COLOURS[state], label=name.replace("_", " "))
        for state, name in STATES.items()
    ]
    parent.legend(handles=handles, ncols=3, fontsize="small", **where)


def stretches(wanted: np.ndarray, t: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The line through both ends of the wanted steps, with a gap (nan) before each of them."""
    start = np.flatnonzero(wanted)
    times = np.column_stack([t[start], t[start + 1], np.full(start.size, np.nan)])
    values = np.column_stack([u[start], u[start + 1], np.full(start.size, np.nan)])
    return times.ravel(), values.ravel()


def prefix(largest: float, unit: str) -> tuple[float, str]:
    """Factor and unit that bring metres to readable numbers."""
    if unit != "m" or not largest > 0.0:
        return 1.0, unit
    for factor, name in ((1.0, "m"), (1e3, "mm"), (1e6, "µm")):
        if largest * factor >= 0.1:
            return factor, name
    return 1e9, "nm"


def unit_of(scene: Scene, unit: str) -> str:
    return unit if scene.units == "SI" else ""


def bracketed(unit: str) -> str:
    return f" ({unit})" if unit else ""
