"""Bad input, generated: the library's own error or a right answer, and nothing else.

Each input ends in time in a finite, certified answer that satisfies the laws, or in a SweepoptError
with a message. No other exception, no warning of numpy, no nan. What a user's own function raises
passes through as it is. 200 inputs here, the same every time; `-m slow` draws 10,000 new ones.
"""

import fuzz_files as files
import fuzz_runs as runs
import pytest
from cases import slow
from fuzz_inputs import ANYTHING, rarely, vector
from fuzz_judge import judge
from fuzz_sets import convex, moving
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

POINTS = st.integers(1, 4).flatmap(
    lambda dim: st.tuples(rarely(convex(dim), moving(dim), 5), vector(dim), vector(dim))
)
GRID = rarely(st.just([0.0, 0.5, 1.0]), ANYTHING, 5)
RUN = st.tuples(runs.problem(), runs.options(), st.none())
LATER = st.tuples(runs.problem(), runs.options(), runs.later())
ADAPTIVE = st.tuples(
    runs.problem(), st.builds(lambda steps: {"t_end": 1.0, "steps": steps}, runs.adaptive())
)
FILE = st.one_of(
    st.tuples(files.DAMAGES, st.just([])),
    st.tuples(st.just([]), files.CHANGES),
)
# name: (inputs of 200, what is drawn, what is asked of it)
TARGETS = {
    "sets": (45, POINTS, runs.ask_set),
    "problems": (20, st.tuples(runs.problem(), GRID), runs.ask_problem),
    "runs": (40, RUN, runs.ask_run),
    "solutions": (15, LATER, runs.ask_run),
    "adaptive": (5, ADAPTIVE, runs.ask_run),
    "scenes": (30, st.tuples(files.SCENES, FILE), files.ask_scene),
    "meshes": (20, st.tuples(st.sampled_from(files.MESHES), files.DAMAGES), files.ask_mesh),
}


def profile(inputs, times):
    """The same inputs every time, or `times` as many new ones."""
    return settings(
        max_examples=inputs * times,
        derandomize=times == 1,
        deadline=None,  # `judge` has a clock of its own
        database=None,
        suppress_health_check=list(HealthCheck),
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("fuzz")
    files.write_seeds(path)
    return path


@pytest.mark.parametrize("times", [1, slow(40)])
@pytest.mark.parametrize("name", TARGETS)
def test_bad_input_gets_an_error_of_ours_or_a_right_answer(name, times, folder, monkeypatch):
    monkeypatch.chdir(folder)  # a checkpoint may be written where a hostile word names a file
    monkeypatch.setattr("sweepopt.integrate.adaptive.STEPS", 5_000)  # no hang, but long
    inputs, drawn, ask = TARGETS[name]
    place = [folder] if ask.__module__ == files.__name__ else []
    asked = 0

    @profile(inputs, times)
    @given(st.data())
    def holds(data):
        nonlocal asked
        asked += 1
        judge(lambda: ask(*place, *data.draw(drawn)))

    holds()
    assert asked >= inputs * times
