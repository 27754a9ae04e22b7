"""Pictures show the solution: what is drawn is compared with the numbers, not with pixels."""

import math
from dataclasses import replace
from itertools import combinations, pairwise
from unittest.mock import Mock

import numpy as np
import pytest
from cases import isotropic, refuses, slow
from matplotlib import rc_context
from matplotlib.collections import PathCollection, QuadMesh, TriMesh
from matplotlib.colors import to_hex, to_rgb
from matplotlib.figure import Figure
from matplotlib.quiver import Quiver
from meshes import annulus, report_of, ring, run_of, square
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image, ImageSequence

import sweepopt as so
from sweepopt import plot
from sweepopt.fem import (
    BodyForce,
    Discretisation,
    Elasticity,
    Friction,
    PrescribedDisplacement,
    Traction,
    Viscosity,
    YieldStress,
    antiplane,
    body,
    grid,
    snapshots,
)
from sweepopt.fem.pictures import draw
from sweepopt.fem.snapshots import STATE_COLOURS
from sweepopt.plot import even_steps


def half_ring():
    """Small in metres, so that pictures need millimetres."""
    force = BodyForce(so.Sine(4.0, period=4.0), f0=lambda x: 1.0 + 40.0 * x[0])
    effects = [Viscosity(2.0), Elasticity(1.0), Friction("outer", g=0.006), force]
    return ring(effects=effects, mesh=annulus(2).scaled(0.01))


@pytest.fixture(scope="module")
def run():
    return report_of(half_ring())


def lay_out(figure):
    """No text is laid over the text of another panel."""
    figure.draw_without_rendering()
    titles = [panel.title.get_window_extent() for panel in figure.axes if panel.get_title()]
    assert not any(one.overlaps(other) for one, other in combinations(titles, 2))


def drawn(panel, kind):
    """What a panel has of a kind, the uppermost last."""
    return [one for one in panel.collections if isinstance(one, kind)]


def words(texts):
    return [text.get_text() for text in texts]


def contact_drawn(panel):
    """Points of the contact boundary and their colours: the uppermost ones."""
    points = drawn(panel, PathCollection)[-1]
    return points.get_offsets(), [to_hex(colour) for colour in points.get_facecolors()]


def test_displacement_stick_slip_and_reversal_are_those_of_the_solution(run):
    scene, solution, slip = run.scene, run.solution, run.slip
    figure = draw(run, "displacement")
    lay_out(figure)
    panels = [panel for panel in figure.axes if panel.get_title()]
    times = [float(panel.get_title().removeprefix("t = ").removesuffix(" s")) for panel in panels]
    assert 4 <= len(times) <= 6
    assert times[-1] == 6.0
    steps = [round(10 * t) for t in times]
    for panel, i in zip(panels, steps, strict=True):
        assert_allclose(
            drawn(panel, TriMesh)[0].get_array(), scene.discretisation.expand(solution.u[i])
        )
        assert panel.get_aspect() == 1.0
        points, colours = contact_drawn(panel)
        assert_array_equal(points, scene.contact.points)
        assert colours == [to_hex(STATE_COLOURS[value]) for value in slip.state[max(i - 1, 0)]]
    assert {*slip.state[np.subtract(steps, 1)].flat} == {-1, 0, 1}
    assert panels[0].yaxis.get_major_formatter()(0.02) == "20 mm"
    assert figure.axes[-1].yaxis.get_major_formatter()(2e-6) == "2 µm"


@pytest.mark.filterwarnings("ignore:the load has a period:sweepopt.StabilityWarning")  # one step
@pytest.mark.parametrize("picture", ["displacement", "contact"])
def test_the_shortest_run_has_pictures(picture):
    draw(report_of(replace(half_ring(), steps=1)), picture).draw_without_rendering()


def test_a_body_at_rest_without_friction_has_a_picture():
    mesh = square(3).scaled((5.0, 1.0))
    scene = antiplane(mesh, clamped="top", effects=[Viscosity(1.0)], t_end=1.0, steps=3)
    figure = draw(report_of(scene), "displacement")
    figure.draw_without_rendering()
    (legend,) = figure.legends
    assert words(legend.get_texts()) == ["clamped"]
    assert figure.axes[0].yaxis.get_major_formatter()(0.5) == "0.5"


