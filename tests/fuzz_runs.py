"""Problems and runs, and what is asked of them."""

from contextlib import suppress

import numpy as np
from fuzz_inputs import (
    ANYTHING,
    INF,
    NAN,
    ODD_NUMBERS,
    Late,
    call,
    definite,
    function,
    rarely,
    vector,
)
from fuzz_judge import check_run
from fuzz_sets import convex, moving, shape
from hypothesis import strategies as st

import sweepopt as so

# ---- sets and histories ---------------------------------------------------------------------


def ask_set(C, z, w):
    """Support and projection are finite and fit: w - P(w) is normal to C at P(w)."""
    if isinstance(C, so.MovingSet):
        C = C.at(0.5)
    if not isinstance(C, so.ConvexSet):
        return  # a hostile value in place of a set
    C.require_nonempty()
    sigma, P, Z = C.support(z), C.project(w), C.project(z)
    assert isinstance(sigma, float)
    assert sigma == sigma, "support is nan"
    assert P.shape == (C.dim,)
    assert np.isfinite(P).all(), "projection is not finite"
    w = np.asarray(w, dtype=float).ravel()
    size = np.linalg.norm(np.abs(P)) + np.linalg.norm(w) + np.linalg.norm(Z)
    if not np.isfinite(size * size):
        return
    if not C.exact:  # a program's accuracy is in units of the set
        size += float(np.abs(C.offsets).max(initial=0.0))
    slack = (1e-9 if C.exact else 1e-4) * size + 1e-300
    assert np.linalg.norm(C.project(P) - P) <= slack, "projected twice is not projected once"
    assert (w - P) @ (Z - P) <= slack * size, "another point of the set is nearer"
    assert C.contains(P, tol=10 * slack)
    magnitude = C.magnitude()
    assert magnitude >= np.linalg.norm(P) * (1 - 1e-6) - slack, "a point outside of the magnitude"
    assert C.distance_bound(C) == 0
    with suppress(so.InputError):
        C.polar()


# ---- problems and runs ----------------------------------------------------------------------


@st.composite
def problem(draw, dim=None):
    """A process or a variational inequality."""
    dim = draw(st.integers(1, 3)) if dim is None else dim
    u0 = rarely(st.just([0.0] * dim), vector(dim), 3)
    still = draw(st.integers(0, 9)) == 0
    A = st.just(np.zeros((dim, dim))) if still else definite(dim)
    B = rarely(definite(dim), rarely(st.none(), ANYTHING, 9), 6)
    if draw(st.integers(0, 2)):
        C = rarely(moving(dim), ANYTHING, 60)
        return draw(call("SweepingProcess", A, B, C, u0))
    given = {
        "load": rarely(function(dim), st.one_of(st.none(), vector(dim), ANYTHING), 5),
        "dissipation": rarely(
            shape(dim), rarely(st.none(), st.one_of(convex(dim), ANYTHING), 2), 3
        ),
        "cone": rarely(st.none(), st.one_of(shape(dim), ANYTHING), 3),
    }
    return draw(call("EvolutionVI", A, B, u0=u0, **given))


SOLVERS = ["auto", "clarabel", "osqp", "newton", "daqp", "active-set", "cvxpy"]
SCHEMES = ["auto", "catching-up", "implicit-euler", "midpoint", "trapezoid", "sdirk2", "exact"]
TIMES = [[0, 0.5, 1], [0.0, 0.1, 1.0], [0, 0.5, 0.2], [1, 0], [0, NAN], [0, 1, 1], [[0, 1]], [0]]
TIMES += [[0, 1e-300, 1], [-1, 0, 1], [0, 1e300], np.array([0, 1]), [0, INF], [0.5, "1"], range(4)]
COUNTS = [0, -1, True, 2.5, 10**400, 10**15, 10**9, np.int64(3), "4", None, [], NAN, [1, 2, 3]]
SAVES = ["last", 2, 0, -1, 10**20, [1.0], [0.33], "x.txt", "/nowhere/x.nc", print, {}, [], NAN]
SOLVED = [so.Clarabel(tol=1e-10), so.OSQP(max_iter=50), so.Newton(), so.Cvxpy("SCS"), so.Clarabel]


