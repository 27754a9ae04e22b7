"""Both problems, their conversion, and the theory's assumptions as checks."""

import re
import warnings
from decimal import Decimal

import numpy as np
import pandas as pd
import pytest
import scipy.sparse as sp
from cases import SQUARE, block, isotropic, random_process, refuses, springs
from meshes import square
from reference_cases import case

import sweepopt as so
from sweepopt.fem import BodyForce, Elasticity, Friction, Viscosity, antiplane


@pytest.mark.parametrize("convert", [np.asarray, sp.csr_array])
def test_beta_and_lam_are_extreme_eigenvalues_dense_and_sparse(convert):
    Q = np.linalg.qr(np.random.default_rng(1).normal(size=(80, 80)))[0]
    A = Q @ np.diag(np.linspace(0.5, 4, 80)) @ Q.T
    B = Q @ np.diag(np.linspace(0, 12, 80)) @ Q.T
    chain = springs(80)
    chain[0, 0] = chain[-1, -1] = 1  # has the constants in its kernel
    known = [((A + A.T) / 2, (B + B.T) / 2, 0.5, 3.0)]
    known.append((np.eye(80), chain, 1.0, 2 + 2 * np.cos(np.pi / 80)))
    for a, b, *expected in known:
        process = so.SweepingProcess(convert(a), convert(b), so.Ball(np.zeros(80), 1), np.zeros(80))
        assert [process.beta, process.Lam] == pytest.approx(expected, rel=1e-8)


def test_a_cone_enters_as_a_minkowski_sum_with_its_polar():
    D, K = so.Box([-1, -1], [2, 2]), so.Orthant(2)
    vi = so.EvolutionVI(np.eye(2), None, load=[0.5, 3.0], dissipation=D, cone=K, u0=[0, 0])
    C = vi.as_sweeping().C.at(0.0)
    # J = sigma(D, .) + indicator of K, sigma(C, -z) = J(z) - <f, z>
    assert C.support([-1.0, -2.0]) == pytest.approx(2 + 4 - 0.5 - 6)
    assert C.support([1.0, -2.0]) == np.inf


def test_only_translates_are_variational_inequalities():
    process = case("P09").process  # the numbers of both forms agree: test_reference.py
    assert process.as_vi().load is process.C.center
    grows = so.Moving(so.Box(-1, 1), scale=so.Sine(0.5, period=3.0, offset=1.0))
    for other in (case("S04").process, so.SweepingProcess(1.0, 1.0, grows, 0.0)):
        with refuses("Moving without scale"):
            other.as_vi()


def test_the_bound_of_the_paper_asks_for_its_assumption():
    """The constant of Adly and Haddad's theorem, 8 v(T) exp(Lam T), with B u0 in C(0)."""
    C = so.Moving(so.Box(-1, 1), so.Sine(3.0, period=4.0))
    inside, outside = (so.SweepingProcess(4.0, 2.0, C, u0) for u0 in (0.5, 8.0))
    assert inside.velocity_bound([0, 4], paper=True).value == pytest.approx(8 * 6 * np.exp(2))
    assert inside.velocity_bound([0, 4]).value == pytest.approx(6, rel=1e-14)
    far = outside.velocity_bound([0, 4])  # its distance is in the norm of A^-1
    assert (far.distance, far.value) == pytest.approx((7.5, 13.5), rel=1e-14)
    with refuses(r"asks for B u0 in C\(0\), whose distance is 7\.5"):
        outside.velocity_bound([0, 4], paper=True)
    still = isotropic(C, 0.0, 2.0)
    with refuses("A coercive"):
        still.velocity_bound([0, 4])
    assert still.variation([0, 4]) == pytest.approx(12 / np.sqrt(2), rel=1e-14)  # B is A's place


@pytest.mark.parametrize("paper", [False, True])
def test_a_start_outside_by_rounding_has_the_velocity_of_its_distance(paper):
    """Of a tiny viscosity that is no rounding: |u'|_A = 5e-10 / sqrt(1e-12)."""
    process = so.SweepingProcess(1e-12, 1.0, so.Box(-1, 1), 1 + 5e-10)
    size = process.metric.norm(so.velocity_field(process)(0.0, process.u0))
    assert size == pytest.approx(5e-4, rel=1e-6)
    assert process.velocity_bound([0, 1], paper=paper).value == pytest.approx(size, rel=1e-12)


