"""Every law over every set of the zoo; then the numbers, the hard cases and malformed input."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.laws import LAWS, ZOO

SEEDS = st.integers(0, 2**20)


@pytest.mark.parametrize("name", ZOO)
@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.__name__)
def test_every_set_obeys_every_law(law, name) -> None:
    @settings(derandomize=True, deadline=None, max_examples=LAWS[law], database=None)
    @given(SEEDS)
    def holds(seed: int) -> None:
        import numpy as np

        law(ZOO[name], ZOO[name].sample(seed), np.random.default_rng(seed + 1))

    holds()
