"""The reference cases, whose exact solutions every path must meet."""

import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from cases import Spiral

import sweepopt as so
from sweepopt.study.problems import PROBLEMS, Problem, problem

DATA = Path(__file__).parent / "data"
GRIDS = (101, 211, 503, 1009)
REFERENCE = json.loads((DATA / "reference_cases.json").read_text())["cases"]
SETS = tuple(REFERENCE)


class Pulled(Problem):
    """A disc pulled along a spiral."""

    def process(self):
        terms = [
            (Spiral(0.8, 2.0, phase), e)
            for phase, e in zip((0.0, -np.pi / 2), np.eye(2), strict=True)
        ]
        C = so.Moving(so.Ball([0.0, 0.0], 1.0), so.Separable(terms))
        return so.SweepingProcess(self.A, self.B, C, self.u0)


PROBLEMS["B14"] = Pulled("B14", "", 6.0, 1.5 * np.eye(2), np.zeros((2, 2)), np.zeros(2), {}, [])


@dataclass(frozen=True, eq=False)
class Case:
    """A reference case: its process, end time, exact values on grids, tabulated errors."""

    name: str
    process: so.SweepingProcess
    t_end: float
    errors: dict[str, dict[str, float]]
    polyhedral: bool

    def exact(self, n):
        """u on the grid of n steps, shape (n+1, dim)."""
        return _grids()[f"{self.name}_{n}"]

    def error(self, sol):
        """max_i |u_i - u(t_i)| in the norm of A, of B where A = 0."""
        return max(map(self.process.metric.norm, sol.u - self.exact(len(sol.t) - 1)))


def as_function(C):
    """C(t) with its load as a function of which nothing else is known."""
    if isinstance(C, so.Moving):
        return (
            so.MovingSet(C.at) if isinstance(C.shape, so.Point) else so.Moving(C.shape, C.center_at)
        )
    return so.Polyhedron([[1.0], [-1.0]], lambda t: C.offsets(t))


@cache
def _grids():
    with np.load(DATA / "reference_grids.npz") as grids:
        return dict(grids)


@cache
def case(name):
    """The reference case of that name."""
    this = problem(name)
    C = as_function(this.process().C)
    return Case(
        name=name,
        process=so.SweepingProcess(this.A, this.B, C, this.u0),
        t_end=this.t_end,
        errors=REFERENCE[name]["errors"],
        polyhedral=C.at(0.0).polyhedral,
    )
