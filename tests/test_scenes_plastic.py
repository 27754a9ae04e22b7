"""The scenes of the library against exact values and independent codes; .ci/run has all."""

from dataclasses import replace
from functools import cache

import meshio
import numpy as np
import pytest
from cases import worst_certificate

from sweepopt.fem import Contribution, read_scene
from sweepopt.fem.output import Report, dataset_on_mesh, write_vtu

known = cache(read_scene)


def heated(kind):
    """The plate with an eigenstrain, for data/refused.txt."""
    heat = {"history": {"waveform": "constant"}, "strain": 1e-3, "E": 206.9e9, "nu": 0.29}
    changes = {"effects.eigenstrain": heat, "domain.element": "P1", "domain.kind": kind}
    return read_scene("plate", changes=changes)


def at_point(scene, solution, point):
    space = scene.discretisation
    node = np.argmin(np.linalg.norm(space.points - point, axis=1))
    return scene.displacement(solution)[:, node]


# 9. a thick ring -----------------------------------------------------------------------------

RING = {20: 0.006869859, 22: 0.044179585, 44: 0.039493079, 66: -0.044175687}
"""Displacement of its inner side by the number of the step, of an independent code."""


def test_the_thick_ring_agrees_with_an_independent_code_over_a_cycle():
    scene = known("ring")
    sol = scene.solve()
    assert sol.plan.path == "return mapping", "chosen where internal variables are many"
    assert worst_certificate(sol) <= 1e-10
    u = at_point(scene, sol, (1.0, 0.0))[:, 0]
    assert u[[*RING]] == pytest.approx([*RING.values()], rel=1e-3)


# 10. a plate with a hole ---------------------------------------------------------------------

HOLE = [
    (4, (0.1, 0.0), 0, -0.0194636e-3),
    (4, (0.0, 0.01), 1, 0.0136656e-3),
    (4, (0.0, 0.1), 1, 0.0465587e-3),
    (18, (0.1, 0.0), 0, -0.1013844e-3),
    (18, (0.01, 0.0), 0, -0.018089e-3),
    (18, (0.0, 0.01), 1, 0.0822044e-3),
    (18, (0.0, 0.1), 1, 0.2260322e-3),
]
"""Step, point and component of displacements (m), of an independent code."""


@pytest.mark.slow
def test_the_plate_agrees_with_an_independent_code_in_plane_strain():
    changes = {"domain.kind": "plane strain", "effects.traction.f2": [0.0, 450e6]}
    scene = read_scene("plate", changes=changes)
    sol = scene.solve(t_end=1.0, steps=18)
    assert worst_certificate(sol) <= 1e-10
    for step, point, component, displacement in HOLE:
        u = at_point(scene, sol, point)[step, component]
        assert u == pytest.approx(displacement, rel=1e-3)
    # the integral of u_y over the pulled side, m^2: what its tension works with
    assert scene.load(1.0) @ sol.u[-1] / 450e6 == pytest.approx(21.216092e-6, rel=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize(
    "changes, elastic, plastic",
    [({}, 148.5, 151.5), ({"domain.refinements": 1}, 147.8, 148.8)],
)
def test_the_plate_yields_first_beside_the_hole_at_the_tension_of_its_notch_factor(
    changes, elastic, plastic
):
    """At 450 / 3.03 = 148.5 MPa; each mesh between two tensions, which close in on that."""
    scene = read_scene("plate", changes=changes) if changes else known("plate")
    below, above = (
        scene.plastic_strain(scene.solve(t_end=tension / 420, steps=1))[1]
        for tension in (elastic, plastic)
    )
    assert not below.any()
    space = scene.discretisation
    middle = space.points[space.scalar.element_dofs[:3, above.argmax()]].mean(axis=0)
    assert above.any()
    assert np.hypot(*(middle - [0.01, 0.0])) < 1e-3


@cache
def pulled_plate():
    scene = known("plate")
    return scene, scene.solve(t_end=1.0, steps=4)


def test_what_a_run_of_plasticity_leaves_names_the_plastic_strain(tmp_path):
    scene, sol = pulled_plate()
    report, strain = Report(scene, sol, "plate"), scene.plastic_strain(sol)
    p = sol.field("plasticity").u
    assert sol.field("u").u.shape[1] + p.shape[1] == sol.u.shape[1]
    points = p.shape[1] // 4  # in plane stress e_zz, then three components of p
    each = np.sqrt(2 / 3) * np.linalg.norm(p[:, points:].reshape(5, points, 3), axis=2)
    assert 0.5 * each.max() < strain.max() <= each.max()
    assert strain.max() > 0 == strain[0].max()
    assert dataset_on_mesh(report).variables["plastic_strain"][1] == pytest.approx(strain)
    files = write_vtu(report, tmp_path)
    assert meshio.read(files[-1]).cell_data["plastic_strain"][0] == pytest.approx(strain[-1])
    assert scene.plot(sol, "stress").axes


def test_an_effect_of_ones_own_adds_its_part_to_the_stress_or_leaves_it_open():
    class Own:
        def __init__(self, stress):
            self.stress = lambda body: stress

        def contribute(self, body):
            return Contribution()

    scene, sol = pulled_plate()

    def stress_with(stress):
        effects, internal = (*scene.effects, Own(stress)), (*scene.internal, slice(0, 0))
        return replace(scene, effects=effects, internal=internal).stress(sol)

    shear = np.array([0.0, 0.0, 3e8])  # of 1 / sqrt(2) times the engineering strain
    rest, pulled = stress_with(lambda motion: shear), scene.stress(sol)
    assert rest[0] == pytest.approx(np.sqrt(1.5) * 3e8)  # at rest nothing else is there
    assert pulled[0] == pytest.approx(0.0)
    assert not np.allclose(rest, pulled)
    assert stress_with(None) is None
