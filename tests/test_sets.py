"""Every law over every set of the zoo; then exact numbers, hard cases and malformed input."""

import copy
import itertools
import math
import operator
import pickle
import re
from fractions import Fraction
from typing import Any, NamedTuple

import cvxpy as cp
import numpy as np
import pytest
import scipy.sparse as sp
from cases import SQUARE, isotropic, refuses, slow, worst_certificate
from scipy.optimize import nnls
from scipy.spatial import ConvexHull

import sweepopt as so
from sweepopt.sets import GAUSS, WEIGHTS, basis
from tests.laws import (
    LAWS,
    ZOO,
    cone_and_polar_split_every_vector,
    normal_and_projection_make_a_pair,
    normal_pair_is_proven_near_any_guess,
    of_each_kind,
)

UNIT = so.Ball([0.0, 0.0], 1.0)
EYE, INF, NAN = np.eye(2), np.inf, float("nan")


def obeys(law, name, times):
    first = [*ZOO].index(name)  # sets differ in their seeds
    for seed in range(first, first + times * LAWS[law]):
        law(ZOO[name], ZOO[name].sample(seed), np.random.default_rng(seed + 1))


@pytest.mark.parametrize("name", ZOO)
def test_every_set_obeys_two_laws_and_one_set_of_each_kind_in_turn_the_others(name):
    for turn, law in enumerate(LAWS):
        of_all = law in (cone_and_polar_split_every_vector, normal_and_projection_make_a_pair)
        if of_all or name in of_each_kind(turn):
            obeys(law, name, 1)


@pytest.mark.slow
@pytest.mark.parametrize("name", ZOO)
def test_every_set_obeys_every_law(name):
    for law in LAWS:
        obeys(law, name, 8)


# Here p left the domain of the support function by what v rounds, a point where p = 0 was away from
# itself by the accuracy of an interior point method, SciPy's nnls gave no minimiser, or the two
# sets of a sample were apart by rounding.
RARE = {
    "orthant + cone": (1, 2, 18),
    "ball + polar cone": (6, 181),
    "selected box + polyhedral cone": (94,),
    "polar of a polyhedral cone": (1833, 2320, 3882),
    "box & polyhedron, touching": (117,),
}


@pytest.mark.parametrize("name, seed", [(name, seed) for name in RARE for seed in RARE[name]])
def test_normal_pairs_that_one_set_in_thousands_asks_for_are_proved(name, seed):
    sample, random = ZOO[name].sample(seed), np.random.default_rng(seed + 1)
    normal_pair_is_proven_near_any_guess(ZOO[name], sample, random)


def test_a_projection_that_is_written_to_is_found_again():
    hull, v = so.Polytope(EYE), np.array([1.0, 3.0])
    hull.project(v)[:] = NAN
    np.testing.assert_array_equal(hull.project(v), [0.0, 1.0])


def test_rows_that_move_are_projected_on_anew():
    C, v = so.Polyhedron([[1.0, 1.0]], so.Separable([(so.Sine(2.0, 4.0), [1.0])])), 3 * np.ones(2)
    np.testing.assert_allclose(C.shape.project(v), [0.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(C.at(1.0).project(v), [1.0, 1.0])


def test_the_hull_of_numbers_is_an_interval():
    hull = so.Polytope([[2.0], [-1.0], [0.5]])
    assert [hull.project([x])[0] for x in (-3.0, 0.7, 5.0)] == [-1.0, 0.7, 2.0]


def test_another_matrix_is_another_cone():
    pairs = [
        (so.Polyhedron(EYE, [1, 1]), so.Polyhedron(2 * EYE, [1, 1])),
        (so.Ellipsoid([0, 0], EYE), so.Ellipsoid([0, 0], 2 * EYE)),
        (so.Polytope(EYE), so.Polytope(2 * EYE)),
        (so.image(EYE, UNIT), so.image(2 * EYE, UNIT)),
        (so.Box([0, 0], [1, 1]), so.Box([0, -INF], [1, 1])),
        (UNIT, so.Box([0, 0], [1, 1])),
        (UNIT + [0, 1], UNIT),
        (so.image([[1, 2], [0, 1], [3, 1]], UNIT), so.image([[1, 2], [0, 1], [3, 2]], UNIT)),
        (so.image([[1], [0]], so.Box(-1, 1)), so.image([[0], [1]], so.Box(-1, 1))),
        (so.SecondOrderCone(2), -so.SecondOrderCone(2)),
        (so.Balls([1, 1], 3), so.Balls([1, 1, 1], 2)),
        *itertools.pairwise(so.Constraints(2, lambda w, k=k: [cp.norm(w, k) <= 1]) for k in (1, 2)),
    ]
    for C, D in pairs:
        assert not C.same_cone(D)
        assert not D.same_cone(C)


# ---- projections, exactly -----------------------------------------------------------------------


@pytest.mark.parametrize("decades", [0, 2, 5, 8])
@pytest.mark.parametrize("distance", [1e-12, 1e-6, 1.0, 1e3, 1e9])
def test_projection_on_an_ellipsoid_is_exact_for_any_shape_and_distance(decades, distance):
    # from the point x of the boundary walk along the outer normal there
    rng = np.random.default_rng(3)
    axes = np.linalg.qr(rng.normal(size=(4, 4)))[0]
    squares = np.logspace(-decades, 0, 4)
    C = so.Ellipsoid(np.zeros(4), (axes * squares) @ axes.T)
    for _ in range(20):
        s = rng.normal(size=4)
        s /= np.linalg.norm(s)
        x, n = axes @ (np.sqrt(squares) * s), axes @ (s / np.sqrt(squares))
        n /= np.linalg.norm(n)
        # the shape itself is only known to rounding, relative to its smallest eigenvalue
        tol = 1e-14 * 10**decades + 4e-16 * distance
        assert np.abs(C.project(x + distance * n) - x).max() <= tol


@pytest.mark.parametrize("scale", [1e-9, 1e-3, 1.0, 1e9])
@pytest.mark.parametrize("seed", range(5))
def test_projection_on_a_polyhedron_meets_its_optimality_conditions_in_all_units(seed, scale):
    rng = np.random.default_rng(seed)
    m, n = int(rng.integers(3, 60)), int(rng.integers(2, 12))
    G = rng.normal(size=(m, n)) * 10.0 ** rng.uniform(-3, 3, size=(m, 1))
    x = rng.normal(size=n)
    h = G @ x + rng.exponential(size=m) * np.linalg.norm(G, axis=1)
    C = so.Polyhedron(G, h * scale)
    w = 20 * scale * rng.normal(size=n)
    P, p = C.project(w), C.normal(w)
    unit = np.abs(w).max() + scale
    lengths = np.linalg.norm(G, axis=1)
    slack = (h * scale - G @ P) / lengths
    assert slack.min() >= -1e-13 * unit
    active = slack <= 1e-11 * unit
    # p is a combination of the active rows with weights >= 0
    assert nnls(G[active].T / lengths[active], p / unit)[1] <= 1e-12


@pytest.mark.parametrize("angle", [1e-2, 1e-4, 1e-6, 1e-7])
def test_the_tip_of_a_thin_wedge_is_found(angle):
    # |w_2| <= angle w_1 - angle, seen from far on the wrong side: the tip is (1, 0)
    C = so.Polyhedron([[-angle, 1.0], [-angle, -1.0]], [-angle, -angle])
    P = C.project([-5.0, 0.3 * angle])
    np.testing.assert_allclose(P, [1.0, 0.0], atol=1e-15 / angle)
    C.require_nonempty()


def test_a_polyhedron_with_thousands_of_sparse_rows_is_projected_to_rounding():
    n = 300
    rng = np.random.default_rng(2)
    eye = sp.eye_array(n, format="csr")
    G = sp.vstack([eye, -eye, sp.random_array((4000, n), density=0.02, rng=rng)])
    C = so.Polyhedron(G, np.concatenate([np.ones(2 * n), np.full(4000, 30.0)]))
    w = 3 * rng.normal(size=n)
    np.testing.assert_allclose(C.project(w), np.clip(w, -1, 1), atol=1e-14)


@pytest.mark.parametrize("gap", [1e-3, 1e-9, 1e-11])
@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e9])
def test_an_empty_polyhedron_is_refused_however_small_the_gap(gap, scale):
    G = np.array([[1.0, 1.0], [-2.0, -2.0], [0.0, 1.0]])
    empty = so.Polyhedron(G, scale * np.array([1.0, -2.0 - 2 * gap, 5.0]))
    thin = so.Polyhedron(G, scale * np.array([1.0, -2.0 + 2 * gap, 5.0]))
    thin.require_nonempty()
    with pytest.raises(so.EmptySetError, match="C\\(t\\) at t = 3 is empty"):
        empty.require_nonempty("C(t) at t = 3")
    with pytest.raises(so.EmptySetError, match="no point"):
        empty.project(scale * np.array([5.0, 5.0]))
    with pytest.raises(so.EmptySetError, match="no point"):
        empty.support([1.0, 1.0])


