"""What is known of each step takes little memory, and is used as an array."""

from __future__ import annotations

import tracemalloc
from typing import Any

import numpy as np
import pytest

import sweepopt as so
from sweepopt.statistics import STATS


def slider(steps: int, **how: Any) -> so.Solution:
    C = so.Moving(so.Box([-1], [1]), center=so.Separable([(so.Sine(3.0, 4.0), [1.0])]))
    process = so.SweepingProcess([[0.5]], [[2.0]], C, [0.0])
    return so.solve(process, t_end=steps / 100, steps=steps, **how)


def test_all_columns_and_rows_are_those_of_one_array() -> None:
    stats = slider(40).stats
    table = np.asarray(stats)
    assert table.dtype == stats.dtype == STATS
    assert table.shape == stats.shape == (len(stats),) == (40,)
    for name in STATS.names or ():
        assert stats[name].dtype == STATS[name]
        assert (stats[name] == table[name]).all()
        assert stats[name].tobytes() == stats.copy()[name].tobytes()
    assert table["t"] == pytest.approx(0.01 * np.arange(1, 41))
    assert stats[3] == table[3]
    assert stats[-1]["solver"] == table["solver"][-1] == "closed form"
    assert (stats[5:9] == table[5:9]).all()
    assert (stats[["t", "solver"]] == table[["t", "solver"]]).all()
    assert [row["t"] for row in stats] == table["t"].tolist()
    with pytest.raises(ValueError, match="no field of name"):
        stats["tee"]


def test_a_run_keeps_less_than_fifty_bytes_a_step() -> None:
    steps = 10_000
    slider(10)
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    sol = slider(steps, save="last")
    grown = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    assert len(sol.stats) == steps
    assert grown < 50 * steps, f"{grown / steps:.0f} bytes a step"
