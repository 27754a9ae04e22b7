"""The velocity as a function of time and state, for anyone's ODE solver, and as a cvxpy program.

u' = Phi(t, u) = A^-1 (P_{C(t)}(B u) - B u), P the projection in the A^-1 metric (MATH.md section
3): the minimiser of the velocity program with M = A, q = B u. Phi is Lipschitz in u, with constant
Lam, and as smooth in t as C(t); its slope jumps at switching times, where ODE solvers reject steps.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from sweepopt.checks import (
    Array,
    count,
    instant,
    meaning,
    number,
    tolerance,
    vector,
    with_checks,
)
from sweepopt.errors import InputError, VelocityError, shown
from sweepopt.integrate.schemes import SCHEMES, Scheme, choose
from sweepopt.integrate.step import Velocities, combination
from sweepopt.problem import EvolutionVI, SweepingProcess, sweeping
from sweepopt.sets import ConvexSet, image
from sweepopt.velocity import StateVelocity, StepProgram, compile_velocity, make_plan

Field = Callable[[float, Any], Array]
FIRST_STAGE = SCHEMES["trapezoid"]  # its first stage is this velocity


def velocity_field(
    process: SweepingProcess | EvolutionVI, *, solver: Any = "auto", tol: float = 1e-6
) -> Field:
    """Phi(t, u), the certified velocity of a state u at a time t.

    Parameters
    ----------
    process : SweepingProcess or EvolutionVI
        With A coercive.
    solver : str or Solver
        As in `solve`.
    tol : float
        The certificate of each call is at most tol * max(|z|_A, |A^-1 q|_A), q = B u - (C's
        translation).

    Returns
    -------
    callable (t, u) -> ndarray, shape (dim,)
        Compiled once; not to be shared by threads. It raises InputError for a t or u that is not
        finite or has the wrong shape, VelocityError where the certificate is above tol.

    Raises
    ------
    InputError
        If A is singular, or C has no certificates.
    SolverRefusedError
        If the solver is not known or cannot treat C.

    Notes
    -----
    In a body at rest all derivatives are zero, and a solver that chooses its steps by them may pass
    a whole slip phase without a look: give it a `max_step` of a fraction of the load's period.

    Examples
    --------
    >>> import sweepopt as so
    >>> from scipy.integrate import solve_ivp
    >>> C = so.Moving(so.Box(-1, 1), so.Separable([(so.Polynomial([0.0, 1.5]), 1.0)]))
    >>> process = so.SweepingProcess(A=0.5, B=2.0, C=C, u0=0.0)
    >>> velocity = so.velocity_field(process)
    >>> velocity(0.5, [0.0]), velocity(1.0, [0.0])
    (array([0.]), array([1.]))
    >>> run = solve_ivp(velocity, (0.0, 5.0), process.u0, method="LSODA", rtol=1e-10, atol=1e-12)
    >>> run.y[:, -1].round(8)
    array([3.06250001])
    """
    process = sweeping(process)
    tol = tolerance(tol)
    if not process.coercive:
        raise InputError(
            "velocity_field needs A coercive: where it is singular the velocity is no function of "
            "(t, u); use so.solve with implicit-euler, sdirk2 or exact"
        )

    def compiled(t: float, C: ConvexSet) -> StateVelocity:
        if not C.certifiable:
            raise InputError(
                f"velocity_field needs a set with certificates, which {type(C).__name__} has not; "
                "state C with other shapes, such as a Box or the image of a small set"
            )
        plan = make_plan(process, process.check(np.array([t])), FIRST_STAGE, solver, tol)
        return compile_velocity(process, plan, 0.0)

    try:
        start = process.C.at(0.0)
    except InputError:
        solve = None  # C is not known at t = 0: the first call compiles
    else:
        solve = compiled(0.0, start)

    @with_checks
    def velocity(t: float, u: Any) -> Array:
        nonlocal solve
        t, u = number("t", t), vector("u", u, process.dim)
        C = process.set_at(t, u)
        if solve is None:
            solve = compiled(t, C)
        z, _, relative, *_ = solve(u, C)
        if not relative <= tol:
            raise VelocityError(
                f"the velocity at t = {t:g} is known to {relative:.2g} of its size only, tol is "
                f"{tol:g}; loosen tol or try another solver",
                t=t,
                u=u,
                certificate=relative,
            )
        return z

    return velocity


def compatible_start(process: SweepingProcess | EvolutionVI, t: float = 0.0) -> Array:
    """The state to which u0 jumps at t where A is singular: A z + B u is in C(t) for some z.

    It is u0 + v for the v in the kernel of A with <B (u0 + v), y - v> + J(y) - J(v) >= 0 for all y
    there, the limit of a step of implicit Euler whose length goes to 0 (MATH.md section 3).

    Parameters
    ----------
    process : SweepingProcess or EvolutionVI
    t : float

    Returns
    -------
    ndarray, shape (dim,)
        u0 itself where A is coercive or u0 is compatible.

    Raises
    ------
    InputError
        If t is not finite, or too many unknowns are coupled to see the kernel of A.
    VelocityError
        If the jump cannot be computed.

    Examples
    --------
    A spring beside a dashpot that holds nothing: the force 3 is above its bound 1.

    >>> import sweepopt as so
    >>> A, B = [[1.0, 0.0], [0.0, 0.0]], [[1.0, 0.0], [0.0, 2.0]]
    >>> process = so.SweepingProcess(A, B, so.Box([2, 2], [4, 4]), u0=[0.0, 0.0])
    >>> so.compatible_start(process)
    array([0., 1.])
    """
    process, t = sweeping(process), instant("t", t)
    process.refuse_state("compatible_start")
    K, u0 = process.kernel, process.u0
    if not K.shape[1]:
        return u0.copy()
    assert process.B is not None
    # all that the kernel sees: -v in N(B v + B u0 - C), as a velocity with B for A
    C = image(K.T, process.C.at(t)) - K.T @ process.times_B(u0)
    jump = SweepingProcess(K.T @ (process.B @ K), None, C, np.zeros(K.shape[1]))
    return np.asarray(u0 + K @ velocity_field(jump, tol=1e-9)(t, jump.u0))


# ---- as a program of cvxpy ----------------------------------------------------------------------


@meaning(dt="; give mu, the length of the step", h="; give mu, the length of the step")
def step_program(
    process: SweepingProcess | EvolutionVI,
    t: float,
    u: Any,
    mu: float,
    *,
    scheme: str = "catching-up",
    stage: int = 0,
) -> StepProgram:
    """The program of one step from (t, u) in cvxpy: min 1/2 <M z, z> + <B u, z> + J(z) - <f, z>.

    Parameters
    ----------
    process : SweepingProcess or EvolutionVI
    t : float
        Start of the step.
    u : array_like, shape (dim,)
        The state there.
    mu : float
        The step.
    scheme : str
        As in `solve`; with "catching-up", the paper's scheme, M is A and f that of t + mu. "auto"
        has its three stages; `Solution.step_program` knows steps that implicit Euler took.
    stage : int
        Of a scheme with several, counted from 0. The library solves the stages before it, as B u
        is taken at the state to which they lead.

    Returns
    -------
    StepProgram

    Raises
    ------
    InputError
        If a number is not finite, mu is not positive, or the scheme has no such program.

    Examples
    --------
    >>> import sweepopt as so
    >>> C = so.Moving(so.Box(-1, 1), center=lambda t: 1.5 * t)
    >>> process = so.SweepingProcess(A=0.5, B=2.0, C=C, u0=0.0)
    >>> program = so.step_program(process, t=0.9, u=[0.0], mu=0.1)
    >>> print(program)
    minimize 0.5 ... QuadForm(z, psd_wrap(M)) + Bu @ z + g @ abs(z) + -...f @ z...
    >>> value = program.problem.solve(solver="CLARABEL")
    >>> program.z.value.round(6), program.certify(program.z.value).certificate < 1e-6
    (array([1.]), True)
    """
    process = sweeping(process)
    tableau = choose(scheme, process.coercive)
    return program_of_stage(process, t, u, mu, tableau, stage)


def program_of_stage(
    process: SweepingProcess, t: float, u: Any, mu: float, tableau: Scheme, stage: int
) -> StepProgram:
    """The same for a tableau, which need not be that of a scheme with a name."""
    t, mu = instant("t", t), number("mu", mu, minimum=0.0, strict=True)
    u = vector("u", u, process.dim)
    if tableau.exact or count("stage", stage, least=0) >= len(tableau.b):
        raise InputError(
            f"scheme {tableau.name!r} has no program of stage {shown(stage)}: exact solves none, "
            "other schemes count their stages from 0"
        )
    *weights, implicit = tableau.a[stage]
    contraction = process.contraction(mu * implicit)
    own, solved = u, stage + bool(contraction)  # the state of a set that depends on it
    if solved:
        members = process.check(t + mu * np.unique(tableau.c[:solved]))
        plan = make_plan(process, members, tableau, "auto", 1e-9)  # as good as `solve` mostly is
        plan = replace(plan, reduction=None, contraction=contraction)
        first = replace(tableau, a=tableau.a[:solved], c=tableau.c[:solved])
        stages = Velocities(process, plan).stages(first, t, mu, u)
        own = u + mu * combination(tableau.a[solved - 1], stages)
        u = u + mu * combination(weights, stages[:stage]) if stage else u
        own = own if contraction else u
    C = process.set_at(t + tableau.c[stage] * mu, own)
    return StepProgram.of(process.matrix(mu * implicit), process.times_B(u), C)