@pytest.mark.parametrize("gap, parts", [(1e-9, 2), *(slow(gap, 4) for gap in (1e-3, 1e-8, 1e-9))])
def test_an_empty_intersection_is_refused_however_small_the_gap(gap, parts):
    tip = np.array([0.6, 0.8])
    pairs = [
        (UNIT, UNIT + (2 + gap) * tip),
        (so.Box([0, 0], [1, 1]) + [0, 0], so.Box([1 + gap, 0], [2, 1])),
        (UNIT, so.HalfSpace(-tip, -1 - gap)),
        (so.SecondOrderCone(2), UNIT - [np.sqrt(2) * (1 + gap), 0]),
    ]
    for C, D in pairs[:parts]:
        with pytest.raises(so.EmptySetError, match=r"is empty|no point"):
            (C & D).require_nonempty()


@pytest.mark.parametrize("gap", [-1e-12, 7.3e-12])
def test_an_intersection_is_called_empty_only_if_that_is_proved(gap):
    M = np.array([[-12.0, 24, -4], [-4, 11, -2], [-3, -11, 4]])
    g = np.array([4.0, 8, 13])
    width = np.linalg.norm(M.T @ g)
    C = so.image(M, so.Ball(np.zeros(3), 1.0)) & so.HalfSpace(g, -(1 + gap) * width)
    error, words = (so.EmptySetError, "empty") if gap > 0 else (so.TouchingError, "in rounding")
    with pytest.raises(error, match=words):
        C.require_nonempty()


def test_half_spaces_one_by_one_beside_a_ball_are_as_one_polyhedron():
    angles = np.linspace(0.1, 6.0, 60)
    G = np.column_stack([np.cos(angles), np.sin(angles)])
    C = so.Ball([0.2, 0.0], 1.0)
    for row in G:
        C = C & so.HalfSpace(row, 0.9)
    together = so.Ball([0.2, 0.0], 1.0) & so.Polyhedron(G, np.full(60, 0.9))
    for v in ([3.0, 1.0], [-2.0, 0.1], [1.3, -0.1]):
        np.testing.assert_allclose(C.project(v), together.project(v), rtol=0, atol=1e-13)


def test_a_polyhedron_around_0_is_not_empty_in_any_units():
    for seed in range(20):
        rng = np.random.default_rng(seed)
        units = 2.0 ** rng.integers(-40, 41, 5)
        C = so.Polyhedron(rng.normal(size=(10, 5)) / units, np.ones(10))
        assert np.isfinite(C.project(3 * units * rng.normal(size=5))).all()


def test_sets_that_meet_in_one_point_are_not_empty():
    small = so.Ball([0.1, 0.2], 0.3)
    for C in (
        UNIT & (UNIT + [2.0, 0.0]),
        small & (small + [0.6, 0.0]),
        UNIT & so.HalfSpace([-1.0, 0.0], -1.0),
    ):
        C.require_nonempty()
        # a rounding error in the data makes a lens with a height of its square root
        with refuses("touch"):
            C.project([3.0, 0.5])


@pytest.mark.parametrize("d", np.geomspace(1e-12, 1e-4, 7))
def test_pairs_of_sets_that_hardly_overlap_are_as_near_as_they_say(d):
    low = 1 - d
    C = so.Ball([0.0, 0.0], 1.0) & so.Box([low, -2.0], [3.0, 2.0])
    height = np.sqrt((1 - low) * (1 + low))  # 1 - low is exact
    for angle in (0.4, 0.9, 1.4, 2.2):
        v = 1.7 * np.array([np.cos(angle), np.sin(angle)])
        try:
            pair = C.normal_pair(v, np.zeros(2), np.ones(2))
        except so.InputError as error:
            assert d < 1e-10, error  # noqa: PT017
            continue
        off = np.abs(pair.w - [low, height])
        assert (off <= pair.perturbation.w + 1e-16).all()


