"""Loads know their exact variation and kinks; bad tables are refused with file, column and row."""

from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from cases import block, isotropic, refuses

import sweepopt as so
from sweepopt import Constant, Polynomial, Separable, Sine, Table, Triangle

HISTORIES = [
    Constant(2.0),
    Sine(1.5, period=0.7),
    Sine(-0.4, period=3.0, phase=1.1, offset=0.2),
    Triangle(2.0, period=1.3),
    Triangle(-1.0, period=40.0),
    Table([-1.0, 0.5, 0.75, 2.0, 9.0], [0.0, 3.0, 3.0, -1.0, 5.0]),
]
RATES = [*(phi.rate() for phi in HISTORIES), Polynomial([1.0, 0.0, -0.2, 0.01]).rate()]
INTERVALS = [(0.0, 8.0), (0.31, 0.32), (-0.9, 0.1), (0.5, 2.0), (1.0, 1.0), (3.3, 7.77)]


@pytest.mark.parametrize("phi", HISTORIES, ids=str)
def test_the_rate_of_a_history_is_its_slope(phi):
    a, b = -0.9, 8.0
    t = np.union1d(np.linspace(a, b, 100_001), phi.breakpoints(a, b))
    rate, middle = phi.rate(), (t[1:] + t[:-1]) / 2
    np.testing.assert_allclose(rate(middle), np.diff(phi(t)) / np.diff(t), atol=1e-6)
    assert isinstance(rate(0.3), float)
    for end in phi.breakpoints(a, b):  # from the left where it jumps, also at a time next to it
        assert rate(float(np.nextafter(end, b))) == pytest.approx(rate(end - 1e-6))


@pytest.mark.parametrize("phi", [*HISTORIES, *RATES], ids=str)
def test_variation_is_that_of_a_fine_sampling_additive_and_straight_between_breakpoints(phi):
    for a, b in INTERVALS:
        t = np.union1d(np.linspace(a, b, 100_001), phi.breakpoints(a, b))
        sampled = np.abs(np.diff(phi(t))).sum()
        assert phi.variation(a, b) == pytest.approx(sampled, rel=1e-6, abs=1e-12)
        assert phi.variation(a, b) >= sampled - 1e-12 * (1 + sampled)
    cuts = np.linspace(-0.7, 8.9, 38)
    pieces = sum(phi.variation(a, b) for a, b in pairwise(cuts))
    assert pieces == pytest.approx(phi.variation(cuts[0], cuts[-1]), rel=1e-12, abs=1e-14)
    cuts = phi.breakpoints(-0.5, 8.5)
    assert np.all((cuts > -0.5) & (cuts < 8.5))
    if not isinstance(phi, (Sine, Polynomial)):
        ends = np.concatenate([[-0.5], cuts, [8.5]])
        early, middle, late = (ends[:-1] + share * np.diff(ends) for share in (0.25, 0.5, 0.75))
        np.testing.assert_allclose(phi(middle), (phi(early) + phi(late)) / 2, atol=1e-12)


def test_a_table_answers_inside_its_range_and_at_its_ends_up_to_rounding():
    table = Table([0.1, 0.7], [1.0, 3.0])
    assert table(0.1 + 6 * 0.1) == 3.0  # 0.7000000000000001
    for t in (0.0999, 0.70001):
        with refuses(r"outside the table, which covers \[0.1, 0.7\]"):
            table(t)


FAR = 2.0**80  # beyond 64-bit integers


@pytest.mark.parametrize(
    "phi, a, b, variation",
    [
        (Sine(1.0, period=1e-3), 0.0, 1e6, 4e9),  # a billion periods
        (Triangle(1.0, period=1e-3), 0.0, 1e6, 4e9),
        (Triangle(1.0, 2.0**70), FAR, FAR + 2.0**70, 4.0),
        (Triangle(0.5, 3.0), 0.0, 1e40, 2e40 / 3.0),
        (Polynomial([-0.0]), 0.0, 2.5, 0.0),
        # the last coefficient is nothing beside the others, but it would make the roots overflow
        (Polynomial([-1.5, 3.0, 5e-324]), 0.0, 2.0, 6.0),
        (Polynomial([0.0, 2e8, -1e8]), 0.0, 2.0, 2e8),
    ],
)
def test_variations_are_known_in_closed_form(phi, a, b, variation):
    assert phi.variation(a, b) == pytest.approx(variation, rel=1e-15)
    if a == FAR:
        assert phi.breakpoints(a, b).size == 2


def test_a_product_of_histories_bounds_its_values_and_their_variation():
    waves = [so.Sine(1.0, 1.3, 0.4, 0.2), so.Triangle(2.0, 0.9), so.Polynomial([0.5, -1.0, 0.7])]
    table = so.Table([0.0, 0.4, 1.1, 2.0], [0.0, 1.0, -0.5, 1.5])
    for phi in (so.Modulated(wave, envelope) for wave in waves for envelope in (table, waves[0])):
        for a, b in ((0.0, 2.0), (0.3, 0.45), (1.0, 1.7)):
            t = np.linspace(a, b, 2001)
            np.testing.assert_array_equal(phi(t), phi.wave(t) * phi.envelope(t))
            fine = np.abs(np.diff(phi(t))).sum()
            assert fine <= phi.variation(a, b) <= 10 * fine
            assert np.abs(phi(t)).max() <= phi.largest(a, b)
    with refuses("the rate of Modulated"):
        phi.rate()
    process = block(phi, 1.0, 1.0)
    with refuses("a Modulated history has no closed form"):
        so.solve(process, t_end=1.0, steps=2, scheme="exact")
    late = so.Moving(so.Box(-1.0, 1.0), so.Modulated(waves[0], table))
    process = isotropic(late, 1.0, 1.0)
    with refuses(r"the table, which covers \[0, 2\]"):
        so.solve(process, t_end=3.0, steps=6)


