"""Sets: shapes, expressions in them, and sets that move."""

import operator
from dataclasses import dataclass

import cvxpy as cp
import numpy as np
from fuzz_inputs import (
    ANYTHING,
    NAN,
    Late,
    MineError,
    call,
    definite,
    function,
    history,
    number,
    positive,
    rarely,
    vector,
)
from hypothesis import strategies as st

import sweepopt as so


@dataclass(frozen=True)
class Built:
    """Constraints in cvxpy: a unit ball, or what is none."""

    what: str

    def __call__(self, w):
        if self.what == "fails":
            raise MineError
        many = {"ball": [cp.norm(w) <= 1], "empty": [w >= 1, w <= 0], "concave": [cp.norm(w) >= 1]}
        return many.get(self.what, self.what)


UNIT_BALL = Built("ball")
NO_CONSTRAINTS = [Built("empty"), Built("concave"), Built("fails"), Built("words"), None]


@st.composite
def shape(draw, dim, strange=True):
    """A set that does not move, of the dimension that is asked for if all is right."""
    size = positive(strange)
    center, ones = vector(dim, strange), vector(dim, False, low=0.0)
    sign = st.sampled_from([1.0, -1.0])
    count = st.just(dim) if not strange else rarely(st.just(dim), ANYTHING, 60)
    rows = draw(st.integers(1, 4))
    G = st.lists(vector(dim, strange), min_size=rows, max_size=rows)
    block = 2 if dim % 2 == 0 and draw(st.booleans()) else 1
    kinds = [
        lambda: ones.map(lambda u: so.Box([-x for x in u], u)),
        lambda: call("Ball", center, size),
        lambda: call("Balls", vector(dim // block, strange, low=0.0), st.just(block)),
        lambda: call("Ellipsoid", center, definite(dim, strange)),
        lambda: call("Point", center),
        lambda: call("Orthant", count),
        lambda: call("SecondOrderCone", count),
        lambda: call("WholeSpace", count),
        lambda: call("Box", center, center),
        lambda: call("Polytope", G),
        lambda: call("Polyhedron", G, vector(rows, strange, low=0.0)),
        lambda: call("HalfSpace", st.lists(sign, min_size=dim, max_size=dim), size),
    ]
    if strange and draw(st.integers(0, 60)) == 60:
        return draw(call("Constraints", count, st.sampled_from([UNIT_BALL, *NO_CONSTRAINTS])))
    return draw(kinds[draw(st.integers(0, len(kinds) - 1))]())


@st.composite
def convex(draw, dim, depth=2):
    """A set, or an expression in sets."""
    kind = draw(st.integers(0, 11)) if depth else 0
    if kind < 5:
        return draw(shape(dim))
    part = convex(dim, depth - 1)
    one = draw(part)
    if kind == 5:
        return one + draw(rarely(vector(dim), ANYTHING, 20))
    if kind == 6:
        return draw(number()) * one
    if kind == 7:
        return -one
    if kind == 8:
        return one + draw(part)
    if kind == 9:
        return one & draw(part)
    if kind == 10 and dim > 1:
        return so.product(draw(convex(1, depth - 1)), draw(convex(dim - 1, depth - 1)))
    few = draw(st.integers(1, dim))
    M = draw(
        rarely(st.just(np.eye(dim)[:, :few]), st.lists(vector(few), min_size=dim, max_size=dim), 2)
    )
    return so.image(M, draw(convex(few, depth - 1)))


@st.composite
def moving(draw, dim):
    """C(t) in every form."""
    kind = draw(st.integers(0, 9))
    if kind < 5:
        scale = rarely(st.none(), st.one_of(positive(), history(), st.just(Late(1.0, NAN, 0.5))), 5)
        center = rarely(function(dim), st.one_of(vector(dim), st.none()), 6)
        return draw(call("Moving", rarely(shape(dim), convex(dim), 4), center, scale))
    if kind == 5:
        G = np.vstack([np.eye(dim), -np.eye(dim)])
        return so.Polyhedron(G, draw(rarely(function(2 * dim), ANYTHING)))
    if kind == 7:
        one = draw(moving(dim))
        other = draw(st.one_of(moving(dim), vector(dim), number()))
        name = draw(st.sampled_from(["add", "mul", "and_", "sub"]))
        return getattr(operator, name)(one, other)
    if kind == 8:
        name = draw(st.sampled_from(["image", "product"]))
        if name == "image":
            return draw(call("image", definite(dim), moving(dim)))
        return draw(call("product", moving(dim)))
    if kind == 6:
        late = Late(draw(shape(dim)), draw(st.one_of(shape(dim), shape(dim + 1), ANYTHING)), 0.5)
        return so.MovingSet(late, *draw(st.sampled_from([(), (dim,)])))
    return draw(convex(dim))
