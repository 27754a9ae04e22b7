"""The same process gives the same solution, bit for bit: again, in threads, in processes.

And a long run keeps nothing of the steps that it was not asked to keep.
"""

import multiprocessing
import os
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
    "uncertified": (free, {"steps": 2}),
    "closed form": (lambda: body(A=np.diag(A.diagonal()), B=None), {}),
    "linear": (lambda: body(C=so.Point(np.zeros(N))), {}),
    "daqp": (body, {"solver": "daqp"}),
    "cvxpy": (body, {"solver": "cvxpy", "steps": 3}),
    "cvxpy:osqp": (body, {"solver": so.Cvxpy("OSQP"), "steps": 3}),
    "adaptive": (body, {"steps": so.Adaptive(1e-2)}),
    "exact": (lambda: three(so.Box(-GAP[:3], GAP[:3])), {"scheme": "exact"}),
    # an intersection, whose support function is a program of its own
    "two sets": (lambda: three(so.Box([-1] * 3, [1] * 3) & so.Ball([0] * 3, 1.2)), {"steps": 6}),
    # Newton starts its projections from one in another metric
    "two sets by newton": (few, {"solver": "newton", "steps": 4}),
}
NAMES = [*ROUTES]


def run(name, process=None):
    make, settings = ROUTES[name]
    return so.solve(process or make(), **{"t_end": 2.0, "steps": 10, **settings})


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
@pytest.mark.parametrize("name", [*NAMES[1::2], *map(slow, NAMES[::2])])
def test_threads_at_once_and_again_are_the_same(name):
    shared, other = ROUTES[name][0](), NAMES[NAMES.index(name) - 1]
    jobs = [(name, None), (name, shared), (name, shared), (other, None)]
    ready = threading.Barrier(len(jobs), timeout=SECONDS)

    def at_once(job):
        ready.wait()
        return run(*job)

    assert alone(name).velocity.any()
    with ThreadPoolExecutor(len(jobs)) as pool:
        for (route, _), sol in zip(jobs, pool.map(at_once, jobs, timeout=SECONDS), strict=True):
            assert same(sol, alone(route))
    assert same(run(name, shared), alone(name))  # what earlier runs left in it changes nothing


@pytest.mark.slow  # .ci/run runs it
def test_processes_give_what_this_one_gives():
    # spawned: nothing is inherited from this process
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        for name, there in zip(
            NAMES[::2], pool.map(result, NAMES[::2], timeout=SECONDS), strict=True
        ):
            assert there == result(name), name


# ---- memory -----------------------------------------------------------------------------------

STATM = Path("/proc/self/statm")  # of proc(5): pages in memory are the second number
WATCHED = """
import sys, sweepopt as so
from pathlib import Path

def look(info):
    if info.step % 40 == 39:
        print(Path("/proc/self/statm").read_text().split()[1])

load = so.Separable([(so.Sine(3.0, 1.0), [1.0, -1.0])])
C = so.Moving(so.Box([-0.5, -1.0], [0.5, 1.0]), load)
process = so.SweepingProcess([[2.1, -1.0], [-1.0, 2.1]], [[3.6, -1.7], [-1.7, 3.7]], C, [0.0, 0.0])
how = {"save": "last", "callback": look, "solver": sys.argv[1]}
sol = so.solve(process, t_end=40.0, steps=4000, **how)
assert (sol.stats["attempts"] > 0).mean() > 0.5
"""


@pytest.mark.slow
@pytest.mark.skipif(not STATM.exists(), reason="only Linux says what is resident")
@pytest.mark.parametrize("solver", ["newton", "daqp", "osqp", "clarabel"])
def test_a_long_run_does_not_grow(solver):
    """The table of statistics is there from the start; a tenth of the run fills caches."""
    pages = python("-c", WATCHED, solver).stdout.split()
    size = os.sysconf("SC_PAGE_SIZE") * np.array(pages, dtype=float)[9:]
    # the C library takes memory in pieces of 132 kB: one of them is 37 bytes a step
    assert np.polyfit(40.0 * np.arange(size.size), size, 1)[0] <= 100
