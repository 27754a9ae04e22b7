"""Error bounds beside true errors, and what they cost: random processes of a few kinds.

    python benchmarks/bounds.py                   # all kinds: 8 minutes on one core
    python benchmarks/bounds.py stiff few

Processes of 1 to 6 unknowns run on [0, 1] by four schemes, each scene by its own one; Lam is the
largest eigenvalue of A^-1 B. The true error is the largest at the ends of eight parts of each step
(scenes: two), and at times from 1e-9 of the first part on. The reference is scheme "exact" or else
a run on halves of these parts; its error is the difference from one on the parts.

runs     those with an error of at least 20 times the reference's; all columns are of these
proved   those whose bound is guaranteed
in B     the largest bound / error in |.|_B, of `sol.error_bound().B`; the others are in |.|_A, in
         |.|_B where A is singular
least    the smallest bound / (error - error of the reference); a guaranteed bound with less than 1,
         of any run, is wrong: the exit code is 1
cost     the processor time of a bound divided by that of its run
"""

import argparse
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

import sweepopt as so
from sweepopt.errors import SweepoptError
from sweepopt.problem import Norms

SCHEMES = ("implicit-euler", "midpoint", "sdirk2", "auto")
SCENES = ("fretting", "ring", "square_pipe")
KNOWN = 1 / 20
HEADS = ("runs", "proved", "median", "95 %", "worst", "in B", "least", "median", "worst")
ROUNDING = 1e-10  # of the largest |u|: the error of scheme "exact"
Random = np.random.Generator


