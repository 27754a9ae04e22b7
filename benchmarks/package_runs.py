"""The scalar case in other people's packages; run by their Python, which needs no sweepopt.

    PYTHON package_runs.py PACKAGE '{"a": 1.0, "b": 1.0, "g": 0.3, "t_end": 10.0, ...}'

a u' + b u + g Sign(u') contains sin t, u(0) = 0. The answer is one line of JSON: the package's
version, seconds (median of the runs, imports and the building of a solver outside), and t and u at
the nodes the package reports.
"""

from __future__ import annotations

import json
import math
import statistics
import sys
import time
from collections.abc import Callable
from importlib.metadata import version
from typing import Any

RUNS, LEAST, ENOUGH = 5, 0.2, 1.0
"""A run is repeated so many times and for 0.2 s, but not beyond 1 s."""
Case = dict[str, Any]
Run = Callable[[], tuple[Any, Any]]


def solve_nivp(case: Case) -> Run:
    """An implicit integrator with a semismooth Newton method and the exact Jacobian.

    `form` is "inclusion" (u, its velocity z and the friction w, which the package projects: w is in
    Sign(z)) or "formula" (u' = S(sin t - b u) / a, S(v) = v - min(max(v, -g), g): nothing is left
    to project). `steps` fixes them; `rtol` asks for the package's adaptive ones.
    """
    import numpy as np
    from solve_nivp import solve_ivp_ns

    a, b, g, t_end = case["a"], case["b"], case["g"], case["t_end"]

    def velocity(t: float, y: Any) -> Any:
        v = math.sin(t) - b * float(y[0])
        return np.array([(v - min(max(v, -g), g)) / a])

    def slope(t: float, y: Any, *_: Any) -> Any:
        return np.array([[-b / a if abs(math.sin(t) - b * float(y[0])) > g else 0.0]])

    def balance(t: float, y: Any, *_: Any) -> Any:
        return np.array([y[1], math.sin(t) - b * y[0] - a * y[1] - g * y[2], 0.0])

    matrix = np.array([[0.0, 1.0, 0.0], [-b, -a, -g], [0.0, 0.0, 0.0]])
    if case["form"] == "inclusion":
        law: dict[str, Any] = {
            "fun": balance,
            "y0": np.zeros(3),
            "A": np.diag([1.0, 0.0, 0.0]),
            "projection": "sign",
            "projection_opts": {"y_indices": [1], "w_indices": [2]},
        }
        jacobian: dict[str, Any] = {"rhs_jac": lambda *_: matrix}
    else:
        law = {"fun": velocity, "y0": np.zeros(1), "projection": "identity"}
        jacobian = {"rhs_jac": slope, "adaptive_lam": False}  # lam serves the projection only

    if "steps" in case:
        settings: dict[str, Any] = {"adaptive": False, "h0": t_end / case["steps"]}
    else:
        rtol, h_max = case["rtol"], case["h_max"]  # at rest an estimate sees no slip to come
        settings = {"rtol": rtol, "atol": 0.1 * rtol, "adaptive_opts": {"h_max": h_max}}

    def run() -> tuple[Any, Any]:
        t, y, *_ = solve_ivp_ns(
            t_span=(0.0, t_end),
            method=case["method"],
            solver="semismooth_newton",
            solver_opts={"tol": case["tol"], **jacobian},
            **law,
            **settings,
        )
        return t, y[:, 0]

    return run


def nosnoc(case: Case) -> Run:
    """Radau IIA elements with switch detection: three regions, slip either way and rest."""
    import casadi as ca
    import nosnoc as package
    import numpy as np

    a, b, g, t_end = case["a"], case["b"], case["g"], case["t_end"]
    state = ca.SX.sym("x", 2)  # u and the time
    v = ca.sin(state[1]) - b * state[0]
    regions = [(v - g) / a, 0.0, (v + g) / a]
    model = package.NosnocModel(
        x=state,
        x0=np.zeros(2),
        F=[ca.horzcat(*[ca.vertcat(velocity, 1.0) for velocity in regions])],
        c=[ca.vertcat(v - g, v + g)],
        S=[np.array([[1, 1], [-1, 1], [-1, -1]])],
    )
    options = package.NosnocOpts()
    options.n_s = case["stages"]
    options.N_finite_elements = case["elements"]
    options.terminal_time = t_end / case["intervals"]
    options.comp_tol = options.sigma_N = case["tol"]
    options.tol_ipopt = 1e-2 * case["tol"]
    options.sigma_0, options.homotopy_update_slope = 0.1, 0.01  # half the time of the defaults
    options.mpcc_mode = package.MpccMode[case["mode"]]
    solver = package.NosnocSolver(options, model)

    def run() -> tuple[Any, Any]:
        looper = package.NosnocSimLooper(solver, np.zeros(2), case["intervals"], print_level=0)
        looper.run()
        states = np.array(looper.get_results()["X_sim"])
        return states[:, 1], states[:, 0]

    return run


PACKAGES = {"solve_nivp": solve_nivp, "nosnoc": nosnoc}


def timed(run: Callable[[], Any]) -> tuple[float, Any]:
    """Seconds, the median of runs after a first one that compiles, and what that one found."""
    found = run()
    seconds: list[float] = []
    spent = 0.0
    while spent < (LEAST if len(seconds) >= RUNS else ENOUGH):
        started = time.perf_counter()
        run()
        seconds.append(time.perf_counter() - started)
        spent += seconds[-1]
    return statistics.median(seconds), found


def main() -> None:
    package, case = sys.argv[1], json.loads(sys.argv[2])
    answer, sys.stdout = sys.stdout, sys.stderr  # packages print what they like
    seconds, (t, u) = timed(PACKAGES[package](case))
    found = {"seconds": seconds, "t": list(map(float, t))}
    found |= {"u": list(map(float, u)), "version": version(package)}
    print(json.dumps(found), file=answer)


if __name__ == "__main__":
    main()