@pytest.mark.filterwarnings("ignore::sweepopt.InitialStateWarning")
def test_the_a_priori_bound_is_above_the_velocity_of_random_processes():
    """|u'(t)|_A <= d(B u0, C(0)) + v(t) at every time; exact velocities at the nodes of a run."""
    ratios = []
    runs = [random_process(seed, rate_independent=False) for seed in range(12)]
    for seed in range(4):  # independent rows that move, and ends of intervals
        (process, times), random = runs[seed], np.random.default_rng(seed)
        G = random.normal(size=(process.dim, process.dim))
        G = np.vstack([np.eye(process.dim), -np.eye(process.dim)]) if seed % 2 else G
        wave = so.Sine(random.normal(), times[-1] - times[0])
        h = so.Separable([(so.Constant(9.0), np.ones(len(G))), (wave, random.normal(size=len(G)))])
        moved = so.SweepingProcess(process.A, process.B, so.Polyhedron(G, h), process.u0)
        runs.append((moved, times))
    for process, times in runs:
        sol = so.solve(process, steps=times, scheme="implicit-euler", on_unstable="ignore")
        velocity = so.velocity_field(process)
        for t, u in zip(sol.t[1:], sol.u[1:], strict=True):
            bound = process.velocity_bound([times[0], t])
            assert bound.guaranteed
            size = process.metric.norm(velocity(t, u))
            assert size <= bound.value * (1 + 1e-6) + 1e-9
            ratios.append(size / bound.value)
    assert max(ratios) > 0.5


@pytest.mark.parametrize(
    "C",
    [
        so.MovingSet(lambda t: so.Box(np.sin(t) - 1, np.sin(t) + 1)),
        so.Moving(so.Box(-1, 1), np.sin),
    ],
)
def test_the_variation_of_functions_is_what_the_times_show_and_no_guarantee(C):
    process = so.SweepingProcess(4.0, 2.0, C, 0.0)
    coarse, fine = (process.variation(np.linspace(0, 2 * np.pi, n)) for n in (4, 401))
    assert (coarse, fine) == pytest.approx((np.sqrt(3), 2.0), rel=1e-4)
    assert not coarse.guaranteed
    assert not process.velocity_bound([0, 1]).guaranteed


def test_a_set_on_one_unknown_that_grows_away_from_0_varies_by_its_farthest_point():
    S = so.image(np.eye(2)[:, :1], so.Box(-1, 1)) + np.array([0.0, 10.0])
    growing = so.Moving(S, scale=so.Sine(1.0, period=4.0, offset=3.0))  # by 1 until t = 1
    process = so.SweepingProcess(np.eye(2), None, growing, np.zeros(2))
    variation = process.variation([0, 1])
    assert variation.guaranteed
    assert np.hypot(1, 10) <= variation <= 11 + 1e-12


def test_rows_on_some_unknowns_whose_distance_is_that_of_no_translate_have_no_variation():
    few = so.Polyhedron([[1.0, 2.0], [1.0, -1.0]], so.Separable([(so.Sine(1.0, 4.0), [1.0, 2.0])]))
    C = so.image(np.eye(3)[:, :2], few)
    process = so.SweepingProcess(np.eye(3) + 0.5, None, C, np.zeros(3))
    with refuses("distance of C.* is not known"):
        process.variation([0, 1])


@pytest.mark.parametrize("element", ["P1", "P2"])
def test_the_a_priori_bound_does_not_depend_on_the_mesh(element):
    values = []
    for n in (4, 8, 16, 32):
        effects = [Viscosity(1.0), Elasticity(2.0), Friction("bottom", g=0.2)]
        effects += [BodyForce(so.Sine(1.0, period=2.0), f0=3.0)]
        vi = antiplane(square(n), clamped="top", element=element, effects=effects).problem
        breathing = so.Moving(-vi.dissipation, vi.load, so.Sine(0.5, period=3.0, offset=1))
        both = [vi, so.SweepingProcess(vi.A, vi.B, breathing, vi.u0)]
        bounds = [process.velocity_bound([0, 2]) for process in both]
        assert all(bound.guaranteed for bound in bounds)
        values.append([*(b.value for b in bounds), vi.velocity_bound([0, 2], paper=True).value])
        if n == 8:
            for process, bound in zip(both, bounds, strict=True):
                z = so.solve(process, t_end=2.0, steps=100, scheme="implicit-euler").velocity
                largest = max(process.metric.norm(one) for one in z)
                assert largest <= bound.value <= 6 * largest
    first, *_, before, last = np.array(values)
    assert last == pytest.approx(before, rel=1e-3)
    assert last == pytest.approx(first, rel=2e-2)


