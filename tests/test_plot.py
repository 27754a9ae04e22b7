"""Pictures show the solution: what is drawn is compared with the numbers, not with pixels."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.collections import LineCollection, QuadMesh
from matplotlib.colors import to_hex, to_rgb
from matplotlib.figure import Figure
from meshes import annulus, square

import sweepopt as so
from sweepopt import plot
from sweepopt.fem import (
    BodyForce,
    Elasticity,
    Friction,
    Scene,
    Traction,
    Viscosity,
    antiplane,
    pictures,
)
from sweepopt.fem.contact import Slip, slip_of


class Run:
    """A scene, its solution and its slip."""

    def __init__(self, scene: Scene) -> None:
        self.scene, self.solution = scene, scene.solve()
        self.slip = slip_of(scene, self.solution)

    @property
    def rubbing(self) -> Slip:
        assert self.slip is not None
        return self.slip


def half_ring(units: str = "SI") -> Scene:
    """Small in metres, so that pictures need millimetres."""
    mesh = annulus(2).scaled(0.01)
    return antiplane(
        mesh,
        clamped="inner",
        element="P2",
        effects=[
            Viscosity(2.0),
            Elasticity(1.0),
            Friction("outer", g=0.006),
            BodyForce(so.Sine(4.0, period=4.0), f0=lambda x: 1.0 + 40.0 * x[0]),
        ],
        t_end=6.0,
        steps=60,
        units=units,
    )


@pytest.fixture(scope="module")
def run() -> Run:
    return Run(half_ring())


def save(figure: Figure, path: Path) -> None:
    figure.savefig(path)
    assert path.stat().st_size > 20_000
    # no text is laid over the text of another panel
    titles = [panel.title.get_window_extent() for panel in figure.axes if panel.get_title()]
    for k, box in enumerate(titles):
        assert not any(box.overlaps(other) for other in titles[k + 1 :])


def states_drawn(panel: Any) -> list[str]:
    """Colours of the contact boundary: the uppermost collection of lines."""
    lines = [item for item in panel.collections if isinstance(item, LineCollection)]
    return [to_hex(colour) for colour in lines[-1].get_colors()]


def test_displacement_and_slip_zone_are_those_of_the_solution(run: Run, tmp_path: Path) -> None:
    scene, solution, slip = run.scene, run.solution, run.rubbing
    times = [0.0, 1.0, 3.0]
    figure = pictures.displacement_figure(scene, solution, slip, times)
    save(figure, tmp_path / "displacement.png")
    panels = [panel for panel in figure.axes if panel.get_title()]
    bar = figure.axes[-1]
    assert [panel.get_title().split(",")[0] for panel in panels] == [
        "t = 0 s",
        "t = 1 s",
        "t = 3 s",
    ]
    factor = {"m": 1.0, "mm": 1e3, "µm": 1e6}[bar.get_ylabel().split("(")[1].rstrip(")")]
    for panel, i in zip(panels, [0, 10, 30], strict=True):
        field = scene.discretisation.expand(solution.u[i])
        np.testing.assert_allclose(panel.collections[0].get_array(), factor * field, rtol=1e-12)
        assert panel.get_aspect() == 1.0
        state = slip.state[max(i - 1, 0)]
        drawn = states_drawn(panel)
        assert len(drawn) == 2 * len(scene.contact)  # a closed boundary: two halves a node
        for value, colour in pictures.STATE_COLOURS.items():
            assert drawn.count(to_hex(colour)) == 2 * np.count_nonzero(state == value)
    assert "(mm)" in panels[0].get_ylabel() + panels[-1].get_xlabel()


def test_half_edges_lie_at_their_node(run: Run) -> None:
    segments, owner = pictures.half_edges(run.scene)
    np.testing.assert_array_equal(segments[:, 0], run.scene.contact.points[owner])
    length = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1).sum()
    assert length == pytest.approx(run.scene.contact.weight.sum(), rel=0.01)


def test_informative_times_tell_the_story(run: Run) -> None:
    moments = pictures.steps_shown(run.solution, run.slip)
    assert 4 <= len(moments) <= pictures.MOST_PICTURES
    assert moments == sorted(set(moments))
    assert moments[-1] == len(run.solution.velocity)
    assert min(np.diff(moments)) >= len(run.solution.velocity) / (2 * pictures.MOST_PICTURES)
    drawn = {int(s) for i in moments for s in np.unique(run.rubbing.state[i - 1])}
    assert drawn == {-1, 0, 1}


@pytest.mark.parametrize("steps", [1, 2, 5])
def test_the_shortest_runs_have_pictures(steps: int, tmp_path: Path) -> None:
    scene = half_ring()
    solution = scene.solve(steps=steps)
    slip = slip_of(scene, solution)
    assert slip is not None
    pictures.displacement_figure(scene, solution, slip).savefig(tmp_path / "displacement.png")
    pictures.contact_figure(scene, slip).savefig(tmp_path / "contact.png")


def test_a_body_at_rest_without_friction_has_a_picture(tmp_path: Path) -> None:
    mesh = square(3).scaled((5.0, 1.0))
    scene = antiplane(mesh, clamped="top", effects=[Viscosity(1.0)], t_end=1.0, steps=3)
    figure = pictures.displacement_figure(scene, scene.solve(), None)
    figure.savefig(tmp_path / "displacement.png")
    assert not figure.legends
    assert "(" not in figure.axes[0].get_ylabel() + figure.axes[-1].get_ylabel()


def test_times_outside_of_the_run_are_refused(run: Run) -> None:
    with pytest.raises(so.InputError, match=r"t = 7 is outside of \[0, 6\]"):
        pictures.displacement_figure(run.scene, run.solution, run.slip, [1.0, 7.0])


def test_contact_histories_are_those_of_the_solution(run: Run, tmp_path: Path) -> None:
    slip = run.rubbing
    figure = pictures.contact_figure(run.scene, slip)
    save(figure, tmp_path / "contact.png")
    zone, moved, traction = figure.axes
    grid = next(item for item in zone.collections if isinstance(item, QuadMesh))
    np.testing.assert_array_equal(np.reshape(grid.get_array(), slip.state.T.shape), slip.state.T)
    colours = [to_hex(grid.cmap(grid.norm(state))) for state in (-1, 0, 1)]
    assert colours == [to_hex(pictures.STATE_COLOURS[state]) for state in (-1, 0, 1)]
    assert (np.diff(pictures.cell_edges(slip)) >= 0.0).all()

    nodes = pictures.nodes_shown(slip)
    assert int(np.argmax(slip.total)) in nodes
    assert slip.total[nodes].min() == slip.total.min()
    curves = [line for line in moved.lines if line.get_label().startswith("at ")]
    forces = [line for line in traction.lines if len(line.get_xdata()) == len(slip.stage_t)]
    factor = 1e3 if "(mm)" in moved.get_ylabel() else 1e6
    for node, curve, force in zip(nodes, curves, forces, strict=True):
        np.testing.assert_allclose(curve.get_ydata(), factor * slip.displacement[:, node])
        share = slip.traction[:, node] / slip.contact.bound[node]
        np.testing.assert_allclose(force.get_ydata(), share)
        assert np.abs(share).max() <= 1.0 + 1e-5


def test_several_boundaries_share_one_picture(tmp_path: Path) -> None:
    scene = antiplane(
        square(5),
        clamped="top",
        effects=[
            Viscosity(1.0),
            Friction(["bottom", "left"], g={"bottom": 0.1, "left": 0.3}),
            Traction("right", so.Sine(1.0, period=2.0)),
        ],
        t_end=2.0,
        steps=20,
    )
    slip = slip_of(scene, scene.solve())
    assert slip is not None
    figure = pictures.contact_figure(scene, slip)
    save(figure, tmp_path / "contact.png")
    zone, moved, _ = figure.axes
    assert zone.get_ylabel() == "arc length of bottom, left"
    labels = [text.get_text() for text in moved.get_legend().get_texts()]
    assert any("bottom" in label for label in labels)
    assert any("left" in label for label in labels)


def test_state_colours_differ_in_lightness_or_blueness_for_every_eye() -> None:
    # deuteranopia mixes red and green: their mean, blue and lightness must still tell states apart
    seen = [
        np.array([(r + g) / 2.0, b]) for r, g, b in map(to_rgb, pictures.STATE_COLOURS.values())
    ]
    for k, one in enumerate(seen):
        for other in seen[k + 1 :]:
            assert np.linalg.norm(one - other) > 0.15


def stick_slip(dim: int) -> so.Solution:
    """Each component has a share of the load: some slip, the last one sticks."""
    shares = np.linspace(3.0, 0.1, dim)
    C = so.Moving(so.Box(-np.ones(dim), np.ones(dim)), center=lambda t: shares * math.sin(2.0 * t))
    process = so.SweepingProcess(np.eye(dim), np.eye(dim), C, np.zeros(dim))
    return so.solve(process, t_end=4.0, steps=40)


@pytest.mark.parametrize("dim", [1, 3, 20])
def test_plot_of_a_solution_draws_components_and_stick_phases(dim: int, tmp_path: Path) -> None:
    solution = stick_slip(dim)
    ax = plot.plot_solution(solution)
    save(ax.figure, tmp_path / "solution.png")
    curves = [line for line in ax.lines if line.get_label().startswith("$u_")]
    assert len(curves) == min(dim, plot.MOST_COMPONENTS)
    for line in curves:
        i = int(line.get_label().strip("$u_{}"))
        np.testing.assert_array_equal(line.get_ydata(), solution.u[:, i])
        stuck = solution.velocity[:, i] == 0.0
        # wide lines: two points and a gap for each stuck step of this component
        wide = [
            other
            for other in ax.lines
            if other.get_color() == line.get_color()
            and other.get_linewidth() > 5
            and len(other.get_xdata()) == 3 * np.count_nonzero(stuck)
        ]
        assert wide or not stuck.any()
    assert ("of 20 components" in ax.get_legend().get_title().get_text()) == (dim == 20)


def test_plot_of_a_solution_draws_into_given_axes() -> None:
    ax = Figure().add_subplot()
    assert plot.plot_solution(stick_slip(2), ax) is ax
    assert ax.lines


def test_missing_matplotlib_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(so.MissingExtraError, match=r'pip install "sweepopt\[plot\]"'):
        plot.plot_solution(stick_slip(1))


def test_no_global_state_of_pyplot_is_touched(run: Run) -> None:
    for file in map(Path, (plot.__file__, pictures.__file__)):
        assert "matplotlib.pyplot" not in file.read_text(encoding="utf-8")
