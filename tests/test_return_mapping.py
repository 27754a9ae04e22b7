"""Elastoplastic bodies: plastic strains at many points are condensed by return mapping."""

import numpy as np
import pytest
import skfem
from cases import worst_certificate
from meshes import run_of
from numpy.testing import assert_allclose, assert_array_equal
from test_fem import order

from sweepopt.fem import (
    BodyForce,
    Discretisation,
    Elasticity,
    Foundation,
    Friction,
    OneWay,
    Plasticity,
    Traction,
    body,
    chain,
    grid,
    read_scene,
)
from sweepopt.loads import Table

# a clamped disc in antiplane shear, G = 1, yield stress 0.2 and hardening 0.1 of the shear stress
PIPE = {
    "kinematic": ({"Hk": 0.2}, {5: 1.15, 15: -1.15}),
    "isotropic": ({"Hi": 0.3}, {5: 1.15, 10: 0.9}),
    "both": ({"Hk": 0.1, "Hi": 0.15}, {5: 1.15, 15: -0.25}),
}
"""Displacements of its centre by the step, in closed form: 5 ends at the load 1, 15 at -1."""


def pipe(refinements, **changes):
    disc = skfem.MeshTri.init_circle(refinements).with_boundaries({"clamped": lambda x: x[0] < 9})
    effects = [
        Elasticity(1.0),
        Plasticity(**({"sigma_y": 0.2 * np.sqrt(3), "Hk": 0.2} | changes)),
        BodyForce(Table([0.0, 1.0, 3.0], [0.0, 1.0, -1.0])),
    ]
    settings = {"t_end": 3.0, "steps": 15, "scheme": "implicit-euler", "tol": 1e-10}
    return body(Discretisation(disc), effects, **settings)


def centre(scene, u):
    space = scene.discretisation
    node = np.argmin(np.hypot(*space.points.T))
    return space.expand(u[..., : space.dim])[..., node]


@pytest.mark.parametrize("name", PIPE)
def test_the_pipe_converges_to_its_closed_form_with_every_step_proved(name):
    hardening, exact = PIPE[name]
    errors = []
    for refinements in (2, 3, 4):
        scene = pipe(refinements, **({"Hk": 0.0} | hardening))
        sol = scene.solve(path="return mapping")
        assert sol.plan.path == "return mapping"
        assert worst_certificate(sol) <= 1e-10
        errors.append(np.abs(centre(scene, sol.u[[*exact]]) - [*exact.values()]).max())
    slopes = order(errors)
    assert slopes.min() > 1.2, (errors, slopes)
    assert errors[-1] < 4e-3


SSNP14 = [[0.0, 0.0], [151.2, 93.1], [257.2, 33.1], [259.3, 0.0]]  # stresses xx and xy
STRAINS = [[0.01483, 0.013601], [0.040642, 0.02001], [0.044217, 0.019315]]
"""Test SSNP14 of the Code_Aster manual: Prager's law, E_t = 1930."""