def test_the_variation_of_data_is_exact_whatever_times_are_given():
    times, A = [0.0, 0.5, 1.0], np.diag([4.0, 1.0])
    moves = so.Separable([(so.Sine(0.225, period=0.25), [2.0, 0.0])])
    ball, zero = so.Ball([0, 0], 2), np.zeros(2)

    def process(C):
        return so.SweepingProcess(A, None, C, zero)

    record = so.Table([0, 0.3, 0.31, 2], [1, 6, 6, 5.0])
    fall = 5 + 0.69 / 1.69
    known = [
        (so.Moving(ball, moves), 4 * 0.9),  # four periods of 4 * 0.225 * |(2, 0)|_{A^-1}
        (so.Moving(ball, so.Separable([(record, [0.0, 2.0])])), 2 * fall),
        (so.Moving(ball, scale=record), 2 * fall),  # the ball's farthest point is at (0, 2)
        (so.Moving(so.Box([-1, 0], [2, np.inf]), scale=record), fall),
        (so.Polyhedron([[0.5, 0], [-1, 0], [0, 1]], so.Separable([(record, [1, 1.5, 0])])), fall),
        (so.Polyhedron([[3, 4.0]], so.Separable([(record, 1.0)])), fall / np.sqrt(9 * 4 + 16)),
        (so.Moving(so.Point([4.0, 0]), scale=so.Sine(1, 0.5, offset=1)), 2 * 8),
    ]
    for C, expected in known:
        v = process(C).variation(times)
        assert v == pytest.approx(expected, rel=1e-6)
        assert v >= expected * (1 - 1e-12)
        assert v.guaranteed
        assert process(C).velocity_bound(times).guaranteed
    # a function that is not known is what the times show of it
    sampled = process(so.Moving(ball, lambda t: moves(t)))
    assert sampled.variation(times) < 1e-14
    fine = sampled.variation(np.linspace(0, 1, 2001))
    assert fine == pytest.approx(4 * 0.9, rel=1e-4)
    assert not fine.guaranteed
    assert process(so.Box([0, 0], [1, np.inf])).variation(times).guaranteed


class NeverRuns(so.Clarabel):
    def compile(self, program):
        raise AssertionError("a solver ran on bad input")


def test_an_empty_set_is_refused_with_its_time_before_any_solver_runs():
    C = so.Polyhedron([[1.0], [-1.0]], lambda t: [1 - t, 0.0])
    process = isotropic(C, 1.0, 1.0)
    with pytest.raises(so.EmptySetError, match=r"t = 1\.1"):
        so.solve(process, t_end=2.0, steps=20, scheme="catching-up", solver=NeverRuns())


@pytest.mark.filterwarnings("ignore::sweepopt.InitialStateWarning")
@pytest.mark.parametrize(
    "C",
    [
        so.MovingSet(lambda t: so.Point([t, t])),
        so.Polyhedron([[1, 0.5]], lambda t: [1 - 2 * np.sin(t)]),
        so.Moving(so.Ball([0, 0], 1), lambda t: [2 * t, t]) + so.Box([-1, 0], [1, 0]),
        -so.Moving(SQUARE, lambda t: [3 * t, 0], lambda t: 1 + t),
    ],
    ids=["point", "half-space", "sum", "negative"],
)
def test_the_a_priori_bound_holds_for_all_kinds_of_moving_sets(C):
    process = isotropic(C, 1.0, 0.2)
    sol = so.solve(process, t_end=2.0, steps=10, scheme="implicit-euler")
    largest = np.linalg.norm(sol.velocity, axis=1).max()
    assert 0 < largest <= process.velocity_bound(np.linspace(0, 2, 11)).value


