"""The problems of the studies; test_reference and test_exact compare them with exact values."""

import numpy as np
from reference_cases import SETS

from sweepopt.study.problems import PROBLEMS, problem


def test_there_is_a_problem_for_every_reference_case_and_a_burst():
    assert {*PROBLEMS} == {*SETS, "H18", "block"}


def test_a_spiral_varies_at_most_as_it_says():
    history = problem("B14").process().C.center.terms[0][0]
    for a, b in ((0.0, 6.0), (1.0, 1.5), (5.9, 6.0)):
        sampled = np.abs(np.diff(history(np.linspace(a, b, 20_001)))).sum()
        assert sampled <= history.variation(a, b) <= 2.2 * sampled
