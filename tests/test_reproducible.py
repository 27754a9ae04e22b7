"""The same process gives the same solution, bit for bit: again, in threads, in processes.

And a long run keeps nothing of the steps that it was not asked to keep.
"""

import multiprocessing
import sys
import threading
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from cases import slow
from processes import SECONDS, python
from test_checkpoint import RUNS, free, same

import sweepopt as so

HERE = Path(__file__).parent
N = 12
LOAD = so.Separable([
    (so.Sine(2.0, 3.0), np.cos(np.arange(N))),
    (so.Triangle(1.5, 2.0), np.sin(2.0 * np.arange(N))),
])  # fmt: skip
GAP = np.linspace(0.3, 1.2, N)
A, B = (k * (2.1 * np.eye(N) - np.eye(N, k=1) - np.eye(N, k=-1)) for k in (1.0, 1.7))
B = B + np.diag(0.1 * np.arange(N))  # not proportional


def body(A=A, B=B, C=None):
    return so.SweepingProcess(A, B, so.Moving(C or so.Box(-GAP, GAP), LOAD), np.zeros(len(A)))


def three(C):
    load = so.Separable([(so.Sine(3.0, 3.0), np.array([1.0, 0.5, -1.0]))])
    return so.SweepingProcess(A[:3, :3], B[:3, :3], so.Moving(C, load), np.zeros(3))


def few(m=5):
    Q = np.random.default_rng(0).normal(size=(m, m))
    centre = so.Separable([
        (so.Sine(3.0, 3.0), np.cos(np.arange(m))),
        (so.Triangle(3.0, 2.0), np.sin(2.0 * np.arange(m))),
    ])  # fmt: skip
    C = so.Moving(so.Ball(np.zeros(m), 1.2) & so.Box(-np.ones(m), np.ones(m)), centre)
    return so.SweepingProcess(
        Q @ Q.T + 0.3 * np.eye(m), np.diag(1.0 + np.arange(m)), C, np.zeros(m)
    )


SLOW_ROUTES = ("steps in parts", "many step sizes")
ROUTES = {
    **{name: route for name, route in RUNS.items() if name not in SLOW_ROUTES},
    "uncertified": (free, {"steps": 3}),
    "closed form": (lambda: body(A=np.diag(A.diagonal()), B=None), {}),
    "linear": (lambda: body(C=so.Point(np.zeros(N))), {}),
    "daqp": (body, {"solver": "daqp"}),
    "cvxpy": (body, {"solver": "cvxpy", "steps": 12}),
    "cvxpy:osqp": (body, {"solver": so.Cvxpy("OSQP"), "steps": 12}),
    "adaptive": (body, {"steps": so.Adaptive(1e-2)}),
    "exact": (lambda: three(so.Box(-GAP[:3], GAP[:3])), {"scheme": "exact"}),
    # an intersection, whose support function is a program of its own
    "two sets": (lambda: three(so.Box([-1] * 3, [1] * 3) & so.Ball([0] * 3, 1.2)), {"steps": 12}),
    # Newton starts its projections from one in another metric
    "two sets by newton": (few, {"solver": "newton"}),
}


def run(name, process=None):
    make, settings = ROUTES[name]
    return so.solve(process or make(), **{"t_end": 4.0, "steps": 20, **settings})


alone = cache(run)


def result(name):
    """What a process can send: all but wall times."""
    sol = alone(name)
    stats = [sol.stats[name] for name in sol.stats.dtype.names or () if name != "seconds"]
    return [array.tobytes() for array in (sol.u, sol.velocity, *stats)]


@pytest.fixture
def hasty():
    """Threads that take turns as often as they can."""
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(interval)


@pytest.mark.usefixtures("hasty")
@pytest.mark.parametrize("name", [*[*ROUTES][1::2], *map(slow, [*ROUTES][::2])])
def test_threads_at_once_and_again_are_the_same(name):
    shared = ROUTES[name][0]()
    ready = threading.Barrier(3, timeout=SECONDS)

    def at_once(process):
        ready.wait()
        return run(name, process)

    assert alone(name).velocity.any()
    with ThreadPoolExecutor(3) as pool:
        for sol in pool.map(at_once, [None, shared, shared], timeout=SECONDS):
            assert same(sol, alone(name))
    assert same(run(name, shared), alone(name))  # what earlier runs left in it changes nothing


@pytest.mark.usefixtures("hasty")
def test_threads_on_different_routes_do_not_meet():
    names = [name for name in ROUTES if name != "adaptive"]
    with ThreadPoolExecutor(4) as pool:
        for name, sol in zip(names, pool.map(run, names, timeout=SECONDS), strict=True):
            assert same(sol, alone(name))


def test_processes_give_what_this_one_gives():
    # spawned: nothing is inherited from this process
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        names = [*ROUTES][::2]  # the others are in threads above
        for name, there in zip(names, pool.map(result, names, timeout=SECONDS), strict=True):
            assert there == result(name), name


# ---- memory -----------------------------------------------------------------------------------

SMALL = {
    "closed form": {"A": np.diag([1.0, 2.0]), "B": np.diag([2.0, 1.0])},
    **{name: {"solver": name} for name in ("newton", "daqp", "osqp", "clarabel")},
}
PAGE = 4096 if sys.platform == "win32" else __import__("resource").getpagesize()


def resident():
    """Bytes of this process that are in memory (proc(5), Linux)."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * PAGE


def watched(name, steps):
    """Print what is resident at a hundred steps of a run; it runs in a process of its own."""
    given = {"A": A[:2, :2], "B": B[:2, :2]} | SMALL[name]
    load = so.Separable([(so.Sine(3.0, 1.0), np.array([1.0, -1.0]))])
    C = so.Moving(so.Box([-0.5, -1.0], [0.5, 1.0]), load)
    process = so.SweepingProcess(given.pop("A"), given.pop("B"), C, [0.0, 0.0])
    every = steps // 100

    def look(info):
        if info.step % every == every - 1:
            print(info.step + 1, resident(), flush=True)

    sol = so.solve(process, t_end=steps / 100, steps=steps, save="last", callback=look, **given)
    assert len(sol.u) == 2
    assert (sol.stats["attempts"] > 0).mean() > 0.5 or name == "closed form"


def growth(name, steps):
    """Bytes that a step adds to what is resident after a tenth of the run.

    The statistics of all steps are written to before the first one; the table that is made of them
    after the last one is not in it.
    """
    code = f"import sys; sys.path.insert(0, {str(HERE)!r}); import test_reproducible as this; "
    code += f"this.watched({name!r}, {steps})"
    lines = python(code).stdout.splitlines()
    done, size = np.array([line.split() for line in lines], dtype=float).T
    print(f"{name}: {(size[-1] - size[9]) / 1e6:.2f} MB from step {done[9]:.0f} to {done[-1]:.0f}")
    return float(np.polyfit(done[9:], size[9:], 1)[0])


LEAK = 5e6 / 1e5  # bytes a step
linux = pytest.mark.skipif(
    not Path("/proc/self/statm").exists(), reason="only Linux says what is resident"
)


SLOW = [slow(name) for name in SMALL if name != "osqp"]


@linux
@pytest.mark.parametrize("name", ["osqp", *SLOW])
def test_a_long_run_does_not_grow(name):
    # the C library takes memory in pieces of 132 kB: one of them is 37 bytes a step here
    assert growth(name, 4000) <= 2 * LEAK