@pytest.mark.parametrize("kind", ["plane stress", "solid"])
def test_a_material_point_follows_the_path_of_ssnp14(kind):
    d, E, E_t = 3 if kind == "solid" else 2, 195e3, 1930.0
    space = Discretisation(
        grid([1.0] * d, [1] * d),
        kind=kind,
        held={"left": "x"} | ({"front": "z"} if d == 3 else {}),
    )
    xx, xy = (Table(np.arange(4.0), np.array(SSNP14)[:, k]) for k in (0, 1))

    def pull(on, history, component, sign=1.0):
        f2 = (sign * np.eye(d)[component]).tolist()
        return Traction(on, history, f2=f2)

    effects = [
        Elasticity(E=E, nu=0.3),
        Plasticity(181.0, Hk=2 / 3 * E * E_t / (E - E_t)),
        Foundation("left", k=1e-6 * E),  # it holds what needs no force
        *(pull("right", xx, 0), pull("right", xy, 1), pull("left", xy, 1, -1.0)),
        *(pull("top", xy, 0), pull("bottom", xy, 0, -1.0)),
    ]
    scene = body(space, effects, t_end=3.0, scheme="implicit-euler", tol=1e-10)
    ends = [np.argmin(np.linalg.norm(space.points - x, axis=1)) for x in (np.eye(d)[0], 0.0)]
    errors = []
    for steps in (30, 60, 120):
        sol = scene.solve(steps=steps, path="return mapping")
        assert worst_certificate(sol) <= 1e-10
        u = space.expand(sol.u[steps // 3 :: steps // 3, : space.dim])[:, ends]
        strains = (u[:, 0] - u[:, 1])[:, :2] * [1.0, 0.5]
        errors.append(np.abs(strains / STRAINS - 1).max())
    slopes = order(errors)
    assert slopes.min() > 0.9, (errors, slopes)
    assert errors[-1] < 1e-2


def test_a_point_that_does_not_yield_has_a_plastic_velocity_of_exactly_zero():
    scene = pipe(3)
    sol = scene.solve(path="return mapping")
    plastic = sol.velocity[:, scene.discretisation.dim :].reshape(15, -1, 2)
    points = plastic.shape[1]
    still = (plastic == 0.0).all(axis=2)
    elastic = [0, 1, 5, 6, 7, 8]  # below the yield stress, and after the load turns
    assert still[elastic].all()
    assert (np.delete(still.mean(axis=1), elastic) * points >= 40).all()
    assert not np.delete(still, elastic, axis=0).all(axis=1).any()


@pytest.mark.parametrize("hardening", [{"Hk": 0.2}, {"Hk": 0.1, "Hi": 0.15}])
def test_it_agrees_with_the_program_for_all_unknowns_to_both_certificates(hardening):
    scene = pipe(2, **hardening)
    B = scene.problem.B
    condensed, full = (
        scene.solve(steps=9, path=path, tol=tol)
        for path, tol in (("return mapping", 1e-10), ("full", 1e-6))
    )
    difference = condensed.u[1] - full.u[1]
    certificates = condensed.stats["certificate"][0] + full.stats["certificate"][0]
    mu = condensed.t[1]
    # certificates are in |.|_M with M = mu B, and u[1] = mu z
    assert np.sqrt(difference @ (B @ difference)) <= np.sqrt(mu) * certificates * (1 + 1e-9)
    assert np.abs(condensed.u - full.u).max() <= 1e-5 * np.abs(full.u).max()


def test_a_ring_a_thousand_times_as_stiff_is_solved_by_return_mapping_alone():
    changes = {"effects.elasticity.E": 70e12, "time.steps": 5, "domain.element": "P1"}
    run = read_scene("ring", changes=changes).solve()
    assert run.success
    assert run.plan.path == "return mapping"
    assert worst_certificate(run) <= run.plan.tol
    assert run.stats["attempts"].max() == 1
    assert run.stats["iterations"].max() <= 150


STRIP = grid([2.0, 1.0], [4, 2]).with_subdomains(
    {"soft": lambda x: x[0] < 1, "hard": lambda x: x[0] > 1}
)
PULL = Traction("right", Table([0.0, 1.0], [0.0, 2.0]))


def test_yield_stresses_differ_by_subdomain_and_the_load_is_data():
    """The pull is twice the one and a 25th of the other."""
    space = Discretisation(STRIP, kind="plane stress", held={"left": "x", "bottom": "y"})
    effects = [
        Elasticity(E=1000.0, nu=0.0),
        Plasticity(1.0, Hi=10.0, on="soft"),
        Plasticity({"hard": 50.0}, Hk=10.0, on="hard"),
        PULL,
    ]
    scene, sol = run_of(space, effects, steps=4, tol=1e-10, path="return mapping")
    strain, hard = scene.plastic_strain(sol)[-1], STRIP.subdomains["hard"]
    assert np.delete(strain, hard).min() > 0.05
    assert not strain[hard].any()
    assert worst_certificate(sol) <= 1e-10
    assert scene.process.variation(np.linspace(0, 1, 5)).guaranteed


@pytest.mark.parametrize("lumped", [False, True])
def test_a_bar_and_the_edges_of_a_chain_yield_in_tension(lumped):
    """At sigma_y, with the tangent moduli of a tension test; not at sigma_y / sqrt(3), in shear."""
    mesh = chain(3) if lumped else grid([2.0], [2])
    space = Discretisation(mesh, "left", kind="lumped" if lumped else "antiplane")
    history, kappa, Hk, Hi = Table([0.0, 1.0, 3.0], [0.0, 3.0, -3.0]), 200.0, 15.0, 7.0
    effects = [Elasticity(kappa), Plasticity(1.0, Hk=Hk, Hi=Hi), Traction("right", history)]
    scene, sol = run_of(space, effects, t_end=3.0, steps=30, scheme="auto", tol=1e-10)
    end = scene.displacement(sol)[:, np.argmax(space.points[:, 0])]
    strain = alpha = 0.0
    for k, force in enumerate(history(sol.t)):
        over = abs(force - 1.5 * Hk * strain) - 1.0 - Hi * alpha
        more = max(over, 0.0) / (1.5 * Hk + Hi)
        strain, alpha = strain + np.sign(force - 1.5 * Hk * strain) * more, alpha + more
        assert end[k] == pytest.approx(2 * (force / kappa + strain), abs=1e-8)
        assert_allclose(scene.plastic_strain(sol)[k], abs(strain), atol=1e-8)
        assert_allclose(scene.stress(sol)[k], abs(force), atol=1e-6)


def test_plasticity_of_a_part_takes_moduli_by_subdomain():
    space, runs = Discretisation(STRIP, "left", kind="plane strain"), []
    for E in ({"soft": 10.0, "hard": 20.0}, lambda x: np.where(x[0] < 1, 10.0, 20.0)):
        effects = [Elasticity(E=E, nu=0.3), Plasticity(1.0, Hk=1.0, on="soft"), PULL]
        scene, sol = run_of(space, effects)
        runs.append(scene.stress(sol))
    assert_array_equal(*runs)


@pytest.mark.parametrize("hardening", [{}, {"Hk": 0.6}, {"Hi": 0.9}, {"Hk": 0.2, "Hi": 0.6}])
def test_perzynas_viscosity_follows_its_closed_form(hardening):
    """One state of shear under the stress t: eta p' + H p = sqrt(2) (t - 1) for t >= 1."""
    space = Discretisation(grid([1.0, 1.0], [2, 2]), "left")
    effects = [
        Elasticity(2.0),
        Plasticity(np.sqrt(3), eta=0.3, **hardening),
        Traction("right", Table([0.0, 3.0], [0.0, 3.0])),
    ]
    scene = body(space, effects, t_end=3.0, scheme="implicit-euler", tol=1e-10)
    H, s, errors = hardening.get("Hk", 0.0) + 2 / 3 * hardening.get("Hi", 0.0), 2.0, []
    shear = s**2 / 0.6 if not H else (s - 0.3 / H * (1 - np.exp(-s * H / 0.3))) / H
    for steps in (15, 30, 60):
        sol = scene.solve(steps=steps, path="return mapping")
        assert worst_certificate(sol) <= 1e-10
        assert set(sol.stats["solver"]) <= {"return mapping", "at rest"}
        errors.append(abs(scene.displacement(sol)[-1].max() - (1.5 + 2 * shear)))
    slopes = order(errors)
    assert slopes == pytest.approx(1.0, abs=0.1), errors
    assert errors[-1] < 0.051 * shear, "without H the steps add 0.05 s to s^2"


@pytest.mark.parametrize("beside", ["friction", "one way"])
def test_isotropic_hardening_alone_goes_beside_friction_and_one_way_motion(beside):
    # a bar of length 2 pulled by 1.5: what friction at its end leaves stretches it, and it hardens
    kappa, sigma_y, Hi, g = 5.0, 0.6, 1.7, 0.3 * (beside == "friction")
    effects = [
        Elasticity(kappa),
        Plasticity(sigma_y, Hi=Hi),
        Traction("right", Table([0.0, 1.0, 2.0], [0.0, 1.5, 1.5])),
        Friction("right", g) if g else OneWay("body"),
    ]
    bar = Discretisation(grid([2.0], [3]), clamped="left")
    scene = body(bar, effects, t_end=2.0, steps=4, scheme="implicit-euler", tol=1e-10)
    sol = scene.solve()
    N = 1.5 - g
    end = scene.displacement(sol)[2:, -1]
    assert_allclose(end, 2 * (N / kappa + (N - sigma_y) / Hi), rtol=1e-10)
    program = sol.step_program(1)
    assert program.certify(sol.velocity[1]).relative < 1e-9
    assert program.certify(0.5 * sol.velocity[1]).relative > 0.1
