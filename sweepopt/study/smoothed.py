"""The friction law smoothed, as it is given to ODE solvers: a u' + b u + g tanh(u'/eps) = f(t).

The law is implicit in u'. With s = f - b u the velocity is the root z of a z + g tanh(z/eps) = s,
and u' = z(f(t) - b u) is an ODE for any solver. As eps -> 0 its solution tends to that of the
sweeping process with C(t) = f(t) - [-g, g], from which it keeps a distance proportional to eps.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import numpy as np

from sweepopt.checks import number
from sweepopt.errors import InputError
from sweepopt.loads import Separable
from sweepopt.problem import SweepingProcess
from sweepopt.sets import Box, Moving

Method = Literal["Radau", "BDF", "LSODA"]
METHODS: tuple[Method, ...] = ("BDF", "Radau", "LSODA")
NEWTON, CLOSE = 50, 1e-14
MOST_STEPS = 100_000
"""Between two times."""


class Friction(NamedTuple):
    """A block on a dashpot a and a spring b, friction bound g, pulled by the load f.

    Attributes
    ----------
    a, b, g : float
    load : Separable
        f, of one entry.
    u0 : float
    """

    a: float
    b: float
    g: float
    load: Separable
    u0: float


class Smooth(NamedTuple):
    """u' and its derivative in u, as `solve_ivp` calls them."""

    velocity: Callable[[float, Any], list[float]]
    slope: Callable[[float, Any], list[list[float]]]


def friction_of(process: SweepingProcess) -> Friction:
    """The numbers of a process of one unknown with C(t) = f(t) - [-g, g].

    Raises
    ------
    InputError
        If the process is another one.

    Examples
    --------
    >>> from sweepopt.study.problems import problem
    >>> friction_of(problem("S03").process())[:3]
    (0.5, 2.0, 1.0)
    """
    C = process.C
    if not (
        process.dim == 1
        and isinstance(C, Moving)
        and isinstance(C.center, Separable)
        and C.scale is None
        and isinstance(C.shape, Box)
        and C.shape.upper[0] == -C.shape.lower[0] > 0.0
        and process.A[0, 0] > 0.0
    ):
        raise InputError(
            "process: a smoothed law is there for one unknown with a dashpot and "
            "C = Moving(Box([-g], [g]), Separable(...)), as in the problems S01, S02 and S03"
        )
    b = process.times_B(np.ones(1))[0]
    a, g, u0 = process.A[0, 0], C.shape.upper[0], process.u0[0]
    return Friction(float(a), float(b), float(g), C.center, float(u0))


def smooth(friction: Friction, eps: float) -> Smooth:
    """The smoothed law, solved for u'.

    Parameters
    ----------
    friction : Friction
    eps : float
        The velocity at which friction reaches 76 % of its bound.

    Examples
    --------
    >>> from sweepopt.study.problems import problem
    >>> law = smooth(friction_of(problem("S01").process()), 1e-3)
    >>> z = law.velocity(2.0, [0.4])[0]  # f = 3
    >>> abs(0.5 * z + 2.0 * 0.4 + math.tanh(z / 1e-3) - 3.0) < 1e-14
    True
    """
    eps = number("eps", eps, minimum=0.0, strict=True)
    a, b, g, load, _ = friction
    weights, histories = load.shapes[:, 0].tolist(), range(len(load.terms))
    steepest = a + g / eps

    def force(t: float, u: Any) -> float:
        pull = sum([weights[k] * load.value(k, t) for k in histories])
        return float(pull - b * u[0])

    def solved(s: float) -> tuple[float, float]:
        """|z| and the slope there: the law is concave in |z|, Newton climbs from below."""
        size = abs(s)
        z = max(size / steepest, (size - g) / a)
        for _ in range(NEWTON):
            friction_now = math.tanh(z / eps)
            slope = a + g / eps * (1.0 - friction_now * friction_now)
            change = (size - a * z - g * friction_now) / slope
            z += change
            if abs(change) <= CLOSE * (z + eps):
                break
        return z, slope

    def velocity(t: float, u: Any) -> list[float]:
        s = force(t, u)
        return [math.copysign(solved(s)[0], s)]

    def velocity_slope(t: float, u: Any) -> list[list[float]]:
        return [[-b / solved(force(t, u))[1]]]

    return Smooth(velocity, velocity_slope)


def solve_smoothed(
    friction: Friction,
    times: np.ndarray,
    *,
    eps: float,
    method: Method,
    rtol: float,
    max_step: float = math.inf,
) -> np.ndarray:
    """States of the smoothed law at some times, by SciPy's solver with the exact Jacobian.

    Parameters
    ----------
    friction : Friction
    times : ndarray, shape (n,)
        The first is where u0 holds.
    eps : float
    method : {"Radau", "BDF", "LSODA"}
    rtol : float
        atol is a tenth of it.
    max_step : float
        At rest all derivatives vanish; without a limit a solver may pass a slip phase unseen.

    Returns
    -------
    ndarray, shape (n, 1)

    Examples
    --------
    >>> import sweepopt as so
    >>> from sweepopt.study.problems import problem
    >>> process, times = problem("S01").process(), np.linspace(0.0, 5.0, 6)
    >>> u = solve_smoothed(friction_of(process), times, eps=1e-6, method="BDF", rtol=1e-8)
    >>> exact = so.solve(process, steps=times, scheme="exact").u
    >>> bool(abs(u - exact).max() < 1e-6)
    True
    """
    law = smooth(friction, eps)
    return integrate(
        law.velocity, np.array([friction.u0]), times, method, rtol, max_step, law.slope
    )


def integrate(
    velocity: Callable[[float, Any], Any],
    u0: np.ndarray,
    times: np.ndarray,
    method: Method,
    rtol: float,
    max_step: float,
    slope: Callable[[float, Any], Any] | None = None,
) -> np.ndarray:
    """u' = velocity(t, u) by SciPy, atol a tenth of rtol; nan where a solver did not come.

    LSODA by `odeint`, which calls back from compiled code only for velocities.
    """
    from scipy.integrate import odeint, solve_ivp

    tolerances = {"rtol": rtol, "atol": 0.1 * rtol}
    if method == "LSODA":
        limit = max_step if math.isfinite(max_step) else 0.0
        u, told = odeint(
            velocity, u0, times, Dfun=slope, tfirst=True, hmax=limit, mxstep=MOST_STEPS,
            full_output=True, **tolerances,
        )  # fmt: skip
        return np.asarray(u) if "successful" in told["message"] else np.full_like(u, np.nan)
    span = (times[0], times[-1])
    with np.errstate(divide="ignore"):  # Radau divides by its error, which is 0 at rest
        found = solve_ivp(
            velocity, span, u0, method=method, t_eval=times, jac=slope, max_step=max_step,
            **tolerances,
        )  # fmt: skip
    u = np.full((len(times), len(u0)), np.nan)
    u[: found.y.shape[1]] = found.y.T
    return u
