"""What the contact does over time: its slip zone, its displacement, its traction."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from sweepopt.fem.slip import STATES, Slip
from sweepopt.plot.canvas import (
    LINE_COLOURS,
    LINE_STYLES,
    STATE_COLOURS,
    STICK,
    bracketed,
    new_figure,
    prefix,
    state_legend,
    stretches,
    unit_of,
)

if TYPE_CHECKING:
    from sweepopt.fem import Scene

MOST_POINTS = 4


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
    for k, node in enumerate(telling_nodes(slip)):
        look: dict[str, Any] = {"color": LINE_COLOURS[k], "linestyle": LINE_STYLES[k]}
        label = _place(slip, node, scale, length)
        zone.axhline(scale * slip.position[node], lw=2.6, color="white")
        zone.axhline(scale * slip.position[node], lw=1.4, **look)
        u = factor * slip.displacement[:, node]
        moved.plot(slip.t, u, lw=1.5, label=label, **look)
        t, u = stretches(slip.state[:, node] == 0, slip.t, u)
        if t.size:
            moved.plot(t, u, color=LINE_COLOURS[k], lw=6.0, alpha=0.25, solid_capstyle="butt")
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
    inner = (position[1:] + position[:-1]) / 2.0
    ends = slip.contact.weight[[0, -1]] / (2.0 if len(position) == 1 else np.inf)
    return np.concatenate([[position[0] - ends[0]], inner, [position[-1] + ends[1]]])


def telling_nodes(slip: Slip) -> list[int]:
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


def _place(slip: Slip, node: int, scale: float, length: str) -> str:
    several = len(slip.boundary_starts) > 1
    where = f"{slip.contact.boundary[node]} " if several else ""
    return f"at {where}{scale * slip.contact.arc[node]:.3g}{length and f' {length}'}"
