"""What new users get wrong; what each of them reads is in data/refused.txt."""

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import cvxpy as cp
import numpy as np
import pytest
import scipy.sparse as sp
from cases import isotropic, refuses
from numpy.testing import assert_allclose, assert_array_equal

import sweepopt as so
from sweepopt import fem
from sweepopt.sets import Features

BOX = so.Box(-1, 1)


def pulled(**others):
    """A block that a spring and a dashpot hold, with friction, pulled by 1.5 t."""
    given = {"A": 0.5, "B": 2.0, "C": so.Moving(BOX, center=lambda t: 1.5 * t), "u0": 0.0}
    return so.SweepingProcess(**{**given, **others})


def run(process=None, **others):
    return so.solve(process or pulled(), **{"t_end": 1.0, "steps": 10, **others})


def scene(text="", mesh="{ sizes = [1.0, 1.0], cells = [2, 2] }"):
    domain = f"[domain]\nmesh = {mesh}\n[time]\nend = 1.0\nsteps = 2\n"
    return fem.read_scene(domain + text)


@dataclass
class Given:
    """An effect of a user's own that contributes whatever a function of the body makes."""

    make: Callable[[fem.Discretisation], Any]

    def contribute(self, body):
        return self.make(body)


def contributed(make):
    section = fem.Discretisation(fem.grid([1.0, 1.0], [2, 2]), "left")
    return fem.body(section, [fem.Viscosity(1.0), Given(make)])


def rubs(g=1.0, block=1, weight=None):
    """Rows that yield at all unknowns, as a user's effect may state them."""

    def make(body):
        E = sp.eye_array(body.dim, format="csr")
        some = np.ones(body.dim) if weight is None else weight
        return fem.Contribution(yields=[fem.Yield(fem.Rows(E, block, some, "nodes"), g)])

    return contributed(make)


def matrix_of(body, value):
    return fem.Contribution(A=sp.diags_array(np.full(body.dim, value)))


HELD = '{ sizes = [1.0, 1.0], cells = [2, 2] }\nclamped = "left"'
VISCOUS = "[effects.viscosity]\neta = 1.0\n"
LAPLACIAN = sp.diags_array([[-1.0] * 5, [1.0, 2, 2, 2, 2, 1], [-1.0] * 5], offsets=[-1, 0, 1])


FORMS = (*so.__all__, *(f"fem.{name}" for name in fem.__all__))
RESULTS = (
    "ConvexSet",
    "ErrorBound",
    "Status",
    "scene",
    "fem.EFFECTS",
    "fem.Effect",
)


def test_every_public_name_refuses_an_argument_that_it_does_not_have():
    for name in sorted({*FORMS} - {*RESULTS}):
        short = name.removeprefix("fem.")
        thing = getattr(so if short == name else fem, short)
        if not isinstance(thing, type) or not issubclass(thing, BaseException):
            with refuses(f"{short} has no argument colour"):
                thing(colour="red")


def test_a_that_is_left_out_is_zero_and_a_function_for_c_is_a_moving_set():
    # the play operator: B u follows the input to within 1
    play = pulled(A=None, C=lambda t: so.Box(1.5 * t - 1, 1.5 * t + 1))
    assert_allclose(run(play, t_end=4.0)(4.0), (6.0 - 1.0) / 2.0, rtol=1e-12)
    elastic = so.EvolutionVI(None, 2.0, load=lambda t: 1.5 * t, dissipation=BOX, u0=0.0)
    assert_allclose(run(elastic, t_end=4.0)(4.0), 2.5, rtol=1e-12)
    for zero in (None, 0, 0.0):
        two = so.SweepingProcess(zero, np.eye(2), so.Ball([0.0, 0.0], 1.0), [0.0, 0.0])
        assert two.A.shape == (2, 2)
        assert two.rate_independent


