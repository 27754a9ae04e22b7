"""What fuzzing puts into the Python face: arguments of calls, mostly right, now and then hostile.

The library is called while they are drawn, under its judge. Hypothesis shows these calls where it
shows a failure: the shrunken example is a test already.
"""

from dataclasses import dataclass
from decimal import Decimal
from typing import Any

import numpy as np
import scipy.sparse as sp
from hypothesis import strategies as st

import sweepopt as so

INF, NAN = float("inf"), float("nan")
FORMATS = ("csr", "csc", "coo", "bsr", "dia", "lil", "dok")


class MineError(Exception):
    """What a user's own function raises: it passes through the library as it is."""


def call(name, *args, **keywords):
    """What a call of a name of sweepopt gives whose arguments are drawn."""
    return st.builds(getattr(so, name), *args, **keywords)


@dataclass(frozen=True)
class Late:
    """A function of time that is right before `t` and wrong from then on."""

    right: Any
    wrong: Any
    t: float

    def __call__(self, t):
        if t < self.t:
            return self.right
        if self.wrong is MineError:
            raise MineError
        return self.wrong


@dataclass(frozen=True)
class Ramp:
    """t -> t v."""

    v: tuple[float, ...]

    def __call__(self, t):
        return t * np.array(self.v)


# ---- values ---------------------------------------------------------------------------------

SIZES = [1e300, -1e155, 5e-324, 1e74, -1e74, 1e-74, 1e40, 1e-40, 1e20, 1e-20, -1e8, 1e-8]
ODD_NUMBERS = [NAN, INF, -INF, *SIZES, -1.0, 0.0, -0.0, 10**400, -(10**400), 10**30, True, None]
ODD_NUMBERS += ["1", "x", 1j, [1.0], [], np.float32(2), np.int8(3), Decimal(2), np.array([1, 2])]
ODD = [*ODD_NUMBERS, "", "auto", b"x", [[1, 2], [3]], (), {}, {"a": 1}, np.array([]), object()]
ODD += [np.zeros((2, 2)), np.zeros((1, 1, 1)), np.array("x"), np.array([1, None], dtype=object)]
ODD += [np.array([1, 2j]), np.array(["2020"], dtype="datetime64[Y]"), np.ma.array([1.0])]
ODD += [[[[[1.0]]]], [None], ["a", 1.0], range(3), {1.0}, slice(None), Ellipsis, np.nan]
RIGHT = st.sampled_from([0.5, 1.0, 2.0, 0.25, 3.0, 0.1, -1.0, 1.5, -0.5])
LONG = st.builds(pow, st.just(10), st.just(5000))  # Python refuses to print it
ANYTHING = st.one_of(*map(st.just, ODD), LONG)


@st.composite
def rarely(draw, usual, strange, odds=24):
    """Mostly the one, seldom the other; shrinks to the one."""
    return draw(strange if draw(st.integers(0, odds)) == odds else usual)


def positive(strange=True):
    usual = st.sampled_from([1.0, 0.5, 2.0, 3, 0.1, 10.0])
    return rarely(usual, st.sampled_from(ODD_NUMBERS)) if strange else usual


def number():
    return rarely(RIGHT, st.sampled_from(ODD_NUMBERS))


@st.composite
def vector(draw, dim, strange=True, low=-3.0):
    """An array_like of dim numbers, of any kind that numpy takes or does not."""
    usual = st.floats(low, 3.0, width=16)
    entries = draw(st.lists(usual, min_size=dim, max_size=dim))
    if not strange:
        return entries
    kind = draw(st.integers(0, 60)) - 30
    if kind == 30:
        return draw(ANYTHING)
    if kind == 29:
        return entries + [1.0] * draw(st.integers(1, 2))
    if kind in (27, 28):
        entries[draw(st.integers(0, dim - 1))] = draw(st.sampled_from(ODD_NUMBERS))
        return entries
    if kind == 26:
        size = draw(st.sampled_from(SIZES))
        return [entry and size for entry in entries]
    if kind > 20:
        kinds = [np.float32, np.float16, np.int8, np.longdouble, object, bool, np.uint64]
        return np.abs(np.array(entries)).astype(draw(st.sampled_from(kinds)))
    return draw(st.sampled_from([entries, np.array(entries), tuple(entries)]))


