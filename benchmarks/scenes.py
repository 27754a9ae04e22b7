"""Scenes beside a loop by hand: steps of the library and of one problem of cvxpy with Clarabel.

    python benchmarks/scenes.py                       # all at their default sizes
    python benchmarks/scenes.py pipe --size 29        # 5,046 triangles
    python benchmarks/scenes.py --memory --size 10    # a block of 18,879 unknowns, no loop
    python benchmarks/scenes.py --memory              # of 107,855: 4 minutes, 3 GB

    tread   3D block on a road, friction in discs          size: cells along its height
    tube    section of a tube, friction on few nodes       size: refinements of its mesh
    pipe    Bingham's fluid, yield stress on triangles     size: rings of triangles
    rough   the same, nodes moved by a quarter of a cell   size: rings of triangles
    ring    thick ring, plastic strains at P2's points     size: cells along the radius

Steps of implicit Euler, one after the other. The loop states one problem of cvxpy whose parameter
is the linear term, and takes the same steps from the same states; the first solve of both is not
counted. Times are processor times. cvxpy 1.9 makes dense matrices of the square of the
unknowns of a parameter in the objective: beyond PARAMETERS of them the loop states each step anew,
and "solver" is the wall time of Clarabel alone. Certificates are relative, "apart" is
|z - z_cvxpy|_M / |z|_M, the largest. Of block and tube a line compares steps without friction.
"""

from __future__ import annotations

import argparse
import multiprocessing
import resource
import sys
import time
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import skfem

import sweepopt as so
from sweepopt import fem
from sweepopt.fem import Effect, Scene, read_scene
from sweepopt.linalg import Factor
from sweepopt.loads import Sine, Table
from sweepopt.velocity import untranslated

PARAMETERS = 15_000  # a dense matrix of the square takes 1.8 GB, cvxpy 5 GB
E, SIGMA_Y, E_T = 70_000.0, 250.0, 700.0  # of the ring
INNER, OUTER = 1.0, 1.3
LIMIT = 2 / np.sqrt(3) * SIGMA_Y * np.log(OUTER / INNER)  # pressure at E_T = 0
MODULUS = E * E_T / (E - E_T)  # of the stress over the plastic strain in tension
KINEMATIC, ISOTROPIC = {"Hk": 2 / 3 * MODULUS}, {"Hi": MODULUS}


def disc(rings: int, moved: float = 0.0) -> skfem.MeshTri:
    """6 rings^2 triangles of nearly one size; inner nodes moved by a share of a cell at random."""
    turns = [np.arange(6 * k) / (6 * k) for k in range(1, rings + 1)]
    radius = np.repeat(np.arange(1, rings + 1) / rings, 6 * np.arange(1, rings + 1))
    angle = 2 * np.pi * np.concatenate(turns)
    points = np.hstack([np.zeros((2, 1)), radius * np.array([np.cos(angle), np.sin(angle)])])
    inside = np.hypot(*points) < 1 - 1e-9
    shift = np.random.default_rng(0).uniform(-moved, moved, points.shape) / rings
    points[:, inside] += shift[:, inside]
    triangles = []
    for k in range(1, rings + 1):
        inner, outer = (3 * i * (i - 1) + 1 if i else 0 for i in (k - 1, k))
        for side in range(6):
            for j in range(k):
                at = [outer + (side * k + j + i) % (6 * k) for i in (0, 1)]
                near = [inner + (side * (k - 1) + j + i) % max(6 * (k - 1), 1) for i in (0, 1)]
                triangles.append([*at, near[0]])
                if j < k - 1:
                    triangles.append([near[0], at[1], near[1]])
    return skfem.MeshTri(points, np.array(triangles).T.copy())