@pytest.mark.parametrize("seed", [0, 20, 70, 82, 84, 98])
def test_far_from_0_pairs_of_sets_that_hardly_overlap_are_as_near_as_they_say(seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 7))
    center, g = 1e6 * rng.normal(size=n), rng.normal(size=n)
    g /= np.linalg.norm(g)
    low = float(g @ center) + 1 - 10 ** rng.uniform(-8.5, -7)
    C = so.Ball(center, 1.0) & so.HalfSpace(-g, -low)
    p = rng.normal(size=n)
    p += (0.8 * rng.choice([-1, 1]) - g @ p) * g
    # the point with this normal, by the depth of the data as they are rounded
    exact = [[Fraction(x) for x in xs.tolist()] for xs in (g, center)]
    depth = Fraction(low) - sum(a * b for a, b in zip(*exact, strict=True))
    square = sum(a * a for a in exact[0])
    along = p - (g @ p) / (g @ g) * g
    height = math.sqrt(1 - depth * depth / square) / np.linalg.norm(along)
    pair = C.normal_pair(p, center, np.ones(n))
    off = pair.w - center - (float(depth / square) * g + height * along)
    assert np.linalg.norm(off) <= np.linalg.norm(pair.perturbation.w) + np.spacing(1e6)


class Nearest(NamedTuple):
    """The point of C nearest to point + length p + beside, for any of the lengths."""

    C: so.ConvexSet
    point: Any
    p: Any
    lengths: tuple[float, ...]
    beside: Any = 0.0
    rounding: float = 0.0  # of the point; relative to the length beyond 1


CUT = so.Box([6.0, -3, -10], [8.0, -3, -6]) & (
    so.image(
        [[0.0, 1, -1, 0, 1, 0], [2, 0, -2, 0, -1, 0], [0, 1, -1, 2, 1, -1]],
        so.HalfSpace([6.0, 0, -6, -6, -3, 3], 6.0),
    )
    + [8.0, -4, -3]
)
MANY_PREIMAGES = so.Box([0, 3, 2], [1, 4, 3]) & (  # a way along them must not hide what it misses
    so.image(
        [[2.0, 2, 0, -2, -2], [1, 0, 1, 1, 0], [2, -1, 2, 0, 1]],
        so.HalfSpace([3.0, 6, -3, -9, -6], -21.0),
    )
    + [2.0, -1, -5]
)
# two vertices are on the face of p, and only what is beside p tells them apart
VERTICES = so.Polytope([[5.0, 7, 7], [4, 2, 8], [5, 3, 5], [4, 8, 8], [3, 3, 7], [4, 5, 5]])
THREE = so.Polytope([[0.0, 1.0], [4.0, 1.0], [2.0, -3.0]])
BALLS = so.Ball([1.0, 2.0, 0.0], 0.7) + so.Ball([0.0, -1.0, 1.0], 1.9)
NORMAL = np.array([2.0, -1.0, 2.0]) / 3
POWERS = (1.0, 2.0**12, 2.0**24, 2.0**36)
FAR = (1.0, 1e8, 1e30, 1e74)
AT_POINT = so.Orthant(2) & so.Point([1.0, 0.0])

NEAREST = {
    "a vertex alone": Nearest(so.Polytope([[0.0, 0, 1]]), [0.0, 0, 1], [0.0, 0, 1], FAR),
    "a corner": Nearest(THREE, [4.0, 1.0], [1.0, 1.0], (1.0, 1e10), (0.0, 3.0)),
    "an edge": Nearest(THREE, [1.0, 1.0], [0.0, 1.0], (0.0, 1.0, 2.0**30)),
    "a vertex": Nearest(VERTICES, [4.0, 5, 5], [0.0, 0, -5], POWERS, [-1.0, 2, 0]),
    "its neighbour": Nearest(VERTICES, [5.0, 3, 5], [0.0, 0, -5], POWERS, [1.0, -2, 0]),
    "between them": Nearest(VERTICES, [4.5, 4, 5], [0.0, 0, -5], POWERS),
    "balls": Nearest(
        BALLS, np.ones(3) + 2.6 * NORMAL, NORMAL, (0, 1e-9, 1e-5, 0.1, 10, 1e4), rounding=1e-8
    ),
    "the edge of a cap": Nearest(
        UNIT & so.HalfSpace([1.0, 0.0], 0.6), [0.6, 0.8], [1.6, 0.8], (0.5, 10, 1e4), rounding=2e-14
    ),
    "a cut": Nearest(CUT, [6.0, -3, -6], [3.0, 0, -2], (1.0, 1e3, 1e6), rounding=1e-13),
    "many preimages": Nearest(
        MANY_PREIMAGES, [0.0, 4, 2], [2.0, -1, -2], (512.0, 2.0**29), rounding=1e-14
    ),
    "a cut of parts at zero": Nearest(
        so.Box(-0.004, 0.0) & (so.Box(-2.0, 6.0) + so.Box(-2.0, -2.0)),
        *([0.0], [1.0], (1.0, 1e3, 1e7)),
        rounding=1e-14,
    ),
    # on the edge of a lens 1e-8 thick, on the box's side and on the circle
    "a thin lens": Nearest(
        SQUARE & so.Ball([2.0 - 1e-8, 0.0], 1.0),
        *([1.0, np.sqrt(2e-8 - 1e-16)], [0.0, 1.0], (0.5,)),
        rounding=1e-11,
    ),
    "beside a far vertex": Nearest(
        so.Polytope([[0.0, 0, 0, 1], [0.0, 0, -1e8, 0], [0.0, 1, 1, 0]]),
        *([0.0, 0.5, -5e-9, 0.5 - 5e-9], [0.0, -0.5, 5e-9, 5e-9 - 0.5], (0.0, 1.0)),
        rounding=1e-15,
    ),
    "a point, ahead": Nearest(AT_POINT, [1.0, 0.0], [1.0, 0.0], FAR),
    "a point, across": Nearest(AT_POINT, [1.0, 0.0], [0.0, 1.0], FAR),
    "a point, behind": Nearest(AT_POINT, [1.0, 0.0], [-1.0, -1.0], FAR),
}


@pytest.mark.parametrize("case", NEAREST)
def test_the_nearest_point_is_found_from_any_distance(case):
    C, point, p, lengths, beside, rounding = NEAREST[case]
    for length in lengths:
        force, atol = length * np.array(p) + beside, rounding * max(length, 1.0)
        v = point + force
        np.testing.assert_allclose(C.project(v), point, rtol=0, atol=atol)
        np.testing.assert_allclose(C.normal(v), v - point, rtol=0, atol=atol)


