"""What MATH.md says of the flow u' = Phi(t, u), on random processes and sets."""

import warnings

import numpy as np
import pytest
from cases import isotropic, slow

import sweepopt as so
from sweepopt.linalg import Factor
from tests.laws import ZOO, of_each_kind


def in_turn(turn):
    """The names of sets: one of each kind here, all with -m slow; constraints prove nothing."""
    return [
        name if name in of_each_kind(turn) else slow(name) for name in ZOO if name != "constraints"
    ]


def matrices(rng, n):
    """A positive definite, B semidefinite."""
    A, B = (root @ root.T for root in rng.normal(size=(2, n, n)))
    return A + 0.2 * np.eye(n), B


@pytest.mark.parametrize("name", in_turn(1))
def test_the_velocity_is_lipschitz_and_cocoercive_in_the_state(name):
    rng, C = np.random.default_rng(1), ZOO[name].sample(3).C
    A, B = matrices(rng, C.dim)
    phi = so.velocity_field(so.SweepingProcess(A, B, C, np.zeros(C.dim)), tol=1e-4)
    norm, dual = Factor(A).norm, Factor(A).dual_norm
    Lam = max(np.linalg.eigvals(np.linalg.solve(A, B)).real)
    for _ in range(3):
        u, v = 3 * rng.normal(size=(2, C.dim))
        y, z = phi(0.0, u), phi(0.0, v)
        force, change = B @ (u - v), y - z
        slack = 2e-4 * (dual(B @ u) + dual(B @ v) + norm(y) + norm(z))
        assert norm(change) <= dual(force) + slack
        assert dual(force) <= Lam**0.5 * np.sqrt((u - v) @ force) * (1 + 1e-9)
        assert dual(force) <= Lam * norm(u - v) * (1 + 1e-9)
        assert force @ change <= -(norm(change) ** 2) + slack * (norm(change) + dual(force))


@pytest.mark.parametrize("name", in_turn(2))
def test_the_force_of_a_velocity_is_the_projection_in_the_dual_metric(name):
    rng, C = np.random.default_rng(2), ZOO[name].sample(4).C
    M, _ = matrices(rng, C.dim)
    q = 3 * rng.normal(size=C.dim)
    process = so.SweepingProcess(M, np.eye(C.dim), C, q)  # B u0 = q
    z = so.velocity_field(process)(0.0, q)
    w, inverse = M @ z + q, np.linalg.inv(M)
    size = 1 + np.abs(w).max() + np.abs(q).max()
    assert C.contains(w, 1e-5 * size)
    for _ in range(20):  # no point of C is nearer to q, and the inequality of the projection holds
        c = C.project(w + rng.normal(size=C.dim))
        assert (q - w) @ inverse @ (c - w) <= 1e-5 * size**2


@pytest.mark.parametrize("seed", range(3))
def test_two_solutions_stay_as_near_as_the_theory_says(seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 4))
    A, B = matrices(rng, n)
    center = so.Separable([(so.Sine(3.0, period=2.0), rng.normal(size=n))])
    C = so.Moving(so.Box(-rng.random(n), rng.random(n)), center)
    times, runs = np.linspace(0.0, 6.0, 61), []
    for u0 in rng.normal(size=(2, n)):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", so.InitialStateWarning)
            runs.append(so.solve(so.SweepingProcess(A, B, C, u0), steps=times, scheme="exact").u)
    e = runs[0] - runs[1]
    in_B = np.sqrt(np.einsum("ti,ij,tj->t", e, B, e))
    assert (np.diff(in_B) <= 1e-12 * in_B[0]).all()
    eigenvalues = np.sort(np.linalg.eigvals(np.linalg.solve(A, B)).real)
    lam, Lam = max(eigenvalues[0], 0.0), eigenvalues[-1]
    nu = (Lam - lam) ** 2 / (8 * (Lam + lam))
    K = np.minimum(np.exp(nu * times), 1 + np.sqrt(Lam * times / 2))
    K = np.minimum(K, np.sqrt(Lam / max(lam, 1e-12)))
    in_A = np.sqrt(np.einsum("ti,ij,tj->t", e, A, e))
    assert (in_A <= K * in_A[0] * (1 + 1e-9)).all()


def test_implicit_euler_without_viscosity_is_moreaus_catching_up():
    """With A = 0 and B = I each step is u_{i+1} = P_{C(t_{i+1})}(u_i)."""
    C = so.Moving(so.Ball([0.0, 0.0], 0.5), lambda t: [np.sin(3 * t), t])
    process = isotropic(C, 0.0, 1.0)
    sol = so.solve(process, t_end=2.0, steps=40, scheme="implicit-euler")
    u = np.zeros(2)
    for t, computed in zip(sol.t[1:], sol.u[1:], strict=True):
        u = C.at(t).project(u)
        assert computed == pytest.approx(u, abs=1e-9)


def test_the_run_of_the_readme_solves_the_papers_program_with_clarabel_and_nothing_else():
    rng, n = np.random.default_rng(5), 6
    A, B = matrices(rng, n)
    few = np.eye(n)[:, [0, 3]]
    C = so.Moving(so.image(few, so.Ball([0.0, 0.0], 0.3)), lambda t: t * np.ones(n))
    process = so.SweepingProcess(A, B, C, np.zeros(n))
    settings = {"scheme": "catching-up", "path": "full", "solver": "clarabel"}
    sol = so.solve(process, t_end=0.1, steps=10, **settings)
    assert (sol.plan.path, sol.plan.scheme.name) == ("full", "catching-up")
    assert set(sol.stats["solver"]) <= {"clarabel", "at rest"}
    assert "clarabel" in sol.stats["solver"]
    for i in (3, 9):
        program = sol.step_program(i)
        assert (program.M == A).all()
        assert program.Bu == pytest.approx(B @ sol.u[i], rel=1e-14)
        assert program.problem.param_dict["f"].value == pytest.approx(np.full(n, sol.t[i + 1]))