def pipe(rings: int, moved: float = 0.0) -> Scene:
    """A cycle of the pressure gradient from 1 to 2 and back; it flows above 0.4."""
    mesh = disc(rings, moved).with_boundaries({"wall": lambda x: np.hypot(*x) > 0})
    pressure = Sine(0.5, 1.0, offset=1.5, phase=-np.pi / 2)
    effects: list[Effect] = [fem.Viscosity(1.0), fem.YieldStress(0.2), fem.BodyForce(pressure)]
    return fem.body(fem.Discretisation(mesh, "wall"), effects, t_end=1.0, steps=40, tol=1e-6)


def ring(cells: int, **hardening: Any) -> Scene:
    """A quarter of the ring under pressure on its inner side; 66 steps are those of the goldens."""
    mesh = skfem.MeshTri.init_tensor(
        np.linspace(INNER, OUTER, cells + 1), np.linspace(0, np.pi / 2, 5 * cells + 1)
    )
    mesh = skfem.MeshTri2.from_mesh(mesh)
    radius, angle = mesh.doflocs
    mesh = skfem.MeshTri2(radius * np.array([np.cos(angle), np.sin(angle)]), mesh.t)
    sides = {
        "inner": lambda x: np.hypot(*x) < INNER + 1e-3,
        "x axis": lambda x: np.abs(x[1]) < 1e-9,
        "y axis": lambda x: np.abs(x[0]) < 1e-9,
    }
    held = {"x axis": "y", "y axis": "x"}
    mesh = mesh.with_boundaries(sides)
    space = fem.Discretisation(mesh, element="P2", kind="plane strain", held=held)
    cycle = Table([0.0, 1.0, 2.0, 3.0], [0.0, 1.1, 0.0, -1.1])  # times LIMIT; tension first
    effects: list[Effect] = [
        fem.Elasticity(E=E, nu=0.3),
        fem.Plasticity(SIGMA_Y, **(hardening or KINEMATIC)),
        fem.Traction("inner", cycle, f2=-LIMIT),
    ]
    return fem.body(space, effects, t_end=3.0, steps=66, scheme="implicit-euler", tol=1e-10)


def tread(cells: int, without: tuple[str, ...] = ()) -> Scene:
    """The block of problems/tread.toml, cubes of six tetrahedra, or without its friction."""
    changes = {"domain.mesh.cells": [3 * cells, 2 * cells, cells]}
    return read_scene("tread", changes=changes, without=without)


def tube(refinements: int, without: tuple[str, ...] = ()) -> Scene:
    """The section of problems/tube.toml, or without its friction."""
    changes = {"domain.refinements": refinements}
    return read_scene("tube", changes=changes, without=without)


Make = Callable[..., Scene]
SCENES: dict[str, tuple[Make, int, float, int]] = {  # size, t_end and steps
    "tread": (tread, 5, 2.0, 40),
    "tube": (tube, 0, 60.0, 240),
    "pipe": (pipe, 29, 1.0, 40),
    "rough": (lambda rings: pipe(rings, 0.25), 29, 1.0, 40),
    "ring": (ring, 19, 1.0, 22),
}


def peak() -> float:
    """The most memory of this process so far, in GB."""
    size = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return size / (1e9 if sys.platform == "darwin" else 1e6)


def timed(scene: Scene, t_end: float, steps: int) -> tuple[so.Solution, np.ndarray]:
    """A run, and the processor time of each step."""
    marks = [time.process_time()]
    solution = scene.solve(
        t_end=t_end,
        steps=steps,
        scheme="implicit-euler",
        callback=lambda info: marks.append(time.process_time()),
    )
    return solution, np.diff(marks)


