"""Bad input to the problems and the driver: our own error, which names the culprit."""

import contextlib
import io
import re
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.sparse as sp
from cases import SQUARE, refuses

import sweepopt as so

EYE = np.eye(2)
BOX = SQUARE


def process(A=EYE, B=EYE, C=BOX, u0=(0, 0)):
    return so.SweepingProcess(A, B, C, u0)


def vi(A=EYE, B=EYE, **others):
    return so.EvolutionVI(A, B, **{"u0": [0, 0], **others})


def run(problem=None, **others):
    problem = process() if problem is None else problem
    return so.solve(problem, **{"t_end": 1.0, "steps": 4, **others})


def sparse_with(value):
    return sp.csr_array(np.array([[1.0, value], [value, 1.0]]))


class Sublinear(so.Ball):
    """A user's set whose support function is wrong."""

    def support(self, z):
        return super().support(z) + 1.0


REFUSED = {}
"""Of data/refused.txt, by module: what somebody writes in it, and words of the error."""
for line in (Path(__file__).parent / "data" / "refused.txt").read_text("utf-8").splitlines():
    if line.startswith("# "):
        calls = REFUSED.setdefault(line[2:], [])
    elif line.startswith("    "):
        calls[-1][1].append(line[4:])
    elif line:
        calls.append((line, []))


OF_ONES_OWN = ("lambda", "of_own(", "scale=so.Table([0, 1], [1, -1])")
"""Where what a user's own function raised is shown first, or that a set is empty, and then why."""


def shows_another(error):
    """Whether a traceback has two errors: this one, and before it one that adds nothing."""
    return error.__cause__ or (error.__context__ and not error.__suppress_context__)


@pytest.mark.filterwarnings("ignore::sweepopt.InitialStateWarning")
@pytest.mark.parametrize("module", REFUSED)
def test_bad_input_is_refused_by_name(module):
    names, wrong = vars(import_module(module)), []
    for call, (first, *more) in REFUSED[module]:
        try:
            kind, said, alone = "not refused", str(eval(call, names)), True
        except Exception as error:
            kind, said, alone = type(error).__name__, str(error), not shows_another(error)
        name, _, words = first.partition(": ")
        assert words
        assert issubclass(getattr(so.errors, name), so.SweepoptError)
        told = kind == name and all(re.search(pattern, said) for pattern in (words, *more))
        if not (told and (alone or any(one in call for one in OF_ONES_OWN))):
            wrong.append((call, kind, said, alone))
    assert wrong == []


def test_an_asymmetry_of_rounding_is_taken_out():
    A = process(A=[[1, 0.5], [np.nextafter(0.5, 1), 1]]).A
    assert A[0, 1] == A[1, 0] == pytest.approx(0.5)


def test_what_a_callback_returns_is_a_yes_or_a_no():
    for wrong in (np.zeros(2), np.ones(3), "stop"):
        with refuses("callback must return True to stop"):
            run(callback=lambda _, wrong=wrong: wrong)
    for right in (None, False, np.False_, 0, np.zeros(1)):
        assert run(callback=lambda _, right=right: right).status is so.Status.SUCCESS
    for stop in (True, np.True_, 1):
        sol = run(callback=lambda _, stop=stop: stop)
        assert sol.status is so.Status.STOPPED
        assert len(sol.stats) == 1


BARE = SimpleNamespace(write=len)  # the least that `print` and redirect_stdout ask of a stream


@pytest.mark.parametrize("stream", [BARE, io.StringIO(), None], ids=["bare", "text", "none"])
@pytest.mark.parametrize("solver", ["osqp", "cvxpy"])
def test_output_may_be_redirected_to_anything(stream, solver):
    with contextlib.redirect_stdout(stream):
        assert run(process(C=so.Moving(BOX, lambda t: [3 * t, t])), solver=solver).success
    assert not isinstance(stream, io.StringIO) or not stream.getvalue()
