"""Yield stresses on a gradient: the method of multipliers with one value for each plug."""

import sys
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp
import skfem
from cases import close_bound, worst_certificate
from meshes import square

import sweepopt as so
from sweepopt import fem
from sweepopt.errors import InitialStateWarning, PathError

sys.path.insert(0, str(Path(__file__).parent.parent / "benchmarks"))
from scenes import disc

pytestmark = pytest.mark.filterwarnings("ignore::sweepopt.errors.InitialStateWarning")
CERTIFICATE = 1e-6
G, ONE = 0.2, so.Constant(1.0)  # yield stress, pressure


def flow(rings, pressure, kappa=0.0, moved=0.0):
    """A pipe of radius 1; with kappa > 0 a gel that is elastic beside its viscosity."""
    mesh = disc(rings, moved).with_boundaries({"wall": lambda x: np.hypot(*x) > 0})
    effects = [fem.Viscosity(1.0), fem.YieldStress(G), fem.BodyForce(pressure)]
    effects += [fem.Elasticity(kappa)] if kappa else []
    return fem.body(fem.Discretisation(mesh, "wall"), effects)


def solve(problem, steps=1, **options):
    settings = {"t_end": 1.0, "scheme": "implicit-euler", "tol": CERTIFICATE, "path": "cones"}
    sol = so.solve(problem, steps=steps, **(settings | options))
    assert worst_certificate(sol) <= CERTIFICATE
    return sol


def run(case, *steps, **options):
    return solve(case.problem, *steps, **options)


def test_a_plug_has_one_velocity_to_the_last_bit():
    case = flow(12, ONE)
    z = case.velocity(run(case))[-1]
    inside = np.hypot(*case.discretisation.points.T) < 0.9 * 2 * G
    assert np.unique(z[inside]).size == 1
    assert z[inside][0] == z.max() > 0


def chain(n):
    """Friction between neighbours, and between the first one and the ground, as intervals."""
    E = sp.eye_array(n, format="csr") - sp.eye_array(n, k=-1, format="csr")
    A = sp.csc_array(sp.eye_array(n))
    f = 1 + np.sin(np.arange(n))
    D = so.image(E.T, so.Balls(np.full(n, 0.6), 1))
    return so.EvolutionVI(A, None, load=lambda t: t * f, dissipation=D, u0=np.zeros(n))


def sheet(n):
    """n points of two components that rub over a face."""
    stiff = sp.diags_array([-1.0, 2.5, -1.0], offsets=[-2, 0, 2], shape=(2 * n, 2 * n))
    f = np.cos(np.arange(2 * n))
    D = so.Balls(np.linspace(0.2, 0.8, n), 2)
    return so.EvolutionVI(
        sp.csc_array(stiff), None, load=lambda t: t * f, dissipation=D, u0=np.zeros(2 * n)
    )


@pytest.mark.parametrize("process", [chain(12), sheet(12)], ids=["chain", "sheet"])
def test_other_balls_agree_with_the_program_for_all_unknowns(process):
    cones, full = (solve(process, 5, path=path) for path in ("cones", "full"))
    assert set(cones.stats["solver"]) <= {"cones", "at rest"}
    assert np.abs(cones.velocity - full.velocity).max() <= 1e-5 * np.abs(full.velocity).max()


def block():
    """A cube that rubs in discs on three faces, whose edges and one corner they share."""
    faces = {name: lambda x, k=k: x[k] < 1e-9 for k, name in enumerate(("back", "side", "floor"))}
    mesh = skfem.MeshTet().refined(1).with_boundaries(faces | {"top": lambda x: x[2] > 1 - 1e-9})
    held = {"back": "x", "side": "y", "floor": "z"}
    rub = [fem.Friction(name, g) for name, g in (("back", 0.12), ("side", 0.15), ("floor", 0.1))]
    pull = fem.Traction("top", so.Sine(1.0, period=1.0), f2=[0.5, 0.3, 0.0])
    effects = [fem.Viscosity(eta=0.1), fem.Elasticity(E=10.0, nu=0.3), *rub, pull]
    return fem.body(fem.Discretisation(mesh, kind="solid", held=held), effects)