def test_the_bound_of_a_body_at_rest_is_zero_whatever_its_constants():
    # exp(|B| T / beta) is infinite here, and nothing times it is nothing
    process = isotropic(so.Box(0, 0), 1e-20, 1.0)
    assert process.velocity_bound([0.0, 1.0]).value == 0.0


def test_beta_is_found_beside_entries_of_another_size():
    A = np.array([[5e-20, 1.5e-30, 5e-21], [1.5e-30, 4.5e-40, 0.0], [5e-21, 0.0, 4.25e-20]])
    beta = so.SweepingProcess(A, None, so.WholeSpace(3), np.zeros(3)).beta
    # the determinant of the first two unknowns alone, over the first entry
    assert beta == pytest.approx(4.5e-40 - 2.25e-60 / 5e-20, rel=0.02)


def test_a_jump_to_an_unbounded_set_is_not_of_bounded_variation():
    C = so.MovingSet(lambda t: so.Box(-1, 1 if t < 0.5 else np.inf))
    process = isotropic(C)
    for _ in "12":  # every run says so
        with pytest.warns(so.VariationWarning, match=r"t = 0\.5"):
            assert so.solve(process, t_end=1.0, steps=10).success


class Square:
    """A user's square wave as data: 1 where t is in the first half of its period, else -1."""

    def __init__(self, period, offset=0.0):
        self.period, self.offset = period, offset

    def __call__(self, t):
        return self.offset + (1.0 if t / self.period % 1 < 0.5 else -1.0)

    def breakpoints(self, a, b):
        half = self.period / 2
        points = half * np.arange(np.floor(a / half), np.ceil(b / half) + 1)
        return points[(points > a) & (points < b)]

    def variation(self, a, b):
        return 2.0 * len(self.breakpoints(a, np.nextafter(b, np.inf)))


STEP = so.Table([0, 0.7, 0.7 + 1e-12, 9], [0, 1, 3, 3])
SMOOTH = so.Sine(1.0, period=0.1)
# beside 1e5 its slow changes are a few rounding units at a time
ROUNDED = so.Table([0, 0.2, 0.2 + 1e-13, *np.linspace(0.3, 2, 35)], [0, 0, *np.linspace(1, 2, 36)])
JUMPS = [
    (so.Moving(so.Box(-1, 1), so.Separable([(STEP, 2), (SMOOTH, 1)])),
     r"C\(t\) jumps at t = 0\.7 by 2 \(center changes by 4\), in"),
    (so.Moving(so.Box(-1, 1), so.Table([0, 0.7, 0.7 + 9e-13, 9], [0, 1, 3, 3])),  # as errors advise
     r"C\(t\) jumps at t = 0\.7 by 1 \(center changes by 2\), in"),
    (so.Moving(so.Box(-1, 3), scale=so.Table([0, 0.6, np.nextafter(0.6, 1), 3], [1, 1, 2, 2])),
     r"jumps at t = 0\.6 by at most 1\.5 \(scale changes by 1\), in"),
    (so.Polyhedron([[1.0], [-1]], so.Separable([(STEP, [1, 0]), (so.Constant(), [1, 2.0])])),
     r"jumps at t = 0\.7 by at most 1 \(h changes by 2\), in"),
    (so.Moving(so.Ball(0, 9), Square(1.0), Square(4 / 3, 2.0)),
     r"t = 0\.5 by 1 \(center .* 0\.666667 by at most 9 \(scale .* t = 1 by 1 .*3 by at most 9 "),
    (so.Moving(so.Ball(0, 9), so.Separable([(Square(0.2), 0.5), (SMOOTH, 1)])),
     r"at t = 0\.1 by 0\.5 .*at t = 0\.5 .*changes by 1\), and 14 more, in the norm"),
    (so.Moving(so.Box(-1, 1), so.Separable([(ROUNDED, 1), (so.Constant(1e5), 1)])),
     r"^C\(t\) jumps at t = 0\.2 by 0\.5 \(center changes by 1\), in"),
]  # fmt: skip


@pytest.mark.parametrize(
    "C, message", JUMPS, ids=["table", "gap", "scale", "h", "square", "many", "large"]
)
@pytest.mark.filterwarnings("ignore::sweepopt.InitialStateWarning")
def test_finite_jumps_of_data_are_named_once_with_their_times_and_sizes(C, message):
    process = isotropic(C, 4.0, 1.0)
    for steps in (41, so.Adaptive(1e-2)):
        with pytest.warns(so.VariationWarning, match=message) as caught:
            assert so.solve(process, t_end=2.0, steps=steps).success
        assert sum(w.category is so.VariationWarning for w in caught) == 1


