"""What is known of each step takes little memory, and is used as an array."""

from __future__ import annotations

import tracemalloc
from typing import Any

import numpy as np
import pandas as pd
import pytest

import sweepopt as so
from sweepopt.integrate.record import STATS


def slider(steps: int, **how: Any) -> so.Solution:
    C = so.Moving(so.Box([-1], [1]), center=so.Separable([(so.Sine(3.0, 4.0), [1.0])]))
    process = so.SweepingProcess([[0.5]], [[2.0]], C, [0.0])
    return so.solve(process, t_end=steps / 100, steps=steps, **how)


def test_all_columns_are_those_of_one_array() -> None:
    table = slider(40).stats
    assert table.dtype == STATS
    assert table.shape == (40,)
    assert table["t"] == pytest.approx(0.01 * np.arange(1, 41))
    assert set(table["solver"]) == {"closed form"}
    assert (table["seconds"] > 0).all()
    assert (table["relative"] < 1e-12).all()
    assert len(pd.DataFrame(table).columns) == len(STATS)


def test_a_run_keeps_less_than_fifty_bytes_a_step() -> None:
    steps = 10_000
    slider(10)
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    sol = slider(steps, save="last")
    grown = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    assert sol.success
    assert grown < 50 * steps, f"{grown / steps:.0f} bytes a step"
