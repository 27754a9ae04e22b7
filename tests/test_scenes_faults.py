"""Scenes of the library against exact solutions."""

import numpy as np
import pytest

from sweepopt.fem import read_scene
from sweepopt.fem.output import Report
from sweepopt.fem.pictures import driven
from sweepopt.io import find_scene, parse_toml

pytestmark = pytest.mark.slow  # .ci/run runs them


def solved(name):
    """A run of a scene; every step is certified to 1e-10."""
    scene = parse_toml(name, find_scene(name).read_text())
    scene["pictures"] = []
    report = Report(read := read_scene(scene), read.solve())
    assert report.solution.success
    assert report.solution.stats["relative"].max() <= 1e-10
    return report


# Strike-slip fault in a half-space: strength 5 MPa + 9800 Pa/m z, 25 MPa and back to -15 MPa

KAPPA, K = 32.04e9, 9800.0


def slip_at(z, s, k):
    """Slip of both sides at the depths z under the stress s above the strength at the surface."""
    a = np.pi * s / (2 * k)
    root, r = a * np.sqrt(np.maximum(a**2 - z**2, 0)), np.maximum(a / np.maximum(z, 1e-9), 1)
    return np.asarray(2 * k / (np.pi * KAPPA) * (root - z**2 * np.arccosh(r)) * (z < a))


def test_a_fault_creeps_down_to_the_depth_of_the_half_space_and_back_by_masing():
    slip = solved("fault").slip
    z = -slip.contact.points[:, 1]
    turn = int(np.argmin(np.abs(slip.t - 4e10)))
    up = slip_at(z, 20e6, K)
    np.testing.assert_allclose(2 * slip.displacement[turn], up, atol=0.01 * 2.00107)
    assert 2 * slip.displacement[turn, np.argmin(z)] == pytest.approx(2.00107, rel=0.01)
    back = slip_at(z, 40e6 - 2 * 5e6, 2 * K)
    np.testing.assert_allclose(2 * slip.displacement[-1], up - back, atol=0.01 * 2.00107)

    def front(step):
        slips = slip.state[step - 1] != 0
        return float(z[slips].max() + z[~slips].min()) / 2

    for stress in (15e6, 20e6, 25e6):
        assert front(round(stress / 1.25e6)) == pytest.approx(
            np.pi * (stress - 5e6) / (2 * K), rel=0.01
        )
    for drop in (15e6, 25e6, 40e6):  # the front of the return, from 401 m on
        depth = np.pi * (drop - 10e6) / (4 * K)
        assert front(turn + round(drop / 1.25e6)) == pytest.approx(depth, rel=0.01)


# Antiplane Cattaneo-Mindlin with Hertz's pressure: a = f p0 = kappa = 1, one half of the contact


def test_fretting_is_that_of_cattaneo_and_mindlin():
    report = solved("fretting")
    slip, solution = report.slip, report.solution
    U, half, _ = driven(report.scene, solution)
    crest, P = 20, np.pi / 2
    Q = 2 * half[crest]
    s = 1 - Q / P
    assert pytest.approx(0.8, rel=0.01) == Q / P
    exact = (Q * (np.log(40) + 0.5) + P / 2 * s * np.log(s)) / np.pi
    assert U[crest] == pytest.approx(exact, rel=0.01)
    # the support carries what rubs
    np.testing.assert_allclose(-slip.traction @ slip.contact.weight, half[1:], rtol=1e-4, atol=1e-4)
    x, sticks = slip.contact.points[:, 0], slip.state[crest - 1] == 0
    core = (x[sticks].max() + x[~sticks].min()) / 2
    assert core == pytest.approx(np.sqrt(s), rel=0.01)
    loss = P**2 / np.pi * (1 - s**2 + 2 * s * np.log(s))
    assert 2 * np.diff(report.energy.friction[[20, 100]])[0] == pytest.approx(loss, rel=0.01)
