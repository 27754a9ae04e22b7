"""What computes here: processor and versions, and one thread for the linear algebra.

With one thread times compare, and results are the same bit for bit.
"""

from __future__ import annotations

import os
import platform
from contextlib import AbstractContextManager
from functools import cache
from pathlib import Path

from sweepopt import __version__
from sweepopt.errors import brought_by
from sweepopt.io import versions_of

PACKAGES = ("numpy", "scipy", "cvxpy", "clarabel", "osqp")


@cache
def processor() -> str:
    """Name, number of cores and operating system."""
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text().splitlines() if cpuinfo.exists() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    name = names[0] if names else platform.processor() or platform.machine()
    return f"{name}, {os.cpu_count()} cores, {platform.system()}"


def versions() -> dict[str, str]:
    """Of the library, of Python and of what computes."""
    return {"sweepopt": __version__, "python": platform.python_version(), **versions_of(PACKAGES)}


def machine() -> str:
    """Processor, threads and versions, in one line.

    Examples
    --------
    >>> "numpy" in machine()
    True
    """
    threads = os.environ.get("OMP_NUM_THREADS", "unset")
    packages = ", ".join(f"{name} {number}" for name, number in versions().items())
    return f"{processor()}, OMP_NUM_THREADS {threads}; {packages}"


def one_thread() -> AbstractContextManager[object]:
    """Limit the BLAS and OpenMP libraries that are loaded to one thread.

    Raises
    ------
    MissingExtraError
        If threadpoolctl is not installed.
    """
    with brought_by("study"):
        from threadpoolctl import threadpool_limits
    limits: AbstractContextManager[object] = threadpool_limits(limits=1)
    return limits
