"""Lumped models, and their scenes (hysteresis, chain) against exact values."""

import numpy as np
import pytest
from cases import refuses, worst_certificate
from meshes import slips
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image

from sweepopt import plot
from sweepopt.fem import (
    BodyForce,
    Discretisation,
    Elasticity,
    Foundation,
    Viscosity,
    body,
    chain,
    read_scene,
)
from sweepopt.fem import Friction as Rub
from sweepopt.fem.output import Report
from sweepopt.io import find_scene, read_toml
from sweepopt.loads import Table


def scene_data(name):
    return dict(read_toml(find_scene(name)))


# --- lumped models, and scene 11: hysteresis


def test_a_lumped_model_is_the_chain_to_the_last_digit():
    n, kappa, k = 6, np.array([1.0, 2.0, 4.0, 8.0, 16.0]), np.arange(6.0)
    space = Discretisation(chain(n), (), kind="lumped")
    effects = [
        Viscosity(1.0),
        Elasticity(lambda x: kappa[np.minimum(x[0].astype(int), n - 2)]),
        Foundation("body", "x"),
        BodyForce(Table([0.0, 1.0], [0.0, 2.0]), "x"),
        Rub("body", "1 + x"),
    ]
    scene = body(space, effects, t_end=1.0, steps=4)
    D = np.diff(np.eye(n), axis=0)
    assert_allclose(scene.process.B.toarray(), D.T @ np.diag(kappa) @ D + np.diag(k), atol=1e-13)
    assert_allclose(scene.process.A.toarray(), D.T @ D, rtol=0, atol=1e-14)
    assert_allclose(scene.load(1.0), 2.0 * k, rtol=0, atol=1e-15)
    assert_array_equal(scene.contact.weight, np.ones(n))
    assert_array_equal(scene.contact.threshold, 1.0 + k)


@pytest.mark.parametrize("d", [None, [0.0, 0.9, -0.7, 0.3, -0.2, 0.3, 0.6]])
def test_the_loop_of_the_scene_is_that_of_fifty_plays(d):
    """Masing's rule, the wiping out of closed loops and their congruence are laws of plays."""
    data = scene_data("hysteresis")
    history = data["effects"]["body_force"]["history"]
    data["time"]["steps"] //= 4
    if d is not None:
        history["table"] = {"t": [float(i) for i in range(len(d))], "values": d}
        data["time"] = {"end": len(d) - 1.0, "steps": 10 * (len(d) - 1)}
    scene = read_scene(data)
    solution = scene.solve()
    assert worst_certificate(solution) <= 1e-10
    r, u = np.arange(1, 51) / 50, np.zeros(50)
    path = np.interp(solution.t, history["table"]["t"], history["table"]["values"])
    for i, x in enumerate(path):
        u = np.clip(u, x - r, x + r)
        assert np.abs(solution.u[i] - u).max() <= 1e-10
    drawn, load = scene.plot(solution, "loop").axes[0].lines[0].get_data()
    assert_allclose(drawn, solution.u.mean(axis=1), atol=1e-12)
    assert_allclose(load, path, atol=1e-12)
    if d is None:  # F, the sum of the g_i: all slide at d = 1
        assert (load - drawn).max() == pytest.approx(0.51, abs=1e-10)


def lumped(domain, **time):
    """The scene with another domain or end, for data/refused.txt."""
    data = scene_data("hysteresis")
    return read_scene(data | {"domain": data["domain"] | domain, "time": data["time"] | time})


# --- scene 12: a chain of blocks


def chain_data(nodes, end, steps):
    data = scene_data("chain")
    data["domain"]["mesh"]["nodes"] = nodes
    data["time"] = {"end": end, "steps": steps}
    data["effects"]["body_force"]["history"] = {"table": {"t": [0.0, end], "values": [0.0, end]}}
    return data