@pytest.mark.parametrize("sizes", [np.ones(4), np.array([1.0, 1.3, 1.1, 2.0])])
def test_curves_beside_a_circle_stay_in_the_disc_and_are_off_it_by_order_four(sizes):
    theta = np.linspace(0, 1, 201)
    p = np.array([[1.0, 0.0], [1.0, 1.0], [-1.0, 2.0]])
    for C, r in ((so.Ball([0, 0], 1.0), 1.0), (-0.5 * so.Balls([4.0], 2), 2.0)):
        off = []
        for length in (1.0, 0.5):
            angle = length * np.arange(4) / 3
            aim = 1.5 * r * np.column_stack([np.cos(angle), np.sin(angle)])
            w = C.curves_within(aim[None], sizes[None])[0]
            arms = basis(3, theta) @ (sizes[:, None] * w) / (basis(3, theta) @ sizes)[:, None]
            distance = np.linalg.norm(arms, axis=1) / r
            assert distance.max() <= 1 + 1e-14
            off.append(1 - distance.min())
        if np.ptp(sizes) == 0:
            assert off[0] / off[1] == pytest.approx(16, rel=0.1)
        gap = C.gaps_along_curves(p[None], np.zeros((1, 4, 2)), sizes[None])[0]  # of w = 0
        exact = [C.support(x) for x in basis(2, GAUSS) @ p] @ (WEIGHTS * (basis(3, GAUSS) @ sizes))
        assert 0.99 * exact <= gap <= 1.3 * exact


def test_the_bound_of_a_gap_holds_where_the_direction_turns_and_grows_60_times():
    # six Gauss points of |p|^2 / l alone are 3e-5 of it too small
    p = np.array([[0.0018968, -0.00142782], [-0.0187944, -0.07757452], [-0.09900198, -0.10607014]])
    nodes, weights = np.polynomial.legendre.leggauss(400)
    exact = 0.5 * weights @ np.linalg.norm(basis(2, 0.5 + 0.5 * nodes) @ p, axis=1)
    gap = UNIT.gaps_along_curves(p[None], np.zeros((1, 4, 2)), np.ones((1, 4)))[0]
    assert exact <= gap <= 1.05 * exact


def test_what_is_inside_does_not_move_at_all():
    w = np.array([0.1, -0.3])
    triangle = so.Polytope([[1.0, 0.0], [-1.0, 1.0], [-1.0, -1.0]])
    inside = [
        so.Ball([0.3, 0.1], 1.0),
        so.Ellipsoid([0.1, 0.0], EYE),
        so.Polyhedron([[1.0, 1.0]], [0.3]),
        triangle,
        UNIT & so.Ball([0.5, 0.0], 1.0),
        UNIT + triangle,
        so.Box([-393, -393], [800, 800]) + so.Ellipsoid([0.3, 0.7], np.diag([1.0, 2.0])),
        so.WholeSpace(2),
        so.image(EYE[[1, 0]], UNIT),
    ]
    for C in inside:
        assert (C.normal(w) == 0.0).all()
        moved, v = C + [0.7, 0.2], w + [0.7, 0.2]
        found = moved.normal_pair(np.zeros(2), v, np.ones(2))
        assert (found.p == 0.0).all()
        assert found.gap == 0.0


@pytest.mark.filterwarnings("ignore::sweepopt.InitialStateWarning")
@pytest.mark.parametrize("name", [name for name in ZOO if "wide image" in name])
def test_the_velocity_in_an_image_with_many_preimages_is_certified(name):
    # M between 2e-3 and 6e-3: an error of w counts 500 times in the velocity
    for seed in range(3):
        C = ZOO[name].sample(seed).C
        k = 5 * C.magnitude() * np.random.default_rng(seed).normal(size=3)
        C = so.Moving(C, center=lambda t, k=k: t * k)
        process = so.SweepingProcess(np.diag([2e-3, 4e-3, 6e-3]), None, C, np.zeros(3))
        so.solve(process, t_end=1.0, steps=3)  # raises StepError above 1e-6


# ---- support functions --------------------------------------------------------------------------


@pytest.mark.parametrize("far", [0.0, 1e6])
@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e9])
def test_support_of_a_polyhedron_is_exact_in_all_units_and_far_from_the_origin(scale, far):
    rng = np.random.default_rng(4)
    vertices = np.vstack([np.zeros(3), np.eye(3)])
    G, h = np.vstack([-np.eye(3), np.ones(3)]), np.array([0.0, 0.0, 0.0, 1.0])
    c = far * scale * rng.normal(size=3)
    C = so.Polyhedron(G, scale * h + G @ c)
    for z in rng.normal(size=(20, 3)):
        expected = scale * (vertices @ z).max() + c @ z
        assert abs(C.support(z) - expected) <= 1e-14 * scale * (1 + 10 * far)


def test_support_tells_the_edge_of_its_domain_to_rounding():
    normal = np.array([1.0, 2.0, -3.0]) / 7
    H, K = so.HalfSpace(normal, 2.0), so.SecondOrderCone(3)
    assert H.support(0.3 * normal) == pytest.approx(0.6, rel=1e-15)
    assert np.isinf(H.support(-1e-9 * normal))
    assert np.isinf(H.support(normal + [0.0, 0.0, 1e-12]))
    edge = np.array([-np.hypot(0.1, 0.7), 0.1, 0.7])
    assert K.support(edge) == 0.0
    assert np.isinf(K.support(edge + [1e-12, 0.0, 0.0]))
    polar = so.Polyhedron([[1.0, 1.0, 0.0], [0.0, 1.0, 3.0]], [0.0, 0.0]).polar()
    assert polar.support([-1.0, 1.0, -1 / 3]) == 0.0
    assert np.isinf(polar.support([-1.0, 1.0 + 1e-12, -1 / 3]))


def test_a_polyhedron_without_rows_is_the_whole_space():
    C = so.Polyhedron(np.zeros((0, 2)), [])
    assert np.isinf(C.support([1.0, 0.0]))
    assert (C.project([3.0, 4.0]) == [3.0, 4.0]).all()


# ---- distances ----------------------------------------------------------------------------------

TRIANGLE = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])

DISTANCES = [
    (so.Point([1, 2]), so.Point([4, 6]), 5.0),
    (so.Ball([0, 0], 1), so.Ball([3, 4], 3), 7.0),
    (so.Balls([1, 2], 2), so.Balls([4, 6], 2), 5.0),
    (so.Balls([1, 2], 2), so.Balls([4, 1], 2), 3.0),
    (so.Box([0, 0], [1, 4]), so.Box([0, 0], [4, 1]), 3.0),
    (so.Box([-INF, 0], [0, INF]), so.Box([-INF, 4], [3, INF]), 4.0),
    (so.Box([0, 0], [1, 1]), so.Box([0, 0], [1, INF]), INF),
    (so.Ball(0, 1), so.Box(-3, 2), 2.0),
    (so.HalfSpace(2, 2), so.Box(-INF, 4), 3.0),
    (UNIT, UNIT + [3, 4], 5.0),
    (so.SecondOrderCone(2), so.SecondOrderCone(2) + [3, 4], 5.0),
    (2 * UNIT, 5 * UNIT, 3.0),
    (2 * so.SecondOrderCone(3), 5 * so.SecondOrderCone(3), 0.0),
    (
        so.Moving(UNIT, [1, 0], lambda t: t).at(0.0),
        so.Moving(UNIT, [1, 0], lambda t: t).at(3.0),
        3.0,
    ),
    (UNIT + so.Box([0, 0], [1, 1]), UNIT + so.Box([0, 0], [4, 5]), 5.0),
    (
        so.image([[0, 2], [1, 0], [0, 0]], so.Box([0, 0], [1, 1])),
        so.image([[0, 2], [1, 0], [0, 0]], so.Box([0, 0], [1, 3])),
        4.0,
    ),
    (
        so.product(UNIT, so.Box(0, 5)),
        so.product(so.Ball([3, 0], 1), so.Box(0, 9)),
        5.0,
    ),
    (so.Polyhedron(TRIANGLE, [1, 1, 1]), so.Polyhedron(TRIANGLE, [1, 1, 1]), 0),
    (UNIT & so.Ball([1, 0], 1), UNIT & so.Ball([1, 0], 1), 0.0),
]


