"""Time-stepping schemes as data: a scheme is a lower triangular tableau.

Stage k of a step from (t_i, u_i) with mu solves the velocity program

    M = A + mu a_kk B,    q = B (u_i + mu sum_{l<k} a_kl z_l),    C(t_i + c_k mu),

and u_{i+1} = u_i + mu sum_k b_k z_k. MATH.md section 3 has the orders and the proofs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

from sweepopt.errors import InputError, shown


@dataclass(frozen=True)
class Scheme:
    """A tableau.

    Attributes
    ----------
    name : str
    a : tuple of tuples
        Row k has k + 1 entries; its last one is the implicit weight of the stage.
    b, c : tuples
        Weights of the stages and their times in units of mu.
    order : float
        For translated sets with smooth loads; infinite if the scheme has no error in time.
    overshoots : float
        mu Lam from which a step can overshoot into a wrong stuck state although it is stable: where
        the stability function turns negative. Never for implicit-euler.
    """

    name: str
    a: tuple[tuple[float, ...], ...]
    b: tuple[float, ...]
    c: tuple[float, ...]
    order: float
    overshoots: float = math.inf

    def amplification(self, z: Any) -> Any:
        """The stability function R(z) = 1 + z b^T (I - z a)^{-1} 1 of the scheme."""
        slopes: list[Any] = []
        for row in self.a:
            known = 1 + sum(weight * slope for weight, slope in zip(row, slopes, strict=False))
            slopes.append(z * known / (1 - z * row[-1]))
        return 1 + sum(weight * slope for weight, slope in zip(self.b, slopes, strict=True))

    @property
    def implicit(self) -> bool:
        """Whether every stage is implicit in u, so that A = 0 is allowed."""
        return all(row[-1] > 0 for row in self.a)

    @property
    def exact(self) -> bool:
        """Whether closed forms take the place of steps; the tableau is then the inclusion's."""
        return math.isinf(self.order)

    @property
    def explicit(self) -> bool:
        """Whether no stage is implicit in u, so that the step size is limited."""
        return not any(row[-1] > 0 for row in self.a)

    @property
    def without_overshoot_warning(self) -> Scheme:
        """The same scheme, whose steps are not checked for overshooting."""
        return replace(self, overshoots=math.inf)


GAMMA = 1 - math.sqrt(0.5)  # Alexander's

SCHEMES = {
    scheme.name: scheme
    for scheme in (
        # the paper's scheme, with C(t_{i+1}) for its truncation C_n(t_{i+1})
        Scheme("catching-up", a=((0.0,),), b=(1.0,), c=(1.0,), order=1),
        # at A = 0 this is Moreau's catching-up algorithm
        Scheme("implicit-euler", a=((1.0,),), b=(1.0,), c=(1.0,), order=1),
        Scheme("midpoint", a=((0.5,),), b=(1.0,), c=(0.5,), order=2, overshoots=2.0),
        Scheme(
            "trapezoid", a=((0.0,), (0.5, 0.5)), b=(0.5, 0.5), c=(0.0, 1.0), order=2, overshoots=2.0
        ),
        Scheme(
            "sdirk2",
            a=((GAMMA,), (1 - GAMMA, GAMMA)),
            b=(1 - GAMMA, GAMMA),
            c=(GAMMA, 1.0),
            order=2,
            overshoots=1 + math.sqrt(2),
        ),
        Scheme("exact", a=((1.0,),), b=(1.0,), c=(1.0,), order=math.inf),
    )
}


def choose(name: str, rate_independent: bool) -> Scheme:
    """The scheme of that name; "auto" is midpoint, or implicit-euler when A = 0."""
    known = {"auto": SCHEMES["implicit-euler" if rate_independent else "midpoint"], **SCHEMES}
    if not isinstance(name, str) or name not in known:
        raise InputError(f"scheme {shown(name)} is not known; use {', '.join(known)}")
    scheme = known[name]
    if rate_independent and not scheme.implicit:
        raise InputError(
            f"scheme {scheme.name!r} needs A coercive; with A = 0 use implicit-euler, sdirk2 or "
            "exact"
        )
    return scheme
