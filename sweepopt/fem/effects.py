"""Effects: each is one record that contributes what it has, and nothing else.

All take one form: matrices, terms of the load, and rows that yield,

    C(t) = f(t) - sum_k E_k^T D_k(t).

A new effect is one frozen dataclass with a method `contribute`, and one line in
`EFFECTS` of scene_file.py; its fields are its keys in a scene file. Errors start with the name of
the field at fault. Effects that are integrals of one kind have a base: `StrainLaw`, `LocalLaw`,
`Density`.

Units in the docstrings are those of solids and of sections, whose forces and energies are per
length across. Other bodies have what is left after integrating across them:

| body | moduli | viscosities | k, eta all over | g all over | loads all over, at an end |
|---|---|---|---|---|---|
| sheet, times its thickness | N/m | N s/m | Pa/m, Pa s/m | Pa | Pa, N/m |
| bar, times its section | N | N s | Pa, Pa s | N/m | N/m, N |
| lumped, kappa of an edge | N/m | N s/m | N/m, N s/m of a node | N | N, N |
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, combinations
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike
from skfem import BilinearForm, LinearForm
from skfem.helpers import div, dot, inner

from sweepopt.checks import choice, listed, number, symmetric, vector
from sweepopt.display import Brief, by_parts, record
from sweepopt.errors import InputError, shown
from sweepopt.fem.contact import Rows, Yield, friction_on
from sweepopt.fem.fields import Array, Coefficient, Datum, SlipLaw, in_time
from sweepopt.fem.frames import held_directions
from sweepopt.fem.spaces import AXES, BODY, Discretisation, Place, boundary_names
from sweepopt.linalg import NEGLIGIBLE
from sweepopt.loads import History

Phi = Callable[[float], Any]
Force = tuple[Phi, Array | Callable[[float], Array]]

PLACE = property(lambda effect: effect.on)
"""Of effects that act on tangents (`turned`), or that pictures mark (`pulled`), where they act."""
YOUNG, POISSON = Coefficient("E", 0.0, strict=True), Coefficient("nu", -1.0, strict=True)


@record
class Contribution(Brief):
    """What an effect adds to the problem; what is None or empty does not exist.

    Attributes
    ----------
    A, B : sparse, shape (dim, dim), or None
        Part of the matrix of u' or of u. With internal unknowns these follow those of the body.
    loads : sequence of (history, f)
        Terms ``phi(t) f`` of the load, f an array of shape (dim,) or a function of t.
    yields : sequence of Yield
        Parts of the dissipation: rows of the velocity and the sets D_k that bound their forces.
    internal : int
        How many internal unknowns the effect has.
    lift : (history, ndarray) or None
        ``d(t) x``: values of all degrees of freedom that are held, where they are not zero.
    """

    A: sp.csc_array | None = None
    B: sp.csc_array | None = None
    loads: Sequence[Force] = ()
    yields: Sequence[Yield] = ()
    internal: int = 0
    lift: tuple[History, Array] | None = None


class Kinematics(NamedTuple):
    """Displacements and velocities at all nodes, and an effect's internal unknowns, at k times.

    Attributes
    ----------
    u, rate : ndarray, shape (k, N), or (k, N, components) of vectors
    internal : ndarray, shape (k, m)
    """

    u: Array
    rate: Array
    internal: Array


Stress = Callable[[Kinematics], Array]


class Effect(Protocol):
    """What a scene asks of an effect, also of one of your own.

    The fields of its dataclass are the keys of its table. `body` has the ``mesh`` and the ``basis``
    of scikit-fem, and ``body.restrict`` takes a matrix or a vector of all degrees of freedom to the
    unknowns. A `Contribution` may hold ``A=`` (of u'), ``B=`` (of u), ``loads=[(history, f)]``, and
    ``yields=``, rows of the velocity whose forces are bounded, as in the example.

    An effect may have more, as it needs it:

    - ``stress(body)``, of one that makes a stress: None if the stress is not known, else a function
      of the motion: of ``motion.u`` and ``motion.rate`` (at all nodes at k times, as
      `Scene.displacement`) and ``motion.internal``. It returns the deviator at the points of
      strains, shape (k, cells, points, s).
    - ``plastic_strain(body, internal)``: sqrt(2/3) |p| of its internal unknowns, shape (k, cells).
    - ``lame(body, place)``, of an elasticity: lam and mu at the points of a quadrature, which
      `Plasticity` takes.
    - ``turned``: boundaries on which it acts on the normal or the tangents, so that unknowns are
      to be the components along these.
    - ``pulled``: the name of a boundary, or a tuple of names, that pictures mark as pulled.
    - ``flows``: True if the body may have plugs (regions that are rigid below a yield stress),
      which the picture "flow" shows.

    ``body.effects`` are all effects of the scene, so that one can take from others what it needs,
    or refuse to act beside them.

    Examples
    --------
    Friction along a line inside of the body, at most g on each length of it:

    >>> from dataclasses import dataclass
    >>> import numpy as np, scipy.sparse as sp, skfem
    >>> from sweepopt.fem import EFFECTS, Contribution, Rows, Yield, read_scene
    >>> @dataclass(frozen=True)
    ... class Seam:
    ...     at: float
    ...     g: float
    ...     def contribute(self, body):
    ...         on_line = body.mesh.facets_satisfying(lambda x: np.isclose(x[0], self.at))
    ...         basis = skfem.FacetBasis(body.mesh, body.basis.elem, facets=on_line)
    ...         length = body.restrict(skfem.LinearForm(lambda v, w: v).assemble(basis))
    ...         rubs = np.flatnonzero(length > 1e-9)     # the unknowns on the line
    ...         E = sp.eye_array(length.size, format="csr")[rubs]
    ...         rows = Rows(E, block=1, weight=length[rubs], where="nodes")
    ...         return Contribution(yields=[Yield(rows, g=np.full(rubs.size, self.g))])
    >>> EFFECTS["seam"] = Seam                   # from now on a table of scene files
    >>> seam = {"effects.seam": {"at": 0.5, "g": 0.2}}
    >>> read_scene("square", changes=seam, without=["friction"]).solve().success
    True
    >>> del EFFECTS["seam"]
    """

    def contribute(self, body: Discretisation) -> Contribution:
        """The effect's matrices, terms of the load or rows that yield, on a body."""
        ...


def total(parts: Sequence[Contribution]) -> tuple[Any, Any, list[Force]]:
    """The sums of the effects' matrices, None where there is none, and all terms of the load."""
    each = ([M for part in parts if (M := getattr(part, name)) is not None] for name in "AB")
    A, B = (sum(matrices) if matrices else None for matrices in each)
    return A, B, [load for part in parts for load in part.loads]


def released(space: Discretisation, effects: Iterable[Effect]) -> tuple[Any, Any, list[Force]]:
    """A, B and loads of all degrees of freedom, of the body with nothing held or turned."""
    own = [(one, one.contribute(space)) for one in effects]
    free = space.with_unknowns(clamped=(), held={}, turned=())
    parts = [
        one.contribute(free)
        for one, part in own
        if part.A is not None or part.B is not None or part.loads
    ]
    return total(parts)


class Record:
    """The base of effects: checks fields when a record is made.

    Attributes
    ----------
    data : tuple of Coefficient
        Those of the fields that are data in space; `on` and `history` are known.
    """

    data: ClassVar[tuple[Coefficient, ...]] = ()
    meaning = dict.fromkeys(
        ("title", "units", "pictures"), "; a key of the scene itself stands above its first table"
    )

    def __init_subclass__(cls) -> None:
        cls.__repr__ = by_parts  # type: ignore[method-assign]  # without the fields that are None

    def __post_init__(self) -> None:
        given = {name: value for name, value in vars(self).items() if value is not None}
        if "on" in given or ("on" in vars(self) and not hasattr(type(self), "on")):
            object.__setattr__(self, "on", boundary_names("on", vars(self)["on"]))
        history = given.get("history")
        if isinstance(history, type) or not (history is None or callable(history)):
            raise InputError(
                f"history must be a function of time such as Table or Sine, got {shown(history)}"
            )
        for coefficient in self.data:
            if coefficient.name in given:
                coefficient.check(given[coefficient.name])

    def values_at(self, place: Place, t: float | None = None) -> Iterator[Array]:
        """Values of the data that are given, at the points of a quadrature (and a time)."""
        for one in self.data:
            datum = getattr(self, one.name)
            if datum is not None or getattr(type(self), one.name, 0.0) is not None:  # not optional
                yield place.values(one, datum, t)


class StrainLaw(Record):
    """The base of laws of strains e: the stress is 2 mu e + lam tr(e) I, or that of a tensor.

    Attributes
    ----------
    choices : tuple of tuple of str
        Groups of fields of which one is given.
    moduli : callable (body, place)
        lam and mu at the points of a quadrature; mu is None where a tensor is given.
    matrix : {"A", "B"}
        The matrix that it adds.
    """

    matrix: ClassVar[str]
    choices: ClassVar[tuple[tuple[str, ...], ...]]
    tensor: Any
    moduli: Any

    def __post_init__(self) -> None:
        fields = [name for names in self.choices for name in names]
        given = {name for name in fields if getattr(self, name) is not None}
        if given not in map(set, self.choices):
            words = ", or ".join(" and ".join(names) for names in self.choices)
            for names in self.choices:
                if given < set(names):
                    missing = next(name for name in names if name not in given)
                    beside = "".join(f" beside {name}" for name in given)
                    raise InputError(f"{missing}: is missing{beside}; give {words}")
            both = " and ".join(sorted(given))
            raise InputError(f"{min(given)}: give by name {words}, not {both}")
        super().__post_init__()

    def contribute(self, body: Discretisation) -> Contribution:
        """The matrix; none if it is zero everywhere."""
        S = _stiffness(body, self)
        return Contribution(**{self.matrix: S}) if S.count_nonzero() else Contribution()

    def deformation(self, body: Discretisation, motion: Kinematics) -> Array:
        """What it strains, at all nodes: u' if its matrix is A, u if it is B."""
        return motion.rate if self.matrix == "A" else motion.u

    def stress(self, body: Discretisation) -> Stress | None:
        """2 mu dev e, at the points of strains; not known of a tensor."""
        if self.tensor is not None:
            return None

        def deviator(motion: Kinematics) -> Array:
            u, place = self.deformation(body, motion), body.whole
            lam, mu = self.moduli(body, place)
            free = body.with_unknowns(clamped=(), held={}, turned=())
            rows = deviators(free, place, lam, mu)[:, body.nodes.T.ravel()]
            strain = (rows @ u.reshape(len(u), -1).T).T.reshape(len(u), *place.basis.dx.shape, -1)
            return 2 * mu[..., None] * strain

        return deviator


@dataclass(frozen=True)
class Viscosity(StrainLaw):
    """``a(u', v) = int eta grad u' . grad v``, or the same of the strain rates of a vector u'.

    The viscous stress is ``2 eta e + zeta tr(e) I`` of the rate e of the strain.

    Parameters
    ----------
    eta : number, formula, mapping of subdomain to number, Profile or callable
        Shear viscosity (Pa s), > 0. A mapping covers every subdomain.
    zeta : as eta
        Second viscosity (Pa s); not seen in antiplane shear.
    tensor : array_like, shape (m, m), instead of eta and zeta
        Viscosities in Voigt's order (xx, yy, zz, yz, xz, xy; in the plane xx, yy, xy; in antiplane
        shear xz, yz) of the engineering strain rates (Pa s), symmetric.

    Raises
    ------
    InputError
        If a value is not a finite number > 0.

    Notes
    -----
    In plane stress each law is condensed on its own, which is exact where all are proportional:
    zeta = 2 nu eta / (1 - 2 nu) beside an elasticity; others are refused, but for tensors, which
    are those of the plane.

    Examples
    --------
    >>> Viscosity({"core": 1.0, "sleeve": 0.2}).eta["sleeve"]
    0.2
    """

    eta: Datum | None = None
    zeta: Datum = 0.0
    tensor: ArrayLike | None = None

    data = Coefficient("eta", 0.0, strict=True), Coefficient("zeta")
    matrix, choices = "A", (("eta",), ("tensor",))

    def moduli(self, body: Discretisation, place: Place) -> tuple[Any, Any]:
        """zeta and eta at the points of a quadrature; eta is None where a tensor is given."""
        *eta, zeta = self.values_at(place)
        return zeta, eta[0] if eta else None


@dataclass(frozen=True)
class Elasticity(StrainLaw):
    """``b(u, v) = int kappa grad u . grad v``, or the same of the strains of a vector u.

    The elastic stress is ``2 mu e + lam tr(e) I`` of the strain e.

    Parameters
    ----------
    kappa : number, formula, mapping of subdomain to number, Profile or callable
        Shear modulus (Pa), >= 0, of antiplane shear; of a bar E times its section (N), of an edge
        of a chain its stiffness (N/m). A mapping covers every subdomain.
    E, nu : as kappa, instead of kappa
        Young's modulus (Pa), > 0, and Poisson's ratio, in (-1, 0.5).
    tensor : array_like, shape (m, m), instead of kappa
        Moduli (Pa) in Voigt's order, as in `Viscosity`: of an orthotropic material, say; in plane
        stress those of the plane.

    Raises
    ------
    InputError
        If a value is not a finite number in its range, or the parameters are of no material.

    Examples
    --------
    >>> Elasticity(2.0).kappa
    2.0
    """

    kappa: Datum | None = None
    E: Datum | None = None
    nu: Datum | None = None
    tensor: ArrayLike | None = None

    data = Coefficient("kappa", 0.0), YOUNG, POISSON
    matrix, choices = "B", (("kappa",), ("E", "nu"), ("tensor",))
    meaning = Record.meaning | dict.fromkeys(
        ("young", "poisson", "mu", "G", "lam", "lambda", "K"),
        "; give E, Young's modulus, and nu, Poisson's ratio, or kappa in antiplane shear",
    )

    def lame(self, body: Discretisation, place: Place) -> tuple[Any, Any]:
        """lam and mu at the points of a quadrature; mu is None where a tensor is given."""
        lam = 0.0
        mu = None
        if self.kappa is not None:
            if body.components > 1:
                raise InputError("kappa is for antiplane shear; give E and nu")
            (mu,) = self.values_at(place)
        elif self.E is not None:
            if body.mesh.dim() == 1:
                raise InputError(
                    "E and nu are for bodies; give kappa, of a bar E times its section"
                )
            E, nu = self.values_at(place)
            _check_compressible(nu)
            lam, mu = E * nu / ((1 + nu) * (1 - 2 * nu)), E / (2 * (1 + nu))
        return lam, mu

    moduli = lame


class LocalLaw(Record):
    """The base of laws ``int c u . v`` on boundaries, subdomains or the whole body.

    Attributes
    ----------
    matrix : {"A", "B"}
        The matrix that it adds.
    """

    matrix: ClassVar[str]
    on: Any

    def contribute(self, body: Discretisation) -> Contribution:
        """The matrix."""
        place = body.place(self.on, nodal=body.lumped)
        (c,) = self.values_at(place)
        mass = BilinearForm(lambda u, v, _: c * inner(u, v)).assemble(place.basis)
        return Contribution(
            **{self.matrix: _restrict(body, f"on: all of {', '.join(self.on)}", mass)}
        )


@dataclass(frozen=True)
class Dashpot(LocalLaw):
    """``a(u', v) = int eta u' . v`` on boundaries, subdomains or the whole body.

    Parameters
    ----------
    on : str or sequence of str
        Boundaries, or subdomains; "body" for all of it (a film under a sheet, a bed along a bar).
        A node of a lumped model between two parts counts half for each.
    eta : number, formula, mapping of name to number, Profile or callable
        Viscosity (Pa s/m on a boundary or under a sheet, Pa s/m^2 in a volume, Pa s along a bar,
        N s/m of a node of a lumped model), >= 0.

    Raises
    ------
    InputError
        If a name is missing or given twice, or eta is negative.

    Examples
    --------
    >>> Dashpot("foot", eta=2.0).on
    ('foot',)
    """

    on: Sequence[str]
    eta: Datum
    matrix, data = "A", (Coefficient("eta", 0.0),)


@dataclass(frozen=True)
class Foundation(LocalLaw):
    """``b(u, v) = int k u . v``: Winkler's springs on boundaries, subdomains or the whole body.

    Where the other ends of the springs move by d(t), they add the load ``int k d(t) . v``: a body
    force or a traction k with the history d.

    Parameters
    ----------
    on : str or sequence of str
        As for `Dashpot`.
    k : number, formula, mapping of name to number, Profile or callable
        Stiffness (Pa/m on a boundary or under a sheet, Pa/m^2 in a volume, Pa along a bar, N/m of
        a node of a lumped model), >= 0.

    Raises
    ------
    InputError
        If a name is missing or given twice, or k is negative.

    Examples
    --------
    >>> Foundation("body", k=2.0).k
    2.0
    """

    on: Sequence[str]
    k: Datum
    matrix, data = "B", (Coefficient("k", 0.0),)


@dataclass(frozen=True)
class Friction(Record):
    """``J(v) = int g |v|`` of the tangential velocity, lumped at the nodes (see `friction_on`).

    Intervals where one component slips, discs where two do (the contact of a solid, a sheet on its
    face), balls in a volume. The bound does not depend on the normal force: in the plane and in a
    solid a run with the normal displacement free is well posed too, but the face moves across the
    floor; hold it, ``held = { bottom = "n" }``, where it shall stay in touch. At a corner of one
    boundary, or of several in one effect, a node has the mean normal, which costs O(h); two effects
    each have their own tangents there. If neither boundary is held along its normal, and they do
    not meet at a right angle, a step takes longer, and is certified to about 1e-6 in a solid of
    which more than half of the unknowns rub.

    Parameters
    ----------
    on : str or sequence of str
        The boundaries that make up Gamma_3; or subdomains, or "body", for a sheet that rubs over
        its face and a bar in a bed. In lumped models as for `Dashpot`.
    g : number, formula, mapping of name to number, Profile or callable
        Friction bound (Pa; Pa/m in a volume, N/m along a bar, N of a node of a lumped model), >= 0;
        a coefficient of friction if `p` is given. A function of x and t moves in time. Where it is
        zero there is no friction and nothing to simulate; where it is inf the body is glued: it
        stays where u0 has it.
    p : as g, optional
        Pressure (Pa) that is known; the bound is g p.
    history : callable, optional
        phi(t) >= 0 that multiplies the bound.
    axes : sequence of float, optional
        ``J(v) = int g |(a_x v_x, a_y v_y, ...)|``: ellipses in place of discs.
    slip : SlipLaw, optional
        phi(s), such as `SlipWeakening`: the bound is g phi(s) where the tangential
        displacement has the length s. The problem is then quasi-variational: see `StateDependent`.

    Raises
    ------
    InputError
        If a name is missing or given twice, or a bound is negative.

    Examples
    --------
    >>> Friction("contact", g=0.3).on
    ('contact',)
    """

    on: Sequence[str]
    g: Datum
    p: Datum | None = None
    history: Phi | None = None
    axes: Sequence[float] | None = None
    slip: SlipLaw | None = None
    data = Coefficient("g", 0.0, finite=False), Coefficient("p", 0.0)
    turned = PLACE
    meaning = Record.meaning | {"mu": "; give g, the largest traction, or mu as g and a pressure p"}

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.slip is not None and not (callable(self.slip) and hasattr(self.slip, "lipschitz")):
            raise InputError(
                f"slip must be a law with its Lipschitz constant, such as SlipWeakening(0.1), got "
                f"{shown(self.slip)}"
            )
        if self.axes is not None:
            object.__setattr__(self, "axes", listed("axes", self.axes, number, 0.0, True))

    def contribute(self, body: Discretisation) -> Contribution:
        """The rows that slip; none if g is zero everywhere."""
        return Contribution(yields=friction_on(body, self))


class Density(Record):
    """The base of ``<f, v> = phi(t) int f . v`` over boundaries `on`, or over the whole body.

    The density is one number, one along the normal of a boundary, or a vector.
    """

    history: Any

    def contribute(self, body: Discretisation) -> Contribution:
        """One term of the load."""
        on = getattr(self, "on", ())
        place = (body.on_boundary if on else body.place)(on, nodal=body.lumped)
        (coefficient,) = self.data
        datum = getattr(self, coefficient.name)
        several = isinstance(datum, (list, tuple))
        along_normal = hasattr(place.basis, "normals") and not several
        parts = coefficient.parts(datum, 1 if along_normal else body.components)

        def shape(t: float) -> Array:
            values = [place.values(coefficient, one, t) for one in parts]

            @LinearForm
            def form(v: Any, w: Any) -> Any:
                if body.components == 1:
                    return values[0] * v
                directions = v if several else [dot(v, w.n)]
                return sum(c * a for c, a in zip(values, directions, strict=True))

            where = f"on: all of {', '.join(on or (BODY,))}"
            return _restrict(body, where, form.assemble(place.basis))

        f = shape if any(map(in_time, parts)) else shape(0.0)
        return Contribution(loads=[(self.history, f)])


@dataclass(frozen=True)
class BodyForce(Density):
    """``<f, v> = phi(t) int_Omega f0 . v``.

    Parameters
    ----------
    history : callable
        phi(t): Table, Sine, Triangle, Constant; or any function, whose variation is not known.
    f0 : number, formula, mapping of subdomain to number, Profile or callable
        Density at phi = 1 (Pa/m); in the plane and in solids a list, one for each of x, y and z
        (required). A function of x and t is any load, and has no guaranteed bounds.

    Raises
    ------
    InputError
        If the history is no function, or a value is not finite.

    Examples
    --------
    >>> from sweepopt.loads import Sine
    >>> BodyForce(Sine(1.0, period=4.0), f0=2.0).f0
    2.0
    """

    history: Phi
    f0: Datum | Sequence[Datum] = 1.0
    data = (Coefficient("f0", vector=True),)


@dataclass(frozen=True)
class Traction(Density):
    """``<f, v> = phi(t) int_{Gamma_2} f2 . v``.

    Parameters
    ----------
    on : str or sequence of str
        The boundaries that make up Gamma_2.
    history : callable
        phi(t): Table, Sine, Triangle, Constant; or any function, whose variation is not known.
    f2 : number, formula, mapping of boundary to number, Profile or callable
        Traction at phi = 1 (Pa). In the plane and in solids a list, one for each of x, y and z; or
        one alone, which acts along the outward normal: a pull is positive, a pressure negative.
        In other bodies one, along u. A function of x and t is any load.

    Raises
    ------
    InputError
        If a name is missing or given twice, the history is no function, or a value is not finite.

    Examples
    --------
    >>> from sweepopt.loads import Table
    >>> Traction(["left", "right"], Table([0.0, 1.0], [0.0, 2.0])).on
    ('left', 'right')
    """

    on: Sequence[str]
    history: Phi
    f2: Datum | Sequence[Datum] = 1.0
    data, pulled = (Coefficient("f2", vector=True),), PLACE


@dataclass(frozen=True)
class PointForce(Record):
    """``<f, v> = phi(t) force . v(at)``.

    Parameters
    ----------
    at : array_like, shape (d,)
        A point of the body. The displacement there grows without bound on finer meshes, as that
        under a point force does.
    history : callable
        phi(t).
    force : number; in the plane and in solids a list, one for each of x, y and z
        At phi = 1 (N; N/m of bodies in the plane).

    Raises
    ------
    InputError
        If the point is not in the body, edges are curved, or a number is not finite.

    Examples
    --------
    >>> from sweepopt.loads import Constant
    >>> PointForce([0.0, 1.0], Constant(), force=2.0).force
    2.0
    """

    at: ArrayLike
    history: Phi
    force: float | Sequence[float] = 1.0
    data = (Coefficient("force", vector=True),)

    def contribute(self, body: Discretisation) -> Contribution:
        """One term of the load."""
        values = vector("force", self.data[0].parts(self.force, body.components))
        at = vector("at", self.at, body.mesh.dim())
        try:
            shape = body.scalar.probes(at[:, None]).toarray()[0]
        except (ValueError, IndexError, NotImplementedError):
            shape = np.full(1, np.nan)
        if not np.isclose(shape.sum(), 1.0):
            raise InputError(
                f"at: the point {shown(self.at)} is not in the body, or edges of cells are curved"
            )
        full = np.zeros(body.nodes.size)
        full[body.nodes] = values[:, None] * shape
        f = _restrict(body, f"at: the point {shown(self.at)}", full)
        return Contribution(loads=[(self.history, f)])


@dataclass(frozen=True)
class PrescribedDisplacement(Record):
    """``u = phi(t) d`` where components are held: the load f - A_fd d' - B_fd d.

    It cannot be combined with a yield stress, one-way motion, plasticity or a Maxwell branch, which
    would have to see it. Steps end at breakpoints of the history, if they are not too many. Of the
    energies of a run only that lost by friction is known, as what is held is no unknown; the others
    are nan.
    Pictures draw the force on the body along d, positive in its direction,
    <d, A u' + B u - f> / |d| with |d| the largest length.

    Parameters
    ----------
    on : str or sequence of str
        Boundaries that are clamped, or held in the components that are prescribed.
    history : History
        phi(t) as data, whose rate is known: Table, Sine, Triangle, Constant, Polynomial.
    d : number, formula, mapping of boundary to number, Profile or callable
        Displacement at phi = 1 (m); in the plane and in solids a list, one for each of x, y and z,
        of which the components that are held are taken. Where another boundary that is held or
        moved meets these, it must agree with that; nodes shared with one that is clamped move.

    Raises
    ------
    InputError
        If the history is no data, nothing is held there, another boundary is moved by it, or a name
        is missing.

    Examples
    --------
    >>> from sweepopt.loads import Table
    >>> PrescribedDisplacement("far", Table([0.0, 1.0], [0.0, 2.0])).d
    1.0
    """

    on: Sequence[str]
    history: History
    d: Datum | Sequence[Datum] = 1.0
    data, pulled = (Coefficient("d", vector=True),), PLACE

    def __post_init__(self) -> None:
        super().__post_init__()
        if not isinstance(self.history, History) or hasattr(self.history, "dim"):
            raise InputError(
                f"history must be data whose rate is known, such as Table or Sine, got "
                f"{shown(self.history)}"
            )

    def contribute(self, body: Discretisation) -> Contribution:
        """The values that are held; none if d is zero everywhere."""
        place, (coefficient,) = body.on_boundary(self.on, nodal=True), self.data
        full = np.zeros(body.nodes.size)
        for dofs, datum in zip(body.nodes, coefficient.parts(self.d, body.components), strict=True):
            at, values = dofs[place.nodes.T], place.values(coefficient, datum)
            full[at] = values
            if np.abs(full[at] - values).max() > NEGLIGIBLE * np.abs(values).max():
                raise InputError(
                    f"d: two of {', '.join(self.on)} share nodes and move them differently; let d "
                    "agree there, as one formula in x and y does"
                )
        T = body.frame.T
        along = T.T @ full
        given = np.abs(along) > NEGLIGIBLE * np.abs(along).max()
        along[body.free] = 0.0
        if not full.any():
            return Contribution()
        if not along.any():
            raise InputError(
                f"on: nothing is held on {', '.join(self.on)} along d; clamp or hold it"
            )
        for dofs in body.nodes[:, np.unique(place.nodes)]:
            some, every = (along[dofs] != 0).sum(), given[dofs].sum()
            if 0 < some < every:
                raise InputError(
                    f"on: {some} of {every} nodes of {', '.join(self.on)} are held along d; clamp "
                    "or hold all of it"
                )
        lift = T @ along
        moving = [one.on for one in body.effects if isinstance(one, PrescribedDisplacement)]
        still = set(body.clamped or ()) - set(chain.from_iterable(moving))
        for name, nodes, directions in held_directions(body):
            distance = np.abs((directions * lift[body.nodes.T[nodes]]).sum(axis=1)).max()
            if name not in {*self.on, *still} and distance > NEGLIGIBLE * np.abs(lift).max():
                raise InputError(
                    f"on: {', '.join(self.on)} shares nodes with {name}, which is held there "
                    f"along d; name both in one effect, or let d be functions that leave {name} "
                    "where it is"
                )
        return Contribution(lift=(self.history, lift))


@dataclass(frozen=True)
class Eigenstrain(Record):
    """``<f, v> = phi(t) int sigma0 tr e(v)``: a strain that no stress makes, such as heat's.

    sigma0 = E strain / (1 - 2 nu) is the pressure that undoes it; in plane stress E strain / (1 -
    nu). The moduli are those of the elasticity, if there is one, without a tensor: viscosities and
    Maxwell branches see the whole strain and resist an eigenstrain that moves.

    Parameters
    ----------
    history : callable
        phi(t).
    strain : number, formula, mapping of subdomain to number, Profile or callable
        In all directions at phi = 1: the coefficient of expansion times the temperature.
    E, nu : as strain
        Young's modulus (Pa) and Poisson's ratio.

    Raises
    ------
    InputError
        If a value is out of its range or the elasticity's moduli are others, or the body is in
        antiplane shear.

    Examples
    --------
    >>> from sweepopt.loads import Constant
    >>> Eigenstrain(Constant(), strain=1e-3, E=2e11, nu=0.3).strain
    0.001
    """

    history: Phi
    strain: Datum
    E: Datum
    nu: Datum
    data = Coefficient("strain"), YOUNG, POISSON

    def contribute(self, body: Discretisation) -> Contribution:
        """One term of the load."""
        if body.components == 1:
            raise InputError("strain: an isotropic strain does nothing in antiplane shear")
        if body.kind == "plane stress" and any(
            hasattr(one, "plastic_strain") for one in body.effects
        ):
            raise InputError(
                "strain: in plane stress an eigenstrain beside plasticity is not offered: the "
                "deviator of the stress lacks the eigenstrain across the plane; take kind = 'solid'"
            )
        place = body.whole
        strain, E, nu = self.values_at(place)
        _check_compressible(nu)
        _check_elastic(body, E, nu, where=strain != 0)
        stress = E * strain / (1 - (1 if body.kind == "plane stress" else 2) * nu)
        f = LinearForm(lambda v, _: stress * div(v)).assemble(place.basis)
        return Contribution(loads=[(self.history, body.restrict(f))])

    def stress(self, body: Discretisation) -> Stress | None:
        """It has no deviator, but for that of the strain across the plane in plane stress."""
        return None if body.kind == "plane stress" else lambda motion: np.zeros(())


@dataclass(frozen=True)
class YieldStress(Record):
    """``J(v) = int g |grad v|``: Bingham's body of antiplane shear, which moves where it yields.

    On P2 elements, where the gradient varies within a cell, |grad v| is its root mean square over
    the cell, which is larger than the mean by O(h^2): one ball for each cell, so that plugs are
    rigid exactly.

    Parameters
    ----------
    g : number, formula, mapping of subdomain to number, Profile or callable
        Yield stress (Pa), >= 0.

    Raises
    ------
    InputError
        If g is negative, or the body has vectors: flow at constant volume is not offered.

    Examples
    --------
    >>> YieldStress(0.2).g
    0.2
    """

    g: Datum
    data, flows = (Coefficient("g", 0.0),), True

    def contribute(self, body: Discretisation) -> Contribution:
        """The gradients that yield; none if g is zero everywhere."""
        if body.components > 1:
            raise InputError(
                "g: yield stress is for antiplane shear; vectors need an incompressible"
                " element, which is not offered"
            )
        place = body.whole
        (g,), dx = self.values_at(place), place.basis.dx
        weight, block = dx.sum(axis=1), body.mesh.dim() * dx.shape[1]
        share = place.shares
        gradients = np.array([phi[0].grad * np.sqrt(share) for phi in place.basis.basis])
        gradients[0] = -gradients[1:].sum(axis=0)  # a constant has none
        E = body.rows(place.basis, gradients)
        E.eliminate_zeros()
        bound = (g * share).sum(axis=1)
        keep = (np.diff(E.indptr[::block]) > 0) & (bound > 0)
        if not keep.any():
            return Contribution()
        chosen = Rows(E[np.repeat(keep, block)], block, weight[keep], "gradient")
        return Contribution(yields=[Yield(chosen, bound[keep])])

    def stress(self, body: Discretisation) -> Stress | None:
        """Where nothing flows it is open."""
        return None


@dataclass(frozen=True)
class OneWay(Record):
    """The velocity is not negative on boundaries or in the body: a ratchet.

    Parameters
    ----------
    on : str or sequence of str
        As for `Dashpot`.
    along : str
        "x", "y" or "z" in the plane and in solids; in antiplane shear it is left out.

    Raises
    ------
    InputError
        If a name is missing, a direction is none of the body, or all of it is clamped.

    Examples
    --------
    >>> OneWay("foot", along="x").along
    'x'
    """

    on: Sequence[str]
    along: str = ""

    def contribute(self, body: Discretisation) -> Contribution:
        """Rows bounded to one side."""
        known = [""] if body.components == 1 else list(AXES[: body.components])
        choice("along", self.along, known)
        nodes = np.unique(body.place(self.on).nodes)
        E = body.extension[body.nodes[known.index(self.along), nodes]]
        E = E[np.diff(E.indptr) > 0]
        if not E.shape[0]:
            raise InputError(f"on: all of {', '.join(self.on)} is clamped; nothing moves there")
        one = np.ones(E.shape[0])
        return Contribution(yields=[Yield(Rows(E, 1, one, "nodes"), one, shape="half-line")])


@dataclass(frozen=True)
class MaxwellBranch(StrainLaw):
    """A spring and a dashpot in a row beside the body's own: memory that fades with time tau.

    With the strain w of the dashpot, an internal unknown at each node,
    ``b(u - w, v)`` is the energy's and ``tau b(w', v)`` the dissipation's form; a Prony series is
    several branches.

    Parameters
    ----------
    tau : float
        Relaxation time (s), > 0.
    kappa, E, nu, tensor
        Moduli of the spring, as for `Elasticity`.

    Raises
    ------
    InputError
        If tau is not > 0, or as for `Elasticity`.

    Examples
    --------
    >>> MaxwellBranch(2.0, kappa=1.0).tau
    2.0
    """

    tau: float
    kappa: Datum | None = None
    E: Datum | None = None
    nu: Datum | None = None
    tensor: ArrayLike | None = None
    data, choices, meaning = Elasticity.data, Elasticity.choices, Elasticity.meaning
    moduli = Elasticity.lame

    def __post_init__(self) -> None:
        number("tau", self.tau, 0.0, strict=True)
        super().__post_init__()

    def deformation(self, body: Discretisation, motion: Kinematics) -> Array:
        """u - w, of the spring."""
        return motion.u - body.expand(motion.internal)

    def contribute(self, body: Discretisation) -> Contribution:
        """Matrices of u and w; none if the moduli are zero everywhere."""
        S = _stiffness(body, self)
        if not S.count_nonzero():
            return Contribution()
        if (point := body.loose_point(S)) is not None:
            raise InputError(
                f"tau: nothing holds the dashpot's own displacement in the piece with the point "
                f"{point}, where no strain tells it; clamp or hold part of every piece, as a "
                "foundation or a dashpot does not act on it"
            )
        zero = sp.csc_array(S.shape)
        return Contribution(
            A=sp.block_diag([zero, self.tau * S], format="csc"),
            B=sp.block_array([[S, -S], [-S, S]], format="csc"),
            internal=body.dim,
        )


def _check_compressible(nu: Array) -> None:
    if nu.max() >= 0.5:
        raise InputError(
            f"nu must be < 0.5, got {nu.max():g}: incompressible bodies are not in the class; in "
            "plane stress take 0.499999"
        )


def _check_elastic(body: Discretisation, E: Array, nu: Array, where: Array) -> None:
    """Refuse moduli, at points of strains, that are not those of the scene's elasticity."""
    try:
        laws = [one.lame(body, body.whole) for one in body.effects if hasattr(one, "lame")]
    except InputError:  # which the elasticity tells under its own name
        return
    if any(mu is None for _, mu in laws):
        raise InputError(
            "E: an eigenstrain beside an elasticity with a tensor is not offered, as its stress is "
            "not the same in all directions; give the elasticity E and nu"
        )
    if not laws:
        return
    lam, mu = (sum(one) for one in zip(*laws, strict=True))
    both = 2 * mu * (1 + nu), (3 * lam + 2 * mu) * (1 - 2 * nu)
    if not np.isclose(E, both, atol=0.0)[:, where].all():
        raise InputError(
            "E: the elasticity of the scene has other moduli where the eigenstrain acts, which "
            "would make another strain; give the same E and nu"
        )


def strains(body: Discretisation, u: Any) -> list[Any]:
    """The gradient of a number, or the engineering strains of a vector in Voigt's order."""
    d, g = body.mesh.dim(), u.grad
    if body.components == 1:
        return list(g)
    shears = reversed([*combinations(range(d), 2)])
    return [g[i, i] for i in range(d)] + [g[i, j] + g[j, i] for i, j in shears]


def deviators(body: Discretisation, place: Place, lam: Any, mu: Any) -> sp.csr_array:
    """Rows of the deviators of strains at the points of a quadrature.

    In an orthonormal basis of the deviators, the components of a point one after the other; in
    plane stress with the e_zz that makes the stress of moduli lam and mu vanish.
    """
    basis, values = place.basis, []
    for phi in basis.basis:
        rows = strains(body, phi[0])
        if body.components > 1:
            xx, yy, *others = rows
            zz = others.pop(0) if body.components == 3 else 0.0
            if body.kind == "plane stress":
                zz = -lam / (lam + 2 * mu) * (xx + yy)
            rows = [xx - yy, (xx + yy - 2 * zz) / np.sqrt(3), *others]
        values.append([row / np.sqrt(2) for row in rows])
    return body.rows(basis, values)


def _stiffness(body: Discretisation, effect: StrainLaw) -> sp.csc_array:
    """int C e(u) . e(v) on the unknowns."""
    place, C = body.whole, effect.tensor
    normal = body.mesh.dim() if body.components > 1 else 0  # strains; the others are shears
    lam, mu = effect.moduli(body, place)
    if C is not None:
        size = body.mesh.dim() * (body.mesh.dim() + 1) // 2 if normal else body.mesh.dim()
        C = symmetric("tensor", C, size)
        if np.linalg.eigvalsh(C)[0] < 0:
            raise InputError("tensor must be positive semidefinite; it has a negative eigenvalue")
    elif body.kind == "plane stress":
        _check_proportional(body, lam / mu, "zeta" if isinstance(effect, Viscosity) else "nu")
        lam = 2 * lam * mu / (lam + 2 * mu)

    @BilinearForm
    def form(u: Any, v: Any, _: Any) -> Any:
        a, b = strains(body, u), strains(body, v)
        if C is not None:
            return sum(C[i, j] * a[j] * b[i] for i, j in np.argwhere(C).tolist())
        twice = sum(x * y for x, y in zip(a[:normal], b, strict=False))
        every = sum(x * y for x, y in zip(a, b, strict=True))
        return lam * sum(a[:normal]) * sum(b[:normal]) + mu * (twice + every)

    return body.restrict(form.assemble(place.basis))


def _check_proportional(body: Discretisation, ratio: Array, name: str) -> None:
    """Refuse laws that differ in lam / mu: in plane stress they share the strain across it."""
    for one in body.effects:
        if hasattr(one, "moduli"):
            try:
                lam, mu = one.moduli(body, body.whole)
            except InputError:  # of the other one, which tells it under its own name
                continue
            if mu is not None and not np.allclose(lam / mu, ratio, rtol=1e-9):  # formulas round
                raise InputError(
                    f"{name}: in plane stress viscosity, elasticity and Maxwell branches need one "
                    "Poisson's ratio, as the strain across the plane follows from all of them, and "
                    f"{type(one).__name__} has another: give all the same nu, and viscosity zeta = "
                    "2 nu eta / (1 - 2 nu), or take kind = 'solid'"
                )


def _restrict(body: Discretisation, where: str, x: Any) -> Any:
    """A matrix or a vector on the unknowns; refused if all that it acts on is held."""
    restricted, size = body.restrict(x), abs(x).sum()
    if size and abs(restricted).sum() <= NEGLIGIBLE * size:
        raise InputError(f"{where} is clamped or held, so that its displacement is given")
    return restricted
