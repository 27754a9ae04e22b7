"""The arguments of `solve` that make up a run, as one record: checked once, kept in checkpoints."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from sweepopt.checks import choice, number
from sweepopt.errors import InputError, PathError
from sweepopt.integrate.adaptive import Adaptive
from sweepopt.integrate.record import MEMORY
from sweepopt.integrate.schemes import Scheme, choose
from sweepopt.velocity import PATHS, REGISTRY

SOLVERS: dict[str, Any] = {getattr(kind, "__name__", name): kind for name, kind in REGISTRY.items()}


@dataclass(frozen=True, eq=False)
class SolveOptions:
    """What `solve` was asked for; see there. `steps` and `save` are checked with the process."""

    t_end: Any = None
    steps: Any = 1000
    scheme: Any = "auto"
    solver: Any = "auto"
    tol: float = 1e-6
    path: str = "auto"
    save: Any = None
    memory: float = MEMORY
    on_failure: str = "raise"
    on_unstable: str = "raise"

    def __post_init__(self) -> None:
        choice("path", self.path, PATHS)
        choice("on_failure", self.on_failure, ("raise", "stop"))
        choice("on_unstable", self.on_unstable, ("raise", "warn", "ignore"))
        for name in ("tol", "memory"):
            value = number(name, getattr(self, name), minimum=0.0, strict=True)
            object.__setattr__(self, name, value)
        if isinstance(self.steps, Adaptive) and self.path == "proportional":
            raise PathError("path='proportional' needs all steps beforehand; Adaptive cannot tell")

    def tableau(self, rate_independent: bool) -> Scheme:
        """The scheme, without a look at overshooting where no warning of it is wanted."""
        name, adaptive = self.scheme, isinstance(self.steps, Adaptive)
        if adaptive and rate_independent and isinstance(name, str) and name == "auto":
            name = "sdirk2"
        scheme = choose(name, rate_independent)
        if adaptive and scheme.exact:
            raise InputError("scheme 'exact' has no error in time that steps could be adapted to")
        return scheme.without_overshoot_warning if self.on_unstable == "ignore" else scheme

    def to_json(self) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
        """The options in terms of JSON, and those that are arrays.

        Raises
        ------
        InputError
            If an option cannot be written to a file.
        """
        plain: dict[str, Any] = {}
        arrays: dict[str, np.ndarray] = {}
        for name, value in vars(self).items():
            kind = type(value)
            if isinstance(value, np.generic):
                value = value.item()
            if value is None or isinstance(value, (str, bool, int, float)):
                plain[name] = value
            elif name == "save" and callable(value):
                plain[name] = {"function": True}
            elif name == "solver" and SOLVERS.get(kind.__name__) is kind:
                plain[name] = {"solver": kind.__name__, "settings": _plain(asdict(value))}
            elif name in ("steps", "save"):
                plain[name] = {"array": name}
                arrays[f"options.{name}"] = np.asarray(value, float)
            else:
                raise InputError(f"{name}: with checkpoint= it must be one of the library's own")
        return plain, arrays

    @classmethod
    def from_json(cls, plain: dict[str, Any], arrays: Mapping[str, np.ndarray]) -> SolveOptions:
        """The options from what `to_json` made of them; a function as None."""

        def option(value: Any) -> Any:
            match value:
                case {"function": True}:
                    return None
                case {"array": name}:
                    return arrays[f"options.{name}"]
                case {"solver": name, "settings": settings}:
                    return SOLVERS[name](**settings)
            return value

        return cls(**{name: option(value) for name, value in plain.items()})


def _plain(settings: dict[str, Any]) -> dict[str, Any]:
    try:
        json.dumps(settings, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise InputError(f"solver: with checkpoint= its settings must be plain: {error}") from error
    return settings