def test_the_distance_of_a_jump_that_is_not_known_is_not_made_up():
    h = so.Separable([(STEP, [1.0, 0, 0]), (so.Constant(), [1, 1, 1])])
    C = so.Polyhedron([[1.0, 0], [0, 1], [-1, -1]], h)
    with pytest.warns(so.VariationWarning, match=r"0\.7 by an unknown distance \(h changes by 2\)"):
        isotropic(C).check_jumps(0.0, 1.0)


@pytest.mark.parametrize("name, f", [("scale", STEP), ("center", so.Separable([(STEP, [1.0, 0])]))])
def test_jumps_of_what_an_intersection_is_made_of_are_named(name, f):
    C = so.Moving(so.Box([-1, -1], [1, 1]), **{name: f}) & so.Ball([0.0, 0.0], 9.0)
    with pytest.warns(so.VariationWarning, match=rf"0\.7 by an unknown .* \({name} changes"):
        isotropic(C).check_jumps(0.0, 1.0)


def test_jumps_that_do_not_move_a_part_of_an_intersection_are_none():
    center = so.Separable([(STEP, [1.0, 0]), (STEP, [-1.0, 0])])
    C = so.Moving(so.Box([-1, -1], [1, 1]), center) & so.Ball([0.0, 0.0], 9.0)
    isotropic(C).check_jumps(0.0, 1.0)


def test_steep_noisy_and_fast_loads_are_no_jumps():
    noise = so.Table(np.linspace(0, 2, 2001), np.random.default_rng(0).normal(size=2001))
    steep = so.Table([0, 0.5, 0.5 + 9e-4, 1e6], [0, 0, 9, 9])
    block(steep).check_jumps(0.0, 1e6)
    for history in (
        noise,
        so.Triangle(2.0, period=1e-6),
        so.Sine(2.0, period=1e-6),
        so.Table([0, 0.5, 0.5001, 2], [0, 0, 9, 9]),
        so.Table([0, 0.5, 0.5 + 1e-12, 2], [0, 1, 1, 9]),
        Square(9.0),
    ):
        C = so.Moving(so.Box(-1, 1), history)
        isotropic(C).check_jumps(0.0, 2.0)  # warnings are errors


class Disc(so.ConvexSet):
    """A user's disc, whose three parts can be of different radii and centres."""

    dim, offsets = 2, np.ones(1)

    def __init__(self, support=1, project=1, center=(0, 0), steps=1):
        self.radii, self.center, self.steps = (support, project), np.array(center), steps

    def support(self, z):
        return float(self.center @ z + self.radii[0] * np.linalg.norm(z))

    def project(self, w):
        away = np.asarray(w) - self.center
        far = max(np.linalg.norm(away) / self.radii[1], 1.0)
        return np.asarray(self.center + away * (1 + self.steps * (1 / far - 1)))

    def features(self, p):
        raise NotImplementedError


def agrees(C):
    """Whether the parts of the set, as far as it is looked at, are those of one set."""
    process = isotropic(C)
    process.check(np.array([0.0, 0.5, 1.0]))


HUGE = np.longdouble("1e400") if np.finfo(np.longdouble).maxexp > 1024 else Decimal("1e400")


@pytest.mark.parametrize(
    "radius, center", [(1e-9, [0, 0]), (1e9, [3e9, 0]), (0.0, [1, 2]), (3, [7, 0])]
)
def test_a_users_set_that_agrees_with_itself_is_taken(radius, center):
    D = Disc(radius, radius or 1e-300, center)
    for C in (
        D,
        -2.0 * D + [1.0, 2.0],
        so.product(D, so.Orthant(1)),
        so.Moving(D, scale=lambda t: 1 + t),
    ):
        agrees(C)