def spectral(random: Random, n: int, decades: float, free: bool = False) -> np.ndarray:
    """A matrix whose eigenvalues spread over up to `decades` powers of 10; free: half are 0."""
    turn = np.linalg.qr(random.normal(size=(n, n)))[0]
    values = np.logspace(0, -random.uniform(0, decades), n)
    values[n - n // 2 :] *= not free
    M = (turn * values) @ turn.T
    return 0.5 * (M + M.T)


# ---- loads and sets ---------------------------------------------------------------------------


def sine(random: Random, steps: int) -> Any:
    return so.Sine(1.0, 1 / random.uniform(0.6, 5))


def slow(random: Random, steps: int) -> Any:
    """A sine or a table; both begin at 0."""
    if random.random() < 0.5:
        return sine(random, steps)
    inner = np.sort(random.uniform(0.02, 0.98, random.integers(3, 10)))
    return so.Table([0, *inner, 1], np.append(0.0, random.normal(size=inner.size + 1)))


def fast(random: Random, steps: int) -> Any:
    return so.Sine(1.0, random.uniform(1.3, 6) / steps)


def friction(random: Random, force: so.Separable) -> so.Moving:
    """Intervals, or discs where n is even."""
    n = force.dim
    if n % 2 == 0 and random.random() < 0.3:
        return so.Moving(so.Balls(random.uniform(0.3, 1.2, n // 2), 2), force)
    g = random.uniform(0.3, 1.2, n)
    return so.Moving(so.Box(-g, g), force)


def ellipsoids(random: Random, force: so.Separable) -> so.Moving:
    return so.Moving(so.Ellipsoid(np.zeros(force.dim), spectral(random, force.dim, 1.5)), force)


def separate(random: Random, force: so.Separable) -> Any:
    """A sum or an intersection of two sets, each of which moves by data of its own."""
    n, swell = force.dim, so.Sine(0.3, 1 / random.uniform(0.6, 3), offset=1.0)
    box = so.Moving(so.Box(-np.ones(n), np.ones(n)), force)
    if random.random() < 0.5:
        return box + so.Moving(so.Ball(np.zeros(n), 0.5), scale=swell)
    return box & so.Moving(so.Ball(np.zeros(n), 1.2), force, swell)


def hulls(random: Random, force: so.Separable) -> so.Moving:
    points = random.normal(size=(force.dim + 1 + int(random.integers(1, 4)), force.dim))
    return so.Moving(so.Polytope(points - points.mean(axis=0)), force)


def any_set(random: Random, force: so.Separable) -> Any:
    of = (friction, ellipsoids, separate, hulls)
    return of[random.integers(len(of))](random, force)


# ---- processes --------------------------------------------------------------------------------


class Kind(NamedTuple):
    """Processes of a kind: powers of 10 between which step * Lam is, and what else they have.

    The eigenvalues of A spread over up to `decades` powers of 10. Hidden data are seen as a
    "function" of time, or as one with its "variation".
    """

    says: str
    stiffness: tuple[float, float] = (-1.0, 4.0)
    steps: tuple[int, int] = (20, 80)
    decades: float = 1.0
    outside: bool = False
    free: bool = False
    history: Callable[[Random, int], Any] = slow
    set_of: Callable[[Random, so.Separable], Any] = friction
    hidden: str = ""
    number: int = 24


FEW, SOME, STIFF = (3, 8), (3, 40), (2, 8)
KINDS = {
    "soft": Kind("step * Lam from 0.01 to 10", (-2, 1)),
    "stiff": Kind("step * Lam from 1e2 to 1e8, and A = 0", STIFF),
    "uneven": Kind("the same, condition of A up to 1e7", STIFF, decades=7),
    "outside": Kind("B u0 outside of C(0), step * Lam from 1 to 1e8", (0, 8), outside=True),
    "free": Kind("B singular, 3 to 40 steps", steps=SOME, free=True),
    "fast": Kind("sines with periods of 1.3 to 6 steps", history=fast),
    "few": Kind("3 to 8 steps, sets of all kinds", steps=FEW, set_of=any_set),
    "ellipsoids": Kind("20 to 80 steps", set_of=ellipsoids, number=12),
    "separate": Kind("sets that move separately", steps=SOME, set_of=separate, number=12),
    "hulls": Kind("of points, 3 to 40 steps", steps=SOME, set_of=hulls),
    "functions": Kind("sines as functions of time", history=sine, hidden="function"),
    "variation": Kind("with |f'| <= L, variation L t", history=sine, hidden="variation"),
    "scenes": Kind(", ".join(SCENES)),
}


class Case(NamedTuple):
    """A process on [0, t_end], and how it is run. `parts` of each step are looked at."""

    process: so.SweepingProcess
    t_end: float
    steps: int
    schemes: tuple[str, ...]
    parts: int
    how: dict[str, Any]
    force: Any = None


def cases(kind: Kind, count: int) -> Iterator[Case]:
    """A process for each seed; A = 0 in every sixth of the stiff ones."""
    for seed in range(count):
        random = np.random.default_rng(seed)
        n, steps = (int(random.integers(a, b + 1)) for a, b in ((1, 6), kind.steps))
        shapes = random.normal(size=(2, n))
        shapes *= (random.uniform(1, 3, 2) * n**0.5 / np.linalg.norm(shapes, axis=1))[:, None]
        force = so.Separable([(kind.history(random, steps), shape) for shape in shapes])
        A, B = spectral(random, n, kind.decades), spectral(random, n, 1, kind.free)
        C = kind.set_of(random, force)
        u0 = np.linalg.pinv(B) @ (kind.outside * random.uniform(1, 3) * random.normal(size=n))
        slowest = so.SweepingProcess(A, B, C, u0).Lam / steps
        stiffness = 10 ** random.uniform(*kind.stiffness)
        A *= 0.0 if kind.stiffness[0] >= 2 and seed % 6 == 5 else slowest / stiffness
        process = so.SweepingProcess(A, B, C, u0)
        yield Case(process, 1.0, steps, SCHEMES, 8, {"tol": 1e-8}, force)


def scenes() -> Iterator[Case]:
    for scene in map(so.scene, SCENES):
        how = {"tol": scene.tol, "path": scene.path, "solver": scene.solver}
        yield Case(scene.process, scene.t_end, scene.steps, (scene.scheme,), 2, how)


# ---- measured ---------------------------------------------------------------------------------


def norm(process: so.SweepingProcess, u: np.ndarray) -> np.ndarray:
    """The largest |u|_A (|u|_B where A is singular) and the largest |u|_B."""
    norms = Norms(process)
    return np.array([norms.A(u).max(), norms.B(u).max()])


def reference(case: Case) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, the states then, and how large the error of these may be in both norms."""
    process, t = case.process, np.linspace(0.0, case.t_end, case.parts * case.steps + 1)
    if case.force:
        t = np.union1d(t, t[1] * np.geomspace(1e-9, 1, 30)[:-1])
    try:
        u = so.solve(process, steps=t, scheme="exact").u
        return t, u, ROUNDING * norm(process, u)
    except SweepoptError:
        halves = np.sort(np.append(t, 0.5 * (t[1:] + t[:-1])))
        how = {**case.how, "on_unstable": "ignore"}
        coarse, fine = (so.solve(process, steps=grid, **how)(t) for grid in (t, halves))
        return t, fine, norm(process, fine - coarse) + ROUNDING * norm(process, fine)


class Row(NamedTuple):
    """A run; `doubt` is the share of its error that the reference's may be."""

    ratio: float
    doubt: float
    of_B: float
    doubt_of_B: float
    cost: float
    guaranteed: bool


def rows(case: Case, hidden: str) -> Iterator[Row]:
    """A run by each scheme."""
    (t, u, doubt), process, given = reference(case), case.process, {}
    if hidden:
        C = so.Moving(process.C.shape, lambda s: case.force(s))
        process = so.SweepingProcess(process.A, process.B, C, process.u0)
    if hidden == "variation":
        speed = sum(2 * np.pi / h.period * np.linalg.norm(shape) for h, shape in case.force.terms)
        given = {"variation": lambda s: speed * s}
    how = {"t_end": case.t_end, "steps": case.steps, "on_unstable": "ignore", **case.how}
    for scheme in case.schemes:
        clock = [time.process_time()]
        sol = so.solve(process, scheme=scheme, **how)
        clock.append(time.process_time())
        bound = sol.error_bound(**given)
        run, more = np.diff([*clock, time.process_time()])
        error = norm(process, sol(t) - u)
        error[error == 0.0] = np.nan  # in |.|_B, for B = 0
        (ratio, of_B), share = np.array([bound, bound.B.max()]) / error, doubt / error
        yield Row(ratio, share[0], of_B, share[1], more / run, bound.guaranteed)


def line(name: str, found: list[Row]) -> tuple[str, bool]:
    """The line of a kind, and whether a bound is wrong."""
    known = [row for row in found if row.doubt <= KNOWN]
    ratio, doubt, of_B, doubt_of_B, cost, proved = map(np.array, zip(*known, strict=True))
    of_B, doubt_of_B = np.array([of_B, doubt_of_B])[:, doubt_of_B <= KNOWN]
    least = np.min(np.append(ratio, of_B) / (1 - np.append(doubt, doubt_of_B)))
    cells = [f"{name:<11}{len(known):>7}{proved.sum():>7}"]
    cells += [f"{q:>9.3g}" for q in np.quantile(ratio, [0.5, 0.95, 1])]
    cells.append(f"{of_B.max(initial=0.0):>7.3g}")
    cells += [f"{least:>9.3f}", *(f"{q:>7.1f}" for q in np.quantile(cost, [0.5, 1]))]
    below = (row.ratio < 1 - row.doubt or row.of_B < 1 - row.doubt_of_B for row in found)
    wrong = any(row.guaranteed and low for row, low in zip(found, below, strict=True))
    return f"{''.join(cells)}  {KINDS[name].says}", wrong


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("kinds", nargs="*", metavar="KIND", help=f"of {', '.join(KINDS)}")
    parser.add_argument("--count", type=int, help="processes of a kind: 12 or 24")
    chosen = parser.parse_args()
    if unknown := set(chosen.kinds) - set(KINDS):
        parser.error(f"{', '.join(unknown)}: kinds are {', '.join(KINDS)}")
    warnings.simplefilter("ignore", so.SweepoptWarning)
    print(f"{'bound / error':>46}{'cost':>31}")
    heads = zip(HEADS, (18, 7, 9, 9, 9, 7, 9, 7, 7), strict=True)
    print("".join(f"{head:>{width}}" for head, width in heads), flush=True)
    wrong = False
    for name in chosen.kinds or KINDS:
        kind = KINDS[name]
        some = scenes() if name == "scenes" else cases(kind, chosen.count or kind.number)
        text, bad = line(name, [row for case in some for row in rows(case, kind.hidden)])
        print(text, flush=True)
        wrong |= bad
    sys.exit(wrong)


if __name__ == "__main__":
    main()