def test_distance_bound_is_sharp_where_the_distance_is_known():
    for C, D, expected in DISTANCES:
        assert C.distance_bound(D) == pytest.approx(expected, rel=1e-14), (C, D)
        assert D.distance_bound(C) == pytest.approx(expected, rel=1e-14), (C, D)


def test_distance_bound_is_none_where_nothing_is_known():
    other = so.Ball([1, 0], 1)
    halves = so.HalfSpace([1, 0], 1), so.HalfSpace([0, 1], 1)
    for C, D in [
        (so.Polyhedron(TRIANGLE, [1, 1, 1]), so.Polyhedron(TRIANGLE, [1, 1, 2])),
        (UNIT & other, UNIT & so.Ball([0.5, 0], 1)),
        (UNIT, so.Box([0, 0], [1, 1])),
        (UNIT + halves[0], UNIT + halves[1]),
        (so.product(UNIT, halves[0]), so.product(UNIT, halves[1])),
        (2 * halves[0], 3 * halves[0]),
        (so.image(EYE, UNIT), so.image([[2, 0], [0, 1]], UNIT)),
    ]:
        assert C.distance_bound(D) is None
        assert D.distance_bound(C) is None
    with refuses("dim 2 and 3"):
        UNIT.distance_bound(so.Orthant(3))


class Slope(so.HalfSpace):
    def __init__(self, steep):
        super().__init__([steep, 1.0], 1.0)


class Corner(so.Polyhedron):
    def __init__(self, *, rows):
        super().__init__(np.eye(rows), h=np.ones(rows))


def test_nearly_opposite_rows_are_a_wedge_and_no_equation():
    """The pair at (0, 5) of a line is none of the wedge x <= 0, x >= a y, whose apex is nearest."""
    for a in np.geomspace(1e-15, 1e-9, 14):
        C = so.Polyhedron([[1.0, 0.0], [-1.0, a]], [0.0, 0.0])
        pair = C.normal_pair(np.zeros(2), np.array([0.3, 5.0]), np.ones(2))
        if pair is not None:
            moved = 0.0 if pair.perturbation is None else np.linalg.norm(pair.perturbation.w)
            assert pair.w[1] <= 1e-12 or moved > 1e-3


@pytest.mark.parametrize("factor", [1.0, 3.0, 0.1])
def test_rows_that_are_opposite_but_for_rounding_are_an_equation_or_refused(factor):
    """With G[1] = -k G[0], rounded, a plane or, where k G[0] is rounded, a wedge at random."""
    row, side = np.array([0.1, 0.3, 0.7]), 0.2
    for turn in range(-4, 5):
        other = -factor * row
        other[2] += turn * np.spacing(other[2])
        h = [side, -factor * side]
        x, y = (np.array([Fraction(number) for number in G]) for G in (row, other))
        exact = (x * y[0] == y * x[0]).all()
        C = so.Polyhedron([row, other], h)
        process = isotropic(C)
        if exact:
            process.check(np.zeros(1))
            continue
        with refuses(r"rows 0 and 1 of G w <= h are opposite but for"):
            process.check(np.zeros(1))
        so.Polyhedron([row, other], [side, 1.0]).require_nonempty()  # a slab of some width


WIDE = so.image(np.random.default_rng(0).normal(size=(3, 320)) / 20, so.Balls(np.ones(160), 2))
TWINS = [copy.copy, copy.deepcopy, lambda C: pickle.loads(pickle.dumps(C))]


@pytest.mark.parametrize(
    "C",
    [so.Polyhedron(TRIANGLE, [1, 1, 1]), so.HalfSpace([3, 4], 5), WIDE]
    + [Slope(2.0), Slope(steep=2.0), Corner(rows=2)],
)
def test_sets_and_those_of_subclasses_with_other_arguments_can_be_copied(C):
    v = 3.0 * np.ones(C.dim)
    known = so.Polyhedron(C.G, C.h) if isinstance(C, so.Polyhedron) else C
    for twin in (C, *(copied(C) for copied in TWINS)):
        assert type(twin) is type(C)
        np.testing.assert_array_equal(twin.project(v), known.project(v))


def test_sets_that_move_by_data_go_through_pickle():
    """Their algebra too; what a user's lambda moves cannot, as Python pickles no lambda."""
    sine = so.Sine(1.0, period=4.0)
    C = so.Moving(SQUARE, center=so.Separable([(sine, [1.0, 0.0])]))
    rows = so.Polyhedron([[1, 0], [0, 1], [-1, -1]], so.Separable([(sine, [0.5, 0.0, 0.0])]))
    ball = so.Ball([0.0, 0.0], 1.0)
    for moving in (rows, C + [1.0, 0.0], 2 * C, C & ball, so.product(C, C), so.image(EYE, C)):
        one, twin = moving.at(1.0), pickle.loads(pickle.dumps(moving)).at(1.0)
        z = np.arange(1.0, moving.dim + 1.0)
        assert twin.support(z) == one.support(z)


# ---- what the algebra simplifies ----------------------------------------------------------------


def test_points_boxes_and_balls_stay_what_they_are():
    p, box = so.Point([1.0, 2.0]), so.Box([0, 0], [1, 2])
    points = [p + [1, 1], -p, 3 * p, p + p, p - [1, 0], so.product(p, p), so.image(EYE, p)]
    for C in points:
        assert isinstance(C, so.Point)
        assert C.singleton
    assert (p + box).anchor @ [1, 0] == 1.0
    for D in (box + box, box & box, -box, so.product(box, box)):
        assert isinstance(D, so.Box)
    ball = so.Ball([3.0, 4.0], 2.0)
    assert isinstance(ball + ball, so.Ball)
    for C in (ball, so.Ellipsoid([3.0, 4.0], 4 * EYE)):
        flat = so.image([[1.0, 0.0], [0.0, 1.0], [1.0, 0.0]], C)  # of any rank
        assert isinstance(flat, so.Ellipsoid)
        np.testing.assert_allclose(flat.project([9.0, 4.0, 9.0]), [5.0, 4.0, 5.0], rtol=1e-15)


