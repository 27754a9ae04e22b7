"""From effects and a start to a problem: what a scene declares is assembled, and nothing else."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
import scipy.sparse as sp
import skfem
from numpy.typing import ArrayLike

from sweepopt.checks import (
    at_path,
    axes,
    choice,
    count,
    entries,
    listed,
    matrix,
    number,
    symmetric,
    times_inside,
    tolerance,
    vector,
    with_checks,
)
from sweepopt.display import Displayed, Rows, record, svg
from sweepopt.errors import DamagedFileError, IndefiniteError, InputError, result_of, shown
from sweepopt.fem import output, pictures
from sweepopt.fem.contact import Contact, Yield, by_history, dissipation, merged
from sweepopt.fem.effects import (
    Contribution,
    Effect,
    Kinematics,
    Record,
    Stress,
    released,
    total,
)
from sweepopt.fem.fields import Array, Coefficient, Datum
from sweepopt.fem.frames import PARALLEL
from sweepopt.fem.mesh import coordinates
from sweepopt.fem.spaces import Discretisation, boundary_names
from sweepopt.integrate import schemes
from sweepopt.io import as_path, folder_at
from sweepopt.linalg import require_semidefinite
from sweepopt.loads import History, Separable, breakpoints
from sweepopt.problem import EvolutionVI, SweepingProcess
from sweepopt.results import Solution, field_names, open_run, read
from sweepopt.sets import ConvexSet, MovingSet, Point, StateDependent, Summands
from sweepopt.velocity import PATHS, solvers

UNITS = ("dimensionless", "SI")


@record
class Scene(Displayed):
    """A problem with its mesh and settings, as `body`, `antiplane` and `read_scene` build it.

    Attributes
    ----------
    problem : EvolutionVI or SweepingProcess
        A, B, load, dissipation and u0 on the unknowns; where the dissipation moves, a process. Its
        fields are "u" and internal unknowns by the table of their effect, such as "plasticity".
    discretisation : Discretisation
    contact : Contact or None
        The nodes with friction; None without friction.
    effects : tuple of Effect
    left_out : tuple of str
        A sentence for each thing the scene does not name and the problem therefore does not have.
    t_end, steps
        Duration, and number of steps or their times; None if the scene does not say.
    scheme, solver, tol, path
        Arguments of `sweepopt.solve`.
    units : {"dimensionless", "SI"}
    title : str
    force : callable or None
        f(t), shape (dim,); None is no load.
    lifts : tuple of (history, ndarray)
        Prescribed displacements phi(t) d, of all degrees of freedom.
    yields : tuple of Yield
        What makes C(t) more than a point; empty without friction and yield stresses.
    internal : tuple of slice
        The internal unknowns of each effect among all.
    tables : tuple of str
        Names of the effects, in a file those of their tables, such as "traction[0]".
    pictures : sequence of str or None
        Those of a run, of PICTURES; None for all that fit.
    changes : tuple of str
        What `read_scene` was told to change in the file.
    """

    problem: EvolutionVI | SweepingProcess
    discretisation: Discretisation
    contact: Contact | None
    effects: tuple[Effect, ...]
    left_out: tuple[str, ...]
    t_end: Any
    steps: Any
    scheme: str
    solver: str
    tol: float
    path: str
    units: str
    title: str
    force: Callable[[float], Any] | None
    lifts: tuple[tuple[History, Array], ...]
    yields: tuple[Yield, ...]
    internal: tuple[slice, ...]
    tables: tuple[str, ...]
    pictures: Sequence[str] | None = None
    changes: tuple[str, ...] = ()

    _instead: ClassVar = {
        "mesh": "it is scene.discretisation.mesh",
        "run": "scene.solve() runs it",
        "u": "scene.solve().u are the states",
    }

    def _rows(self) -> Rows:
        space = self.discretisation
        yield "Scene", self.title
        yield "body", f"{space.kind}, {space.element}, {space.mesh.nelements} cells"
        yield "unknowns", self.problem.dim
        yield "effects", ", ".join(type(effect).__name__ for effect in self.effects)
        yield "t_end, steps", f"{self.t_end}, {self.steps}"
        yield "left out", "; ".join(self.left_out)

    def _picture(self) -> str:
        mesh = self.discretisation.mesh
        if mesh.dim() != 2:
            return ""
        edges = mesh.boundary_facets()
        return svg([mesh.p[:2, mesh.facets[:2, edge]].T for edge in edges], equal=True)

    @property
    def process(self) -> SweepingProcess:
        """The problem as a sweeping process."""
        return self.problem.as_sweeping()

    def load(self, t: float) -> Array:
        """f(t), shape (dim,)."""
        return np.zeros(self.problem.dim) if self.force is None else self.force(t)

    def require_run(self, solution: Any) -> None:
        """Refuse what is no run of this scene."""
        if not isinstance(solution, Solution):
            raise InputError(f"solution must be what scene.solve() returns, got {shown(solution)}")
        given, dim = solution.process.dim, self.problem.dim
        if given != dim:
            raise InputError(f"solution has dim {given}, the scene {dim}; give a run of this scene")
        digest = self.problem.unknowns_digest
        if vars(solution.process).get("unknowns_digest", digest) != digest:
            raise InputError("solution is of another mesh or clamping; give a run of this scene")

    @with_checks
    def displacement(self, solution: Solution, t: ArrayLike | None = None) -> Array:
        """u at all nodes, shape (k, N), or (k, N, components) of vectors.

        Parameters
        ----------
        solution : Solution
        t : array_like, shape (k,), optional
            Times of the run; those of the solution by default.
        """
        self.require_run(solution)
        times = solution.t if t is None else np.atleast_1d(t)
        u = solution.u if t is None else solution(times)
        return self._full(u, lambda history: history(times))

    @with_checks
    def velocity(self, solution: Solution, t: ArrayLike | None = None) -> Array:
        """u' at all nodes in each step, shape (n, N), or (n, N, components) of vectors.

        Or, shape (k, N, ...), at k times of the run: in the step that contains the time or ends
        there; in the first step at its start.
        """
        self.require_run(solution)
        mu = np.diff(solution.t)
        rate = self._full(solution.velocity, lambda history: np.diff(history(solution.t)) / mu)
        if t is None:
            return rate
        times = times_inside(np.atleast_1d(t), solution.t)
        return rate[np.maximum(np.searchsorted(solution.t, times) - 1, 0)]

    def stress(self, solution: Solution, t: ArrayLike | None = None) -> Array | None:
        """Von Mises's stress in each cell, of antiplane shear the shear stress, shape (k, cells).

        That of the mean deviator in the cell, by elasticity, viscosity, plastic strains, Maxwell
        branches, and effects of your own that have `stress`, at times t of the run, by default
        those of the solution. None where strains do not tell it: with a yield stress or a tensor,
        and in plane stress with an eigenstrain.

        Notes
        -----
        The deviator is the sum of what effects add to it, at the points of strains,
        s = 2 mu (dev e(u) - p) + 2 eta dev e(u'), with u' of the step that ends there; its size is
        sqrt(3/2) |s|, in antiplane shear |s| / sqrt(2).
        """
        self.require_run(solution)
        if not (laws := self.stress_laws()):
            return None
        t, body = solution.t if t is None else np.atleast_1d(t), self.discretisation
        u, rate = self.displacement(solution, t), self.velocity(solution, t)
        states = solution(t)
        total = np.zeros((len(u), 1, 1, 1))
        for law, at in laws:
            total = total + law(Kinematics(u, rate, states[:, at]))
        mean = np.einsum("cp,kcps->kcs", body.whole.shares, total)
        return np.linalg.norm(mean, axis=2) * np.sqrt(0.5 if body.components == 1 else 1.5)

    def stress_laws(self) -> list[tuple[Stress, slice]]:
        """The parts of the stress with their internal unknowns; none if one is not known."""
        each = zip(self.effects, self.internal, strict=True)
        laws = [(one.stress(self.discretisation), at) for one, at in each if hasattr(one, "stress")]
        return [] if any(law is None for law, _ in laws) else laws

    def plastic_strain(self, solution: Solution, t: ArrayLike | None = None) -> Array | None:
        """sqrt(2/3) |p|, its mean in each cell, shape (k, cells); None without p.

        At times t of the run, by default those of the solution.
        """
        self.require_run(solution)
        u = solution.u if t is None else solution(np.atleast_1d(t))
        each = zip(self.effects, self.internal, strict=True)
        parts = [
            one.plastic_strain(self.discretisation, u[:, at])
            for one, at in each
            if hasattr(one, "plastic_strain")
        ]
        return sum(parts) if parts else None

    def _full(self, u: Any, values: Callable[[History], Any]) -> Array:
        space = self.discretisation
        field = space.expand(u[:, : space.dim])
        nodes = space.nodes[0] if space.components == 1 else space.nodes.T
        for history, d in self.lifts:
            field = field + np.multiply.outer(values(history), d[nodes])
        return field

    @with_checks
    def solve(self, **arguments: Any) -> Solution:
        """`sweepopt.solve` with the scene's settings; keywords replace or add arguments."""
        from sweepopt.driver import solve

        names = ("t_end", "steps", "scheme", "solver", "tol", "path")
        settings = {name: one for name in names if (one := getattr(self, name)) is not None}
        return solve(self.problem, **(settings | arguments))

    @with_checks
    def plot(self, solution: Solution, picture: str = "") -> Any:
        """A picture of a run, one of PICTURES; by default the first that fits.

        Returns
        -------
        matplotlib Figure

        Raises
        ------
        InputError
            If the picture does not fit the scene.
        """
        return pictures.draw(output.Report(self, solution), picture)

    @with_checks
    def write(self, solution: Solution, folder: str | Path) -> Path:
        """Write what `sweepopt run` writes: pictures, NetCDF, VTU and a summary; the folder.

        Raises
        ------
        MissingExtraError
            If matplotlib, h5netcdf or h5py is not installed.
        """
        folder = folder_at("folder", as_path("folder", folder))
        picture_files = [f"{name}.png" for name in pictures.pictures_of(self)]
        output.write(output.Report(self, solution, name=folder.name), folder, picture_files)
        return folder

    @with_checks
    def animate(self, solution: Solution, path: str | Path, picture: str = "") -> Path:
        """Write a run as an animation of at most 50 kept steps that end at even times.

        Parameters
        ----------
        path : str or Path
            A ``.gif``, or an ``.mp4``, which needs the program ffmpeg.
        picture : str
            One of "displacement", "surface", "flow", "stress", "yielding" and "arrows"; by default
            the first of the scene's pictures that is one of them, else the first that fits.

        Returns
        -------
        Path

        Raises
        ------
        InputError
            If the picture does not fit the scene, or ffmpeg is not there for an MP4.
        """
        return pictures.animate(output.Report(self, solution), path, picture)


@dataclass(frozen=True)
class Initial(Record):
    """u0 of a scene: zero where nothing is given.

    Parameters
    ----------
    u : number, formula, Profile or callable, optional
        Displacement (m) at the start; of vectors a list, one for each of x, y and z. What is held
        stays where it is held, internal unknowns start at zero.
    run : str or Path, optional
        Instead of u: a NetCDF file whose last state is taken: the ``solution.nc`` of ``sweepopt
        run``, or one of ``save="run.nc"`` or `Solution.save`.

    Raises
    ------
    InputError
        If both are given or a value is not finite; when used, if the file is no run of this body:
        another number of unknowns, other fields or another mesh.

    Examples
    --------
    >>> Initial(u="0.1 * x").u
    '0.1 * x'
    """

    u: Datum | Sequence[Datum] | None = None
    run: str | Path | None = None
    data = (Coefficient("u", vector=True),)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.u is not None and self.run is not None:
            raise InputError("run: give u or run, not both")

    def state(
        self, space: Discretisation, fields: Mapping[str, slice], size: int, digest: str
    ) -> Array:
        """u0 on all unknowns, shape (size,).

        Parameters
        ----------
        fields : mapping of str to slice
            What the unknowns are: "u", and internal ones.
        digest : str
            Of the unknowns of the scene.
        """
        u0 = np.zeros(size)
        if self.u is not None:
            u0[: space.dim] = space.interpolate(self.u, "u")
        if self.run is None:
            return u0
        path = as_path("run", self.run)
        labels = field_names(fields, size)
        try:
            with open_run(path) as run:
                kinds = read(run["field"]) if "field" in run.variables else labels
                u, digest_of_run = run["u"], run.attrs.get("unknowns_digest", "")
                last = u[-1] if "time" in u.dimensions else u[...]
        except (InputError, DamagedFileError) as error:
            raise InputError(f"run: {str(error).removeprefix('path: ')}") from None
        if last.shape != u0.shape or not np.array_equal(kinds, labels):
            raise InputError(
                f"run: {path} has {last.size} unknowns of {_fields(kinds)}, the scene "
                f"{size} of {_fields(labels)}; take a run of the same body and effects"
            )
        if digest_of_run not in ("", digest):
            raise InputError(
                f"run: {path} is of another mesh or an earlier version of sweepopt, or other "
                "components are held or turned (by friction), other cells are plastic, or moduli "
                "differ in a body with isotropic hardening; take a run of this body"
            )
        return last


def _fields(names: Any) -> str:
    """The fields in an array of names of unknowns."""
    return ", ".join(dict.fromkeys(map(str, names)))


def antiplane(
    mesh: skfem.Mesh | str | Path,
    *,
    clamped: str | Sequence[str],
    effects: Sequence[Effect],
    element: str = "P1",
    refinements: int = 0,
    **settings: Any,
) -> Scene:
    """Antiplane shear of a section: u(x, t) is the displacement out of its plane.

    Parameters
    ----------
    mesh : skfem.Mesh, str or Path
        With named boundaries; a path is read by `read_mesh`. `skfem.MeshTri2` has curved edges.
    clamped : str or sequence of str
        Names of the boundaries that make up Gamma_1.
    effects : sequence of Effect
        A viscosity; all others are optional.
    element : {"P1", "P2"}
    refinements : int
        How often each triangle of the mesh is divided into four.
    settings
        u0, t_end, steps, scheme, solver, tol, path, units, title: as for `body`.

    Returns
    -------
    Scene

    Raises
    ------
    InputError
        Naming the argument, or the effect and its field, at fault.

    Examples
    --------
    >>> import skfem
    >>> from sweepopt.fem import Elasticity, Friction, Viscosity, antiplane
    >>> square = skfem.MeshTri().refined(2).with_defaults()
    >>> scene = antiplane(
    ...     square, clamped="top", effects=[Viscosity(1.0), Friction("bottom", g=0.5)]
    ... )
    >>> len(scene.contact), float(scene.contact.weight.sum())
    (5, 1.0)
    >>> scene.left_out
    ('no elasticity: B is not formed', 'no load: f = 0')
    """
    space = Discretisation(mesh, clamped, element, refinements)
    return body(space, effects, **settings)


def body(
    space: Discretisation,
    effects: Sequence[Effect],
    u0: ArrayLike | Initial | None = None,
    t_end: float | None = None,
    steps: int | None = None,
    scheme: str = "auto",
    solver: str = "auto",
    tol: float = 1e-6,
    path: str = "auto",
    units: str = "dimensionless",
    title: str = "",
) -> Scene:
    """A body with effects: antiplane, in plane strain or stress, or solid, as the space says.

    Parameters
    ----------
    space : Discretisation
    effects : sequence of Effect
        Of each kind as many as there are; A from viscosity or dashpots is asked for.
    u0 : array_like of shape (dim,) or Initial, optional
        Initial values of the unknowns, or where they are from; zero by default. Where friction
        turns unknowns to normals and tangents, take an `Initial`.
    t_end, steps, scheme, solver, tol, path, units, title
        Kept in the scene. Histories must cover [0, t_end], or the times that `steps` lists;
        functions of time are called at the start once, to see what they return.

    Returns
    -------
    Scene

    Raises
    ------
    InputError
        Naming the argument, or the effect and its field, at fault.

    Examples
    --------
    >>> from sweepopt.fem import Dashpot, Discretisation, Foundation, Friction, body, grid
    >>> sheet = Discretisation(grid([2.0, 1.0], [4, 2]), (), kind="plane stress")
    >>> effects = [Dashpot("body", 1.0), Foundation("body", 2.0), Friction("body", g=0.5)]
    >>> scene = body(sheet, effects)
    >>> scene.discretisation.dim, len(scene.contact)
    (30, 15)
    """
    if not isinstance(space, Discretisation):
        remedy = "a mesh is made one by so.fem.Discretisation(mesh, clamped)"
        raise InputError(f"space must be a Discretisation, got {shown(space)}; {remedy}")
    labelled = {f"effects[{k}]": effect for k, effect in enumerate(listed("effects", effects))}
    if t_end is not None:
        t_end = number("t_end", t_end, minimum=0.0, strict=True)
    settings = {"t_end": t_end, "steps": steps, "units": units, "title": title}
    return build(space, labelled, u0, settings | method(scheme, solver, tol, path))


def method(
    scheme: str = "auto", solver: str = "auto", tol: float = 1e-6, path: str = "auto"
) -> dict[str, Any]:
    """Arguments of `sweepopt.solve`; a name that is not known is refused."""
    schemes.choose(scheme, coercive=True)
    solvers.choose(solver, Point([0.0]))
    choice("path", path, PATHS)
    return {"scheme": scheme, "solver": solver, "tol": tolerance(tol), "path": path}


def build(
    space: Discretisation,
    effects: Mapping[str, Effect],
    u0: ArrayLike | Initial | None,
    settings: Mapping[str, Any],
) -> Scene:
    """A scene from effects by the label that errors shall give them."""
    _check_words(**settings)
    steps = settings["steps"]
    start = float(entries("steps", steps)[0]) if axes(steps) else 0.0
    given, space = space, _with_effects(space, effects, start)
    _check_directions(given, space, u0)
    parts = [_contribution(label, effects[label], space, settings["t_end"]) for label in effects]
    ends = np.cumsum([space.dim, *[part.internal for part in parts]]).tolist()
    size, internal = ends[-1], tuple(map(slice, ends, ends[1:]))
    tables = tuple(label.removeprefix("effects.") for label in effects)
    fields = {"u": slice(0, space.dim)} | {
        name: one for name, one in zip(tables, internal, strict=True) if one.stop > one.start
    }
    parts = _on_all_unknowns(space.dim, parts, internal)
    A, B, loads = total(parts)
    lifts = tuple(part.lift for part in parts if part.lift is not None)
    yields = tuple(one for part in parts for one in part.yields)
    with _blaming(effects, parts):
        _check_held(space, A, B)
    _check_lifts(space, effects, parts)
    loads += _forces_of_motion(space, effects, lifts) if lifts else []
    known = [one.slopes for one in yields if one.slopes is not None]
    places = [one.cells(space) for one in space.effects if hasattr(one, "plastic_strain")]
    digest = space.digest(*known, *places)  # of what the unknowns are, internal ones too
    vars(space).pop("basis", None)
    force = _force(loads, space.dim, size)
    if isinstance(u0, Initial):
        with at_path("initial."):
            u0 = u0.state(space, fields, size, digest)
    A = sp.csc_array((size, size)) if A is None else A
    with _blaming(effects, parts):
        problem = _problem(A, B, force, yields, np.zeros(size) if u0 is None else u0, fields)
    problem.unknowns_digest, problem.moved = digest, bool(lifts)
    terms = {
        "no elasticity: B is not formed": B is not None,
        "no friction: J is not formed": yields,
        "no load: f = 0": loads,
    }
    return Scene(
        problem=problem,
        discretisation=space,
        contact=merged([one.contact for one in yields if one.contact is not None]),
        effects=space.effects,
        left_out=tuple(sentence for sentence, present in terms.items() if not present),
        force=force,
        lifts=lifts,
        yields=yields,
        internal=internal,
        tables=tables,
        **settings,
    )


def _check_words(units: Any, title: Any, **_: Any) -> None:
    if units not in UNITS:
        raise InputError(
            f"units must be one of {', '.join(UNITS)}; got {shown(units)}; convert to metres, "
            "seconds and pascals (SI), or leave it out (dimensionless)"
        )
    if not isinstance(title, str) or not title.replace("\n", " ").isprintable():
        raise InputError(f"title must be text, got {shown(title)}; leave out control characters")


def _with_effects(
    space: Discretisation, effects: Mapping[str, Effect], start: float
) -> Discretisation:
    """The body of a scene: with its effects, and turned where these need it."""
    turned = list(space.turned)
    for label, one in effects.items():
        if isinstance(one, type) or not hasattr(one, "contribute"):
            raise InputError(
                f"{label} must be an object with a method contribute(body), as Viscosity(1.0), got "
                f"{shown(one)}"
            )
        if space.components > 1 and hasattr(one, "turned"):
            names = boundary_names(f"{label}.turned", one.turned)
            if set(names) <= set(space.mesh.boundaries or {}):
                turned.append(names)
    return space.with_unknowns(
        turned=tuple(dict.fromkeys(turned)), effects=tuple(effects.values()), start=start
    )


def _check_directions(given: Discretisation, space: Discretisation, u0: Any) -> None:
    """Refuse numbers for unknowns that effects turn to other directions."""
    if isinstance(u0, Initial) or not np.any(u0):
        return
    if np.abs(given.extension - space.extension).max() > PARALLEL:
        raise InputError(
            "u0: friction turns unknowns of this space to normals and tangents, so that numbers "
            "along x, y and z would be taken for others; give so.fem.Initial(u=...), or both the "
            "space and the numbers of scene.discretisation of a scene with these effects"
        )


@contextmanager
def _blaming(effects: Mapping[str, Any], parts: Sequence[Contribution]) -> Iterator[None]:
    """Name the effect of an indefinite matrix where a check of the sums fails."""
    try:
        yield
    except InputError as error:
        for (label, effect), part in zip(effects.items(), parts, strict=True):
            cones = any(one.slopes is not None for one in part.yields)
            if cones and isinstance(error, IndefiniteError) and not getattr(effect, "Hk", True):
                raise InputError(
                    f"{label}.Hk: isotropic hardening alone is not offered beside a yield stress, "
                    "or friction with axes, on walls that meet at an angle or where another effect "
                    "bounds the same nodes; give Hk > 0 or eta > 0"
                ) from None
            for name in "AB":
                if (M := getattr(part, name)) is not None and not part.internal:
                    with at_path(f"{label}: its "):
                        require_semidefinite(name, M)
        raise


def _check_held(space: Discretisation, A: Any, B: Any) -> None:
    """Refuse a body of which a piece moves freely."""
    matrices = [M for M in (A, B) if M is not None]
    if not matrices:
        raise InputError(
            "effects must hold a viscosity, an elasticity, a dashpot or a foundation: "
            "nothing resists a motion"
        )
    of_body = sum(M[: space.dim, : space.dim] for M in matrices)
    if (point := space.loose_point(of_body)) is not None:
        raise InputError(
            "clamped (domain.clamped of a file): nothing holds the piece of the body that contains "
            f"{point}; clamp part of every piece, hold components, or give it a foundation or a "
            "dashpot"
        )
    if (alone := np.flatnonzero(of_body.diagonal() == 0)).size:
        node = np.nonzero(space.nodes == space.free[alone[0]])[1][0]
        point = coordinates(space.points[node])
        raise InputError(
            f"effects: no viscosity, elasticity, dashpot or foundation acts at {point}, so that "
            "nothing resists its motion; let one act there"
        )


def _check_lifts(
    space: Discretisation, effects: Mapping[str, Effect], parts: Sequence[Contribution]
) -> None:
    """Refuse a prescribed displacement that something nonsmooth or internal would see.

    Several of the same boundaries are terms of one; of others they would add up where they meet.
    """
    labelled, frame = list(zip(effects, parts, strict=True)), space.frame
    lifts = [(label, part.lift[1]) for label, part in labelled if part.lift is not None]
    for name, d in lifts:
        for label, part in labelled:
            bound = any(one.rows.where == "gradient" or one.shape != "ball" for one in part.yields)
            if bound or part.internal:
                raise InputError(
                    f"{label} cannot be combined with {name}: its strains or velocities would lack "
                    "what is prescribed; drive the body by a traction"
                )
            for one in part.yields:
                if one.contact is None:
                    continue
                node = one.contact.node
                normal = (frame.held[node] == 1) & ~frame.normal[node] & (one.rows.where == "trace")
                if d[space.nodes[:, node[~normal]]].any():  # |v| would lack it
                    raise InputError(
                        f"{name} moves a tangent of a boundary of {label}, whose slip would lack "
                        "it; prescribe it elsewhere"
                    )


def _problem(
    A: Any,
    B: Any,
    force: Any,
    yields: Sequence[Yield],
    u0: ArrayLike,
    fields: dict[str, slice],
) -> EvolutionVI | SweepingProcess:
    """The variational inequality, or the process where bounds move."""
    slipping = [one.lipschitz for one in yields if one.slip is not None]
    D: Any = dissipation(yields) if yields else None
    if not slipping and not any(callable(one.g) for one in yields):
        D = D and D()
        return EvolutionVI(A, B, load=force, dissipation=D, u0=u0, fields=fields)

    def at(t: float, u: Array | None = None) -> ConvexSet:
        C = -D(t, u)
        return C if force is None else C + force(t)

    histories = [phi for one in yields for phi in one.histories]
    histories += [] if force is None else [phi for phi, _ in force.terms]
    if slipping:
        return SweepingProcess(A, B, StateDependent(at, sum(slipping), histories), u0, fields)
    C = MovingSet(at, A.shape[0], histories)
    parts = tuple((phi, -dissipation(some)()) for phi, some in by_history(yields))
    if parts and not isinstance(force, _Load):  # all of it is data
        at_rest = Point(np.zeros(A.shape[0]))
        C.summands = Summands(() if force is None else force.terms, at_rest, parts)
    return SweepingProcess(A, B, C, u0, fields)


def _contribution(
    label: str, effect: Effect, space: Discretisation, t_end: float | None
) -> Contribution:
    """What an effect adds; its history must cover the run."""
    own = type(effect).__module__.startswith(__package__)
    if not (own or label.startswith("effects.")):
        label = f"{type(effect).__name__}: {label}"
    with at_path(f"{label}."):
        part = _valid_contribution(effect.contribute(space), space, own)
    if (history := getattr(effect, "history", None)) is not None and t_end is not None:
        with at_path(f"{label}.history: "):
            for t in (space.start, t_end):
                result_of(history, t, "history")
    return replace(part, yields=[replace(one, label=f"{label}.") for one in part.yields])


def _valid_contribution(part: Any, space: Discretisation, own: bool) -> Contribution:
    """What an effect, one of our own or a user's, gives, if it is finite and fits the body."""
    if not isinstance(part, Contribution):
        raise InputError(f"contribute must return a so.fem.Contribution, got {shown(part)}")
    dim = space.dim
    sizes = {dim, dim + count("internal", part.internal, 0)}

    def fits(name: str, size: int) -> None:
        if size not in sizes:
            raise InputError(
                f"{name} has {size} unknowns, the body has {dim}: take what is of all degrees of "
                "freedom to those that are not held by body.restrict"
            )

    for name in ("A", "B"):
        if (given := getattr(part, name)) is not None:
            M = symmetric(name, given)
            fits(name, M.shape[0])
            part = replace(part, **{name: sp.csc_array(M)})  # not all formats have slices
    for name in ("loads", "yields"):
        if not isinstance(getattr(part, name), (list, tuple)):
            raise InputError(f"{name} must be a list, [...], got {shown(getattr(part, name))}")
    if not all(isinstance(load, tuple) and len(load) == 2 for load in part.loads):
        raise InputError("loads must hold pairs of a history and a vector: loads=[(history, f)]")
    for k, (phi, f) in enumerate(part.loads):
        if not callable(phi):
            field = "; only a field called history is read as a waveform" * isinstance(phi, Mapping)
            raise InputError(f"loads[{k}][0] must be a function of time, got {shown(phi)}{field}")
        fits(f"loads[{k}]", vector(f"loads[{k}]", f(space.start) if callable(f) else f).size)
    for k, one in enumerate(part.yields):
        if not (isinstance(one, Yield) and hasattr(one.rows, "E")):
            raise InputError(f"yields[{k}] must be a Yield of Rows, got {shown(one)}")
        with at_path("" if own else f"yields[{k}]."):
            fits("rows.E", matrix("rows.E", one.rows.E).shape[1])
            one.check(space.start)
    return part


def _on_all_unknowns(
    dim: int, parts: Sequence[Contribution], internal: Sequence[slice]
) -> list[Contribution]:
    """The parts on all unknowns: internal ones follow those of the body in order."""
    every, result = sp.eye_array(internal[-1].stop if internal else dim, format="csr"), []
    for part, own in zip(parts, internal, strict=True):
        E = every[np.r_[:dim, own]]
        A, B = (
            None if M is None else E[: M.shape[0]].T @ M @ E[: M.shape[0]] for M in (part.A, part.B)
        )
        yields = [
            replace(one, rows=replace(one.rows, E=one.rows.E @ E[: one.rows.E.shape[1]]))
            for one in part.yields
        ]
        result.append(replace(part, A=A, B=B, yields=yields))
    return result


class _Load(NamedTuple):
    """``sum_k phi_k(t) f_k(t)``, with the breakpoints of those phi_k that know them."""

    terms: Sequence[tuple[Any, Any]]
    of_body: int
    dim: int

    def __call__(self, t: float) -> Array:
        name, terms = f"a function in loads, at t = {t:g},", self.terms
        f = sum(phi(t) * vector(name, f(t) if callable(f) else f, self.of_body) for phi, f in terms)
        return np.pad(f, (0, self.dim - self.of_body))

    def breakpoints(self, a: float, b: float) -> Array:
        return breakpoints((phi for phi, _ in self.terms), a, b)


def _force(terms: Sequence[Any], of_body: int, dim: int) -> Any:
    """The sum of the terms; data where all of them are. None acts on internal unknowns."""
    if any(callable(f) for _, f in terms):
        return _Load(terms, of_body, dim)
    padded = [(phi, np.pad(vector("loads", f, of_body), (0, dim - of_body))) for phi, f in terms]
    return Separable(padded) if terms else None


def _forces_of_motion(
    space: Discretisation,
    effects: Mapping[str, Effect],
    lifts: Sequence[tuple[History, Array]],
) -> list[Any]:
    """-A_fd d' and -B_fd d, by the matrices of the body with nothing held."""
    A, B, _ = released(space, effects.values())
    return [
        (phi, -space.restrict(M @ d))
        for history, d in lifts
        for phi, M in ((history.rate(), A), (history, B))
        if M is not None
    ]
