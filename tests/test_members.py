"""Chords between members of sets that move separately: inside of C(t), their gaps bounded."""

import numpy as np
import pytest
from test_error_bound import check_close

import sweepopt as so
from sweepopt.results.members import chords
from sweepopt.sets.chords import ball_inside

TURN = np.array([[0.8, -0.6], [0.6, 0.8]])
WAVES = [
    (so.Sine(1.6, 3.4), [1.0, 0.5]),
    (so.Table([0.0, 0.7, 2.0], [0.0, 0.6, -0.3]), [0.4, -1.0]),
]


def made_of_separate_sets(kind):
    """What operations make of a disc, an ellipse, a triangle and rows that move separately."""
    disc = so.Moving(so.Ball([0.1, 0.0], 1.0), so.Separable(WAVES), so.Sine(0.1, 0.9, offset=1.0))
    own = so.Separable([*WAVES, (so.Triangle(0.3, 1.1), [1.0, -1.0])])
    ellipse = so.Moving(so.Ellipsoid([0.0, 0.1], [[1.0, 0.3], [0.3, 0.7]]), own)
    triangle = so.Moving(
        so.Polytope([[1.0, 0.0], [-0.8, 1.0], [-0.8, -1.2]]), own, so.Constant(1.1)
    )
    G = np.vstack([np.eye(2), -np.eye(2)])
    h = [(phi, G @ f) for phi, f in WAVES]
    rows = so.Polyhedron(G, so.Separable([*h, (so.Sine(0.2, 1.3, offset=0.8), np.ones(4))]))
    return {
        "discs": lambda: disc & ellipse,
        "a disc and rows": lambda: rows & disc,
        "a disc and a triangle": lambda: [0.1, 0.2] - 0.5 * (triangle & disc),
        "rows and a disc added": lambda: rows + 0.5 * disc,
        "rows turned": lambda: so.image(TURN, rows),
        "a product": lambda: so.product(rows, disc & ellipse),
    }[kind]()


KINDS = ["discs", "a disc and rows", "a disc and a triangle", "rows and a disc added"]
KINDS += ["rows turned", "a product"]


@pytest.mark.parametrize("kind", KINDS)
def test_chords_are_in_the_set_and_their_gaps_are_below_the_bound(kind):
    C, random = made_of_separate_sets(kind), np.random.default_rng(3)
    times = np.unique([*np.linspace(0.0, 1.9, 20), 0.7, 0.275, 0.825, 1.375])
    p = random.normal(size=(len(times), C.dim))
    v = np.array([C.at(t).project(np.zeros(C.dim)) for t in times]) + p
    found, k, x = chords(C, times, v, 1.0), np.arange(len(times) - 1), np.linspace(0.0, 1.0, 9)
    middle = 0.5 * (p[:-1] + p[1:])
    w, bound = found.along(k, x, np.stack([p[:-1], middle, p[1:]], axis=1))
    for i in k:
        gaps = []
        for share, point in zip(x, w[i], strict=True):
            S, q = (
                C.at((1 - share) * times[i] + share * times[i + 1]),
                (1 - share) * p[i] + share * p[i + 1],
            )
            assert S.contains(point, tol=1e-9)
            gaps.append(S.support(q) - q @ point)
        assert np.trapezoid(gaps, x) <= bound[i] + 1e-9


@pytest.mark.parametrize(
    "kind, A, scheme",
    [
        ("discs", 1.0, "implicit-euler"),
        ("a disc and rows", 0.0, "implicit-euler"),
        ("a disc and a triangle", 0.1, "sdirk2"),
        ("rows and a disc added", 0.0, "sdirk2"),
        ("rows turned", 1.0, "sdirk2"),
        ("a product", 0.3, "implicit-euler"),
    ],
)
def test_the_bound_of_sets_that_move_separately_is_guaranteed_and_close(kind, A, scheme):
    C = made_of_separate_sets(kind)
    B = np.eye(C.dim) + 0.3 * np.eye(C.dim, k=1) + 0.3 * np.eye(C.dim, k=-1)
    u0 = np.linalg.solve(B, C.at(0.0).project(np.zeros(C.dim)))
    process = so.SweepingProcess(A * np.eye(C.dim), B, C, u0)
    check_close(process, 1.2, 6, scheme, 8, 0.95, fine=60)


@pytest.mark.parametrize(
    "S",
    [
        so.Ball([3.0, 1.0], 0.01),
        so.Ellipsoid([1.0, 0.0], [[1.0, 0.9], [0.9, 1.0]]),
        so.Polytope([[0.0, 0.0], [1.0, 0.0], [0.0, 1e-3]]),
        so.SecondOrderCone(2),
        so.Ball([0.0, 0.0], 1.0) & so.Ball([1.5, 0.0], 1.0),
    ],
)
def test_a_ball_inside_is_inside(S):
    a, r = ball_inside(S)
    assert r > 0
    angle = np.linspace(0.0, 2 * np.pi, 50)
    assert all(S.contains(a + r * np.array([np.cos(x), np.sin(x)])) for x in angle)


def test_a_flat_set_has_no_ball_inside_and_no_guaranteed_bound_where_it_moves_on_a_curve():
    flat = so.Polytope([[-1.0, 0.0], [1.0, 0.0]])
    assert ball_inside(flat)[1] == 0
    C = so.Moving(flat, so.Separable([(so.Sine(0.5, 2.0), [1.0, 1.0])])) & so.Ball([0.0, 0.0], 2.0)
    sol = so.solve(so.SweepingProcess(np.eye(2), np.eye(2), C, [0.0, 0.0]), t_end=1.0, steps=3)
    with pytest.warns(so.BoundWarning, match="next to empty"):
        assert not sol.error_bound().guaranteed