def test_intersections_of_polyhedra_are_polyhedra():
    box, cut = so.Box([0, 0], [1, INF]), so.HalfSpace([1.0, 1.0], 1.5)
    for C in (box & cut, cut & box, (box - [0, 0]) & (2 * cut), (-cut) & box, cut & cut):
        assert isinstance(C, so.Polyhedron)
    np.testing.assert_allclose((box & cut).project([9.0, 9.0]), [0.75, 0.75], atol=1e-15)
    np.testing.assert_allclose((cut & box).project([9.0, 0.0]), [1.0, 0.0], atol=1e-15)


def test_user_constraints_have_no_proof_nor_does_anything_made_of_them():
    C = so.Constraints(2, lambda w: [w[0] ** 2 + w[1] <= 1, w[1] >= -1])
    sets = [C, C + [1, 1], 2 * C, -C, C + UNIT, C & UNIT, so.product(C, UNIT)]
    sets += [so.image(EYE, C)]
    for D in sets:
        assert not D.certifiable
        assert D.normal_pair(np.zeros(D.dim), np.zeros(D.dim), np.ones(D.dim)) is None


def test_a_moving_cone_that_rests_at_zero_has_a_polar():
    rest = so.Moving(so.Orthant(2), center=lambda t: [t, t]).at(0.0)
    assert (rest.polar().project([1.0, -1.0]) == [0.0, -1.0]).all()


def test_user_constraints_are_read_once():
    r = cp.Parameter(value=1.0)
    C = so.Constraints(2, lambda w: [cp.norm(w) <= r])
    r.value = 2.0
    assert C.support([1.0, 0.0]) == pytest.approx(1.0)


def test_user_constraints_without_a_ray_are_unbounded():
    parabola = so.Constraints(2, lambda w: [w[0] ** 2 <= w[1]])
    assert parabola.support([1.0, -1.0]) == pytest.approx(0.25)
    assert parabola.magnitude() == INF
    assert so.Constraints(2, lambda w: []).support([1.0, 0.0]) == INF


# ---- malformed input ----------------------------------------------------------------------------

CONE = so.SecondOrderCone(2)


def test_every_set_refuses_vectors_of_another_shape():
    for C in (entry.sample(0).C for entry in ZOO.values()):
        n = C.dim
        for wrong in (np.zeros(n + 1), np.zeros((n, 1)), np.full(n, NAN), ["?"] * n):
            with refuses(re.compile("^[wzv]")):
                C.support(wrong)
            with refuses(re.compile("^[wzv]")):
                C.project(wrong)


@pytest.mark.parametrize("seed", [217, 241, 249, 309])
def test_a_body_at_rest_moves_by_no_more_than_its_certificate(seed):
    """Its force is inside of a sum by 1e-12 or less: the velocity is 0."""
    random = np.random.default_rng(seed)
    Q = np.linalg.qr(random.normal(size=(2, 2)))[0]
    M = Q @ np.diag([1.0, 1e6]) @ Q.T
    M = (M + M.T) / 2
    matrices = (
        random.normal(size=(2, 2)),
        random.normal(size=(2, 3)) * 10 ** random.uniform(-3, 3, 3),
    )
    balls = so.Ball(np.zeros(2), 1.0), so.Ball(np.zeros(3), 0.7)
    C = so.image(matrices[0], balls[0]) + so.image(matrices[1], balls[1])
    d = random.normal(size=2)
    d /= np.linalg.norm(d)
    pulls = [E.T @ d for E in matrices]
    s = sum(
        E @ p * S.radius / np.linalg.norm(p) for E, p, S in zip(matrices, pulls, balls, strict=True)
    )
    v = s - 10.0 ** random.uniform(-13.5, -12) * np.linalg.norm(s) * d
    process = so.SweepingProcess(M, None, so.MovingSet(lambda t: C - v), np.zeros(2))
    sol = so.solve(process, t_end=1.0, steps=1, scheme="implicit-euler")
    assert np.sqrt(sol.velocity[0] @ M @ sol.velocity[0]) <= sol.stats["certificate"][0]


def test_sums_cuts_and_images_of_one_another_keep_their_nearest_points():
    random = np.random.default_rng(4)
    hull = so.Polytope(random.normal(size=(6, 2)))
    rows = so.Polyhedron([[1.0, 2.0], [-1.0, 1.0], [2.0, -1.0], [-1.0, -2.0]], [1.0, 2.0, 1.0, 2.0])
    thin = so.image(random.normal(size=(3, 2)).round(1), rows)
    flat = so.image(random.normal(size=(3, 2)).round(1), hull) + so.Box([-0.5] * 3, [0.5] * 3)
    many = so.Polyhedron(random.integers(-2, 3, size=(11, 7)) + 0.0, random.uniform(size=11))
    both = so.image(random.integers(-2, 3, size=(3, 7)) + 0.0, many) + so.image(
        random.normal(size=(3, 2)), so.HalfSpace([1.0, -0.4], 0.3)
    )
    cuts = (-flat & thin, flat & (thin + so.HalfSpace([1.0, 2.0, 0.0], 0.1)), thin & thin + flat)
    for C in (*cuts, 0.5 * both + np.ones(3), so.image(np.eye(3)[:2], both)):
        for v in (np.zeros(C.dim), *9 * random.normal(size=(3, C.dim))):
            w = C.project(v)
            np.testing.assert_allclose(C.project(w), w, rtol=0, atol=1e-12)
            np.testing.assert_allclose(C.project(w + 3 * (v - w)), w, rtol=0, atol=1e-11)


def test_a_hull_has_each_facet_once():
    # Qhull has two equations for a facet of four points where rounding makes it a wedge
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    for seed in range(60):
        random = np.random.default_rng(seed)
        turn = np.linalg.qr(random.normal(size=(3, 3)))[0]
        cube = so.Polytope(corners @ turn + 10 * random.normal(size=3))
        assert len(cube.halfspaces().N) == 6


def test_a_pair_says_how_far_rounding_moved_it():
    corner = 1.0 * np.array([1, 1, -1, -1])
    hull = so.Polytope(np.vstack([2 * corner, np.eye(4), -np.eye(4)]))
    ball, box = so.Ball(np.zeros(4), 2.0), so.Box([-3.0] * 4, [3.0] * 4)
    cut = (hull + ball) & so.HalfSpace(corner, 100.0)
    for C, w in ((hull + ball, 3 * corner), (box + (hull + ball), 6 * corner), (cut, 3 * corner)):
        for size in (1.0, 2.0**12, 2.0**30):
            p = size * corner  # beside which w is rounded away
            found = C.normal_pair(p, w, np.ones(4))
            last = 4 * np.finfo(float).eps
            assert (np.abs(found.w - w) <= found.perturbation.w + last * np.abs(w)).all()
            assert (np.abs(found.p - p) <= found.perturbation.p + last * size).all()
            assert found.perturbation.w.max() <= 1e-12
            assert found.perturbation.p.max() <= 1e-12 * size


