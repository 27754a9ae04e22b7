"""How errors of a step arise in u' = Phi(t, u), and how they decay.

A step of order r misses h^(r+1) (p u^(r+1) + (q - p) J u^(r)) to leading order, J the derivative of
Phi by u; p and q follow from the tableau. J is not known; along the velocity z it is
-<Bz, z> / <Az, z> where unknowns move and nothing where they stick (an unknown that sticks has the
velocity 0 exactly).
"""

from __future__ import annotations

import math

import numpy as np

from sweepopt.integrate.schemes import Scheme
from sweepopt.problem import SweepingProcess, squares

# at A = 0: what turns misses more than what goes on to move, which its last stage corrects
TURNS, STARTS = 1.5, 0.5


class Flow:
    """How a scheme's errors in a process arise and decay.

    Attributes
    ----------
    order : int
    mean, chain : float
        p and q - p.
    spread : float
        Standard deviation of the error over the place of a kink; its mean is p.
    locates : bool
        Whether the place of a kink says what it does.
    """

    def __init__(self, process: SweepingProcess, scheme: Scheme) -> None:
        # at A = 0 a scheme that does not end with its last stage is of order 1
        stiff = scheme.a[-1] == scheme.b
        self.order = int(scheme.order) if stiff or not process.rate_independent else 1
        self.continuous = not process.rate_independent  # the velocity, where the load has a kink
        self._process = process
        metric = process.metric
        self._scales = np.sqrt(metric.diagonal) if metric.is_diagonal else None
        n = len(scheme.b)
        self._rows, self._weights = scheme.a, scheme.b
        self._a = np.array([[*row, *[0.0] * (n - len(row))] for row in scheme.a])
        self._b, c = np.array(scheme.b), np.array(scheme.c)
        self._c = c
        kernel = self.kink((np.arange(1000) + 0.5) / 1000)
        self.mean, self.spread = float(kernel.mean()), float(kernel.std())
        delays = self._a @ c if self.order == 2 else self._a.sum(axis=1)
        self.chain = float(self._b @ delays) - 1 / (self.order * (self.order + 1)) - self.mean
        turns = np.zeros(1)
        if process.rate_independent:
            turns = self.turned((np.arange(100) + 0.5) / 100)
        self.turn, self.turn_spread = float(turns.mean()), TURNS * float(turns.std())
        # at A = 0 what moves along flat faces is where it should be after each step, unless it
        # depends on others that are not
        apart = self.continuous or (metric.is_diagonal and process.C.at(0.0).polyhedral)
        self.locates = self.order == 2 and apart
        if process.rate_independent:
            self.spread *= STARTS

    def kink(self, s: np.ndarray) -> np.ndarray:
        """What a step misses where the velocity has a kink after a share s of it.

        In h^2 times the jump of the slope, of the velocity itself at order 1: the Peano kernel of
        the scheme's quadrature.
        """
        late = np.maximum(self._c[:, None] - s, 0.0) ** (self.order - 1) * (self._c[:, None] > s)
        kernel: np.ndarray = self._b @ late - (1 - s) ** self.order / self.order
        return kernel

    def turned(self, s: np.ndarray) -> np.ndarray:
        """How far u goes too far at A = 0 where it stops after a share s, in h^2 times the jump."""
        z = np.zeros((len(self._c), len(s)))
        for k, c in enumerate(self._c):
            free = s * c - 0.5 * c**2 - self._a[k, :k] @ z[:k]
            z[k] = np.maximum(free / self._a[k, k], 0.0)
        far: np.ndarray = self._b @ z - 0.5 * s**2
        return far

    def beyond(self, s: np.ndarray) -> np.ndarray:
        """What a kink after a share s of a step does, in h^2 times the jump of the slope."""
        return self.kink(s) if self.continuous else self.turned(s)

    def norms(self, rows: np.ndarray) -> np.ndarray:
        """|u|_A of each row, |u|_B where A = 0."""
        return np.sqrt(np.maximum(squares(self._process.metric.M, rows), 0.0))

    def parts(self, rows: np.ndarray) -> np.ndarray:
        """|u| of what the norm takes together: of each unknown, or of all of them.

        A body's unknowns have their kinks together: told one by one, they would fit badly to each
        other, and |.|_A sees what neighbours differ by.
        """
        if self._scales is None:
            return self.norms(rows)[:, None]
        return self._scales * np.abs(rows)

    def dual(self, u: np.ndarray) -> np.ndarray:
        """The gradient of |u|^2 / 2."""
        return self._process.metric.M @ u

    def rates(self, z: np.ndarray, sizes: np.ndarray) -> np.ndarray:
        """How fast errors along the velocities decay, whose norms are `sizes`."""
        moving = sizes > 0
        if self._process.rate_independent:
            return np.where(moving, math.inf, 0.0)
        if self._process.B is None:
            return np.zeros(len(z))
        directions = z / np.where(moving, sizes, 1.0)[:, None]
        return squares(self._process.B, directions)

    def unheld(self, t: float, u: np.ndarray, z: np.ndarray) -> float:
        """About the velocity that unknowns have at time t which rested in the step before."""
        A = self._process.A
        force = A @ z + self._process.times_B(u)
        diagonal = A.diagonal()
        missed = force - self._process.C.at(t).nearest(force, diagonal)
        missed[z != 0] = 0.0
        return math.sqrt(missed @ (missed / diagonal))

    def missed(
        self, h: np.ndarray, x: np.ndarray, own: np.ndarray, lower: np.ndarray, high: np.ndarray
    ) -> np.ndarray:
        """What steps h miss where the velocity is continuous.

        Parameters
        ----------
        h, x, own : ndarray, shape (k,)
            Steps, steps times rates, what of a step is left of what it misses.
        lower, high : ndarray, shape (k, dim)
            The (r-1)-th and the r-th derivative of the velocity.
        """
        chain = (self.chain * x)[:, None] * lower
        return (own * h**self.order)[:, None] * ((h * self.mean)[:, None] * high - chain)

    def missed_without_A(self, h: np.ndarray, stops: np.ndarray, high: np.ndarray) -> np.ndarray:
        """What steps h miss at A = 0, where entries of u stop after them or go on to move."""
        mean = np.where(stops, self.turn if self.order == 2 else self.mean, self.mean)
        return (h ** (self.order + 1))[:, None] * mean * high

    def scatter(self, stops: np.ndarray) -> np.ndarray | float:
        """Standard deviations of what steps miss over the place of a kink, in h^(r+1) times it."""
        if self.continuous or self.order == 1:
            return self.spread
        return np.where(stops, self.turn_spread, self.spread)

    def decay(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What is left after steps of an error, and of what the steps themselves miss."""
        stages: list[np.ndarray] = []
        own = np.ones_like(x)
        for row in self._rows:
            known = sum(weight * stage for weight, stage in zip(row, stages, strict=False))
            own /= 1 + x * row[-1]
            stages.append((1 - x * known) / (1 + x * row[-1]))
        return 1 - x * sum(b * stage for b, stage in zip(self._weights, stages, strict=True)), own
