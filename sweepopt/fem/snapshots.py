"""Fields of a body at times: a few side by side in a picture, many in turn in an animation."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Mapping
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from subprocess import TimeoutExpired, run
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from sweepopt.checks import Array
from sweepopt.fem.contact import Slip, signed_lengths
from sweepopt.fem.spaces import boundary_names
from sweepopt.plot import STICK, even_steps, new_figure, write_animation

if TYPE_CHECKING:
    from sweepopt.fem.output import Report

PLUG, PULLED = "#E69F00", "#CC79A7"
OUT, SIZE = "displacement out of the plane", "magnitude |u| of the displacement"
STATE_COLOURS = {-1: "#0072B2", 0: STICK, 1: "#D55E00"}


class Field(NamedTuple):
    """What is drawn at each of some times.

    Attributes
    ----------
    draw : callable (panel, i) -> what the bar of colours belongs to, if there is one
    points : ndarray, shape (N, d)
        What is drawn lies in their box.
    label, quantity : str
        Of the bar, and whose units it has.
    legend : mapping of str to str
        What colours mean.
    axes : tuple of str
        Names of the coordinates of the points, which are lengths.
    """

    draw: Callable[[Any, int], Any]
    points: Array
    label: str
    quantity: str
    legend: Mapping[str, str]
    axes: tuple[str, ...] = ("x", "y", "z")


At = Callable[["Report", Array], Field]
"""The field of a run at the ends of steps."""


def picture(report: Report, field: At) -> Any:
    """The field at up to six times, the last of them the end.

    Times are even; of plastic strains they are those when they have reached another fifth of the
    cells, as a front may pass in a few steps.

    Returns
    -------
    matplotlib Figure
    """
    steps = even_steps(report.solution, 6)
    if field is yielding:
        every = np.arange(steps[-1] + 1)
        reached = np.count_nonzero(report.at("plastic_strain", every), axis=1)
        fronts = np.searchsorted(reached, reached[-1] * np.linspace(0.2, 1.0, 5))
        steps = np.unique([*fronts, steps[-1]])
    return _page(report, field(report, steps), steps)[0]


def animation(report: Report, field: At, path: Path) -> None:
    """Write the field at even times as a GIF or, by ffmpeg, as an MP4."""
    steps = even_steps(report.solution)
    shown = field(report, steps)
    figure, panel = _page(report, shown, steps[:1])

    def draw(i: int) -> None:
        for artist in [*panel.collections, *panel.lines, *panel.images]:
            artist.remove()
        _draw(report, shown, panel, steps, i)

    write_animation(figure, path, draw, len(steps))


def displacement(report: Report, steps: Array) -> Field:
    """The displacement of a body in the plane, or over x along a line, and where it slips.

    A section whose displacement is in its plane is drawn deformed.
    """
    from matplotlib.collections import LineCollection

    body, legend = report.body, states_of(report.slip)
    u, x = signed_lengths(report.at("displacement", steps)), body.points
    if body.mesh.dim() == 1:
        order, x = np.argsort(x[:, 0]), np.stack([np.broadcast_to(x[:, 0], u.shape), u], axis=2)

        def curve(panel: Any, i: int) -> None:
            panel.plot(*x[i, order].T, color="black", lw=1.0, zorder=1)
            _mark(report, panel, steps[i], x[i])

        return Field(curve, x.reshape(-1, 2), "", "length", legend, ("x", "displacement"))
    pulled = [
        name
        for one in report.scene.effects
        if hasattr(one, "pulled")
        for name in boundary_names(f"{type(one).__name__}.pulled", one.pulled)
    ]
    arcs, look, label = list[Any](), colours_of(u), OUT
    positions = np.broadcast_to(x, (len(steps), *x.shape))
    if body.components > 1:
        positions, label = _deformed_nodes(report, steps, SIZE)
    clamped = [name for name in body.clamped or () if name not in pulled]
    for what, names, colour in (("clamped", clamped, "black"), ("pulled", pulled, PULLED)):
        if names:
            arcs.append((body.facets(what, names)[0], colour))
            legend[colour] = what

    def draw(panel: Any, i: int) -> Any:
        image = _fill(report, panel, positions[i], u[i], **look)
        for facets, colour in arcs:
            edges = positions[i][body.facet_nodes(facets).T]
            panel.add_collection(LineCollection(edges, colors=colour, lw=3.0))
        _mark(report, panel, steps[i], positions[i])
        return image

    return Field(draw, positions.reshape(-1, 2), label, "length", legend)


def surface(report: Report, steps: Array) -> Field:
    """The surface of a solid, with the size of its displacement."""
    size = signed_lengths(report.at("displacement", steps))
    faces = size[:, report.body.triangles].mean(axis=2)
    return _deformed(report, steps, faces, SIZE, "length")


def stress(report: Report, steps: Array) -> Field:
    """The stress in the cells of a section, or in those at the surface of a solid."""
    mesh, values = report.body.mesh, report.at("stress", steps)
    name = "shear stress" if report.body.components == 1 else "von Mises stress"
    if mesh.dim() == 2:
        return _in_cells(report, values, name, "stress", "YlOrRd", {})
    behind = mesh.f2t[0, mesh.boundary_facets()]
    return _deformed(report, steps, values[:, behind], name, "stress", "YlOrRd")


def _deformed(
    report: Report, steps: Array, faces: Array, label: str, quantity: str, rising: str = "Greens"
) -> Field:
    """The surface of a solid, seen from its contact, with a value on each of its faces.

    PyVista draws it, where it is there, else matplotlib.
    """
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize, to_rgba_array
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    body, contact = report.body, report.scene.contact
    positions, label = _deformed_nodes(report, steps, label)
    triangles, look = body.triangles, colours_of(faces, rising)
    faces = np.tile(faces, len(triangles) // faces.shape[1])  # the parts of a P2 element
    below = contact is not None and contact.points[:, 2].mean() < body.points[:, 2].mean()
    legend = states_of(report.slip)

    def render(panel: Any, i: int) -> Any:
        plotter = pyvista.Plotter(off_screen=True, window_size=(800, 600))
        shape = pyvista.PolyData.from_regular_faces(positions[i], triangles)
        how = {"clim": (0.0, look["vmax"]), "cmap": look["cmap"], "show_scalar_bar": False}
        plotter.add_mesh(shape, scalars=faces[i], show_edges=True, lighting=False, **how)
        if contact is not None:
            colours = to_rgba_array(_colours(report, steps[i]))[:, :3]
            how = {"render_points_as_spheres": True, "point_size": 12, "lighting": False}
            plotter.add_points(positions[i, contact.node], scalars=colours, rgb=True, **how)
        plotter.show_axes()
        plotter.view_vector((0.5, -0.9, 0.6 - 1.2 * below), viewup=(0.0, 0.0, 1.0))
        plotter.camera.zoom(1.2)
        panel.imshow(plotter.screenshot(return_img=True))
        panel.set_axis_off()
        plotter.close()
        return ScalarMappable(Normalize(0.0, look["vmax"]), look["cmap"])

    if (pyvista := off_screen()) is not None:
        return Field(render, np.zeros((1, 2)), label, quantity, legend, ())

    def draw(panel: Any, i: int) -> Any:
        artist = Poly3DCollection(positions[i, triangles], ec="0.3", lw=0.2, cmap=look["cmap"])
        artist.set(array=faces[i], clim=(0.0, look["vmax"]))
        panel.add_collection3d(artist)
        _mark(report, panel, steps[i], positions[i], depthshade=False)
        panel.view_init(elev=30 - 60 * below, azim=-60)
        panel.set_box_aspect(np.ptp(positions, axis=(0, 1)))
        return artist

    return Field(draw, positions.reshape(-1, 3), label, quantity, legend)


def _deformed_nodes(report: Report, steps: Array, label: str) -> tuple[Array, str]:
    """The nodes of a deformed body, and the label of a bar of colours that says how far.

    The largest displacement is drawn as a tenth of the body's length.
    """
    u, x = report.at("displacement", steps), report.body.points
    factor = 0.1 * np.ptp(x, axis=0).max() / (signed_lengths(u).max() or 1.0)
    return x + factor * u, f"{label}\n(displacement drawn {factor:.2g} times as large)"


def flow(report: Report, steps: Array) -> Field:
    """The velocity of a section, and what is rigid in it.

    A triangle is a part of a plug if its corners have one velocity, and at rest if that is 0: both
    exactly, as the steps leave them.
    """
    from matplotlib.colors import ListedColormap

    body = report.body
    velocity = report.at("velocity", steps)
    look, flat = colours_of(velocity), ListedColormap([STICK, PLUG])

    def draw(panel: Any, i: int) -> Any:
        image = _fill(report, panel, body.points, velocity[i], **look)
        corners = velocity[i, body.triangles]
        rigid = np.ma.array(corners[:, 0] != 0, mask=np.ptp(corners, axis=1) > 0)
        _fill(report, panel, body.points, facecolors=rigid, vmin=0, vmax=1, cmap=flat)
        return image

    legend = {PLUG: "moves as a rigid body", STICK: "rests"}
    return Field(draw, body.points, "velocity", "velocity", legend)


def yielding(report: Report, steps: Array) -> Field:
    """Plastic strains of a body in the plane; grey where there is none yet, to show their front."""
    strain = np.ma.masked_equal(report.at("plastic_strain", steps), 0.0)
    legend = {STICK: "elastic so far"}
    return _in_cells(report, strain, "plastic strain", "", "plasma_r", legend)


def _in_cells(
    report: Report, values: Any, label: str, quantity: str, rising: str, legend: Mapping[str, str]
) -> Field:
    """Values in the cells of a body in the plane."""
    body, look = report.body, colours_of(values, rising)
    parts = len(body.triangles) // values.shape[1]  # of a P2 element

    def draw(panel: Any, i: int) -> Any:
        cells = np.ma.concatenate(parts * [values[i]])
        return _fill(report, panel, body.points, facecolors=cells, **look)

    return Field(draw, body.points, label, quantity, legend)


def arrows(report: Report, steps: Array) -> Field:
    """Slip arrows in the plane of contact, and the friction traction over its bound, of vectors."""
    slip = report.slip
    plane = np.sort(np.argsort(-np.ptp(slip.contact.points, axis=0), kind="stable")[:2])
    x, speed, use = slip.contact.points[:, plane], slip.speed[steps], slip.use[steps]
    velocity = report.at("velocity", steps)[:, slip.contact.node][..., plane]

    def draw(panel: Any, i: int) -> Any:
        moves, fastest = speed[i] > 0, speed[i].max()
        scale = (fastest or 1.0) / (0.08 * np.ptp(x[:, 0]))
        panel.quiver(*x[moves].T, *velocity[i, moves].T, angles="xy", scale_units="xy", scale=scale)
        longest = f"slip arrows up to {fastest:.2g}{report.suffix('velocity')}"
        panel.title.set_text(f"{panel.get_title()}, {longest}")
        panel.set_aspect("equal")
        return panel.scatter(*x.T, c=use[i], s=14, vmin=0.0, vmax=1.0, cmap="viridis")

    axes = tuple("xyz"[k] for k in plane)
    label = "friction traction / bound\n(above 1: error of the step)"
    return Field(draw, x, label, "", {}, axes)


def colours_of(values: Array, rising: str = "Greens") -> dict[str, Any]:
    """Colours from 0, or on both sides of 0, to the largest value; grey where there is none."""
    from matplotlib import colormaps

    limit, signed = float(np.abs(values).max()) or 1.0, values.min() < 0
    colours = colormaps["PRGn" if signed else rising].with_extremes(bad=STICK)
    return {"cmap": colours, "vmin": -limit * signed, "vmax": limit}


def name_axis(report: Report, axis: Any, label: str, quantity: str) -> None:
    """The label of an axis, and ticks in one unit, such as 20 mm; without units plain numbers.

    An axis of time is in the unit of `Report.clock`.
    """
    from matplotlib.ticker import EngFormatter

    def tick(x: float, _: int) -> str:
        size = np.abs(axis.get_view_interval()).max()
        power = int(np.clip(3 * np.floor(np.log10(size) / 3), -30, 30))
        number = EngFormatter.fix_minus(f"{round(x / 10.0**power, 6) + 0.0:g}")
        return f"{number} {EngFormatter.ENG_PREFIXES[power]}{report.units[quantity]}"

    axis.set_label_text(label)
    if quantity == "time":
        axis.set_major_formatter(f"{{x:g}}{report.clock[0]}")
    elif quantity and report.suffix(quantity):
        axis.set_major_formatter(tick)


def legend_of(figure: Any, names: Mapping[str, str]) -> None:
    """What colours mean, below all panels."""
    from matplotlib.patches import Patch

    handles = [Patch(color=colour, label=name) for colour, name in names.items()]
    if handles:
        figure.legend(handles=handles, ncols=3, fontsize="small", loc="outside lower center")


def states_of(slip: Slip | None) -> dict[str, str]:
    """What the colours of nodes with friction mean that occur; of vectors slip has no sign."""
    if slip is None:
        return {}
    names = {-1: "slips backward", 0: "sticks", 1: "slips forward"}
    if slip.velocity.ndim > 2:
        names = {0: "sticks", 1: "slips"}
    return {STATE_COLOURS[k]: name for k, name in names.items() if (slip.state == k).any()}


def _fill(report: Report, panel: Any, points: Array, *values: Array, **look: Any) -> Any:
    """Values at the nodes of a body in the plane, or `facecolors` of its triangles, outlined."""
    from matplotlib.collections import LineCollection

    edges: Any = points[report.body.facet_nodes(report.body.mesh.boundary_facets()).T]
    panel.add_collection(LineCollection(edges, colors="black", lw=0.6))
    look |= {"shading": "gouraud" if values else "flat", "rasterized": True}
    panel.set_aspect("equal")
    return panel.tripcolor(*points.T, report.body.triangles, *values, **look)


def _mark(report: Report, panel: Any, step: int, points: Array, **look: Any) -> None:
    """Nodes with friction in the colours of their states, with a casing against the field."""
    if report.slip is not None:
        spots = points[report.slip.contact.node].T
        # all casings first: they would hide neighbours
        for size, colours in ((50, "white"), (24, _colours(report, step))):
            panel.scatter(*spots, s=size, c=colours, lw=0, zorder=2, **look)


def _colours(report: Report, step: int) -> list[str]:
    """Of the nodes with friction, by their states in a step."""
    slip = report.slip
    return [STATE_COLOURS[k] for k in slip.state[step].tolist()]


@cache
def off_screen() -> Any:
    """PyVista, if it is installed and draws without a window here; else None.

    It is tried in another process, which ends or hangs where there is no library to draw with.
    """
    if not find_spec("pyvista"):
        return None
    if sys.platform == "linux" and not os.environ.get("DISPLAY"):
        os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")
    trial = "import pyvista; pyvista.Plotter(off_screen=True).screenshot(return_img=True)"
    try:
        drawn = run([sys.executable, "-c", trial], capture_output=True, timeout=60)
    except TimeoutExpired:  # some drivers hang
        return None
    return None if drawn.returncode else import_module("pyvista")


def _draw(report: Report, field: Field, panel: Any, steps: Array, i: int) -> Any:
    """The field on a panel, and the time."""
    panel.set_title(report.moment(report.solution.t[steps[i] + 1]), fontsize="medium", pad=14)
    return field.draw(panel, i)


def _page(report: Report, field: Field, steps: Array) -> tuple[Any, Any]:
    """A figure with the field at ends of steps, up to three in a row, and its first panel."""
    rows = -(-len(steps) // 3)
    columns = -(-len(steps) // rows)
    figure = new_figure((max(4.0 * columns, 5.5), 3.5 * rows))  # a legend is wide
    kind = {"projection": "3d"} if field.points.shape[1] == 3 else {}
    panels = [figure.add_subplot(rows, columns, k, **kind) for k in range(1, len(steps) + 1)]
    for i, panel in enumerate(panels):
        image = _draw(report, field, panel, steps, i)
        for own, name, x in zip("xyz", field.axes, field.points.T, strict=False):
            edge = 0.08 * (np.ptp(x) or 1.0)
            panel.set(**{f"{own}lim": (x.min() - edge, x.max() + edge)})
            name_axis(report, getattr(panel, f"{own}axis"), name, "length")
        panel.locator_params(nbins=4)
        if not kind:  # panels have the same axes
            panel.label_outer()
    if panels[0].get_aspect() == 1.0:  # in inches: panels are 3.3 wide, titles and labels 0.8 high
        flat = 3.3 * np.ptp(panels[0].get_ylim()) / np.ptp(panels[0].get_xlim())
        figure.set_figheight(max(rows * min(flat + 0.8, 3.5), 4.0))
    if image is not None:
        bar = figure.colorbar(image, ax=panels, shrink=0.8)
        name_axis(report, bar.ax.yaxis, field.label, field.quantity)
    legend_of(figure, field.legend)
    return figure, panels[0]
