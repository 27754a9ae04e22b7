"""What computes: processor and versions, one thread a process, processes or a dask cluster.

A study asks for no more than `concurrent.futures` has: submit(function, *arguments) -> Future. With
one thread times compare, and results are the same bit for bit, wherever they are computed.
"""

from __future__ import annotations

import os
import platform
import re
import warnings
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import cache
from pathlib import Path
from typing import Any

from sweepopt.checks import count
from sweepopt.errors import InputError, brought_by
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


@contextmanager
def processes(workers: int) -> Iterator[Executor]:
    """New processes of this machine as an executor: a dask cluster of its own.

    Parameters
    ----------
    workers : int

    Notes
    -----
    Workers that die are replaced; all end with the process that started them, even by kill -9. They
    are started anew ("spawn"): a script guards its own code with ``if __name__ == "__main__":``.
    """
    size = count("workers", workers)
    with brought_by("study"):
        from distributed import LocalCluster
    with (
        LocalCluster(
            n_workers=size,
            threads_per_worker=1,
            dashboard_address=None,
            scheduler_kwargs={"allowed_failures": 1},  # a second death is the cell's doing
        ) as cluster,
        dask_executor(cluster.scheduler_address) as executor,
    ):
        yield executor


@contextmanager
def dask_executor(client: Any) -> Iterator[Executor]:
    """The workers of a dask cluster as an executor.

    Parameters
    ----------
    client : dask.distributed.Client or str
        A client, or the address of a running scheduler, such as "tcp://127.0.0.1:8786".

    Raises
    ------
    InputError
        If the scheduler does not answer, or a worker has several threads: cells in one process
        would share its time. Start workers with ``--nthreads 1``.
    MissingExtraError
        If distributed is not installed.

    Notes
    -----
    If a worker dies, another one computes its cells. A cell that several workers died of (dask's
    setting distributed.scheduler.allowed-failures) is tried again alone and then becomes a failed
    row.
    """
    with brought_by("study"):
        from distributed import Client
    try:
        connected = Client(client, timeout=10) if isinstance(client, str) else nullcontext(client)
    except (OSError, ValueError) as error:
        raise InputError(f"scheduler {client!r} does not answer: {error}") from error
    # the references of large problems, each of which a worker needs once
    with connected as cluster, warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Sending large graph")
        for address, worker in cluster.scheduler_info(n_workers=-1)["workers"].items():
            if worker["nthreads"] > 1:
                raise InputError(
                    f"worker {address} has {worker['nthreads']} threads, which would share a "
                    "cell's time; start workers with --nthreads 1"
                )
        yield cluster.get_executor(pure=False)
