"""The programs that the stages of a step solve, for a user of cvxpy."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from sweepopt.checks import count, instant, number, vector
from sweepopt.errors import InputError, shown
from sweepopt.integrate.schemes import Scheme, choose
from sweepopt.integrate.step import Velocities, combination
from sweepopt.problem import EvolutionVI, SweepingProcess, sweeping
from sweepopt.velocity import StepProgram, make_plan, matrix

TOL = 1e-9  # of the stages before the one that is asked for: as good as `solve` mostly is


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
        As in `solve`; with "catching-up", the paper's scheme, M is A and f that of t + mu.
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
        plan = make_plan(process, members, tableau, "auto", TOL)
        plan = replace(plan, reduction=None, contraction=contraction)
        first = replace(tableau, a=tableau.a[:solved], c=tableau.c[:solved])
        stages = Velocities(process, plan).stages(first, t, mu, u)
        own = u + mu * combination(tableau.a[solved - 1], stages)
        u = u + mu * combination(weights, stages[:stage]) if stage else u
        own = own if contraction else u
    C = process.set_at(t + tableau.c[stage] * mu, own)
    return StepProgram.of(matrix(process, mu * implicit), process.times_B(u), C)
