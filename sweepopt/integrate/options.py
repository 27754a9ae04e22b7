"""The arguments of `solve` that make up a run, as one record: checked once, kept in checkpoints."""

from __future__ import annotations

import base64
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from sweepopt.checks import choice, number, tolerance
from sweepopt.errors import InputError, shown
from sweepopt.integrate.adaptive import Adaptive
from sweepopt.integrate.grid import (
    contraction,
    evaluation_times,
    meeting_breakpoints,
    time_grid,
)
from sweepopt.integrate.record import MEMORY
from sweepopt.integrate.schemes import Scheme, automatic, choose
from sweepopt.loads import Table
from sweepopt.problem import SweepingProcess, histories_of
from sweepopt.velocity import PATHS, REGISTRY, Plan, make_plan


def encoded(value: Any) -> Any:
    """The nest in terms of JSON.

    Raises
    ------
    TypeError
        If it is none of numbers, text and arrays, alone or in tuples, lists and dicts.
    """
    kind = type(value)
    if value is None or kind in (bool, float, str) or (kind is int and abs(value) < 2**63):
        return value  # Python writes no integer of any length
    if isinstance(value, (np.ndarray, np.generic)) and value.dtype.kind in "biuf":
        content = base64.b64encode(value.tobytes()).decode()
        return {
            "array": kind is np.ndarray,
            "dtype": value.dtype.str,
            "shape": value.shape,
            "bytes": content,
        }
    if kind in (list, tuple):
        return {kind.__name__: [encoded(part) for part in value]}
    if kind is dict and all(type(key) is str for key in value):
        return {"dict": {key: encoded(part) for key, part in value.items()}}
    raise TypeError(f"{kind.__name__} is not stored")


def decoded(value: Any) -> Any:
    """What `encoded` took."""
    match value:
        case {"dict": parts}:
            return {key: decoded(part) for key, part in parts.items()}
        case {"list": parts}:
            return [decoded(part) for part in parts]
        case {"tuple": parts}:
            return tuple(map(decoded, parts))
        case {"array": is_array, "dtype": dtype, "shape": shape, "bytes": content}:
            flat = np.frombuffer(base64.b64decode(content), dtype)
            return flat.reshape(shape).copy() if is_array else flat[0]
    return value


@dataclass(frozen=True, eq=False)
class SolveOptions:
    """What `solve` was asked for; see there. `steps` and `save` are checked with the process."""

    t_end: Any
    steps: Any
    scheme: Any
    solver: Any
    tol: float
    path: str = "auto"
    save: Any = None
    memory: float = MEMORY
    on_failure: str = "raise"
    on_unstable: str = "raise"

    def __post_init__(self) -> None:
        choice("path", self.path, PATHS)
        choice("on_failure", self.on_failure, ("raise", "stop"))
        choice("on_unstable", self.on_unstable, ("raise", "warn", "ignore"))
        memory = number("memory", self.memory, minimum=0.0, strict=True)
        object.__setattr__(self, "memory", memory)
        object.__setattr__(self, "tol", tolerance("tol", self.tol))
        if isinstance(self.scheme, Adaptive):
            raise InputError(f"scheme {shown(self.scheme)}: Adaptive goes into steps")
        if self.steps is Adaptive:
            raise InputError("steps must be an object, got a class; call it: so.Adaptive(tol)")

    def tableau(self, process: SweepingProcess) -> Scheme:
        """The scheme; "auto" chooses by the longest step, or for steps that adapt."""
        name, adaptive = self.scheme, isinstance(self.steps, Adaptive)
        if isinstance(name, str) and name == "auto" and not adaptive:
            mu = float(time_grid(self.t_end, self.steps)[1].max())
            return automatic(process, mu)
        scheme = choose(name, process.coercive)
        if adaptive or scheme.exact:
            process.refuse_state("Adaptive" if adaptive else "scheme 'exact'")
        if adaptive and not (process.coercive or process.rate_independent):
            raise InputError(
                "Adaptive estimates errors where A is coercive or zero, here it is singular; give "
                "a number of steps or their times"
            )
        if adaptive and scheme.exact:
            raise InputError("scheme 'exact' has no error in time that steps could be adapted to")
        return scheme

    def plan(
        self, process: SweepingProcess, scheme: Scheme, times: np.ndarray, mus: np.ndarray
    ) -> Plan:
        """How the process is simulated; C(t) is checked at all times that are asked for."""
        for history in histories_of(process.C, inside=False):
            if isinstance(history, Table):
                history.check_run(float(times[0]), float(times[-1]))
        members = process.check(evaluation_times(times, mus, scheme))
        plan = make_plan(process, members, scheme, self.solver, self.tol, self.path)
        plan = replace(plan, contraction=contraction(process, scheme, float(mus.max())))
        reduction = plan.reduction if self.path == "auto" else None
        if reduction and not reduction.suits(mus, scheme, self.tol):
            plan = plan.of_all_unknowns(
                "the steps differ so much that short ones would be rounding"
            )
        return meeting_breakpoints(process, plan, times) if self.scheme == "auto" else plan

    def to_json(self) -> dict[str, Any]:
        """The options in terms of JSON.

        Raises
        ------
        InputError
            If an option cannot be written to a file.
        """

        def plain(value: Any) -> Any:
            if callable(value):
                return {"function": True}
            for name, kind in REGISTRY.items():
                if type(value) is kind:
                    return {"solver": name, "settings": encoded(asdict(value))}
            return encoded(value if isinstance(value, str) else np.asarray(value)[()])

        try:
            return {name: plain(value) for name, value in vars(self).items()}
        except TypeError as error:
            raise InputError(
                "with checkpoint= options are written to a file: a solver must be one of the "
                "library's own and its settings plain, other options numbers or text "
                f"({error})"
            ) from error

    @classmethod
    def from_json(cls, plain: dict[str, Any]) -> SolveOptions:
        """The options from what `to_json` made of them; a function as None."""

        def option(value: Any) -> Any:
            match value:
                case {"function": True}:
                    return None
                case {"solver": name, "settings": settings}:
                    kind: Any = REGISTRY[name]
                    return kind(**decoded(settings))
            return decoded(value)

        return cls(**{name: option(value) for name, value in plain.items()})
