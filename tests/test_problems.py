"""The problems of the studies; test_reference and test_exact compare them with exact values."""

import numpy as np

from sweepopt.study.problems import problem


def test_a_spiral_varies_at_most_as_it_says():
    history = problem("B14").process().C.center.terms[0][0]
    for a, b in ((0.0, 6.0), (1.0, 1.5), (5.9, 6.0)):
        sampled = np.abs(np.diff(history(np.linspace(a, b, 20_001)))).sum()
        assert sampled <= history.variation(a, b) <= 2.2 * sampled
