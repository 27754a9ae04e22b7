"""The problems of the studies are the reference cases; their sets meet the exact values."""

import numpy as np
import pytest
from cases import SETS, case

import sweepopt as so
from sweepopt.study.problems import PROBLEMS, problem


@pytest.mark.parametrize("name", SETS)
def test_a_problem_is_the_reference_case_of_its_name(name):
    this, given = problem(name), case(name)
    process, reference = this.process(), given.process
    assert this.t_end == given.t_end
    assert np.allclose(process.u0, reference.u0, rtol=1e-15)
    assert np.allclose(process.A, reference.A, rtol=1e-15)
    assert (process.B is None) == (reference.B is None)
    assert process.B is None or np.allclose(process.B, reference.B, rtol=1e-15)


def test_there_is_a_problem_for_every_reference_case_and_a_burst():
    assert list(PROBLEMS) == [*SETS, "H18", "block"]
    with pytest.raises(so.InputError, match=r"problem must be one of S01, S02, .*; got 'S99'"):
        problem("S99")


def test_a_spiral_varies_at_most_as_it_says():
    history = problem("B14").process().C.center.terms[0][0]
    for a, b in ((0.0, 6.0), (1.0, 1.5), (5.9, 6.0)):
        sampled = np.abs(np.diff(history(np.linspace(a, b, 20_001)))).sum()
        assert sampled <= history.variation(a, b) <= 2.2 * sampled
