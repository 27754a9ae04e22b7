"""What computes here: processor and versions, and one thread for the linear algebra.

With one thread times compare, and results are the same bit for bit.
"""

from __future__ import annotations

import os
import platform
import re
from contextlib import AbstractContextManager
from functools import cache
from pathlib import Path

from sweepopt.errors import brought_by
from sweepopt.io import versions_of

PACKAGES = ("numpy", "scipy", "cvxpy", "clarabel", "osqp")


@cache
def machine() -> str:
    """Processor, threads and versions, in one line.

    Examples
    --------
    >>> "numpy" in machine()
    True
    """
    cpuinfo = Path("/proc/cpuinfo")
    model = re.search(r"model name\s*: (.*)", cpuinfo.read_text() if cpuinfo.exists() else "")
    name = model[1] if model else platform.processor()
    threads = os.environ.get("OMP_NUM_THREADS", "unset")
    versions = {"python": platform.python_version(), **versions_of(PACKAGES)}
    packages = ", ".join(f"{package} {version}" for package, version in versions.items())
    system = f"{os.cpu_count()} cores, {platform.system()}, OMP_NUM_THREADS {threads}"
    return f"{name}, {system}; {packages}"


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