def test_many_operations_on_sets_work_or_say_what_to_do():
    v, disc, box = np.array([1e-3, 2e-3]), so.Ball([0, 0], 1), SQUARE
    for C in (disc, box, so.Polyhedron([[1, 1.0]], [1])):
        moved = C
        for _ in range(2000):
            moved = 1.0 * (moved + v)
        assert moved.support([1.0, 1.0]) == pytest.approx(C.support([1.0, 1.0]) + 6, rel=1e-12)
        assert moved.contains(C.project([9.0, 9.0]) + 2000 * v)
    many = so.Ball(0, 1)
    for _ in range(300):
        many = so.product(many, so.Ball(0, 1))
    assert many.support(np.ones(301)) == 301
    cut = wide = disc
    for _ in range(250):  # deeper than Python's stack
        cut, wide = cut & box, wide + 0.001 * box
    assert repr(cut).startswith("Intersection(dim 2, Ball(")
    assert cut.magnitude() <= np.sqrt(2)
    assert wide.support([1.0, 0.0]) == pytest.approx(1.25, rel=1e-12)
    flat = disc & box & so.HalfSpace([1.0, 0.0], 0.6)
    np.testing.assert_allclose(flat.project([9.0, 0.0]), [0.6, 0.0])
    swap, moving = [[0.0, 1], [1, 0]], so.Moving(disc, lambda t: [t, 0])
    for start, operation in (
        (moving, lambda C: C + v),
        (moving, lambda C: so.image(swap, C)),
        (disc, lambda C: so.image(swap, C)),
        (disc, lambda C: so.image(swap, C) if C.depth % 2 else C + v),
        (disc, lambda C: C & so.Ball([0, 0], 2.0) if C.depth % 2 else C + 0.01 * box),
    ):
        C = start
        while C.depth < 50:
            C = operation(C)
        with refuses("more than 50 operations on sets are nested"):
            operation(operation(C))
        process = isotropic(C)
        assert so.solve(process, t_end=1.0, steps=2).success  # as deep as is allowed


def test_a_series_is_the_array_it_is():
    s, e = pd.Series([1.0, 2.0], index=[7, 3]), [1.0, 0.0]
    for C in (so.Ball([0, 0], 1), so.Moving(so.Ball([0, 0], 1), lambda t: [t, t])):
        assert [D.at(0.0).support(e) for D in (C + s, s + C, C - s, s - C)] == [2, 2, 0, 2]
    assert so.Box(-s, s).support(s) == 5
    with refuses("scale must be one number"):
        s * C


def test_a_sparse_matrix_whose_indices_are_not_sorted_stays_as_it_is():
    pointers, indices = np.array([0, 2, 4]), np.array([1, 0, 1, 0])
    A = sp.csc_array((np.array([-1.0, 2.0, 3.0, -1.0]), indices, pointers), shape=(2, 2))
    before = A.toarray()
    for _ in range(2):
        process = so.SweepingProcess(A, None, SQUARE, np.zeros(2))
        assert np.array_equal(process.A.toarray(), before)
    assert np.array_equal(A.toarray(), before)


BOX = so.Box([-1, -1, -1], [1, 1, 1])
PLAIN = so.SweepingProcess(np.eye(3), sp.eye_array(3), so.Moving(BOX, lambda t: 3 * [t]), 3 * [0.0])
TITLED = antiplane(
    square(2),
    clamped="top",
    effects=[Viscosity(1.0), Elasticity(1.0), Friction("bottom", g=0.1)],
    title="plates <1 & 2>",
)
RUN = so.solve(PLAIN, t_end=2.0, steps=20, scheme="midpoint", save=4)
SHOWN = {
    "Box(dim 3, lower=[-1., -1., -1.], upper=[1., 1., 1.])": BOX,
    "Moving(dim 3, shape=Box(dim 3, lower=[-1., -1., -1.], upper": PLAIN.C,
    "StateDependent(dim 1, at=a function, lipschitz=0.5)": so.StateDependent(
        lambda t, u: so.Box(t - 1, t + 1), 0.5
    ),
    "Ellipsoid(dim 2, center=[0., 0.]": so.Ellipsoid([0, 0], np.eye(2)),
    "SweepingProcess     dim 3, dense": PLAIN,
    "EvolutionVI": so.EvolutionVI(np.eye(3), None, dissipation=BOX, u0=np.zeros(3)),
    "B                   2.0": so.SweepingProcess(0.5, 2.0, so.Box(-1, 1), u0=0.0),
    "dissipation         Box(dim 1, lower=-1.0, upper=1.0)": so.EvolutionVI(
        0.5, 2.0, dissipation=so.Box(-1, 1), u0=0.0
    ),
    "plates <1 & 2>": TITLED,
    "20, 5 of them kept": RUN,
    "full: a program for all unknowns": RUN.plan,
    "balance             (21,) in [": so.solve(PLAIN, t_end=2.0, steps=20).energy(),
    "Contact(unknown=": TITLED.contact,
    "Discretisation(dim 6, mesh=<skfem": TITLED.discretisation,
    "problem             minimize 0.5 * QuadForm(z": RUN.step_program(0),
    "20 steps: t, seconds, iterations": RUN.stats,
    "center=Separable(dim 3, 1": so.Moving(BOX, so.Separable([(so.Sine(3, 4), [1, 2, 3])])),
}