def by_cvxpy(scene: Scene, mu: float) -> Callable[[np.ndarray, float], tuple[np.ndarray, ...]]:
    """(u, t) -> z of a step from u to t, its seconds, and those of Clarabel alone."""
    import cvxpy as cp

    process = scene.process
    z, S = cp.Variable(process.dim), untranslated(process.C.at(0.0)).S
    few = S.selection
    support, constraints = few.part.epigraph(-z[few.unknowns]) if few else S.epigraph(-z)
    energy = 0.5 * cp.quad_form(z, cp.psd_wrap(process.matrix(mu))) + support
    parameter = cp.Parameter(process.dim)
    known = cp.Problem(cp.Minimize(energy + parameter @ z), constraints)

    def step(u: np.ndarray, t: float) -> tuple[np.ndarray, ...]:
        q, start = process.times_B(u) - untranslated(process.C.at(t)).c, time.process_time()
        if process.dim <= PARAMETERS:
            parameter.value, problem = q, known
        else:
            problem = cp.Problem(cp.Minimize(energy + q @ z), constraints)
        problem.solve(solver=cp.CLARABEL)
        seconds = time.process_time() - start
        return z.value, np.array([seconds, problem.solver_stats.solve_time])

    return step


def compare(name: str, size: int) -> None:
    """One line: the library's steps, then the same by cvxpy; some of them take twice the others."""
    warnings.simplefilter("ignore", so.errors.InitialStateWarning)
    make, _, t_end, steps = SCENES[name]
    scene = make(size)
    run, ours = timed(scene, t_end, steps)
    memory = peak()
    solve, M = by_cvxpy(scene, t_end / steps), Factor(scene.process.matrix(t_end / steps))
    solve(run.u[0], float(run.t[1]))
    theirs, apart = [], 0.0
    for k in range(1, steps):
        z, seconds = solve(run.u[k], float(run.t[k + 1]))
        theirs.append(seconds)
        z_ours = run.velocity[k]
        apart = max(apart, M.norm(z - z_ours) / M.norm(z_ours)) if z_ours.any() else apart
    mine, (loop, alone) = 1e3 * ours[1:].mean(), 1e3 * np.mean(theirs, axis=0)
    print(
        f"{name:<6}{scene.problem.dim:>8}{run.plan.nonsmooth_unknowns:>8}{mine:>10.2f}{loop:>10.1f}"
        f"{loop / mine:>8.1f}{alone:>10.1f}{run.stats['relative'].max():>10.0e}{apart:>9.0e}"
        f"{memory:>7.2f}{peak():>7.2f}  {run.plan.path}",
        flush=True,
    )
    if make in (tread, tube):
        _, linear = timed(make(size, without=("friction",)), t_end, steps)
        linear_ms = 1e3 * linear[1:].mean()
        print(f"       without friction {linear_ms:.2f} ms a step: with it {mine / linear_ms:.2f}"
              " times that")  # fmt: skip


def block_memory(cells: int) -> None:
    """The peak of a run of a large block, which is all that this process does."""
    before, scene = peak(), tread(cells)
    assembled = peak()
    start = time.process_time()
    run = scene.solve(t_end=0.2, steps=4, scheme="implicit-euler")
    print(run.plan)
    print(f"4 steps in {time.process_time() - start:.0f} s, certified to "
          f"{run.stats['relative'].max():.0e}")  # fmt: skip
    print(f"peak {peak():.2f} GB ({before:.2f} before, {assembled:.2f} with the scene)")


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene", nargs="?", choices=SCENES, help="all of them if not given")
    parser.add_argument("--size", type=int, help="see the top of the file")
    parser.add_argument("--memory", action="store_true", help="only the peak of a large block")
    args = parser.parse_args()
    warnings.simplefilter("ignore", so.errors.InitialStateWarning)
    if args.memory:
        block_memory(args.size or 18)
        return
    print("          unknowns              ms a step                  certi-            peak GB")
    print(f"{'scene':<6}{'all':>8}{'cones':>8}{'ours':>10}{'cvxpy':>10}{'ratio':>8}{'solver':>10}"
          f"{'ficate':>10}{'apart':>9}{'ours':>7}{'both':>7}  path", flush=True)  # fmt: skip
    for name in [args.scene] if args.scene else SCENES:
        arguments = name, args.size or SCENES[name][1]
        # in a process of its own, whose peak is that of this scene
        one = multiprocessing.get_context("spawn").Process(target=compare, args=arguments)
        one.start()
        one.join()


if __name__ == "__main__":
    main()