@pytest.mark.parametrize("length", [1.0, 5.0])
def test_sections_fill_their_panels_and_where_there_is_flow_it_is_drawn_first(length):
    mesh, effects = square(3).scaled((length, 1.0)), [Viscosity(1.0), YieldStress(0.1)]
    scene = antiplane(mesh, clamped="top", effects=effects, t_end=1.0, steps=4)
    figure = scene.plot(scene.solve())
    figure.draw_without_rendering()
    *panels, bar = figure.axes
    assert bar.get_ylabel() == "velocity"
    assert panels[0].get_gridspec().get_geometry() == (2, 2)
    drawn = sum(np.prod(panel.get_position().size) for panel in panels)
    assert drawn > 0.2  # 0.10 of the page if a flat body has that of a square


def test_contact_histories_are_those_of_the_solution(run):
    slip = run.slip
    figure = draw(run, "contact")
    lay_out(figure)
    zone, moved, traction, load = figure.axes
    t, force = load.lines[0].get_data()
    assert_allclose(force / abs(force).max(), np.sin(np.pi * t / 2), atol=1e-9)
    (grid,) = drawn(zone, QuadMesh)
    assert_array_equal(np.reshape(grid.get_array(), slip.state.T.shape), slip.state.T)
    for state, colour in STATE_COLOURS.items():
        assert to_hex(grid.cmap(grid.norm(state))) == to_hex(colour)
    curves = [line for line in moved.lines if line.get_label().startswith("outer, ")]
    forces = [line for line in traction.lines if len(line.get_xdata()) == len(slip.stage_t)]
    shares = slip.traction / slip.contact.bound
    nodes = [int(np.argmax(slip.displacement[-1] == c.get_ydata()[-1])) for c in curves]
    for node, curve, force in zip(nodes, curves, forces, strict=True):
        assert_allclose(curve.get_ydata(), slip.displacement[:, node])
        assert_allclose(force.get_ydata(), shares[:, node])
    assert slip.total[nodes].max() == slip.total.max()
    assert slip.total[nodes].min() == slip.total.min()


@pytest.mark.parametrize("ends, x, label", [
    ((0.0, 1.2), [0.0, 0.2, 1.0], ["0 m", "0.2 m", "1 m"]),
    ((-0.5, 0.02), [-0.5, -0.005, 0.01], ["\N{MINUS SIGN}500 mm", "\N{MINUS SIGN}5 mm", "10 mm"]),
    ((0.0, 2000.0), [-1e-13, 500.0], ["0 km", "0.5 km"]),
])  # fmt: skip
def test_the_ticks_of_an_axis_have_one_unit(ends, x, label):
    report, panel = Mock(), plot.new_figure((4.0, 3.0)).subplots()
    report.units = {"length": "m"}
    snapshots.name_axis(report, panel.yaxis, "u", "length")
    panel.set_ylim(*ends)
    assert [panel.yaxis.get_major_formatter()(one) for one in x] == label


def test_several_boundaries_share_one_picture():
    friction = Friction(["bottom", "left"], g={"bottom": 0.1, "left": 0.3})
    effects = [Viscosity(1.0), friction, Traction("right", so.Sine(1.0, period=2.0))]
    scene = antiplane(square(5), clamped="top", effects=effects, t_end=2.0, steps=20)
    run = report_of(scene)
    # the shared corner counts once, the clamped one not at all
    assert_allclose(run.slip.contact.arc, np.arange(10) / 5.0, atol=1e-12)
    figure = draw(run, "contact")
    lay_out(figure)
    zone, moved, *_ = figure.axes
    assert zone.get_ylabel() == "arc length along bottom, left"
    (beside,) = zone.child_axes
    assert words(beside.get_yticklabels()) == ["bottom", "left"]
    begins = [line.get_ydata()[0] for line in zone.lines if line.get_color() == "white"]
    assert begins == beside.get_yticks().tolist() == pytest.approx([0.0, 1.2])
    labels = " ".join(words(moved.get_legend().get_texts()))
    assert "bottom" in labels
    assert "left" in labels


def test_state_colours_differ_in_lightness_or_blueness_for_every_eye():
    # deuteranopia mixes red and green: their mean, blue and lightness must still tell states apart
    colours = map(to_rgb, STATE_COLOURS.values())
    backward, stick, forward = (np.array([(r + g) / 2.0, b]) for r, g, b in colours)
    for one, other in ((backward, stick), (backward, forward), (stick, forward)):
        assert np.linalg.norm(one - other) > 0.15


