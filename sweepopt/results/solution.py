"""A trajectory that can prove how good it is."""

from __future__ import annotations

import json
import warnings
from contextlib import suppress
from dataclasses import fields, replace
from functools import cached_property
from os import PathLike
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from sweepopt import checks
from sweepopt.checks import Array
from sweepopt.display import Displayed, Rows, as_lines, brief, evenly, record, svg
from sweepopt.errors import (
    BoundWarning,
    CheckpointWarning,
    InputError,
    SaveError,
    Status,
    SweepoptError,
    shown,
    warn,
)
from sweepopt.integrate import (
    BY_EULER,
    ROW,
    SCHEMES,
    Pass,
    States,
    Statistics,
    differences,
    implicit_euler,
    program_of_stage,
)
from sweepopt.io import writable
from sweepopt.problem import SweepingProcess, sweeping
from sweepopt.results.dataset import (
    STATISTICS,
    dataset_of,
    open_run,
    read,
    to_xarray,
    write_dataset,
)
from sweepopt.results.error_bound import ErrorBound, error_bound, nodes_of, require_bound
from sweepopt.results.interpolation import Nodes
from sweepopt.velocity import Plan, StepProgram, VelocityOf, compile_projection, make_plan

if TYPE_CHECKING:
    from collections.abc import Callable

    from matplotlib.axes import Axes
    from xarray import Dataset

    from sweepopt.integrate import Trajectory


TRIED = {
    "to_netcdf": "save(path) writes that file",
    "y": "the states are u, one row a time",
    "x": "the states are u, one row a time",
    "times": "the times are t",
    "sol": "the solution is a function: call it",
    "time": "the times are t",
    "v": "the velocities are velocity, one row a step",
    "displacement": "the states are u; those of a body at its nodes are scene.displacement(sol)",
    "z": "the velocities are velocity, one row a step",
    **dict.fromkeys(("error", "bound"), "a bound of the error is error_bound()"),
    "t_end": "it ends at t[-1]",
    **dict.fromkeys(("to_csv", "to_dataframe"), "to_xarray() is a dataset, u and t are arrays"),
    "stress": "stresses of a body are scene.stress(sol)",
    "certificate": "certificates are stats['certificate'], one a step",
}
"""Those of SciPy's solve_ivp first."""


class Field(NamedTuple):
    """Some unknowns of a solution by name: at its times, and their velocities in its steps."""

    u: Array
    velocity: Array


class Energy(NamedTuple):
    """Energies from the start to each time, shape (n+1,); dissipated + stored = work + O(mu).

    Of a body with a prescribed displacement only `friction` is known: the others are nan after the
    start, as what is held and moved is no unknown.

    Attributes
    ----------
    stored : ndarray
        1/2 <B u, u>, its change since t_0.
    viscous : ndarray
        int <A u', u'>.
    friction : ndarray
        int J(u'), J the support function of D where C(t) = f(t) - D.
    work : ndarray
        int <f, u'>.
    """

    stored: Array
    viscous: Array
    friction: Array
    work: Array

    def __repr__(self) -> str:
        rows = ((name, brief(one)) for name, one in self._asdict().items())
        return as_lines([*rows, ("balance", brief(self.balance))])

    def _repr_html_(self) -> str:
        return f"<pre>{self}</pre>"

    @property
    def balance(self) -> Array:
        """stored + viscous + friction - work: zero but for errors of the scheme and within steps.

        u is taken as linear within a step, also where scheme="exact" knows it at both ends.
        """
        return self.stored + self.viscous + self.friction - self.work


class _Absent(SimpleNamespace):
    """What a file says of a process and its plan."""

    def __repr__(self) -> str:
        return "not in the file: so.Solution.load(path, process) has it"

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        raise InputError(
            "this solution was loaded without its process, which this needs: "
            "so.Solution.load(path, process)"
        )


