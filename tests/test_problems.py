"""The problems of the studies; test_reference and test_exact compare them with exact values."""

import numpy as np
import pytest
from cases import REFERENCE, SETS

import sweepopt as so
from sweepopt.study.problems import PROBLEMS, problem


@pytest.mark.parametrize("name", SETS)
def test_a_problem_has_the_matrices_the_start_and_the_end_of_its_reference_case(name):
    this, data = problem(name), REFERENCE[name]
    assert this.t_end == data["T"]
    B = np.zeros(np.shape(data["B"])) if this.B is None else this.B
    for given, expected in ((this.A, data["A"]), (B, data["B"]), (this.u0, data["u0"])):
        np.testing.assert_allclose(given, expected, rtol=1e-15)


def test_there_is_a_problem_for_every_reference_case_and_a_burst():
    assert {*PROBLEMS} == {*SETS, "H18", "block"}
    with pytest.raises(so.InputError, match=r"problem must be one of S01, S02, .*; got 'S99'"):
        problem("S99")


def test_a_spiral_varies_at_most_as_it_says():
    history = problem("B14").process().C.center.terms[0][0]
    for a, b in ((0.0, 6.0), (1.0, 1.5), (5.9, 6.0)):
        sampled = np.abs(np.diff(history(np.linspace(a, b, 20_001)))).sum()
        assert sampled <= history.variation(a, b) <= 2.2 * sampled