def stick_slip(dim):
    """Each component has a share of the load: some slip, the last one sticks."""
    shares = np.linspace(3.0, 0.1, dim)
    C = so.Moving(so.Box(-np.ones(dim), np.ones(dim)), center=lambda t: shares * math.sin(2.0 * t))
    process = isotropic(C, 1.0, 1.0)
    return so.solve(process, t_end=4.0, steps=40)


@pytest.mark.parametrize("dim", [1, 3, 20])
def test_plot_of_a_solution_draws_components_and_stick_phases(dim):
    solution = stick_slip(dim)
    ax = solution.plot()
    given = Figure().add_subplot()
    assert solution.plot(given) is given
    assert len(given.lines) == len(ax.lines)
    lay_out(ax.figure)
    curves = [line for line in ax.lines if line.get_label().startswith("u[")]
    assert len(curves) == min(dim, len(plot.LOOKS))
    for line in curves:
        i = int(line.get_label().strip("u[]"))
        assert_array_equal(line.get_ydata(), solution.u[:, i])
        stuck = np.count_nonzero(solution.velocity[:, i] == 0.0)
        # wide lines: two points and a gap for each stuck step of this component
        mine = [other for other in ax.lines if other.get_color() == line.get_color()]
        wide = [other for other in mine if other.get_linewidth() > 5]
        assert not stuck or 3 * stuck in [len(other.get_xdata()) for other in wide]
    assert ("of 20 unknowns" in ax.get_legend().get_title().get_text()) == (dim == 20)


def test_a_legend_says_sticks_only_where_something_does():
    def legend_of(run):
        return words(run.plot(Figure().add_subplot()).get_legend().get_texts())

    flows = so.EvolutionVI(1.0, 1.0, load=so.Separable([(so.Sine(1.0, 7.0), 1.0)]), u0=0.0)
    assert legend_of(so.solve(flows, t_end=1.0, steps=5)) == ["u[0]"]
    assert legend_of(stick_slip(1)) == ["u[0]", "sticks"]


def test_one_unknown_is_drawn_with_its_velocity_and_the_force_inside_of_the_tube():
    solution = stick_slip(1)
    u, velocity, force = solution.plot().figure.axes
    assert [panel.get_ylabel() for panel in (u, velocity, force)] == ["u", "u'", "force"]
    t = (solution.t[1:] + solution.t[:-1]) / 2
    # constant on each step: a ramp between middles would hide where u' jumps
    drawn = [stairs.get_data() for panel in (velocity, force) for stairs in panel.patches]
    (rate, *_), (inside, *_), (high, _, low) = drawn
    for _, ends, _ in drawn:
        assert_array_equal(ends, solution.t)
    assert_array_equal(rate, solution.velocity[:, 0])
    middle = 3.0 * np.sin(2.0 * t)
    assert_allclose([low, high], [middle - 1.0, middle + 1.0])
    assert_allclose(inside, rate + (solution.u[1:, 0] + solution.u[:-1, 0]) / 2.0)
    # the middle of a step is in C(t) to second order
    assert abs(inside - middle).max() < 1.0 + 0.1


def test_two_unknowns_are_drawn_as_a_path_beside_the_set():
    C = so.Moving(so.Ball([0.0, 0.0], 1.0), lambda t: [2.0 * t, t])
    solution = so.solve(isotropic(C), t_end=2.0, steps=40)
    path, force = solution.plot().figure.axes
    assert (path.get_xlabel(), path.get_ylabel()) == ("u[0]", "u[1]")
    assert_array_equal(path.lines[0].get_xydata(), solution.u)
    for line in force.lines[1:]:
        t = float(line.get_label().removeprefix("C(t), t = "))
        radii = np.hypot(*(line.get_xydata() - [2.0 * t, t]).T)
        assert_allclose(radii, 1.0, atol=0.02)
    assert len(force.lines) == 6


LENS = so.Ball([0.0, 0.0], 1.0) & so.Ball([0.6, 0.0], 1.0)


@pytest.mark.parametrize("C, sets", [(LENS, 2), (so.HalfSpace([1.0, 0.0], 0.5), 0)])
def test_a_set_in_the_legend_is_drawn_and_one_without_an_outline_is_not_there(C, sets):
    process = isotropic(C)
    panel = so.solve(process, t_end=1.0, steps=2).plot().figure.axes[1]
    drawn = [line.get_xydata() for line in panel.lines[1:]]
    assert len(panel.get_legend().get_texts()) == len(drawn) + 1 == sets + 1
    for points in drawn:
        from_centres = np.hypot(*points.T), np.hypot(*(points - [0.6, 0.0]).T)
        assert_allclose(np.maximum(*from_centres), 1.0, atol=2e-3)
        assert_allclose(np.ptp(points, axis=0), [1.4, 2 * np.sqrt(0.91)], atol=2e-3)


