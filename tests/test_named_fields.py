"""Unknowns that have names."""

import numpy as np
import pytest

import sweepopt as so


def process(fields):
    C = so.Moving(so.Box([-1, -1, -1], [1, 1, 1]), lambda t: [2 * t, 3 * t, -2 * t])
    return so.SweepingProcess(np.eye(3), np.eye(3), C, np.zeros(3), fields)


def test_a_field_is_its_part_of_the_solution_and_of_the_dataset():
    sol = so.solve(process({"u": slice(0, 2), "p": slice(2, 3)}), t_end=1.0, steps=10)
    assert (sol.field("p").u == sol.u[:, 2:]).all()
    assert (sol.field("u").velocity == sol.velocity[:, :2]).all()
    data = sol.to_xarray()
    assert (data.u.values[:, data.field.values == "u"] == sol.u[:, :2]).all()
    assert "field" not in so.solve(process(None), t_end=1.0, steps=10).to_xarray()
    with pytest.raises(so.InputError, match=r"no field 'q'; its fields are u, p"):
        sol.field("q")