@record
class Solution(Displayed):
    """The piecewise-linear interpolant u_n and its diagnostics.

    Attributes
    ----------
    process : SweepingProcess
    plan : Plan
    t : ndarray, shape (k+1,)
        The start and the ends of the kept steps: with ``save=None`` the whole grid, k = n;
        read-only.
    states : States
        The kept steps, and where `u` and `velocity` come from: ``states.u(i)`` gives some nodes
        without the others.
    statistics : Statistics
        What `stats` is made of.
    status : Status
        Such as `so.Status.SUCCESS`, which equals "success"; `success` says whether the run reached
        its end.
    cause : str
        Which step failed and why, when the run stopped at it.
    recorded : list or None
        What the function given as `save` returned, one entry a step.
    passes : tuple of Pass
        All passes of adaptive steps, the last one is the run; empty for steps given beforehand.
    trajectory : Trajectory or None
        `exact`, if there is one.
    """

    process: SweepingProcess
    plan: Plan
    t: Array
    states: States
    statistics: Statistics
    status: Status
    cause: str = ""
    recorded: list[Any] | None = None
    passes: tuple[Pass, ...] = ()
    trajectory: Trajectory | None = None
    loaded: bool = False

    _instead = TRIED

    def __post_init__(self) -> None:
        checks.read_only(self.t)

    def __reduce__(self) -> tuple[Any, ...]:
        """For copies and pickle: the states as arrays; those of a run are functions of its plan."""
        states = States(self.steps, self.u.__getitem__, self.velocity.__getitem__)
        known = {one.name: getattr(self, one.name) for one in fields(self)} | {"states": states}
        return type(self), tuple(known.values())  # which makes t read-only again

    def __getitem__(self, key: Any) -> Any:
        raise InputError(
            "a Solution has attributes, no items: sol.u, sol.t, sol.velocity and sol.stats, its "
            f"steps sol.u[i], its fields sol.field(name); got [{shown(key)}]"
        )

    def _rows(self) -> Rows:
        stats, names = self.statistics.rows, [*self.statistics.solvers, "none"]
        yield type(self).__name__, f"dim {self.process.dim}, {self.status.name.lower()}"
        yield "ended", self.message
        yield "times", f"{self.t[0]:g} to {self.t[-1]:g}"
        yield "steps", f"{len(stats)}, {len(self.steps)} of them kept"
        yield "scheme", self.plan.scheme.name
        yield "solver", ", ".join(names[i] for i in np.unique(stats["solver"]))
        worst = stats["relative"].max(initial=0.0)
        yield "worst certificate", "none" if np.isnan(worst) else f"{worst:.1e} (relative)"
        bound = vars(self).get("_bound")
        yield "error bound", "not asked for: sol.error_bound()" if bound is None else repr(bound)

    def _picture(self) -> str:
        some = evenly(len(self.t), 200)
        t, u = self.t[some], self.states.u(some)[:, :4]
        span = f"{u.min():.3g} to {u.max():.3g} over t = {t[0]:g} to {t[-1]:g}"
        names = "u[0]" if u.shape[1] == 1 else f"u[0] to u[{u.shape[1] - 1}]"
        return svg([np.column_stack([t, x]) for x in u.T], title=f"{names}: {span}")

    @property
    def steps(self) -> Array:
        """The kept steps, counted from 0, shape (k,)."""
        return self.states.steps

    @cached_property
    def u(self) -> Array:
        """u_n at the times t, shape (k+1, dim), read-only."""
        return checks.read_only(self.states.u(slice(None)))

    @cached_property
    def velocity(self) -> Array:
        """u_n' in the kept steps, shape (k, dim), read-only: (u_{i+1} - u_i) / mu of each."""
        return checks.read_only(self.states.velocity(slice(None)))

    @cached_property
    def stats(self) -> Array:
        """A structured array, one row a step, shape (n,).

        t (its end), seconds, iterations, attempts, certificate (the largest bound of |z - z*|_M
        over the programs that the step solved), relative (the certificate in units of the program's
        size, what tol bounds), solver (who found it: a solver's name, "linear",
        "closed form" or "at rest"; "newton (implicit-euler)" for a step that sdirk32 took by steps
        of implicit Euler; "clarabel/4" for one in 4 parts, as breakpoints of the load lie in it or
        it missed tol as a whole: its programs are those of the parts, M = A + gamma h B with their
        lengths h, and no bound of how far its mean velocity is from that of one whole step).
        """
        return self.statistics.table()

    @checks.with_checks
    def field(self, name: str) -> Field:
        """The unknowns that `fields` of the process calls so.

        Returns
        -------
        Field
            `u` at the times t, shape (k+1, m), and `velocity` in the kept steps, shape (k, m).

        Raises
        ------
        InputError
            If no field has this name.

        Examples
        --------
        >>> import sweepopt as so
        >>> A, B, C = [[0.0, 0.0], [0.0, 1.0]], [[2.0, -1.0], [-1.0, 1.0]], so.Box([-1, -1], [1, 1])
        >>> fields = {"u": slice(0, 1), "p": slice(1, 2)}
        >>> start = [0.0, 0.0]
        >>> sol = so.solve(so.SweepingProcess(A, B, C, start, fields), t_end=1.0, steps=10)
        >>> sol.field("p").u.shape, sol.field("p").velocity.shape
        ((11, 1), (10, 1))
        """
        fields = self.process.fields
        if not isinstance(name, str) or name not in fields:
            known = ", ".join(fields) or "none; give fields= to the process"
            raise InputError(f"there is no field {shown(name)}; its fields are {known}")
        return Field(self.u[:, fields[name]], self.velocity[:, fields[name]])

    @property
    def exact(self) -> Trajectory:
        """With ``scheme="exact"`` the trajectory: u at any time to rounding, its `switches`."""
        if self.trajectory is None:
            raise AttributeError(
                'only a run with scheme="exact" has an exact trajectory, and no file keeps it; '
                "sol(t) interpolates any run"
            )
        return self.trajectory

    @property
    def complete(self) -> bool:
        """Whether all steps are kept."""
        return len(self.steps) == len(self.statistics.rows)

    @cached_property
    def _grid(self) -> Array:
        """All times of the run, kept or not, shape (n+1,)."""
        return self.t if self.complete else np.append(self.t[0], self.statistics.rows["t"])

    @property
    def success(self) -> bool:
        """Whether the run reached t_end with no step known to be wrong."""
        return self.status in (Status.SUCCESS, Status.UNCERTIFIED)

    @property
    def message(self) -> str:
        """The status as a sentence, how many steps missed tol whole, the cause of an early stop."""
        return f"{self.status.value} {self.cause}".rstrip()

    def __call__(self, t: Any) -> Array:
        """u_n(t) = u_{i+1} - (t_{i+1} - t) u_n', u_n' the velocity of step i.

        Parameters
        ----------
        t : float or array_like, shape (k,)

        Returns
        -------
        ndarray, shape (dim,) or (k, dim)

        Raises
        ------
        InputError
            If a time is outside of [t[0], t[-1]] or in a step that was not kept.
        """
        times = self._inside(t)
        later = times > self.t[0]  # the start is kept, its step may not be
        values = np.tile(self.states.u(0), (*times.shape, 1))
        i = self._step_of(times[later])
        before = (self.t[i + 1] - times[later])[:, None]
        values[later] = self.states.u(i + 1) - before * self.states.velocity(i)
        return values

    def _inside(self, t: Any) -> Array:
        """The times as floats; one that misses a kept node by rounding is that node."""
        if len(self.t) < 2:
            raise InputError("the run has no complete step to interpolate")
        return checks.times_inside(t, self.t)

    def _step_of(self, times: Array) -> Array:
        """i with t in (t_i, t_{i+1}]; refused if that step was not kept."""
        i = np.maximum(np.searchsorted(self.t, times, side="left") - 1, 0)
        between = times < self._grid[self.steps[i]]
        if between.any():
            raise InputError(
                f"t = {times[between].flat[0]:g} is in a step that was not kept; solve with "
                "another save="
            )
        return i

    def step_program(self, i: int, stage: int = 0) -> StepProgram:
        """The program of step i in cvxpy: min 1/2 <M z, z> + <B u_i, z> + J(z) - <f, z>.

        It has all unknowns, also those that the run eliminated or recovers when asked, and its
        answer is ``velocity[i]`` to the certificates of both; with several stages z_k the velocity
        is sum_k b_k z_k, b the weights ``plan.scheme.b``. It is that of the whole step, also where
        the run took it in parts ("clarabel/4" in `stats`) and ``velocity[i]`` is their mean: where
        scheme "auto" met breakpoints of the load, or its own solvers missed tol on this program.
        Where sdirk32 took five steps of implicit Euler ("newton (implicit-euler)"), these are its
        stages, with equal weights.

        Parameters
        ----------
        i : int
            A kept step, as in ``velocity[i]``.
        stage : int
            Of a scheme with several, such as sdirk2, counted from 0.

        Returns
        -------
        StepProgram
            Its `problem` and `z` are cvxpy's, `certify` is the library's proof of any answer.

        Raises
        ------
        InputError
            If there is no such step or stage, or the scheme is "exact", which has no programs.

        Examples
        --------
        >>> import sweepopt as so
        >>> C = so.Moving(so.Box(-1, 1), center=lambda t: 1.5 * t)
        >>> process = so.SweepingProcess(A=0.5, B=2.0, C=C, u0=0.0)
        >>> sol = so.solve(process, t_end=5.0, steps=200, scheme="catching-up")
        >>> program = sol.step_program(120)
        >>> value = program.problem.solve(solver="OSQP", eps_abs=1e-8, eps_rel=1e-8)
        >>> answer = program.certify(program.z.value)
        >>> bool(abs(answer.z - sol.velocity[120]) < 1e-6), answer.certificate < 1e-6
        (True, True)
        """
        try:
            i = range(len(self.steps))[i]
        except (IndexError, TypeError):
            kept = len(self.steps)
            raise InputError(
                f"i must be the number of a step that was kept, 0 to {kept - 1}, got {shown(i)}"
            ) from None
        step = self.steps[i]
        t, end = self._grid[step : step + 2].tolist()
        u = self.states.u(i + 1) - (end - t) * self.states.velocity(i)  # which may not be kept
        tableau = self.plan.scheme
        if self.stats["solver"][step].endswith(BY_EULER):
            tableau = implicit_euler(tableau.euler_steps)
        return program_of_stage(self.process, t, u, end - t, tableau, stage)

    @checks.with_checks
    def viability(self, t: Any = None) -> Array:
        """How far the viability condition A u' + B u in C(t) is missed, in the A^-1 metric.

        Where A is singular that is the metric of A + tau B, the process's `metric`.

        Parameters
        ----------
        t : float or array_like, shape (k,), optional
            Without it: for each step a bound of the distance of the stage's M z + q to its C, from
            the certificate: |.|_{A^-1} <= sqrt(1 + mu a_kk Lam) |.|_{M^-1}; of a step in parts it
            bounds those of all stages of the parts. With it: the distance
            of A u_n'(t) + B u_n(t) to C(t), u_n' the left derivative (the right one at t[0]);
            O(mu) for the first-order schemes.

        Returns
        -------
        ndarray, shape (n,), () or (k,)
        """
        if t is None:
            implicit = max(row[-1] for row in self.plan.scheme.a) * np.diff(self._grid)
            ratios = self.process.largest_ratio_to_metric(implicit)
            certificate = self.stats["certificate"]
            with np.errstate(invalid="ignore"):  # Lam is inf where no bound of it is proved
                return np.where(certificate == 0, 0.0, certificate * np.sqrt(ratios))
        return self._at_times(t, self._distance)

    def residual(self, t: Any) -> Array:
        """The residual of the variational inequality, sigma(C(t), -u_n') + <u_n', A u_n' + B u_n>.

        For C(t) = f - D it is J(u') - <f, u'> + <A u' + B u, u'>: minus the least value that
        <A u' + B u - f, v - u'> + J(v) - J(u') takes where the viability condition holds. Zero for
        the exact solution; O(mu) for first-order schemes; in units of power.

        Parameters
        ----------
        t : float or array_like, shape (k,)

        Returns
        -------
        ndarray, shape () or (k,)
        """
        return self._at_times(t, lambda z, force, C: C.support(-z) + float(z @ force))

    @cached_property
    def _projection(self) -> VelocityOf:
        return compile_projection(self.plan, self.process.metric)

    @checks.with_checks
    def error_bound(self, *, variation: Callable[[float], float] | None = None) -> ErrorBound:
        """A guaranteed bound of sup_t |u(t) - u_n(t)|_A (|.|_B if A is singular to rounding).

        Computing it takes several times as long as the run, as it makes other runs with more steps
        where bodies start and stop; a single one where C(t) is not data. Steps that were not kept
        are computed again. `benchmarks/bounds.py` prints how close bounds are and what they cost.

        Parameters
        ----------
        variation : callable, optional
            v(t) with d_H(C(t), C(s)) <= v(t) - v(s) for s <= t, in Euclidean norms, for a C(t)
            that is a function of time and not data.

        Returns
        -------
        ErrorBound
            A float, with the bound on each step, in the B-seminorm, and a lower bound.

        Raises
        ------
        InputError
            If a variation that is given falls, the states do not fit in memory, or A and B are both
            singular, where no norm bounds the error.
        PathError
            If the run's path is "cones" and C(t) a function of time.

        Warns
        -----
        BoundWarning
            If the bound is sampled, which its repr says too.

        Notes
        -----
        For any Lipschitz v with v(t_0) = u0 and any w(t) in C(t), with r = A v' + B v - w and
        G = sigma(C(t), -v') + <v', w>,

            |u - v|_A (t) <= K(t) int sqrt(2 G + |r|^2)    (|r| in the dual norm of A),
            |u - v|_B^2 (t) <= int 2 G + |r|^2 / 2,

        K(tau) = min(exp(nu tau), 1 + sqrt(Lam tau / 2)), nu = (Lam - lam)^2 / (8 (Lam + lam)), with
        lam <= Lam the extreme eigenvalues of A^-1 B: `results/error_bound.py` has all of it, the
        notebook error_band.ipynb the proof. |u - u_n| <= |u - v| + |v - u_n|, v through
        the nodes of a more accurate run beside it. No constant is unknown, what the
        solvers miss is in r and G, and both are bounded on whole steps, not sampled. For a body of
        finite elements u is the solution of the semi-discrete problem.

        Examples
        --------
        >>> import sweepopt as so
        >>> C = so.Moving(so.Box(-1, 1), center=so.Separable([(so.Sine(3.0, 4.0), 1.0)]))
        >>> process = so.SweepingProcess(A=0.5, B=2.0, C=C, u0=0.0)
        >>> bound = so.solve(process, t_end=5.0, steps=500).error_bound()
        >>> bound.guaranteed, 0 < bound < 3e-3
        (True, True)
        """
        if variation is None:
            if not ("_bound" in vars(self) or self._bound.guaranteed):
                reason = self._bound.reason
                warn(f"this bound is sampled, not guaranteed: {reason}", BoundWarning)
            return self._bound
        checks.takes("variation", variation, "t")
        return self._bound_with(variation)

    @cached_property
    def _bound(self) -> ErrorBound:
        return self._bound_with(None)

    def _bound_with(self, variation: Callable[[float], float] | None) -> ErrorBound:
        require_bound(self.process, self.plan)
        if self.complete:
            run = Nodes(self.t, self.u, self.velocity)
        elif self.loaded:
            raise InputError(
                "error_bound of a run from a file needs all its steps, as the file has no plan by "
                "which those that are missing could be made again: keep all, save=None"
            )
        else:
            run = nodes_of(self.process, replace(self.plan, reduction=None), self._grid)
        with np.errstate(over="ignore", invalid="ignore"):  # a bound may be infinite
            return error_bound(self.process, self.plan, run, variation)

    def _distance(self, _: Array, force: Array, C: Any) -> float:
        # the velocity program with M = A, q = w is the projection of w on C in the A^-1 metric
        projection = self._projection(force, C)
        if projection.relative > self.plan.tol:
            raise SweepoptError(
                f"the distance to C(t) is known to {projection.relative:.2g} only, tol is "
                f"{self.plan.tol:g}; solve with a looser tol to see it all the same"
            )
        return self.process.metric.norm(projection.z)

    def _at_times(self, t: Any, measure: Any) -> Array:
        times, values = self._inside(t), list[float]()
        for time, i in zip(times.ravel(), self._step_of(times).ravel().tolist(), strict=True):
            z = self.states.velocity(i)
            u = self(time)
            force = self.process.A @ z + self.process.times_B(u)
            values.append(measure(z, force, self.process.set_at(float(time), u)))
        return np.array(values).reshape(times.shape)

    @checks.with_checks
    def to_xarray(self) -> Dataset:
        """The trajectory and its statistics as an xarray.Dataset (needs the extra "study")."""
        return to_xarray(self)

    @checks.with_checks
    def save(self, path: str | PathLike[str]) -> None:
        """Write `to_xarray` to a NetCDF file with checksums, as ``solve(save="run.nc")`` does.

        Raises
        ------
        SaveError
            If the file cannot be written; nothing of it stays.
        """
        file = writable("path", path)
        if file.suffix != ".nc":
            raise InputError(f"path is {shown(str(path))}; a NetCDF file must end with .nc")
        try:
            write_dataset(dataset_of(self), file)
        except OSError as error:
            why = (
                f"path: {file} cannot be written ({error.strerror}); free the disk or name another"
            )
            raise SaveError(why, solution=self) from error

    @classmethod
    @checks.with_checks
    def load(cls, path: str | PathLike[str], process: SweepingProcess | None = None) -> Solution:
        """Read what `save` or ``solve(save="run.nc")`` wrote: the same numbers to the last bit.

        Parameters
        ----------
        path : str or Path
        process : SweepingProcess or EvolutionVI, optional
            The problem, whose functions no file holds; `viability`, `energy`, `error_bound` and
            what else needs it are refused without it.

        Returns
        -------
        Solution

        Raises
        ------
        InputError
            If it is no such file, as ``solution.nc`` of ``sweepopt run`` is none, or that of
            another number of unknowns, other unknowns or u0.
        CheckpointError
            If it is not as it was written.

        Warns
        -----
        CheckpointWarning
            If A, B or C(t) of the process are not those of the run.

        Examples
        --------
        >>> import pathlib, tempfile
        >>> import sweepopt as so
        >>> process = so.SweepingProcess(A=0.5, B=2.0, C=so.Box(-1, 1), u0=0.2)
        >>> sol = so.solve(process, t_end=1.0, steps=10)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     sol.save(pathlib.Path(folder) / "run.nc")
        ...     same = so.Solution.load(pathlib.Path(folder) / "run.nc", process)
        >>> bool((same.u == sol.u).all()), same.message == sol.message
        (True, True)
        """
        known, data = _read_run(path)
        t, u, velocity = data["time"], data["u"], data["velocity"]
        steps = data["kept_step" if "kept_step" in data else "step"]
        names, number = np.unique(data["solver"], return_inverse=True)
        rows = np.zeros(len(number), ROW)
        rows["t"], rows["solver"] = data["step_end"], number
        for name in STATISTICS.keys() - {"solver"}:
            rows[name] = data[name]
        status, scheme = Status[known["status"].upper()], SCHEMES[known["scheme"]]
        tol = known["tol"]
        plan: Any = _Absent(scheme=scheme, tol=tol, solvers=())
        given: Any = _Absent(dim=u.shape[1], fields={})
        if process is not None:
            given = process = sweeping(process)
            if given.dim != u.shape[1]:
                raise InputError(f"process has dim {given.dim}, but {path} has dim {u.shape[1]}")
            digest = known.get("unknowns_digest", given.unknowns_digest)
            if digest != given.unknowns_digest or not np.array_equal(given.u0, u[0]):
                raise InputError(
                    f"process is not that of {path}: its unknowns or u0 are others, or an earlier "
                    "version of sweepopt wrote the file"
                )
            if differ := differences(json.loads(known["problem"]), given, t):
                warn(
                    f"{', '.join(differ)} of process and of the run in {path} are not the same to "
                    "the last bit; bounds and viability are those of the process that is given",
                    CheckpointWarning,
                )
            plan = make_plan(process, process.check(t), scheme, "auto", tol)
        return cls(
            process=given,
            plan=plan,
            t=t,
            states=States(steps, u.__getitem__, velocity.__getitem__),
            statistics=Statistics(rows, tuple(map(str, names))),
            loaded=True,
            status=status,
            cause=known["message"].removeprefix(status.value).strip(),
        )

    @checks.with_checks
    def plot(self, ax: Axes | None = None) -> Axes:
        """Components of u_n over time, stick phases shaded (needs the extra "plot").

        Of one unknown its velocity too, and the force A u' + B u inside of C(t); of two their path
        and that of the force. `sweepopt.plot.plot_solution` says more.
        """
        from sweepopt.plot import plot_solution

        return plot_solution(self, ax)

    @checks.with_checks
    def animate(self, path: str | Path = "solution.gif") -> Path:
        """Write `plot` as an animation in which the time, u, the force and C(t) move.

        In a notebook ``IPython.display.Image(sol.animate())`` shows it; bodies are animated by
        `sweepopt.fem.Scene.animate`.

        Parameters
        ----------
        path : str or Path
            A ``.gif``, or an ``.mp4``, which needs the program ffmpeg.

        Raises
        ------
        InputError
            If the path cannot be written, or ffmpeg is not there for an MP4.
        """
        from sweepopt.plot import animate_solution

        return animate_solution(self, path)

    @checks.with_checks
    def energy(self) -> Energy:
        """Energies of the run; forces are taken at the middle of each step.

        Raises
        ------
        InputError
            If not all steps were kept.

        Notes
        -----
        For a C that is not a translate C = f - D, `work` is zero and `friction` holds
        int sigma(C, -u').
        """
        if not self.complete:
            raise InputError("energies add up all steps, but not all were kept; leave save= out")
        process, t, states = self.process, self.t, self.states
        mu, known = np.diff(t), np.nan if process.moved else 1.0
        powers = np.zeros((3, len(t)))  # viscous, friction, work; none before the start
        for i in range(len(mu)):
            z = states.velocity(i)
            C = process.set_at(float(t[i] + 0.5 * mu[i]), states.u(i) + 0.5 * mu[i] * z)
            work = C.anchor @ z
            powers[:, i + 1] = known * z @ (process.A @ z), C.support(-z) + work, known * work
        nodes = map(states.u, range(len(t)))
        stored = np.array([0.5 * known * u @ process.times_B(u) for u in nodes])
        return Energy(stored - stored[0], *np.cumsum(powers * np.append(0.0, mu), axis=1))


def _read_run(path: str | PathLike[str]) -> tuple[dict[str, Any], dict[str, Array]]:
    """Attributes and variables of a file that `Solution.save` wrote."""
    with open_run(path) as file:
        known = dict(file.attrs)
        data = {name: read(variable) for name, variable in file.variables.items()}
        over_time = "u" in data and "time" in file["u"].dimensions
    if not {"status", "scheme"} <= set(known) or "u" not in data:
        raise InputError(f"{path} is no file of sol.save or save=: it has no u, status and scheme")
    if not over_time:
        raise InputError(
            f"{path} holds the fields of a scene on its mesh, and u at the end alone: read it "
            "with xarray.open_dataset(path, engine='h5netcdf'), and write what is to be loaded "
            "with sol.save or save="
        )
    return known, data


def guaranteed_bound(solution: Solution) -> Any:
    """The `ErrorBound` of a run; nan if there is none, or only samples of C(t) are known."""
    with suppress(SweepoptError), warnings.catch_warnings():
        warnings.simplefilter("ignore", BoundWarning)
        bound = solution.error_bound()
        return bound if bound.guaranteed else np.nan
    return np.nan
