"""Where a body starts: at a displacement that is given in space, or where a run of it has ended."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sweepopt.errors import InputError, brought_by
from sweepopt.fem.fields import Coefficient, Datum
from sweepopt.fem.spaces import Discretisation
from sweepopt.io import as_path

DISPLACEMENT = Coefficient("u", vector=True)


@dataclass(frozen=True)
class Initial:
    """u0 of a scene: zero where nothing is given.

    Parameters
    ----------
    u : number, formula, Profile or callable, optional
        Displacement (m) at the start; of vectors a list, one for each of x, y and z. What is held
        stays where it is held, internal unknowns start at zero.
    run : str or Path, optional
        Instead of u: a NetCDF file whose last state is taken. One of ``save="run.nc"`` or
        `Solution.to_xarray` has all unknowns; the ``solution.nc`` of ``sweepopt run``, or its
        folder, has displacements and is for bodies without internal unknowns.

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

    def __post_init__(self) -> None:
        if self.u is not None and self.run is not None:
            raise InputError("run: give u or run, not both")
        if self.u is not None:
            DISPLACEMENT.check(self.u)
        if self.run is not None:
            as_path("run", self.run)

    def state(
        self, space: Discretisation, fields: Mapping[str, slice], size: int
    ) -> NDArray[np.float64]:
        """u0 on all unknowns, shape (size,).

        Parameters
        ----------
        fields : mapping of str to slice
            What the unknowns are: "u", and internal ones.
        """
        u0 = np.zeros(size)
        if self.u is not None:
            parts = DISPLACEMENT.parts(self.u, space.components)
            values = [DISPLACEMENT.values(datum, space.points.T, {}) for datum in parts]
            u0[: space.dim] = space.interpolate(values if space.components > 1 else values[0])
        return u0 if self.run is None else _last_state(Path(self.run), space, fields, u0)


def _last_state(
    path: Path, space: Discretisation, fields: Mapping[str, slice], u0: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The last state of a file, put into u0."""
    with brought_by("fem"):
        import xarray
    path = path / "solution.nc" if path.is_dir() else path
    try:
        with xarray.open_dataset(path, engine="h5netcdf") as run:
            last = np.asarray(run["u" if "u" in run else "displacement"][-1], dtype=float)
            known = {name: np.asarray(run[name]) for name in (*"xyz", "field") if name in run}
    except Exception as error:  # h5py has no list of what it raises
        raise InputError(f"run: {path} is no NetCDF file of a run ({error})") from error
    if "x" not in known:
        names = np.full(u0.size, "", dtype=object)
        for name, part in fields.items():
            names[part] = name
        if last.shape != u0.shape or not np.array_equal(known.get("field", names), names):
            raise InputError(
                f"run: {path} has {last.size} unknowns of {_fields(known.get('field', last))}, the "
                f"scene {u0.size} of {_fields(names)}; take a run of the same body and effects"
            )
        return last
    places = [known[axis] for axis in "xyz" if axis in known]
    if np.shape(places) != space.points.T.shape or not np.allclose(places, space.points.T):
        raise InputError(f"run: {path} has the nodes of another mesh; take a run of this body")
    if u0.size > space.dim:
        raise InputError(
            f"run: {path} has displacements only, and not {', '.join(list(fields)[1:])}; keep all "
            'unknowns, with save="run.nc" of the solution, to go on from there'
        )
    u0[:] = space.interpolate(last if space.components == 1 else list(last.T))
    return u0


def _fields(names: NDArray[Any]) -> str:
    """The fields in an array of names of unknowns."""
    return ", ".join(dict.fromkeys(map(str, names))) if names.dtype.kind != "f" else "no fields"