def test_a_table_and_its_load_cannot_be_changed_afterwards():
    times, shape = np.array([0.0, 1.0]), np.array([1.0, 2.0])
    f = Separable([(Table(times, [0.0, 1.0]), shape)])
    times[1] = shape[0] = 7.0
    np.testing.assert_array_equal(f(1.0), [1.0, 2.0])
    with pytest.raises(ValueError, match="read-only"):
        f.terms[0][1][0] = 3.0


def test_a_separable_load_is_its_sum_and_bounds_its_variation():
    shapes = np.array([[1.0, 0.0, 2.0], [0.5, -1.0, 0.0]])
    f = Separable(zip((Sine(2.0, period=3.0), Triangle(1.0, period=2.0)), shapes, strict=True))
    assert f.dim == 3
    np.testing.assert_array_equal(f.shapes, shapes.T)
    np.testing.assert_allclose(
        f(0.4), 2 * np.sin(2 * np.pi * 0.4 / 3) * shapes[0] + 0.8 * shapes[1]
    )
    t = np.linspace(0.0, 5.0, 2001)
    path = np.linalg.norm(np.diff([f(s) for s in t], axis=0), axis=1).sum()
    assert path <= f.variation(0.0, 5.0)
    twice = f.variation(0.0, 5.0, norm=lambda force: 2 * np.linalg.norm(force))
    assert twice == pytest.approx(2 * f.variation(0.0, 5.0))
    np.testing.assert_allclose(f.breakpoints(0.0, 2.0), [0.5, 1.5])


@pytest.mark.parametrize("value", [2, 2.0, np.float32(2), np.int64(2), np.array([2.0]), [[2]]])
def test_one_number_in_any_wrapping_is_a_value_of_a_history(value):
    assert Separable([(lambda t: value, [1.0, 3.0])])(0.0).tolist() == [2.0, 6.0]


@pytest.mark.parametrize(
    "text",
    [
        "\ufeff# a log, units in the header\n\n t , f ,note\n0,1,x\n0.5,2.5,\n2,-1,y\n",
        "x,time,f\n9,0,1\n9,0.5,2.5\n9,2,-1",
        "seconds,x,f\n0,9,1\n0.5,9,2.5\n2,9,-1",
        "f,when,x\n1,0,9\n2.5,0.5,9\n-1,2,9",
    ],
)
def test_a_csv_column_becomes_a_table_whatever_the_column_of_times_is_called(text, tmp_path):
    (tmp_path / "log.csv").write_text(text)
    table = Table.from_csv(tmp_path / "log.csv", "f", scale=2.0)
    np.testing.assert_array_equal(table.times, [0.0, 0.5, 2.0])
    np.testing.assert_array_equal(table.values, [2.0, 5.0, -2.0])


def from_csv(text):
    """A column of a file of this text, for data/refused.txt."""
    with TemporaryDirectory() as place:
        path = Path(place) / "log.csv"
        if text is not None:
            path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return Table.from_csv(path, "f2")


def test_histories_of_any_kind_are_checked_and_used_one_time_at_a_time():
    class Step:
        def __call__(self, t):
            return 1.0 if t < 1 else 2.0

        def variation(self, a, b):
            return 1.0

        def breakpoints(self, a, b):
            return np.array([1.0])

    black_box = Separable([(lambda t: t**2, [1.0])])
    assert black_box(3.0) == [9.0]
    assert black_box.breakpoints(0.0, 1.0).size == 0
    with refuses(r"terms\[0\].* does not tell its variation"):
        black_box.variation(0.0, 1.0)
    load = so.Separable([(Step(), 1.0), (so.Sine(1.0, 4.0), 0.0)])
    times = np.array([0.5, 1.5])
    assert load.values(times).tolist() == [load.coefficients(t).tolist() for t in times]
    assert load.values(times)[:, 0].tolist() == [1.0, 2.0]
    assert so.solve(block(so.Table([0, 5], [0, 7])), t_end=5.0, steps=20).success


def test_a_ramp_of_two_points_never_turns_and_its_run_has_a_bound():
    ramp = Table([0.0, 1.0], [0.0, 2.0])
    assert ramp.turning_points(0.0, 1.0).size == 0
    sol = so.solve(block(ramp), t_end=1.0, steps=50)
    bound = sol.error_bound()
    assert bound.guaranteed
    assert bound < 1e-2


def test_a_table_may_end_before_the_run_if_the_users_function_does_not_ask_it_there():
    table = Table([0.0, 1.0], [0.0, 2.0])
    C = so.MovingSet(lambda t: so.Box(-1, 1) + table(min(t, 1.0)), histories=[table])
    sol = so.solve(isotropic(C, 0.5, 2.0), t_end=2.0, steps=40)
    assert sol.success
