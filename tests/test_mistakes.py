"""What new users get wrong: each message names the argument and the remedy, none needs the source."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp

import sweepopt as so

BOX = so.Box(-1, 1)


def pulled(**others):
    """A block that a spring and a dashpot hold, with friction, pulled by 1.5 t."""
    given = {"A": 0.5, "B": 2.0, "C": so.Moving(BOX, center=lambda t: 1.5 * t), "u0": 0.0}
    return so.SweepingProcess(**{**given, **others})


def run(process=None, **others):
    return so.solve(process or pulled(), **{"t_end": 1.0, "steps": 10, **others})


def scene(text="", mesh="{ sizes = [1.0, 1.0], cells = [2, 2] }"):
    domain = f"[domain]\nmesh = {mesh}\n[time]\nend = 1.0\nsteps = 2\n"
    return so.fem.read_scene(domain + text)


@dataclass
class Given:
    """An effect of a user's own that contributes whatever a function of the body makes."""

    make: Callable[[so.fem.Discretisation], Any]

    def contribute(self, body):
        return self.make(body)


def contributed(make):
    section = so.fem.Discretisation(so.fem.grid([1.0, 1.0], [2, 2]), "left")
    return so.fem.body(section, [so.fem.Viscosity(1.0), Given(make)])


def matrix_of(body, value):
    return so.fem.Contribution(A=sp.diags_array(np.full(body.dim, value)))


VISCOUS = "[effects.viscosity]\neta = 1.0\n"
LAPLACIAN = sp.diags_array([[-1.0] * 5, [1.0, 2, 2, 2, 2, 1], [-1.0] * 5], offsets=[-1, 0, 1])

