"""Curves in sets that move separately by smooth data, on intervals of a quarter of a period."""

import numpy as np
import pytest

import sweepopt as so
from sweepopt.results.interpolation import GAUSS, TO_BERNSTEIN
from sweepopt.results.separate import within_separate
from sweepopt.sets import basis

WAVE, ARC = so.Sine(0.6, 0.8), so.Polynomial([0.0, 1.5, -2.0, 0.0, 3.0, -2.0])
SCALE = so.Modulated(so.Sine(0.2, 0.9, offset=1.0), so.Polynomial([1.0, -0.2, 0.1]))
DISC = so.Moving(so.Ball([0.3, 0.0], 1.0), so.Separable([(WAVE, [1.0, 0.5])]), SCALE)
ELLIPSE = so.Moving(
    so.image([[1.4, 0.3], [0.0, 0.9]], so.Ball([0.0, 0.0], 1.0)), so.Separable([(ARC, [0.4, 1.0])])
)
H = so.Separable([(so.Constant(), [0.9, 0.8, 1.0]), (WAVE, [1.0, -0.4, 0.1])])
JUMPS = so.Table([0.0, 0.2, 0.4, 0.6], [0.0, 0.02, -0.01, 0.02]).rate()
JERKED = so.Moving(
    so.Ball([0.2, 0.1], 1.0), so.Separable([(JUMPS, [1.0, 2.0]), (WAVE, [0.5, 0.0])])
)
ROWS = so.Polyhedron([[1.0, 0.2], [-1.0, 0.5], [0.0, -1.0]], H)


@pytest.mark.parametrize(
    "C",
    [
        DISC & ELLIPSE,
        so.image([[1.0, 0.3], [0.2, -1.0]], DISC & ROWS),
        JERKED & ELLIPSE,
        JERKED & so.Moving(so.Box([-1.0, 0.0], [1.0, 0.0]), so.Separable([(JUMPS, [1.0, 2.0])])),
    ],
)
def test_curves_are_in_sets_that_move_separately_and_bounds_of_gaps_are_not_below_them(C):
    random = np.random.default_rng(3)
    times = np.linspace(0.0, 0.6, 4)
    directions = random.normal(size=(3, 1, 2)) + 0.3 * random.normal(size=(3, 3, 2))
    aim = 4 * basis(2, GAUSS) @ directions
    w, gaps = within_separate(C, times[:-1], times[1:], aim, directions, {})
    x, weights = (np.polynomial.legendre.leggauss(4) + np.array([[1], [0]])) / 2
    w, p = basis(3, x) @ TO_BERNSTEIN @ w, basis(2, x) @ directions
    outside, each = np.zeros(w.shape[:2]), np.zeros(w.shape[:2])
    for i, k in np.ndindex(outside.shape):
        S = C.at(times[i] + x[k] * (times[i + 1] - times[i]))
        outside[i, k] = np.linalg.norm(S.project(w[i, k]) - w[i, k])
        each[i, k] = S.support(p[i, k]) - p[i, k] @ w[i, k]
    assert outside.max() < 1e-9
    assert (gaps >= each @ weights).all()
    assert np.mean(gaps) < 3 * np.mean(each @ weights)


def test_a_row_that_never_binds_hides_nothing_of_the_others():
    """Its rounding is more than the others move."""
    t, directions, found = np.linspace(0.0, 0.9, 13), np.tile([1.0, 0.2], (12, 3, 1)), []
    disc = so.Moving(so.Ball([0.0, 0.0], 0.3), so.Separable([(so.Sine(0.1, 3.0), [1.0, 0.5])]))
    for far in (10.0, 1e13):
        h = [(so.Constant(), [0.9, 0.9, 0.9, far]), (so.Sine(1.5, 0.9), [1.0, -1.0, 0.5, 0.0])]
        C = so.Polyhedron([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [1.0, 1.0]], so.Separable(h)) + disc
        aim = np.tile([10.0, 2.0], (12, 4, 1))
        found.append(within_separate(C, t[:-1], t[1:], aim, directions, {}))
    (w, gaps), (others, theirs) = found
    assert np.abs(w - others).max() < 1e-9
    assert gaps == pytest.approx(theirs, rel=1e-6)


