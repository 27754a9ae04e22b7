"""Where a body starts: at a displacement that is given in space, or where a run of it has ended."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sweepopt.errors import DamagedFileError, InputError
from sweepopt.fem.effects import Record
from sweepopt.fem.fields import Array, Coefficient, Datum
from sweepopt.fem.spaces import Discretisation
from sweepopt.io import as_path
from sweepopt.results import field_names, open_run, read


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
