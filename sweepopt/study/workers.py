"""What computes: processor and versions, one thread a process, processes or a dask cluster.

A study asks for no more than `concurrent.futures` has: submit(function, *arguments) -> Future. With
one thread times compare, and results are the same bit for bit, wherever they are computed.
"""

from __future__ import annotations

import os
import platform
import re
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager, nullcontext
from functools import cache
from multiprocessing import get_context, parent_process
from pathlib import Path
from threading import Thread
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
    names = re.findall(r"model name\s*: (.*)", cpuinfo.read_text() if cpuinfo.exists() else "")
    name, *_ = *names, platform.processor()
    threads = os.environ.get("OMP_NUM_THREADS", "unset")
    packages = ", ".join(map(" ".join, versions_of(PACKAGES).items()))
    system = f"{os.cpu_count()} cores, {platform.system()}, OMP_NUM_THREADS {threads}"
    return f"{name}, {system}; {packages}"


def one_thread() -> Any:
    """Limit the BLAS and OpenMP libraries that are loaded to one thread.

    Raises
    ------
    MissingExtraError
        If threadpoolctl is not installed.
    """
    with brought_by("study"):
        from threadpoolctl import threadpool_limits
    return threadpool_limits(limits=1)


def processes(workers: int) -> Executor:
    """New processes of this machine as an executor, for `run`.

    Parameters
    ----------
    workers : int

    Notes
    -----
    They are started anew ("spawn"): a script guards its own code with
    ``if __name__ == "__main__":``. All end with the process that started them, even by kill -9.
    """
    return ProcessPoolExecutor(count("workers", workers), get_context("spawn"), _end_with_parent)


def _end_with_parent() -> None:
    """A thread of a worker that waits for the end of the process that started it."""
    parent: Any = parent_process()

    def end() -> None:
        parent.join()
        os._exit(1)

    Thread(target=end, daemon=True).start()


@contextmanager
def dask_executor(client: Any) -> Iterator[Executor]:
    """The workers of a dask cluster as an executor, for `run`.

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
    Workers read scenes in the files of the machine that runs the study. If a worker dies, another
    one computes its cells.
    """
    with brought_by("study"):
        from distributed import Client
    try:
        connected = Client(client, timeout=10) if isinstance(client, str) else nullcontext(client)
    except (OSError, ValueError) as error:
        raise InputError(f"scheduler {client!r} does not answer: {error}") from error
    with connected as cluster:
        for address, worker in cluster.scheduler_info(n_workers=-1)["workers"].items():
            if worker["nthreads"] > 1:
                raise InputError(
                    f"worker {address} has {worker['nthreads']} threads, which would share a "
                    "cell's time; start workers with --nthreads 1"
                )
        yield cluster.get_executor(pure=False)