def test_cones_of_a_users_effect_beside_an_indefinite_matrix_are_refused():
    def cones(body):
        rows = fem.Rows(sp.eye_array(body.dim + 2, format="csr")[body.dim :], 2, [1.0], "internal")
        B = sp.diags_array(np.append(np.zeros(body.dim), [-1.0, -1.0]))
        yields = [fem.Yield(rows, [1.0], slopes=np.ones(1))]
        return fem.Contribution(B=B, internal=2, yields=yields)

    with refuses(r"^B must be positive semidefinite, but B\[6, 6\] = -1"):
        contributed(cones)


def test_an_effect_that_is_registered_as_an_object_is_named(monkeypatch):
    monkeypatch.setitem(fem.EFFECTS, "given", Given(None))
    with refuses(r"EFFECTS\['given'\] must be a class .*, got G"):
        scene("[effects.given]\n", HELD)


@dataclass
class Typed:
    """An effect of a user's own whose fields are annotated with plain types."""

    at: float
    layers: int = 1
    side: "str" = "left"
    closed: bool = False
    share: float | None = None

    def contribute(self, body):
        return fem.Contribution()


def test_the_fields_of_a_users_effect_have_the_types_that_they_are_annotated_with(monkeypatch):
    monkeypatch.setitem(fem.EFFECTS, "typed", Typed)
    right = "at = 1\nlayers = 2\nside = 'top'\nclosed = true\nshare = 0.5\n"
    table = VISCOUS + "[effects.typed]\n"
    assert Typed(1, 2, "top", True, 0.5) in scene(table + right, HELD).effects
    for wrong, message in (
        ("at = '1.0'", r"at must be a number without quotes, got '1\.0'"),
        ("at = true", "at must be a number without quotes, got True"),
        ("at = 1.0\nlayers = 1.5", r"layers must be a whole number without quotes, got 1\.5"),
        ("at = 1.0\nside = 3", "side must be text in quotes, got 3"),
        ("at = 1.0\nclosed = 1", "closed must be true or false, got 1"),
        ("at = 1.0\nshare = 'all'", "share must be a number without quotes, got 'all'"),
    ):
        with refuses(rf"^effects\.typed\.{message}$"):
            scene(table + wrong, HELD)


def test_what_a_users_effect_raises_names_its_table(monkeypatch):
    @dataclass
    class Weak(Typed):
        def __post_init__(self):
            raise ArithmeticError("too weak")

    monkeypatch.setitem(fem.EFFECTS, "weak", Weak)
    with pytest.raises(ArithmeticError, match="too weak") as caught:
        scene(VISCOUS + "[effects.weak]\nat = 1.0\n", HELD)
    assert caught.value.__notes__ == ["This was raised for effects.weak."]


def own_name(x):
    return nowhere * x[0]  # noqa: F821


def test_what_a_function_in_an_effect_raises_names_the_effect_the_field_and_the_time():
    mesh = fem.grid([1.0, 1.0], [2, 2])
    for effect, words in (
        (fem.Friction("right", own_name), ["raised for g", r"raised for effects\[1\]"]),
        (fem.BodyForce(np.sin, own_name), ["raised for f0", r"raised for effects\[1\]"]),
        (
            fem.BodyForce(lambda t: own_name([t])),
            [r"given for history, at t = 0", r"raised for effects\[1\]\.history"],
        ),
        (
            fem.BodyForce(np.sin, lambda x, t: own_name(x) if t else x[0]),
            ["raised for f0", r"given for load\(t\), at t = 0\."],
        ),
    ):
        with pytest.raises(NameError, match="nowhere") as caught:
            fem.antiplane(
                mesh, clamped="left", effects=[fem.Viscosity(1.0), effect], t_end=1.0, steps=2
            ).solve()
        for note, pattern in zip(caught.value.__notes__, words, strict=True):
            assert re.search(pattern, note)


def test_a_dissipation_without_0_is_named_where_the_start_moves():
    vi = so.EvolutionVI(0.5, 2.0, load=np.sin, dissipation=so.Box(1, 2), u0=0.0)
    with pytest.warns(so.InitialStateWarning, match=r"a dissipation that contains 0, as so\.Box"):
        run(vi)