def steady_creep(g, t):
    """V t - B^-1 (g + eta V), with V = 1."""
    D = np.diff(np.eye(g.size), axis=0)
    return t - np.linalg.solve(np.eye(g.size) + 100.0 * D.T @ D, g + 0.1)


@pytest.mark.parametrize("nodes", [10, 50])
def test_a_chain_that_slides_creeps_at_the_speed_of_its_loader(nodes):
    scene = read_scene(chain_data(nodes, 7.0, 140))
    solution = scene.solve(tol=1e-10)
    assert worst_certificate(solution) <= 1e-10
    u = steady_creep(scene.contact.threshold, 7.0)
    assert np.allclose(solution.u[-1], u, rtol=0, atol=1e-10)
    assert (scene.velocity(solution)[0] == 0.0).all()  # it starts at rest, exactly


def test_the_map_of_slip_has_sticking_blocks_white():
    scene = read_scene(chain_data(20, 2.0, 40))
    report = Report(scene, scene.solve())
    figure = scene.plot(report.solution, "space_time")
    shown = np.ma.asarray(figure.axes[0].collections[0].get_array()).reshape(20, 40)
    assert np.array_equal(np.ma.getmaskarray(shown), report.slip.state.T == 0)


def test_the_displacement_of_a_chain_is_a_curve_that_can_be_animated(tmp_path, monkeypatch):
    monkeypatch.setattr(plot, "MOST_FRAMES", 3)
    scene = read_scene(chain_data(20, 2.0, 4))
    solution = scene.solve()
    u = scene.displacement(solution)
    drawn = scene.plot(solution, "displacement").axes[3].lines[0]
    assert_array_equal(drawn.get_ydata(), u[-1])
    with Image.open(scene.animate(solution, tmp_path / "chain.gif", "displacement")) as shown:
        assert shown.n_frames == 3
    assert_allclose(2 * scene.displacement(solution, [0.75])[0], u[1] + u[2])
    rate = scene.velocity(solution)
    assert_array_equal(scene.velocity(solution, [0.0, 0.5, 0.75]), rate[[0, 0, 1]])
    with refuses(r"t = 2\.5 is outside of \[0, 2\]"):
        scene.velocity(solution, 2.5)


@pytest.mark.slow
def test_ten_thousand_blocks_reach_the_steady_creep():
    scene = read_scene(chain_data(10_000, 7.0, 140))
    solution = scene.solve(scheme="implicit-euler")
    assert worst_certificate(solution) <= 1e-6
    assert np.abs(scene.velocity(solution)[-1] - 1.0).max() <= 1e-5


def test_a_node_between_two_subdomains_counts_once_in_all():
    """Stated as one effect or as two, which gave the node between them twice its share."""
    halves = chain(5).with_subdomains({"a": lambda x: x[0] < 2, "b": lambda x: x[0] > 2})
    space = Discretisation(halves, (), kind="lumped")
    each = {"a": 1.0, "b": 2.0}
    springs = [Foundation(name, g) for name, g in each.items()]
    for rubs in ([Rub(["a", "b"], each)], [Rub(name, g) for name, g in each.items()]):
        scene = body(space, [Viscosity(1.0), *springs, *rubs])
        threshold = scene.contact.threshold[np.argsort(scene.contact.node)]
        for found in (threshold, scene.process.B.diagonal()):
            assert_allclose(found, [1.0, 1.0, 1.5, 2.0, 2.0])


def test_a_node_of_a_chain_that_rubs_at_its_end_too_has_the_sum_of_both_bounds():
    space = Discretisation(chain(4), (), kind="lumped")
    pull = BodyForce(Table([0.0, 1.0], [0.0, 1.0]), 1.0)
    rubs = [Rub("body", 0.1), Rub("right", 0.2)]
    slip = slips(space, [Viscosity(1.0), Foundation("body", 1.0), *rubs, pull])
    assert_allclose(slip.bound[-1], [0.1, 0.1, 0.1, 0.3])
    assert_allclose(slip.traction[-1], -slip.bound[-1])