def test_few_long_steps_have_a_guaranteed_bound():
    """A set that is smaller by what a parabola misses on half of such a step is empty here."""
    thin = so.image([[0.8, 0.2], [0.0, 0.2]], so.Ball([0.0, 0.0], 1.0))
    disc, ellipse = (
        so.Moving(S, so.Separable([(so.Sine(size, 0.8), [1.0, 0.5])]))
        for S, size in ((so.Ball([0.3, 0.0], 1.0), 1.5), (thin, 2.0))
    )
    process = so.SweepingProcess(0.1 * np.eye(2), np.eye(2), disc & ellipse, [0.0, 0.0])
    how = {"t_end": 0.8, "scheme": "sdirk2"}
    sol, fine = (so.solve(process, steps=n, **how) for n in (3, 48))
    bound, error = sol.error_bound(), max(map(process.metric.norm, sol(fine.t) - fine.u))
    assert bound.guaranteed
    assert error < bound < 3 * error


class Wave:
    """A function of which only the variation is known."""

    def __call__(self, t):
        return 0.4 * np.sin(2 * np.pi * t)

    def variation(self, a, b):
        return 0.4 * 2 * np.pi * (b - a)


SMALL = so.Box([-0.1, -0.15], [0.1, 0.1])


@pytest.mark.parametrize(
    "C",
    [
        JERKED & so.Moving(SMALL, so.Separable([(WAVE, [0.5, 0.3])])),
        DISC & so.Moving(SMALL, so.Separable([(Wave(), [1.0, 0.3])])),
        so.product(
            DISC & ELLIPSE, so.Moving(so.HalfSpace(1.0, 0.0), so.Separable([(WAVE, [1.0])]))
        ),
    ],
    ids=["jumps", "variation", "unbounded"],
)
def test_parts_that_jump_or_are_unbounded_have_a_guaranteed_bound(C):
    B = np.eye(C.dim) + 0.3
    u0 = np.linalg.solve(2 * B, C.at(0.0).project(np.zeros(C.dim)))
    process = so.SweepingProcess(0.1 * B, 2 * B, C, u0)
    sol = so.solve(process, t_end=0.6, steps=3, scheme="sdirk2")
    fine = so.solve(process, steps=np.linspace(0.0, 0.6, 97), scheme="sdirk2")
    bound, error = sol.error_bound(), max(map(process.metric.norm, sol(fine.t) - fine.u))
    assert bound.guaranteed
    assert error < bound < 5 * error


def test_a_bound_finds_what_the_run_took_for_rest():
    """A push that comes and goes between the stages of a step."""
    pulse = so.Table([0, 0.5, 0.51, 0.52, 2], [0, 0, 2.6, 0, 0])
    terms = ((pulse, [1.0, 0.5]), (so.Sine(0.1, 3.0), [0.3, -1.0]))
    disc = so.Moving(so.Ball([0, 0], 1.0), so.Separable(terms))
    box = so.Box([-0.9, -0.9], [0.9, 0.95])
    more = so.Moving(box, so.Separable([*terms, (so.Sine(0.1, 3.0), [1.0, 0.0])]))
    process = so.SweepingProcess(1e-3 * np.eye(2), np.eye(2), disc & more, [0.0, 0.0])
    sol = so.solve(process, t_end=1.0, steps=19, scheme="sdirk2")
    assert not sol.velocity.any()
    fine = so.solve(process, steps=np.union1d(sol.t, np.linspace(0.5, 0.52, 65)), scheme="sdirk2")
    error = max(map(process.metric.norm, fine.u))
    assert error < sol.error_bound() < 1.5 * error