@pytest.mark.parametrize(
    "case", [flow(8, so.Sine(1.0, 4.0), 1.0), flow(6, so.Sine(1.0, 4.0), moved=0.25), block()]
)
def test_certificates_bound_the_error_and_go_to_1e_11(case):
    rough, sharp = (run(case, 6, tol=tol, t_end=0.6) for tol in (1e-6, 1e-11))
    assert worst_certificate(sharp) <= 1e-11
    assert set(sharp.stats["solver"]) <= {"cones", "at rest"}
    for i, (z, certificate) in enumerate(
        zip(rough.velocity, rough.stats["certificate"], strict=True)
    ):
        program = rough.step_program(i)
        moved = so.SweepingProcess(program.M, None, program.C + -program.Bu, 0.0 * z)
        best = so.solve(moved, t_end=1.0, steps=1, scheme="implicit-euler", tol=1e-11)
        norm = best.process.metric.norm  # that of M
        assert norm(z - best.velocity[0]) <= certificate + best.stats["certificate"][0]


@pytest.mark.parametrize("g", [0.3, 5.0])
def test_friction_beside_a_yield_stress_agrees_with_a_program_stated_in_cvxpy(g):
    pull = fem.Traction("right", so.Sine(1.5, period=2.0))
    effects = [fem.Viscosity(1.0), fem.Elasticity(1.5), fem.YieldStress(G), pull]
    effects.append(fem.Friction("bottom", g=g))
    scene = fem.antiplane(square(4), clamped="top", effects=effects)
    sol = run(scene, 10, scheme="sdirk2", path="auto")
    assert sol.plan.path == "cones"
    assert (scene.contact.of(sol.velocity[-1]) == 0.0).any()
    stages = [sol.step_program(9, stage).problem for stage in range(2)]
    for problem in stages:
        problem.solve(solver="CLARABEL", tol_gap_abs=1e-10, tol_gap_rel=1e-10, tol_feas=1e-10)
    weights = sol.plan.scheme.b
    z = sum(b * problem.variables()[0].value for b, problem in zip(weights, stages, strict=True))
    norm = scene.process.metric.norm
    assert norm(z - sol.velocity[9]) <= 1e-4 * norm(z)


def test_a_yield_stress_that_grows_in_time_stops_the_flow_and_as_a_function_has_no_bound():
    vi = flow(6, ONE).problem
    C = so.Moving(vi.dissipation, center=vi.load(0.0), scale=lambda t: 1 + 2 * t)
    sol = solve(so.SweepingProcess(vi.A, None, C, vi.u0), 4)
    assert sol.velocity[0].any()
    assert not sol.velocity[-1].any()
    assert set(sol.stats["solver"]) == {"cones"}
    with pytest.raises(PathError, match=r"C\(t\) is a function.*give it as data"):
        sol.error_bound()


def test_discs_choose_the_path_and_rough_meshes_are_certified():
    case = flow(14, so.Polynomial([0.5, 1.0]), moved=0.25)
    sol = run(case, 5, path="auto")
    assert sol.plan.path == "cones"
    assert set(sol.stats["solver"]) == {"cones"}
    assert run(flow(2, so.Polynomial([0.0, 1.0])), path="auto").plan.path == "cones"
    assert solve(chain(20), path="auto").plan.path == "full"  # a polyhedron has a finite method


def test_whether_the_start_is_inside_is_found_without_a_slow_projection():
    without_B = r"f\(0\) - B u0 is not in the diss.* for a start at rest give loads and"
    with pytest.warns(InitialStateWarning, match=without_B):
        run(flow(12, ONE), path="auto")


@pytest.mark.parametrize("scheme, kappa", [("implicit-euler", 0.0), ("sdirk2", 1.0)])
def test_the_bound_is_above_the_error_and_close_to_it(scheme, kappa):
    case = flow(4, so.Sine(1.0, 4.0), kappa=kappa)
    sol = run(case, 8, t_end=1.0, scheme=scheme)
    fine = run(case, 64, t_end=1.0, scheme="sdirk2")
    close_bound(sol, fine.t, fine.u, 1.5, 0.99)


def test_states_are_viable_and_energies_balance():
    case = flow(6, so.Polynomial([0.0, 1.0]), kappa=1.0)
    sol = run(case, 8, t_end=2.0)
    assert sol.viability().max() < 1e-5
    assert np.isfinite(sol.viability([0.5, 2.0])).all()
    energy = sol.energy()
    spent = energy.stored + energy.viscous + energy.friction
    assert np.abs(spent - energy.work).max() <= 0.05 * np.abs(energy.work).max()