@pytest.mark.parametrize("form", [np.asarray, sp.dia_array, sp.coo_array, sp.csr_array])
def test_a_matrix_of_an_effect_may_be_dense_or_have_any_sparse_format(form):
    whole = contributed(lambda body: fem.Contribution(B=form(np.eye(6))))
    free = contributed(lambda body: fem.Contribution(B=body.restrict(form(np.eye(9)))))
    for scene in (whole, free):
        assert_array_equal(scene.problem.B.toarray(), np.eye(6))


def test_a_status_is_compared_with_its_name():
    status = run().status
    assert status == so.Status.SUCCESS == "success"
    assert status != "uncertified"
    assert {status: 1}["success"]


def test_a_table_with_one_column_is_a_load_of_one_unknown():
    rows, table = so.VectorTable([0, 1], [[0.0], [3.0]]), so.Table([0, 1], [0.0, 3.0])
    many, one = (run(pulled(C=so.Moving(BOX, center=center))) for center in (rows, table))
    assert_allclose(many.u, one.u, rtol=1e-12, atol=1e-15)


def test_an_effect_may_be_a_named_tuple(monkeypatch):
    class Spring(NamedTuple):
        k: float

        def contribute(self, body):
            return matrix_of(body, self.k)

    monkeypatch.setitem(fem.EFFECTS, "spring", Spring)
    given = scene(VISCOUS + "[effects.spring]\nk = 2.0\n", HELD)
    assert Spring(2.0) in given.effects


def test_a_run_of_another_mesh_is_no_run_of_the_scene():
    left, right = (
        scene(VISCOUS, f'{{ sizes = [1.0, {height}], cells = [2, 2] }}\nclamped = "left"')
        for height in (1.0, 2.0)
    )
    assert left.displacement(left.solve()).shape == (3, 9)
    with refuses("give a run of this scene"):
        left.displacement(right.solve())


def test_what_a_set_is_made_of_and_states_that_a_bound_is_proved_of_cannot_be_changed():
    # a process has its own set, and bounds have the offsets: neither would follow
    ball, half, sol = so.Ball([0.0], 1.0), so.Polyhedron([[1.0], [-1.0]], [1.0, 1.0]), run()
    sets = (ball.center, BOX.lower, BOX.upper, half.G, half.h)
    for entries in (*sets, sol.t, sol.u, sol.velocity):
        with pytest.raises(ValueError, match="read-only"):
            entries[:] = 2.0


class Pull:
    """A load that is no function of Python's, whose repr has an address."""

    def __call__(self, t):
        return 1.5 * t


def test_a_set_shows_no_address_of_what_moves_it():
    for C in (so.Moving(BOX, Pull()), so.Polyhedron([[1.0]], Pull())):
        assert "=a function" in " ".join(repr(C).split()).replace("= a", "=a")


def broken(t):
    if t > 0.55:
        raise ZeroDivisionError("of my own")
    return 0.5 + t