MISTAKES = [
    # the arguments of other libraries
    ("dt", lambda: run(dt=0.1), "argument dt", r"steps=round\(t_end / dt\)"),
    ("t_span", lambda: run(t_span=(0, 1)), "argument t_span", "give t_end"),
    ("t_span by place", lambda: so.solve(pulled(), (0, 1)), "solve: too many", "by name process, t_end"),
    ("t_span as t_end", lambda: run(t_end=(0, 1)), "t_end must be one number", "steps to start els"),
    ("method", lambda: run(method="BDF"), "argument method", "give scheme"),
    ("rtol", lambda: run(rtol=1e-3), "argument rtol", "tol, of each step's .* or error"),
    ("a letter wrong", lambda: run(shceme="midpoint"), "argument shceme", r"did you mean scheme\?"),
    ("frequency", lambda: so.Sine(1.0, frequency=2.0), "Sine has no argument frequency", "1 / frequency"),
    ("a table's name", lambda: so.Table(time=[0, 1], values=[0, 1]), "argument time", r"mean times\?"),
    ("rtol of steps", lambda: so.Adaptive(rtol=1e-3), "Adaptive has no argument rtol", "give tol"),
    ("a short table", lambda: run(pulled(C=so.Moving(BOX, so.Table([0, 0.5], [0, 1])))),
        r"a table of C\(t\) covers \[0, 0.5\], but the run \[0, 1\]", "extend the table, or .* t_end = 0.5"),
    ("no end", lambda: so.solve(pulled()), "t_end is missing", "give it or pass the times as steps"),
    ("C of a vi", lambda: so.EvolutionVI(0.5, 2.0, C=BOX, u0=0), "argument C", "load - dissipation"),
    ("J of a vi", lambda: so.EvolutionVI(0.5, 2.0, J=BOX, u0=0), "argument J", "dissipation"),
    ("load of a process", lambda: pulled(load=np.sin), "argument load", "take EvolutionVI"),
    ("no u0", lambda: so.SweepingProcess(0.5, 2.0, BOX), "'u0'", "give by name A, B, C, u0"),
    ("no u0 but None", lambda: pulled(u0=None), "u0 must be .* got None", "None is no number"),
    ("load gives None", lambda: run(so.EvolutionVI(0.5, 2.0, load=lambda t: None, dissipation=BOX,
        u0=0)), r"load\(t\) at t = 0 must be .* got None", "a function without return gives it"),
    # sets
    ("dissipation moves", lambda: so.EvolutionVI(0.5, 2.0, dissipation=so.Moving(BOX), u0=0),
        "dissipation must be a set that does not move", "C=so.Moving.-set, center=load, scale=g"),
    ("M transposed", lambda: so.image(np.ones((3, 2)), so.Box([-1] * 3, [1] * 3)),
        "M has 2 columns but C has dim 3", "its transpose"),
    ("an interval", lambda: pulled(C=(-1, 1)), r"C must be a set .* \(-1, 1\)", r"so.Box\(-1, 1\)"),
    ("a center for C", lambda: pulled(C=lambda t: 1.5 * t), "C.t. at t = 0", r"so.Moving\(set, center"),
    ("C a class", lambda: pulled(C=so.Box), "C must be a set", r"so.Box\(-1, 1\)"),
    ("bounds reversed", lambda: so.Box(1, -1), "lower", "upper"),
    # shapes: the one at odds with the others is blamed
    ("A at odds", lambda: pulled(A=np.eye(3)), "A has dim 3, but B and C and u0 1", "same number"),
    ("C at odds", lambda: pulled(C=so.Ball([0, 0], 1)), "C has dim 2, but A and B and u0", "same num"),
    ("load at odds", lambda: so.EvolutionVI(np.eye(2), None, load=[1, 2, 3], dissipation=so.Ball(
        [0, 0], 1), u0=[0, 0]), "load has dim 3, but A and dissipation and u0 2", "same number"),
    ("all None", lambda: pulled(A=None, B=None), "A and B are both None", "give one of them"),
    ("upper triangle", lambda: pulled(A=[[1, 2], [0, 1]]), r"A\[0, 1\] = 2 but A\[1, 0\] = 0", r"A \+ A.T"),
    ("no clamping", lambda: so.EvolutionVI(None, LAPLACIAN, dissipation=so.Ball(np.zeros(6), 1), u0=[0] * 6),
        r"A and B let the body move as a whole", "Clamp a part of it"),
    # numbers of runs
    ("half a step", lambda: run(steps=0.1), "steps must be a positive whole number", "got 0.1"),
    ("solver", lambda: run(solver="clarabell"), "solver 'clarabell' is not known", "use auto, clarabel"),
    ("scheme", lambda: run(scheme="euler"), "scheme 'euler' is not known", "use .* implicit-euler"),
    ("a scheme's letter", lambda: run(scheme="midpont"), "scheme 'midpont'", r"did you mean midpoint\?"),
    ("solver misspelt", lambda: run(solver="newtn"), "solver 'newtn' is not known", "did you mean newton"),
    ("solver of cvxpy", lambda: run(solver="mosek"), "solver .mosek. is not known", "did you mean cvxpy:mosek"),
    ("scheme in words", lambda: run(scheme="implicit euler"), "is not known", "did you mean implicit-eu"),
    ("progress", lambda: run(progress="yes"), "progress must be True or False", "got 'yes'"),
    ("A is True", lambda: pulled(A=True), "A must be a matrix of numbers, got True", "give numbers"),
    ("solver a class", lambda: run(solver=so.OSQP), "solver must be a name or", r"call it: so.OSQP\(\)"),
    ("steps a class", lambda: run(steps=so.Adaptive), "steps must be an", r"so.Adaptive\(tol\)"),
    ("save of t", lambda: run(save=lambda t: t), r"save must be a function of \(t, u, z\)", "too many"),
    ("callback", lambda: run(callback=lambda: 1), r"callback must be a function of \(step\)", "too many"),
    ("on_failure", lambda: run(on_failure="stopp"), "on_failure must be one of", "did you mean stop"),
    ("no word", lambda: run(on_failure=10**5000), "on_failure must be one of", "int too long to print"),
    # scenes
    ("scene", lambda: so.scene("tub"), "tub", "tube"),
    ("effect", lambda: scene("[effect.viscosity]\neta = 1.0\n"), "effect: unknown key", "mean effects"),
    ("effect's name", lambda: scene("[effects.viscocity]\neta = 1.0\n"), "viscocity", "mean viscosity"),
    ("effect on top", lambda: scene("[friction]\ng = 1.0\n"), "friction: unknown", "effects.friction"),
    ("held", lambda: scene(VISCOUS + '[domain.held]\nbottom = "y"\n'), "held.bottom must be 'all'",
        "kind 'antiplane', the default"),
    ("key", lambda: scene("[effects.viscosity]\netta = 1.0\n"), "effects.viscosity.etta", "mean eta"),
    # effects of a user's own
    ("no Contribution", lambda: contributed(lambda body: None), r"^Given: effects\[1\].contribute must",
        "return a so.fem.Contribution, got None"),
    ("nan in A", lambda: contributed(lambda body: matrix_of(body, np.nan)),
        r"^Given: effects\[1\].A\[0, 0\] is nan", "give finite"),
    ("not restricted", lambda: contributed(lambda body: so.fem.Contribution(B=np.eye(body.dim + 3))),
        r"^Given: effects\[1\].B has \d+ unknowns, the body has \d+", "body.restrict"),
    ("not square", lambda: contributed(lambda body: so.fem.Contribution(B=np.ones((2, 3)))),
        r"^Given: effects\[1\].B must be square", r"got shape \(2, 3\)"),
    ("a load too short", lambda: contributed(lambda body: so.fem.Contribution(loads=[np.ones(2)])),
        r"^Given: effects\[1\].loads\[0\] has 2 unknowns", "body.restrict"),
    # numbers and names of a mechanics student
    ("steps as text", lambda: run(steps="10"), "steps must be a positive whole", "got '10'"),
    ("tol as text", lambda: run(tol="1e-6"), "tol must be one number", "give numbers"),
    ("back in time", lambda: run(t_end=-1), "t_end must be > 0", "got -1"),
    ("nan", lambda: pulled(A=np.nan), r"A\[0, 0\] is nan", "give finite numbers"),
    ("A and C swapped", lambda: so.SweepingProcess(BOX, 2.0, 0.5, 0.0), "A must be a matrix", "got Box"),
    ("unsorted table", lambda: so.Table([0, 2, 1], [1, 2, 3]), "times must increase", "sort the table"),
    ("table's sizes", lambda: so.Table([0, 1], [1, 2, 3]), "values has 3 entries for 2", "one each"),
    ("save off the grid", lambda: run(save=[0.333]), "save asks for t = 0.333", "choose steps so that"),
    ("loose body", lambda: scene('[effects.viscosity]\neta = 1.0\n', "{ sizes = [1.0], cells = [2] }"),
        "clamped", "clamp"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("call", "name", "remedy"), [m[1:] for m in MISTAKES], ids=[m[0] for m in MISTAKES]
)
def test_a_mistake_is_named_with_its_remedy(call, name, remedy):
    with pytest.raises(so.InputError, match=name) as caught:
        call()
    with pytest.raises(so.InputError, match=remedy):
        raise caught.value


FORMS = (*so.__all__, *(f"fem.{name}" for name in so.fem.__all__))
RESULTS = (
    "ConvexSet",
    "ErrorBound",
    "Status",
    "scene",
    "fem.EFFECTS",
    "fem.Effect",
    "fem.EffectCosts",
)


@pytest.mark.parametrize("name", [one for one in FORMS if one not in RESULTS])
def test_every_public_name_refuses_an_argument_that_it_does_not_have(name):
    thing = so.fem.__dict__[name[4:]] if name.startswith("fem.") else getattr(so, name)
    if isinstance(thing, type) and issubclass(thing, BaseException):
        return
    with pytest.raises(so.InputError, match=f"{name.removeprefix('fem.')} has no argument colour"):
        thing(colour="red")


@pytest.mark.parametrize(("call", "remedy"), [
    (lambda: so.Moving(BOX, centre=np.sin), "Moving has no argument centre; did you mean center"),
    (lambda: so.Ball([0.0, 0.0], r=1.0), "Ball has no argument r; there are: center, radius"),
    (lambda: so.Sine(3.0), "Sine: missing a required argument: 'period'; give by name amplitude"),
    (lambda: so.HalfSpace(norm=[1.0], offset=0.0), "did you mean normal"),
    (lambda: so.fem.Friction("left", mu=0.3), "Friction has no argument mu; there are: on, g, p"),
])  # fmt: skip
def test_a_wrong_argument_is_named_with_those_there_are(call, remedy):
    with pytest.raises(so.InputError, match=remedy):
        call()


def test_a_half_space_takes_its_arguments_by_name():
    assert so.HalfSpace(normal=[1.0, 0.0], offset=2.0).support([1.0, 0.0]) == 2.0


def test_one_unknown_needs_no_brackets():
    plain = run(steps=10.0)
    lists = run(
        so.SweepingProcess(
            [[0.5]], [[2.0]], so.Moving(so.Box([-1], [1]), lambda t: [1.5 * t]), [0.0]
        )
    )
    np.testing.assert_array_equal(plain.u, lists.u)
    assert plain(0.95) > 0


def test_a_that_is_left_out_is_zero_and_a_function_for_c_is_a_moving_set():
    # the play operator: B u follows the input to within 1
    play = pulled(A=None, C=lambda t: so.Box(1.5 * t - 1, 1.5 * t + 1))
    np.testing.assert_allclose(run(play, t_end=4.0)(4.0), (6.0 - 1.0) / 2.0, rtol=1e-12)
    elastic = so.EvolutionVI(None, 2.0, load=lambda t: 1.5 * t, dissipation=BOX, u0=0.0)
    np.testing.assert_allclose(run(elastic, t_end=4.0)(4.0), 2.5, rtol=1e-12)


def broken(t):
    if t > 0.55:
        raise ZeroDivisionError("of my own")
    return 0.5 + t


@pytest.mark.parametrize(("C", "function"), [
    (so.Moving(BOX, center=broken), "center"),
    (so.Moving(BOX, scale=broken), "scale"),
    (so.MovingSet(lambda t: so.Box(-1, broken(t))), "C"),
    (so.Moving(BOX, so.Separable([(broken, 1.0)])), r"terms\[0\]\[0\]"),
])  # fmt: skip
def test_what_a_users_function_raises_goes_through_with_the_time(C, function):
    with pytest.raises(ZeroDivisionError, match="of my own") as caught:
        run(pulled(C=C), scheme="implicit-euler")
    note = rf"the function that was given for {function}.*, at t = 0\.6"
    with pytest.raises(AssertionError, match=note):
        raise AssertionError(" ".join(caught.value.__notes__))


@pytest.mark.filterwarnings("ignore::sweepopt.InitialStateWarning")
def test_dense_matrices_that_are_mostly_zeros_are_warned_about_and_work():
    n = 1000
    A, at = np.diag(np.linspace(1.0, 2.0, n)), np.arange(n)
    with pytest.warns(so.SweepoptWarning, match=r"A is dense, 8 MB .* scipy.sparse.csc_array\(A\)"):
        dense = pulled(
            A=A,
            B=None,
            C=so.Moving(so.Box(-1.0 + 0 * at, 1.0 + 0 * at), center=3.0 + 0 * at),
            u0=np.zeros(n),
        )
    np.testing.assert_allclose(run(dense, steps=2)(1.0), 2.0 / np.diag(A), rtol=1e-9)


def test_constraints_tell_their_price_and_what_to_use_instead():
    cp = pytest.importorskip("cvxpy")
    linear = so.Constraints(2, lambda w: [w <= 1, w[0] + w[1] >= -1])
    assert "0.1 s a step and no proof" in repr(linear)
    assert "as these constraints are linear: so.Polyhedron" in repr(linear)
    curved = so.Constraints(2, lambda w: [cp.norm(w) <= 1])
    assert "so.Ball" in repr(curved)