@st.composite
def options(draw):
    """Arguments of solve, most left out."""
    odd = {
        "t_end": st.sampled_from([*ODD_NUMBERS, 1e-9, 1e9, 100.0]),
        "steps": st.sampled_from([*TIMES, *COUNTS]),
        "scheme": rarely(st.sampled_from(SCHEMES), ANYTHING, 3),
        "solver": rarely(st.sampled_from(SOLVERS), st.one_of(st.sampled_from(SOLVED), ANYTHING), 3),
        "tol": st.sampled_from([*ODD_NUMBERS, 1e-3, 1e-9, 1e-15]),
        "path": rarely(st.sampled_from(["full", "eliminated", "proportional"]), ANYTHING, 3),
        "save": rarely(st.sampled_from(SAVES), ANYTHING, 3),
        "memory": st.sampled_from([*ODD_NUMBERS, 100]),
        "error": st.sampled_from([*ODD_NUMBERS, 0.5, 1e-2]),
        "on_failure": rarely(st.just("stop"), ANYTHING, 1),
        "on_unstable": rarely(st.sampled_from(["warn", "ignore"]), ANYTHING, 1),
        "checkpoint": ANYTHING,
        "callback": rarely(st.just(len), ANYTHING, 1),
    }
    chosen = {"t_end": 1.0, "steps": draw(st.integers(1, 4))}
    names = draw(st.lists(st.sampled_from(list(odd)), max_size=2, unique=True))
    return chosen | {name: draw(odd[name]) for name in names}


@st.composite
def adaptive(draw):
    """Steps that are chosen."""
    tol = rarely(st.sampled_from([0.5, 0.1, 0.02]), st.sampled_from(ODD_NUMBERS), 5)
    limit = rarely(st.none(), st.sampled_from([*ODD_NUMBERS, 0.2]), 4)
    return draw(call("Adaptive", tol, limit, limit))


def ask_run(process, chosen, later=None):
    """A run is finite and certified, its velocities satisfy the inclusion by the set's laws."""
    sol = so.solve(process, **chosen)
    check_run(sol)
    if later is not None:
        ask_later(sol, *later)


def later():
    """What is asked of a solution afterwards."""
    times = rarely(st.sampled_from([0.5, [0.0, 1.0], [0.25, 0.75], 1.0]), ANYTHING, 2)
    variation = st.one_of(
        st.none(), st.just(Late(1.0, 0.0, 0.5)), st.just(Late(0.0, NAN, 0.5)), ANYTHING
    )
    return st.one_of(
        st.tuples(st.sampled_from(["__call__", "viability", "residual"]), times),
        st.tuples(st.just("error_bound"), variation),
        st.tuples(st.just("energy"), st.none()),
    )


def ask_later(sol, name, argument):
    if name == "energy":
        assert not np.isnan(sol.energy().balance).any()  # J is inf where C(t) turns unbounded
    elif name == "error_bound":
        bound = sol.error_bound(variation=argument)
        assert bound >= 0
        assert not bound.guaranteed or bound >= bound.lower * (1 - 1e-9)
    elif argument is not None or name != "__call__":
        found = getattr(sol, name)(argument)
        assert not np.isnan(found).any()
        assert name == "residual" or np.isfinite(found).all()


def ask_problem(problem, times):
    """Conversions and constants of a problem."""
    process = problem.as_sweeping()
    assert process.beta >= 0
    assert process.Lam >= 0
    process.check(np.array([0.0, 0.5]))
    process.check_start(0.0)
    with suppress(so.InputError):  # not every C(t) is a translate
        assert process.as_vi().as_sweeping().dim == process.dim
    bound = process.velocity_bound(times)
    assert bound.value >= 0
