"""The property: in time a right answer, or an error of the library's own."""

import math
import signal
import warnings
from contextlib import contextmanager

import numpy as np
from fuzz_inputs import MineError

import sweepopt as so
from sweepopt.linalg import dense

SECONDS = 30  # an input that takes longer hangs


class Hang(BaseException):
    """Raised by the clock; no `except Exception` stops it."""


@contextmanager
def limited(seconds):
    """End what takes longer by a signal; where no Python code runs any more pytest has a limit.

    The signal counts the time of this process, so that a busy machine hangs nothing.
    """

    def stop(*_):
        raise Hang(f"no answer in {seconds:g} s")

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)


def judge(question):
    """Ask: a right answer (the question asserts that it is) or an error of the library's own.

    An exception that a user's own function raises passes through the library as it is.
    """
    with limited(SECONDS), warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", so.SweepoptWarning)
        try:
            question()
        except MineError:
            pass
        except so.SweepoptError as error:
            message = str(error)
            assert message.strip()
            assert "Traceback" not in message, message


def check_run(sol):
    assert sol.status is not None
    for name in ("t", "u", "velocity"):
        assert np.isfinite(getattr(sol, name)).all(), f"{name} is not finite"
    assert (np.diff(sol.t) > 0).all()
    if sol.status is so.Status.UNCERTIFIED:
        return
    for name in ("certificate", "relative"):
        assert np.isfinite(sol.stats[name]).all(), f"{name} is not finite"
    assert (sol.stats["relative"] <= sol.plan.tol).all(), "a step is above tol"
    scheme = sol.plan.scheme
    if not sol.complete or len(scheme.b) > 1 or scheme.exact or abs(sol.t).max() > 1e9:
        return  # far away the rounding of a time is more than the period of a load
    for i, z in enumerate(sol.velocity):
        _check_inclusion(sol, i, z, scheme.a[0][-1], scheme.c[0])


def _check_inclusion(sol, i, z, a, c):
    """-z in N_C(w), w = M z + q: w = P_C(w - s z) for any s > 0, as far as the certificate says."""
    process, mu = sol.process, float(sol.t[i + 1] - sol.t[i])
    t = float(sol.t[i]) + c * mu
    C = process.C.at(t)
    A, B = (np.zeros((len(z), len(z))) if M is None else dense(M) for M in (process.A, process.B))
    M, q = A + a * mu * B, process.times_B(sol.u[i])
    w, values, s = M @ z + q, np.linalg.eigvalsh(M), float(np.mean(np.diag(M)))
    size = np.linalg.norm(q) + np.linalg.norm(C.anchor) + np.abs(M).max() * np.linalg.norm(z)
    if not (values[0] > 1e-9 * values[-1] and 1e-100 < size < 1e100 and 1e-100 < s < 1e100):
        return
    v = w - s * z
    residual = np.linalg.norm(w - C.project(v))
    # the run may have had another rounding of the time
    near = (process.C.at(t + side * 8e-16 * abs(sol.t).max()) for side in (-1, 1))
    residual -= 2 * max(np.linalg.norm(other.project(v) - C.project(v)) for other in near)
    error = sol.stats["certificate"][i] * (2 * math.sqrt(values[-1]) + s / math.sqrt(values[0]))
    rounding = (1e-9 if C.exact else 1e-4) * (size + s * np.linalg.norm(z))
    rounding += 2e-15 * np.abs(C.offsets).max(initial=0.0)  # of what C is made of
    assert residual <= 1.01 * error + rounding, f"step {i}: misses the inclusion by {residual:g}"