def test_a_vertex_that_only_rounding_says_is_ahead_leaves_a_polytope_quietly():
    C = so.Polytope([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    x, y, z = C.project(np.array([5.8e73, 0.0, 7.6e-24]))
    assert x == y == 0.0 <= z <= 1.0


def gradient(n):
    """Of functions on a square grid: two differences for each node that has both neighbours."""
    D = sp.diags_array([-np.ones(n - 1), np.ones(n - 1)], offsets=[0, 1], shape=(n - 1, n))
    inner = sp.eye_array(n - 1, n)
    pairs = sp.vstack([sp.kron(D, inner), sp.kron(inner, D)])
    m = (n - 1) ** 2
    return sp.csr_array(pairs)[np.arange(2 * m).reshape(2, m).T.ravel()]


def test_sets_of_many_unknowns_are_made_of_sparse_matrices():
    G = gradient(143)  # dense, it would need 6 GB
    discs = so.image(G.T, so.Balls(np.ones(G.shape[0] // 2), 2))
    z = np.random.default_rng(0).normal(size=discs.dim)
    lengths = np.linalg.norm((G @ z).reshape(-1, 2), axis=1)
    assert discs.support(z) == pytest.approx(lengths.sum(), rel=1e-12)
    many = so.product(*(so.Ball([0.0, 0.0], 1.0) + so.Box([0, 0], [1, 1]) for _ in range(500)))
    assert many.support(np.ones(1000)) == pytest.approx(500 * (np.sqrt(2) + 2), rel=1e-12)
    wide = so.image(
        sp.random_array((5, 9000), density=0.01, rng=0), so.Box(-(z[:9000] ** 2), [1.0] * 9000)
    )
    (2.0 * -(wide + so.HalfSpace(np.ones(5), 1.0)) + np.ones(5)).support(np.zeros(5))


CUBE = so.Box(-np.ones(400), np.ones(400))


def discs_and_box(count):
    rng, n = np.random.default_rng(2 * count), 2 * count
    radii, (lower, upper) = rng.uniform(0.5, 1.5, count), rng.uniform(0.2, 1, (2, n))
    return so.Balls(radii, 2), so.Box(-lower, upper)


@pytest.mark.parametrize("combined", [operator.and_, operator.add])
def test_many_discs_and_a_box_are_the_product_of_small_sets(combined):
    discs, box = discs_and_box(80)
    v, C = 3 * np.random.default_rng(1).normal(size=160), combined(discs, box)
    w = C.project(v)
    for k in range(20):
        at = slice(2 * k, 2 * k + 2)
        one = so.Ball([0.0, 0.0], discs.radii[k]), so.Box(box.lower[at], box.upper[at])
        np.testing.assert_allclose(w[at], combined(*one).project(v[at]), rtol=0, atol=1e-12)
    pair = C.normal_pair(v - w, w, np.ones(160))
    assert pair.gap == 0
    np.testing.assert_allclose([pair.w, pair.p], [w, v - w], rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    "one, other",
    [
        (discs_and_box(80)[0], so.Ball(np.zeros(160), 5.0)),
        (discs_and_box(80)[0], so.HalfSpace(np.ones(160), -2.0)),
        (so.image(sp.eye_array(400) + 0.5 * sp.eye_array(400, k=1), CUBE), so.Ball([0] * 400, 12)),
    ],
)
def test_large_cuts_that_are_no_products_have_pairs(one, other):
    C, v = one & other, 2 * np.random.default_rng(2).normal(size=one.dim)
    w = C.project(v)
    pair = C.normal_pair(v - w, w, np.ones(C.dim))
    assert pair.gap == 0
    for part in (one, other):
        assert part.contains(pair.w, 1e-13)
    np.testing.assert_allclose(pair.w + pair.p, v, rtol=0, atol=1e-13)


@pytest.mark.parametrize("count, full", [(10, True), (20, False), slow(40, True)])
def test_discs_cut_with_a_box_are_proved_to_a_tight_tolerance(count, full):
    (discs, box), n = discs_and_box(count), 2 * count
    root = np.random.default_rng(count).normal(size=(n, n))
    A = root @ root.T / n + np.eye(n) if full else np.diag(np.linspace(1.0, 2.0, n))
    C = so.Moving(discs & box, center=lambda t: 5 * t * np.cos(np.arange(n)))
    found = so.solve(so.SweepingProcess(A, None, C, np.zeros(n)), t_end=1.0, steps=1, tol=1e-9)
    assert worst_certificate(found) <= 1e-9


def test_the_cone_of_one_unknown_is_taken_by_every_solver():
    C = so.Moving(so.image([[1.5]], so.Orthant(1)), center=lambda t: np.array([2 * t]))
    for solver in ("auto", "osqp", "clarabel"):
        process = isotropic(C, 2.0)
        assert so.solve(process, t_end=1.0, steps=1, solver=solver).status == so.Status.SUCCESS


@pytest.mark.parametrize("seed", range(2))
def test_an_image_of_a_polyhedron_has_the_same_points_in_other_units_of_its_unknowns(seed):
    rng = np.random.default_rng(seed)
    M, G, h = rng.normal(size=(3, 5)), rng.normal(size=(10, 5)), np.ones(10)
    units, v = 10.0 ** rng.uniform(-8, 8, 5), 10 * rng.normal(size=3)
    one, other = (so.image(M * s, so.Polyhedron(G * s, h)) for s in (np.ones(5), units))
    np.testing.assert_allclose(other.project(v), one.project(v), rtol=0, atol=1e-12)


def test_normals_beside_a_generated_cone_are_in_its_polar():
    rng = np.random.default_rng(0)
    finite = []
    for _ in range(50):
        cone = so.Polyhedron(rng.normal(size=(6, 4)), np.zeros(6))
        x, p = cone.polar().project(10 * rng.normal(size=4)), cone.project(rng.normal(size=4))
        finite.append(np.isfinite(cone.polar().support(cone.polar().normal(x + 1e-8 * p))))
    assert np.mean(finite) >= 0.9  # 0.08 of them if the rounding of x stays in p


def corners(C):
    """Of a bounded polyhedron, shape (k, dim)."""
    found = []
    for rows in itertools.combinations(range(C.h.size), C.dim):
        G = C.G[list(rows)]
        if np.linalg.cond(G) < 1e6:
            found.append(np.linalg.solve(G, C.h[list(rows)]))
    size = np.abs(C.G) @ np.abs(np.array(found)).T + np.abs(C.h)[:, None]
    inside = (C.G @ np.array(found).T - C.h[:, None] <= 1e-10 * size).all(axis=0)
    return np.array(found)[inside]


@pytest.mark.parametrize("seeds", [30, slow(1000)])
def test_a_pair_of_a_polyhedron_counts_what_it_misses_and_misses_little(seeds):
    """w + tau p tells nothing of w, on which the corner depends that p is normal to."""
    exact = 0
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        n = int(rng.integers(2, 5))
        G = np.vstack([rng.normal(size=(2, n)), np.eye(n), -np.eye(n)])
        C = so.Polyhedron(G, rng.uniform(0, 1, len(G)) * rng.integers(2, size=len(G)))
        p = G.T @ (rng.uniform(0, 5e3, len(G)) * (rng.random(len(G)) < 0.5))
        pair = C.normal_pair(p, 1e4 * rng.normal(size=n), 10.0 ** rng.uniform(-2, 18, n))
        if pair is None:
            continue  # no proof at all
        dw, dp = pair.perturbation  # an exact pair is as near
        assert (G @ pair.w <= C.h + abs(G) @ dw + 1e-12).all()
        missed = corners(C) @ pair.p - pair.w @ pair.p
        rounded = np.abs(pair.p) @ dw + (np.abs(corners(C)).max() + np.abs(pair.w)) @ dp
        size = np.abs(pair.p).sum() * (1 + np.abs(pair.w).max())
        assert missed.max() <= pair.gap + rounded + 1e-12 * size
        exact += pair.gap <= 1e-24 * size
    assert exact >= 0.7 * seeds


@pytest.mark.parametrize("seeds", [10, slow(200)])
def test_a_sum_is_projected_on_beside_a_vertex(seeds):
    # whole Newton steps go to and fro between its faces
    C = so.Polytope(
        [
            [2, 0, -2],
            [-1, 1, 3],
            [2, 0, 0],
            [0, 2, 0],
            [0, 0, 2],
            [-1, 0, 0],
            [0, -1, 0],
            [0, 0, -1],
        ]
    ) + so.Box([-1, -1, -1], [1, 1, np.inf])
    vertex = C.project([0.0, 3.0, 3.0])
    for seed in range(seeds):
        v = vertex + 2e-7 * np.random.default_rng(seed).normal(size=3)
        pair = C.normal_pair(v - C.project(v), C.project(v), np.ones(3))
        assert pair.gap == 0.0


@pytest.mark.parametrize("given, lacks", [({}, "dim"), ({"dim": 1}, "offsets")])
def test_a_set_of_ones_own_that_lacks_an_attribute_is_told_so(given, lacks):
    class Interval(so.ConvexSet):
        def __init__(self):
            self.__dict__ |= given

        def support(self, z):
            return abs(z[0])

        def project(self, w):
            return np.clip(w, -1, 1)

        def features(self, p):
            y = cp.Variable(1)
            return so.sets.Features([y], [cp.abs(p) <= y])

    with refuses(f"^Interval has no {lacks}: give it self.{lacks} = "):
        isotropic(Interval()).check([0.0])


@pytest.mark.parametrize("seed", range(4))
def test_a_body_rests_exactly_inside_of_a_skew_cone(seed):
    M = np.random.default_rng(seed).normal(size=(3, 3))
    cone, within = so.image(M, so.Orthant(3)), M @ np.full(3, 0.3)
    assert not cone.normal(within).any()
    A = np.eye(3)
    assert not so.compatible_start(so.SweepingProcess(0 * A, A, cone - within, np.zeros(3))).any()


@pytest.mark.parametrize("seed", range(3))
def test_what_bounds_the_support_of_an_intersection_is_near_and_not_below_its_program(seed):
    random = np.random.default_rng(seed)
    hull = so.Polytope(random.normal(size=(9, 3)))
    for C in (
        hull & so.Ball(np.zeros(3), 1.2),
        so.Ball(np.zeros(3), 1.0) & so.Box([-0.8] * 3, [0.8] * 3),
    ):
        v = 2 * random.normal(size=3)
        w = C.project(v)
        p = v - w + 1e-3 * random.normal(size=(1, 3, 3))
        bounds = C.supports_along(p, np.stack([w, w])[None])[0]
        excess = (bounds - [C.support(x) for x in p[0]]) / np.linalg.norm(p[0], axis=1)
        assert excess.min() > -1e-8  # as the cone programs are solved
        assert excess.max() < 1e-3


def test_a_projection_of_0_that_starts_from_0_comes_to_parts_away_from_0():
    # a ZeroDivisionError: nothing told the size of the numbers
    from sweepopt.sets.projection import Projector, Start

    form = (so.Box([0.5, -1.0], [2.0, 1.0]) & so.Ball([1.0, 0.0], 0.7)).form()
    zero = np.zeros(form.E.shape[1])
    near = Projector(form)(np.zeros(2), Start(zero, zero))
    np.testing.assert_allclose(near.w, [0.5, 0.0], atol=1e-12)


@pytest.mark.parametrize("seed, which", [(56, 4), (89, 3), (156, 1), (175, 3)])
def test_a_body_rests_in_a_sum_whose_faces_are_nearly_parallel(seed, which):
    random = np.random.default_rng(seed)
    vertices, sides = random.normal(size=(5, 3)), random.uniform(0.1, 1, (2, 3))
    C = so.Polytope(vertices) + so.Box(-sides[0], sides[1])
    for _ in range(which + 1):  # a point that is 1e-6 to 0.1 inside
        direction = random.normal(size=3)
        far = 10 * direction / np.linalg.norm(direction)
        boundary = C.project(far)
        normal = (far - boundary) / np.linalg.norm(far - boundary)
        inside = boundary - normal * 10.0 ** random.uniform(-6, -1)
    assert np.array_equal(C.project(inside), inside)
    process = so.SweepingProcess(np.eye(3), None, C - inside, np.zeros(3))
    assert not so.solve(process, t_end=1.0, steps=1).velocity.any()


@pytest.mark.parametrize("seed, row", [(162, 4), (276, 6)])
def test_the_support_function_beside_nearly_dependent_rows_is_that_of_the_vertices(seed, row):
    random = np.random.default_rng(seed)
    vertices = random.normal(size=(8, 3))
    rows = ConvexHull(vertices).equations
    for j in range(row + 1):  # normals but for rounding, as those of the facets of a sum are
        z = rows[j, :-1] * (1 + 1e-15) + 3e-16 * random.normal(size=3)
    support = so.Polyhedron(rows[:, :-1], -rows[:, -1]).support(z)
    assert support == pytest.approx((vertices @ z).max(), rel=1e-12)