@pytest.mark.parametrize("dim", [1, slow(2)])
def test_an_animation_shows_each_time_once(dim, tmp_path, monkeypatch):
    monkeypatch.setattr(plot, "MOST_FRAMES", 3)
    path = stick_slip(dim).animate(tmp_path / "run.gif")
    with Image.open(path) as shown:
        frames = [np.array(frame.convert("L")) for frame in ImageSequence.Iterator(shown)]
    assert len(frames) == 3
    assert min(np.ptp(one - other) for one, other in pairwise(frames)) > 100


@pytest.mark.parametrize("steps", [60, 90])
def test_even_times_that_miss_a_node_by_rounding_are_that_node(steps):
    solution = so.solve(isotropic(so.Box(-1, 1)), t_end=1.0, steps=steps)
    for parts in range(2, steps):
        if steps % parts == 0:
            chosen = plot.even_steps(solution, parts)
            assert_array_equal(chosen, np.arange(1, parts + 1) * (steps // parts) - 1)


def test_an_animation_of_two_unknowns_shows_even_times(tmp_path, monkeypatch):
    monkeypatch.setattr(plot, "MOST_FRAMES", 5)
    titles, states = [], []

    def write(figure, path, draw, frames):
        for i in range(frames):
            draw(i)
            titles.append(figure.get_suptitle())
            states.append(figure.axes[0].lines[-1].get_xydata()[0])

    monkeypatch.setattr(plot, "write_animation", write)
    solution = stick_slip(2)
    solution.animate(tmp_path / "run.gif")
    times = solution.t[8::8]  # of 40 steps
    assert titles == [f"t = {t:.4g}" for t in times]
    assert_array_equal(states, solution(times))


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_a_run_that_is_stopped_in_its_first_step_has_nothing_to_draw(dim, tmp_path, monkeypatch):
    monkeypatch.setattr(
        "sweepopt.integrate.loop.compensated_sum", Mock(side_effect=KeyboardInterrupt)
    )
    solution = stick_slip(dim)
    assert solution.status is so.Status.INTERRUPTED
    for draw_it in (solution.plot, lambda: solution.animate(tmp_path / "run.gif")):
        with refuses("no complete step to draw"):
            draw_it()


def test_an_animation_of_a_loaded_run_needs_no_process(tmp_path):
    stick_slip(2).save(tmp_path / "run.nc")
    loaded = so.Solution.load(tmp_path / "run.nc")
    with refuses(r"ending of an animation must be one of .gif, .mp4"):
        loaded.animate(tmp_path / "run.png")
    assert loaded.plot().get_ylabel() == "u"


def test_a_scene_writes_what_the_command_line_writes(tmp_path, monkeypatch):
    monkeypatch.setattr("sweepopt.fem.pictures.draw", Mock(return_value=Figure()))
    scene = half_ring()
    folder = scene.write(scene.solve(steps=4), tmp_path / "new" / "run")
    files = {path.name for path in folder.iterdir()}
    assert {"solution.nc", "displacement.png", "contact.png", "summary.json", "vtu"} <= files


@pytest.fixture(scope="module")
def solid():
    box = grid([2.0, 1.0, 1.0], [2, 1, 1])
    effects = [Viscosity(1.0), Elasticity(E=1.0, nu=0.3), Friction("front", g=0.01)]
    effects.append(Traction("right", so.Sine(0.1, 4.0), [1.0, 0.0, 0.0]))
    return run_of(Discretisation(box, "back", kind="solid"), effects, scheme="auto")


def test_a_solid_is_drawn_deformed_and_a_picture_that_does_not_fit_is_refused(solid, monkeypatch):
    monkeypatch.setattr(snapshots, "off_screen", lambda: None)
    scene, solution = solid
    for name in ("surface", "stress"):
        panel, *_ = scene.plot(solution, name).axes
        assert panel.name == "3d"
        faces = next(one for one in panel.collections if one.get_array() is not None)
        values = faces.get_array()
        assert len(values) == len(scene.discretisation.triangles)
    stress, mesh = scene.stress(solution), scene.discretisation.mesh
    assert set(values) <= set(stress[1])  # the first panel: the end of the first step
    assert values.size == mesh.boundary_facets().size
    with refuses("picture: flow needs a section with a yield stress"):
        scene.plot(solution, "flow")


def test_arrows_of_slip_have_a_scale_at_each_time_and_say_how_fast_the_longest_one_is(solid):
    scene, solution = solid
    figure = scene.plot(solution, "arrows")
    tangential = scene.velocity(solution)[:, scene.contact.node][..., :2]  # front and back are z
    speed = np.linalg.norm(tangential, axis=-1).max(axis=1)
    panels, width = figure.axes[:-1], np.ptp(scene.contact.points[:, 0])
    assert len(panels) > 1
    for panel, i in zip(panels, even_steps(solution, 6), strict=False):
        (arrows,) = drawn(panel, Quiver)
        longest = np.hypot(arrows.U, arrows.V).max(initial=0.0) / arrows.scale
        assert longest == pytest.approx(0.08 * width if speed[i] else 0.0)
        assert panel.get_title().endswith(f", slip arrows up to {speed[i]:.2g}")
    # a mean: at the end of a step its nodes may slip below the bound of Tresca
    assert figure.axes[-1].get_ylabel() == "friction traction / bound\n(above 1: error of the step)"


def test_a_solid_is_rendered_by_pyvista_where_it_is_installed(solid):
    pytest.importorskip("pyvista")
    if snapshots.off_screen() is None:
        pytest.skip("nothing draws off-screen here")
    scene, solution = solid
    figure = scene.plot(solution, "stress")
    shown = figure.axes[0].images[0].get_array()
    assert len(np.unique(shown.reshape(-1, 3), axis=0)) > 20
    assert figure.axes[-1].get_ylim() == (0.0, scene.stress(solution).max())


def test_a_section_is_drawn_with_the_stress_of_its_cells(run):
    figure = draw(run, "stress")
    stress = run.scene.stress(run.solution)
    outline, drawn = figure.axes[5].collections
    assert_array_equal(drawn.get_array(), np.tile(stress[-1], 4))
    body = run.scene.discretisation
    facets = body.facet_nodes(body.mesh.boundary_facets()).T
    assert_array_equal(outline.get_segments(), body.points[facets])


@pytest.mark.parametrize("cone, sides", [(so.Orthant(1), 1), (so.WholeSpace(1), 2)])
def test_a_set_without_bound_is_drawn_to_the_end_of_the_axes(cone, sides):
    C = so.Moving(cone, center=lambda t: t - 1.0)
    sol = so.solve(so.SweepingProcess(0.5, 2.0, C, 0.5), t_end=1.0, steps=20)
    *_, force = sol.plot().figure.axes
    band = next(one for one in force.patches if one.get_label() == "C(t)")
    low, high = band.get_data().baseline, band.get_data().values
    assert np.isfinite([low, high]).all()
    assert [np.ptp(high), np.ptp(low)].count(0.0) == sides


def test_a_section_that_moves_in_its_plane_is_drawn_deformed_with_its_title():
    pull = Traction("right", so.Sine(0.1, 4.0), [1.0, 0.0])
    effects = [Elasticity(E=1.0, nu=0.3), Viscosity(1.0), pull]
    space = Discretisation(square(3), "left", kind="plane strain")
    scene = body(space, effects, t_end=1.0, steps=4, title="A square that is pulled")
    solution = scene.solve()
    figure = scene.plot(solution, "displacement")
    assert figure.get_suptitle() == scene.title
    u = scene.displacement(solution)[1:]
    size = np.linalg.norm(u, axis=2)
    factor = 0.1 / size.max()  # the square has length 1
    for panel, moves, sizes in zip(figure.axes, u, size, strict=False):
        (field,) = drawn(panel, TriMesh)
        assert_allclose(field.get_array(), sizes)
        moved = (space.points + factor * moves)[space.triangles]
        assert_allclose([path.vertices[:3] for path in field.get_paths()], moved)
    said = f"(displacement drawn {factor:.2g} times as large)"
    assert figure.axes[-1].get_ylabel().endswith(said)


def test_profiles_name_the_bound_of_friction(run):
    _, traction = draw(run, "profiles").axes
    bounds = [line for line in traction.lines if not line.get_label().startswith("t = ")]
    names = words(traction.get_legend().get_texts())
    assert names[-1] == "bound, t = 0"
    assert len(names) == len(traction.lines) - 1
    for line, bound in zip(bounds, (0.006, -0.006), strict=True):
        assert_allclose(line.get_ydata(), bound)


@pytest.mark.filterwarnings("ignore::sweepopt.InitialStateWarning")
def test_what_slips_is_shown_alone_with_a_word_of_the_rest_and_what_drives_it_is_named():
    """Half of the boundary is pulled: the rest of it never slips."""
    pull = PrescribedDisplacement("right", so.Table([0.0, 1.0], [0.0, 0.6]))
    effects = [Elasticity(1.0), Viscosity(0.01), Friction("bottom", g=0.5), pull]
    scene = antiplane(square(8), clamped=["right", "left"], effects=effects, t_end=1.0, steps=10)
    run = report_of(scene)
    panel, (_, below) = draw(run, "space_time").axes[0], draw(run, "profiles").axes
    slips = run.slip.contact.arc[run.slip.total > 0]
    for low, high, name in (
        (*panel.get_ylim(), panel.get_ylabel()),
        (*below.dataLim.intervalx, below.get_xlabel()),
    ):
        assert 0 < low <= slips.min() <= slips.max() <= high
        assert name == "arc length along bottom\n(where it slips at some time)"
    (panel,) = draw(run, "loop").axes
    assert panel.get_ylabel() == "force on the body along\nthe prescribed motion"
    assert panel.lines[0].get_ydata()[-1] > 0
    whole = draw(report_of(half_ring()), "space_time").axes[0]
    assert whole.get_ylabel() == "arc length along outer"


@pytest.mark.slow  # .ci/run runs it
def test_an_mp4_is_written_where_there_is_ffmpeg(tmp_path, monkeypatch):
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    monkeypatch.setattr(plot, "MOST_FRAMES", 2)
    with rc_context({"animation.ffmpeg_path": ffmpeg.get_ffmpeg_exe()}):
        animation = stick_slip(1).animate(tmp_path / "run.mp4").read_bytes()
    assert animation[4:8] == b"ftyp"
    with (
        rc_context({"animation.ffmpeg_path": "no such program"}),
        refuses(r"an MP4 is made by ffmpeg, .*; install it"),
    ):
        stick_slip(1).animate(tmp_path / "run.mp4")


@pytest.mark.parametrize(
    "end, unit, seconds",
    [
        (5e-4, " \N{MICRO SIGN}s", 1e-6),
        (10.0, " s", 1.0),
        (7200.0, " h", 3600.0),
        (1e11, " yr", 365.25 * 86400.0),
    ],
)
def test_times_of_pictures_are_in_the_unit_that_suits_the_run(end, unit, seconds):
    effects = [Viscosity(end), Elasticity(1.0), Friction("bottom", g=0.5)]
    effects.append(BodyForce(so.Sine(4.0, period=end), f0=1.0))
    settings = {"t_end": end, "steps": 5, "units": "SI"}
    scene = antiplane(square(2), clamped="top", effects=effects, **settings)
    solution = scene.solve()
    titles = [panel.get_title() for panel in scene.plot(solution, "displacement").axes[:-1]]
    assert f"t = {end / seconds:.5g}{unit}" in titles
    for name in ("contact", "space_time")[end > 1 :]:
        panels = scene.plot(solution, name).axes
        panel = next(one for one in panels if one.get_xlabel() == "time")
        low, high = panel.get_xlim()
        assert (low, high) == pytest.approx((0.0, end / seconds), rel=0.06)
        assert panel.xaxis.get_major_formatter()(2.5) == f"2.5{unit}"


def test_the_front_of_plastic_strains_is_drawn_on_its_way_through_the_ring():
    """It passes in 3 of 66 steps, which six even times miss."""
    scene = so.scene("ring", changes={"domain.element": "P1"})
    solution = scene.solve()
    titles = [panel.get_title() for panel in scene.plot(solution, "yielding").axes[:-1]]
    times = [float(title.removeprefix("t = ").removesuffix(" s")) for title in titles]
    drawn = [abs(solution.t - time).argmin() for time in times]  # titles are rounded
    share = (scene.plastic_strain(solution) > 0)[drawn].mean(axis=1)
    assert ((share > 0.1) & (share < 0.9)).sum() >= 2
    assert times[-1] == 3.0


def test_a_loop_marks_its_start(run):
    (panel,) = draw(run, "loop").axes
    (line,) = panel.lines
    assert (line.get_marker(), line.get_markevery()) == ("o", [0])
    assert panel.get_xlabel().endswith("(dot: start)")
