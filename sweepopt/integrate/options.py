"""The arguments of `solve` that make up a run, as one record: checked once, kept in checkpoints."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from sweepopt.checks import (
    MEMORY,
    Array,
    at_path,
    axes,
    choice,
    number,
    takes,
    tolerance,
    vector,
)
from sweepopt.errors import InputError, brought_by, shown
from sweepopt.integrate.grid import (
    Adaptive,
    contraction,
    evaluation_times,
    meeting_breakpoints,
)
from sweepopt.integrate.record import Callback
from sweepopt.integrate.schemes import ADAPTING, AUTOMATIC, Scheme, choose
from sweepopt.io import decoded, encoded
from sweepopt.loads import Slope, Table
from sweepopt.problem import SweepingProcess, histories_of
from sweepopt.velocity import PATHS, REGISTRY, Plan, make_plan


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
    callback: Callback | None = None
    progress: bool = False

    def __post_init__(self) -> None:
        choice("path", self.path, PATHS)
        choice("on_failure", self.on_failure, ("raise", "stop"))
        choice("on_unstable", self.on_unstable, ("raise", "warn", "ignore"))
        memory = number("memory", self.memory, minimum=0.0, strict=True)
        object.__setattr__(self, "memory", memory)
        object.__setattr__(self, "tol", tolerance(self.tol))
        if isinstance(self.scheme, Adaptive):
            raise InputError(f"scheme {shown(self.scheme)}: Adaptive goes into steps")
        if self.steps is Adaptive:
            raise InputError("steps must be an object, got a class; call it: so.Adaptive(tol)")
        if self.callback is not None:
            takes("callback", self.callback, "step")
        if not isinstance(self.progress, bool):
            raise InputError(f"progress must be True or False, got {shown(self.progress)}")
        if self.progress:
            with brought_by("fem"):  # said before a file is written
                import tqdm.auto  # noqa: F401

    def times_to_meet(self) -> Array:
        """What adaptive steps contain: 0, the times that are to be saved, and the end."""
        if self.t_end is None:
            raise InputError("t_end is missing; Adaptive steps need it")
        end = number("t_end", self.t_end, minimum=0.0, strict=True)
        times = vector("save", self.save) if axes(self.save) == 1 else np.empty(0)
        # `saving` refuses those that are not between 0 and the end
        return np.r_[0.0, times[(times > 0.0) & (times < end)], end]

    def tableau(self, process: SweepingProcess) -> Scheme:
        """The scheme; "auto" is another one for steps that adapt."""
        adaptive = isinstance(self.steps, Adaptive)
        scheme = choose(self.scheme, process.coercive, ADAPTING if adaptive else AUTOMATIC)
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

    def plan(self, process: SweepingProcess, scheme: Scheme, times: Array, mus: Array) -> Plan:
        """How the process is simulated; C(t) is checked at all times that are asked for."""
        for history in histories_of(process.C, inside=False):
            if isinstance(history, Table):
                with at_path(f"{shown(history)}: "):  # outside of the table there is none
                    history(times[[0, -1]])
        members = process.check(evaluation_times(times, mus, scheme))
        plan = make_plan(process, members, scheme, self.solver, self.tol, self.path)
        plan = replace(plan, contraction=contraction(process, scheme, float(mus.max())))
        reduction = plan.reduction if self.path == "auto" else None
        gamma, span = scheme.a[-1][-1] * float(mus.min()), float(mus.sum())
        if reduction and not (scheme.exact or reduction.suits(gamma, span, self.tol)):
            reason = "proportional path: steps differ so much that short ones would be rounding"
            plan = replace(plan, reduction=None, left_out=(*plan.left_out, reason))
        histories = [] if scheme.exact else histories_of(process.C)
        if self.scheme != "auto":
            histories = [one for one in histories if isinstance(one, Slope)]
        return meeting_breakpoints(process, plan, times, histories)

    def to_json(self) -> dict[str, Any]:
        """The options but for what watches the run, in terms of JSON.

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
            options = [one for one in vars(self).items() if one[0] not in ("callback", "progress")]
            return {name: plain(value) for name, value in options}
        except TypeError as error:
            raise InputError(
                "with checkpoint= options are written to a file: a solver must be one of the "
                "library's own and its settings plain, other options numbers or text "
                f"({error})"
            ) from None

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
