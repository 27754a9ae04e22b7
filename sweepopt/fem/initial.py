"""Where a body starts: at a displacement that is given in space, or where a run of it has ended."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sweepopt.errors import InputError
from sweepopt.fem.effects import Record
from sweepopt.fem.fields import Array, Coefficient, Datum
from sweepopt.fem.spaces import AXES, Discretisation
from sweepopt.io import as_path
from sweepopt.results import last_state

DISPLACEMENT = Coefficient("u", vector=True)
SAME = 1e-9  # of the body's size: nodes that are nearer are one, as a file may have rounded them


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
        run``, or its folder, or one of ``save="run.nc"`` or `Solution.to_xarray`.

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
    data = (DISPLACEMENT,)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.u is not None and self.run is not None:
            raise InputError("run: give u or run, not both")

    def state(self, space: Discretisation, fields: Mapping[str, slice], size: int) -> Array:
        """u0 on all unknowns, shape (size,).

        Parameters
        ----------
        fields : mapping of str to slice
            What the unknowns are: "u", and internal ones.
        """
        u0 = np.zeros(size)
        if self.u is not None:
            u0[: space.dim] = space.interpolate(self.u, "u")
        if self.run is None:
            return u0
        path = as_path("run", self.run)
        path = path / "solution.nc" if path.is_dir() else path
        names = "u", "field", "unknowns_digest", "displacement", "internal", "internal_field", *AXES
        try:
            run = last_state(path, *names)
        except InputError as error:
            raise InputError(f"run: {error}") from error
        labels = np.full(u0.size, "", dtype=object)
        for name, part in fields.items():
            labels[part] = name
        if "u" in run:
            last, kinds = run["u"], run.get("field")
            if last.shape != u0.shape or not (kinds is None or np.array_equal(kinds, labels)):
                raise InputError(
                    f"run: {path} has {last.size} unknowns of {_fields(kinds)}, the scene "
                    f"{u0.size} of {_fields(labels)}; take a run of the same body and effects"
                )
            if run.get("unknowns_digest") not in (None, "", space.digest):
                raise InputError(
                    f"run: {path} is of another mesh, or has other components held or turned; take "
                    "the solution.nc of sweepopt run, or a run of this body"
                )
            return np.asarray(last)
        points, last = [run[axis] for axis in AXES if axis in run], run.get("displacement", u0[:0])
        nodes = space.points.T
        if np.shape(points) != nodes.shape or not np.allclose(
            points, nodes, rtol=0, atol=SAME * np.ptp(nodes)
        ):
            raise InputError(f"run: {path} has the nodes of another mesh; take a run of this body")
        if np.shape(last) != space.expand(u0[: space.dim]).shape:
            raise InputError(
                f"run: {path} has displacements of another kind of body than {space.kind}"
            )
        internal, kinds = run.get("internal", u0[:0]), run.get("internal_field", labels[:0])
        if not np.array_equal(kinds, labels[space.dim :]):
            raise InputError(
                f"run: {path} has internal unknowns of {_fields(kinds)}, the scene of "
                f"{_fields(labels[space.dim :])}; take a run of the same effects"
            )
        u0[: space.dim] = space.interpolate(last if space.components == 1 else list(last.T))
        u0[space.dim :] = internal
        return u0


def _fields(names: Any) -> str:
    """The fields in an array of names of unknowns."""
    return "none" if names is None else ", ".join(dict.fromkeys(map(str, names))) or "none"
