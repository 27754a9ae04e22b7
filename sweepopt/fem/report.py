"""A run of a scene: what its files and pictures have in common."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

from sweepopt.fem.slip import Slip, slip_of

if TYPE_CHECKING:
    from sweepopt.fem import Scene
    from sweepopt.results import Energy, Solution


class Units(NamedTuple):
    """Units of antiplane quantities; energies and forces are per length of the body."""

    time: str
    length: str
    velocity: str
    traction: str
    force: str
    energy: str
    certificate: str
    viability: str


DIMENSIONLESS = Units(*["1"] * len(Units._fields))
SI = Units("s", "m", "m s-1", "Pa", "N m-1", "J m-1", "W^0.5 m^-0.5", "W^0.5 m^-0.5")


@dataclass(frozen=True, eq=False)
class Report:
    """A run of a scene and what its files and pictures have in common.

    Attributes
    ----------
    name, text : str
        The scene's name and its file's text.
    scene : Scene
    solution : Solution
        With one step or more.
    slip : Slip or None
        None without friction.
    energy : Energy
    seconds : float
        Wall time of the solution.
    """

    name: str
    text: str
    scene: Scene
    solution: Solution
    slip: Slip | None
    energy: Energy
    seconds: float

    @property
    def units(self) -> Units:
        """Units of the scene's quantities."""
        return SI if self.scene.units == "SI" else DIMENSIONLESS


def make_report(
    scene: Scene, solution: Solution, *, name: str = "", text: str = "", seconds: float = 0.0
) -> Report:
    """Compute slip and energies of a run, once."""
    slip, energy = slip_of(scene, solution), solution.energy()
    return Report(name, text, scene, solution, slip, energy, seconds)


def solver_counts(solution: Solution) -> dict[str, int]:
    """Number of steps that each solver answered."""
    return dict(Counter(solution.stats["solver"].tolist()))


def materials_of(scene: Scene) -> dict[str, Any]:
    """Triangles of each named subdomain."""
    return dict(scene.discretisation.mesh.subdomains or {})
