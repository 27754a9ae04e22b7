"""Time-stepping schemes as data: a scheme is a lower triangular tableau.

Stage k of a step from (t_i, u_i) with mu solves the velocity program

    M = A + mu a_kk B,    q = B (u_i + mu sum_{l<k} a_kl z_l),    C(t_i + c_k mu),

and u_{i+1} = u_i + mu sum_k b_k z_k. MATH.md section 3 has the orders and the proofs.

The last stage of a second-order scheme starts from an extrapolation, which may have carried a
body past the place where it should rest: friction then holds it there. Where step * Lam > 2, a
scheme with `euler_steps` takes such a step by implicit Euler instead, which never goes too far.

A scheme by name is its tableau on the given grid. "auto" meets the breakpoints of loads that are
data, too: a step that contains some is taken in parts that end there, unless they are too many for
the grid (`grid.meeting_breakpoints`). Else a turn of the load inside a step costs O(mu) where A is
0, and where it falls decides which scheme is best: of 300 tables on step * Lam from 1e-2 to inf 8
errors were above twice the best of implicit-euler, midpoint and sdirk2, the worst 5.2 times; now
none, 1.6 times. Schemes by name do not, so that a comparison shows the tableaux; but with
the same limit all meet the jumps of a velocity that is prescribed, as a step would take the one at
its end for all of its way.
"""

import math
from dataclasses import dataclass, replace
from typing import Any

from sweepopt.checks import HUGE
from sweepopt.errors import InputError, shown, suggestion
from sweepopt.problem import SweepingProcess


@dataclass(frozen=True)
class Scheme:
    """A tableau.

    Attributes
    ----------
    name : str
    a : tuple of tuples
        Row k has k + 1 entries; its last one is the implicit weight of the stage.
    b, c : tuples
        Weights of the stages and their times in units of the step.
    order : float
        For translated sets with smooth loads; infinite if the scheme has no error in time.
    euler_steps : int
        Into how many steps of implicit Euler a stiff step is divided in which bodies that rest or
        turn back in the last stage moved more than implicit Euler is late to follow the others; 0
        for none. Their matrix is that of the stages.
    reason : str
        Why "auto" is this scheme.
    """

    name: str
    a: tuple[tuple[float, ...], ...]
    b: tuple[float, ...]
    c: tuple[float, ...]
    order: float
    euler_steps: int = 0
    reason: str = ""

    def amplification(self, z: Any) -> Any:
        """The stability function R(z) = 1 + z b^T (I - z a)^{-1} 1 of the scheme."""
        slopes: list[Any] = []
        for row in self.a:
            known = 1 + sum(weight * slope for weight, slope in zip(row, slopes, strict=False))
            slopes.append(z * known / (1 - z * row[-1]))
        return 1 + sum(weight * slope for weight, slope in zip(self.b, slopes, strict=True))

    @property
    def times(self) -> tuple[float, ...]:
        """When C(t) may be asked for: those of the stages, and of steps of implicit Euler."""
        return (*self.c, *((k + 1) / self.euler_steps for k in range(self.euler_steps)))

    @property
    def implicit(self) -> bool:
        """Whether every stage is implicit in u, so that a singular A is allowed."""
        return all(row[-1] > 0 for row in self.a)

    @property
    def exact(self) -> bool:
        """Whether closed forms take the place of steps; the tableau is then the inclusion's."""
        return math.isinf(self.order)

    @property
    def explicit(self) -> bool:
        """Whether no stage is implicit in u, so that the step size is limited."""
        return not any(row[-1] > 0 for row in self.a)


def stiffly_accurate(
    name: str, *a: tuple[float, ...], order: float, euler_steps: int = 0
) -> Scheme:
    """The step ends with its last stage: b is the last row, c has the sums of the rows."""
    return Scheme(name, a, a[-1], tuple(map(math.fsum, a)), order, euler_steps)


GAMMA = 1 - math.sqrt(0.5)  # Alexander's

SCHEMES = {
    scheme.name: scheme
    for scheme in (
        # the paper's scheme, with C(t_{i+1}) for its truncation C_n(t_{i+1})
        Scheme("catching-up", a=((0.0,),), b=(1.0,), c=(1.0,), order=1),
        # at A = 0 this is Moreau's catching-up algorithm
        stiffly_accurate("implicit-euler", (1.0,), order=1),
        Scheme("midpoint", a=((0.5,),), b=(1.0,), c=(0.5,), order=2),
        stiffly_accurate("trapezoid", (0.0,), (0.5, 0.5), order=2),
        stiffly_accurate("sdirk2", (GAMMA,), (1 - GAMMA, GAMMA), order=2),
        # L-stable; a diagonal of 1/5 makes its first stage a step of implicit Euler. Order 2 leaves
        # c_2 free: with 0.6 to 0.7 its largest error over that of the best of implicit-euler,
        # midpoint and sdirk2 is about as small (200 sines, step * Lam from 0.1 to inf)
        stiffly_accurate(
            "sdirk32",
            (1 / 5,),
            (9 / 20, 1 / 5),
            (22 / 45, 14 / 45, 1 / 5),
            order=2,
            euler_steps=5,
        ),
        stiffly_accurate("exact", (1.0,), order=math.inf),
    )
}


# sdirk2 takes 0.7 of the time where step * Lam <= 2, but of 636 rows at 1e-2 it was above twice the
# best of implicit-euler, midpoint and sdirk2 in 19, sdirk32 in 3
AUTOMATIC = replace(SCHEMES["sdirk32"], reason="second order and L-stable, for any step * Lam")
ADAPTING = SCHEMES["sdirk2"]
"""For steps that adapt to their errors: its last stage is at the end of the step, where data turn.
Midpoint has none there, and misses a slip that begins after the last midpoint before a
breakpoint."""


def implicit_euler(steps: int) -> Scheme:
    """So many equal steps of implicit Euler as one step."""
    rows = tuple((1 / steps,) * (k + 1) for k in range(steps))
    times = tuple((k + 1) / steps for k in range(steps))
    return Scheme("implicit-euler", a=rows, b=rows[-1], c=times, order=1)


def rings(process: SweepingProcess, scheme: Scheme, mu: float, least: float) -> bool:
    """Whether errors come back with the other sign and more than this share of their size."""
    # of implicit Euler R = 1 / (1 + step * Lam) > 0, whatever Lam is: to prove it takes factors
    if scheme.order == 1 and not scheme.explicit:
        return False
    return scheme.amplification(-min(mu * process.Lam, HUGE)) < -least


def choose(name: str, coercive: bool, automatic: Scheme = AUTOMATIC) -> Scheme:
    """The scheme of that name; "auto" is the automatic one."""
    known = {"auto": automatic, **SCHEMES}
    if not isinstance(name, str) or name not in known:
        names, hint = ", ".join(known), suggestion(name, known)
        raise InputError(f"scheme {shown(name)} is not known; use {names}{hint}")
    scheme = known[name]
    if not coercive and not scheme.implicit:
        raise InputError(
            f"scheme {scheme.name!r} needs A coercive; with A = 0 or singular use implicit-euler, "
            "sdirk2 or auto"
        )
    return scheme