@pytest.mark.parametrize("C, function", [
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
    with pytest.warns(so.SweepoptWarning, match=r"A is dense, 8 MB .* scipy.sparse.csr_array\(A\)"):
        dense = pulled(
            A=A,
            B=None,
            C=so.Moving(so.Box(-1.0 + 0 * at, 1.0 + 0 * at), center=3.0 + 0 * at),
            u0=np.zeros(n),
        )
    assert_allclose(run(dense, steps=2)(1.0), 2.0 / np.diag(A), rtol=1e-9)


def test_constraints_tell_their_price_and_what_to_use_instead():
    with pytest.warns(so.SweepoptWarning, match=r"100 ms, .* linear, as so\.Polyhedron"):
        so.Constraints(2, lambda w: [w <= 1, w[0] + w[1] >= -1])
    with pytest.warns(so.SweepoptWarning, match=r"100 ms, .* balls, .* as so\.Ball") as told:
        curved = so.Constraints(2, lambda w: [cp.norm(w) <= 1])
    assert [one.filename for one in told] == [__file__]
    load = so.Separable([(so.Sine(3.0, period=4.0), [1.0, 0.5])])
    process = so.EvolutionVI(np.eye(2), None, load=load, dissipation=curved, u0=[0.0, 0.0])
    sol = run(process, steps=1)
    assert "certificates: C(t) proves no answer" in repr(sol.plan)
    assert "worst certificate   none\n" in repr(sol)


class Disc(so.ConvexSet):
    """A user's disc of radius 1/2, with what a test gives in place of the right things."""

    def __init__(self, **wrong):
        self.dim, self.offsets = 2, np.array([0.5])
        self.y, self.law = cp.Variable(1), lambda p, y: Features([y], [cp.norm(p) <= y[0]])
        vars(self).update(wrong)

    def support(self, z):
        return 0.5 * np.hypot(*z)

    def project(self, w):
        return w * (0.5 / max(np.hypot(*w), 0.5))

    def features(self, p):
        return self.law(p, self.y)


class Orthant(so.ConvexSet):
    """A user's cone without offsets: its support function is 0 or inf."""

    dim, offsets = 2, np.zeros(0)

    def support(self, z):
        return 0.0 if (z <= 0).all() else np.inf

    def project(self, w):
        return np.maximum(w, 0.0)

    def features(self, p):
        return Features((), (p <= 0,))


def of_own(D):
    load = so.Separable([(so.Sine(3.0, period=4.0), [1.0, 0.5])])
    process = isotropic(so.Moving(D, load))
    return so.solve(process, t_end=1.0, steps=4)


def lawless(law, **wrong):
    return of_own(Disc(law=law, **wrong))


def test_a_cone_of_ones_own_may_have_no_offsets_and_features_may_be_tuples():
    assert of_own(Orthant()).success
    assert lawless(lambda p, y: Features((y,), (cp.norm(p) <= y[0],))).success


def test_a_run_without_an_exact_trajectory_says_which_scheme_has_one():
    sol = run()
    with pytest.raises(AttributeError, match=r'only a run with scheme="exact" .* sol\(t\)'):
        sol.exact(1.0)
    assert not hasattr(sol, "exact")


def test_a_name_that_other_libraries_have_says_what_stands_here_for_it():
    process = so.EvolutionVI(0.5, 2.0, load=so.Sine(1.0, 1.0), u0=0.0)
    with pytest.raises(AttributeError, match=r"EvolutionVI has no attribute solve; .* so\.solve\("):
        process.solve(t_end=1.0)
    assert not hasattr(process, "steps")
    sol = so.solve(process, t_end=1.0, steps=3)
    with pytest.raises(AttributeError, match="Solution has no attribute y; the states are u"):
        sol.y  # noqa: B018

    with pytest.raises(AttributeError, match="no attribute t_end; it ends at t"):
        sol.t_end  # noqa: B018
    with pytest.raises(AttributeError, match=r"no attribute run; scene\.solve\(\) runs it"):
        scene(VISCOUS, HELD).run  # noqa: B018
    for name, here in (("Interval", "Box"), ("Circle", "Ball"), ("Disc", "Ball")):
        with pytest.raises(AttributeError, match=f"no attribute '{name}'; did you mean {here}"):
            getattr(so, name)


def test_what_an_own_set_raises_names_the_step():
    class Weary(Disc):
        left = 15

        def project(self, w):
            self.left -= 1
            if self.left < 0:
                raise ZeroDivisionError("of my own")
            return super().project(w)

    with pytest.raises(ZeroDivisionError) as caught:
        of_own(Weary())
    (note,) = caught.value.__notes__
    assert re.fullmatch(r"This was raised in step \d, from t = [\d.]+\.", note)


def test_an_empty_list_of_pictures_draws_none_and_a_study_without_solvers_takes_auto(tmp_path):
    from sweepopt.fem.pictures import pictures_of
    from sweepopt.study import read_study

    body = scene(VISCOUS, HELD)
    assert pictures_of(body) == ["displacement", "stress"]
    assert pictures_of(replace(body, pictures=[])) == []
    file = tmp_path / "study.toml"
    file.write_text('problems = ["S03"]\nschemes = ["midpoint"]\nsteps = [10]\n', encoding="utf-8")
    assert read_study(file).solvers == ["auto"]