@pytest.mark.parametrize("words", SHOWN)
def test_objects_show_themselves_in_a_few_lines(words):
    shown = repr(SHOWN[words])
    assert words in shown
    assert "0x" not in shown
    lines = shown.splitlines()
    assert len(lines) <= 8
    assert max(map(len, lines)) < 120


def test_notebooks_show_rows_with_the_words_of_users_escaped():
    assert "<td>plates &lt;1 &amp; 2&gt;<" in TITLED._repr_html_()
    for this in (PLAIN, TITLED, RUN, RUN.plan):
        assert this._repr_html_().count("<tr>") == repr(this).count("\n") + 1
    assert so.Ball([0.0, 0.0], 1.0)._repr_html_().startswith("<pre>Ball(dim 2, center=[0., 0.]")


def test_a_class_based_on_ours_shows_our_arguments_too():
    class Spring(so.EvolutionVI):
        def __init__(self, k):
            f, D = so.Sine(1.0, 2.0), so.Box(-1.0, 1.0)
            super().__init__(A=0.5, B=k, load=f, dissipation=D, u0=0.0)
            self.k = k

    shown = dict(line.split(maxsplit=1) for line in repr(Spring(2.0)).splitlines())
    assert shown["k"] == shown["B"] == "2.0"
    assert shown["dissipation"] == repr(so.Box(-1.0, 1.0))


def test_sums_and_intersections_show_what_they_are_made_of_once_and_sum_adds_sets():
    square, disc = SQUARE, so.Ball([0, 0], 1)
    for made, name in ((sum([square, disc]), "Sum"), (square & disc, "Intersection")):
        assert " ".join(repr(made).split()) == f"{name}(dim 2, {square!r}, {disc!r})"


def test_notebooks_show_small_pictures():
    """A history, the outline of a set in the plane and of a mesh; none of what has no outline."""

    def points(this):
        lines = re.findall(r'<polyline points="([^"]*)"', this._repr_html_())
        return [np.array([p.split(",") for p in line.split()], float) for line in lines]

    (disc,) = points(so.Ball([3.0, 4.0], 2.0))
    middle = (disc.min(axis=0) + disc.max(axis=0)) / 2
    np.testing.assert_allclose(np.hypot(*(disc - middle).T), 60.0, rtol=2e-3)
    (box,) = points(so.Box([-2, -1], [2, 1]))
    np.testing.assert_allclose(abs((box - [125.0, 65.0]) / [120.0, 60.0]).max(axis=1), 1.0)
    assert not points(so.Orthant(2))
    assert not points(BOX)
    assert len(points(TITLED)) == 8  # edges of the boundary
    assert len(points(RUN)) == 3
    t = points(RUN)[0][:, 0]
    assert (np.diff(t) > 0).all()
    np.testing.assert_allclose(np.ptp(t), 300.0)


def test_a_solution_shows_a_bound_once_it_is_known_and_whether_it_is_guaranteed():
    for process, words in (
        (block(so.Sine(3.0, 4.0)), "guaranteed"),
        (PLAIN, "sampled, not guaranteed: center(t) is"),
    ):
        sol = so.solve(process, t_end=1.0, steps=10)
        assert "error bound         not asked for: sol.error_bound()" in repr(sol)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            bound = sol.error_bound()
            assert sol.error_bound() is bound
        assert [w.category for w in caught] == [so.BoundWarning] * (not bound.guaranteed)
        assert f"{bound:.4g} ({words}" in repr(bound)
        assert f"error bound         {bound!r}" in repr(sol)