@st.composite
def definite(draw, dim, strange=True):
    """A symmetric positive definite matrix in one of many forms, or something near it."""
    shift = draw(st.sampled_from([0.5, 1.0, 3.0]))
    root = np.array(draw(st.lists(st.integers(-2, 2), min_size=dim**2, max_size=dim**2)))
    root = root.reshape(dim, dim) / 2
    M = root @ root.T + shift * np.eye(dim)
    if draw(st.booleans()):
        M = np.diag(M.diagonal())
    if not strange:
        return M
    kind = draw(st.integers(0, 40))
    if kind > 38:
        return draw(ANYTHING)
    if kind > 35:
        i, j = draw(st.tuples(*2 * [st.integers(0, dim - 1)]))
        entries = M.tolist()
        entries[i][j] = draw(st.sampled_from([0.37, *ODD_NUMBERS]))
        entries[j][i] = entries[i][j] if kind > 36 else entries[j][i]
        return entries
    if kind == 35:
        return draw(st.sampled_from([M[:-1], M[:, :-1], M.ravel(), M[None], -M, 0 * M, M - shift]))
    if kind > 32:
        scales = np.array(draw(st.lists(st.sampled_from(SIZES), min_size=dim, max_size=dim)))
        with np.errstate(all="ignore"):
            return np.abs(scales[:, None]) ** 0.5 * M * np.abs(scales) ** 0.5
    if kind > 30:
        kinds = [np.float32, np.float16, np.int8, np.longdouble, object, complex, bool]
        return M.astype(draw(st.sampled_from(kinds)))
    if kind > 20:
        return draw(sparse(M))
    return draw(st.sampled_from([M, M.tolist(), np.asfortranarray(M), 0.5 * M]))


@st.composite
def sparse(draw, M):
    """M in any sparse format: entries in two parts, explicit zeros, now and then a wrong one."""
    rows, columns = (np.tile(axis.ravel(), 2) for axis in np.indices(M.shape))
    data = np.tile(M.ravel() / 2, 2)
    if not draw(st.integers(0, 6)):
        data[draw(st.integers(0, len(data) - 1))] = draw(st.sampled_from([NAN, INF, 1e300]))
        return sp.coo_array((data, (rows, columns)), M.shape)
    form = draw(st.sampled_from(FORMATS))
    dtype = draw(rarely(st.just(float), st.sampled_from([np.float32, complex, int]), 6))
    return sp.coo_matrix((data.astype(dtype), (rows, columns)), shape=M.shape).asformat(form)


# ---- histories ------------------------------------------------------------------------------


def entries(t):
    """How many there are in the first axis and below, ragged or not."""
    return np.array(t, dtype=object).size


def history():
    """Scalar functions of time as data."""
    n = number()
    times = rarely(st.sampled_from([[0.0, 1.0], [0, 0.5, 1, 4], [-1, 9]]), vector(3))
    return st.one_of(
        call("Constant", n),
        call("Polynomial", st.integers(1, 4).flatmap(vector)),
        call("Sine", n, positive(), n, n),
        call("Triangle", n, positive()),
        times.flatmap(lambda t: call("Table", st.just(t), vector(entries(t) or 1))),
    )


@st.composite
def function(draw, dim):
    """A function of time: data, a plain one, one that goes wrong."""
    kind = draw(st.integers(0, 9))
    if kind < 4:
        wrong_phi = st.sampled_from([3.0, None, Late(1.0, NAN, 0.5), Late(1.0, MineError, 0.5)])
        pair = st.tuples(rarely(history(), wrong_phi), vector(dim))
        terms = st.lists(rarely(pair, ANYTHING, 60), min_size=1, max_size=2)
        return draw(call("Separable", rarely(terms, ANYTHING, 60)))
    right = draw(vector(dim, strange=False))
    if kind < 8:
        return Ramp(tuple(right))
    wrong = draw(st.one_of(ANYTHING, vector(dim), st.just(MineError)))
    return Late(right, wrong, draw(st.sampled_from([0.0, 0.3, 0.6, 0.95])))
