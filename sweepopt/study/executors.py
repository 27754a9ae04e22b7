"""Where cells are computed: in a thread, in processes, on a dask cluster. All give the same rows.

A study asks for no more than `concurrent.futures` has: submit(function, *arguments) -> Future.
"""

from __future__ import annotations

import os
import threading
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, nullcontext
from multiprocessing import get_context, parent_process
from typing import Any

from sweepopt.checks import count
from sweepopt.errors import InputError, SweepoptError, brought_by

ATTEMPTS = 2  # as dask's scheduler: a second death is the cell's doing


class WorkerDiedError(SweepoptError):
    """The process of a worker ended while it was computing, each time it was tried."""


class Processes(ThreadPoolExecutor):
    """Worker processes that are replaced when they die.

    Each is a pool of its own, of the thread that attends to it: `ProcessPoolExecutor` gives up all
    that it was handed when one of its workers dies. They end with the process that started them,
    even by kill -9.

    Parameters
    ----------
    workers : int

    Notes
    -----
    Workers are started anew ("spawn"): a script guards its own code with
    ``if __name__ == "__main__":``.
    """

    def __init__(self, workers: int) -> None:
        super().__init__(count("workers", workers))
        self._own = threading.local()

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Have the next free worker compute; a second one if it dies.

        The future raises WorkerDiedError if that dies too.
        """
        return super().submit(self._attend, fn, args, kwargs)

    def _attend(self, fn: Callable[..., Any], args: Any, kwargs: Any) -> Any:
        for _ in range(ATTEMPTS):
            if not hasattr(self._own, "pool"):
                context = get_context("spawn")
                self._own.pool = ProcessPoolExecutor(1, context, _end_with_parent)
            try:
                return self._own.pool.submit(fn, *args, **kwargs).result()
            except BrokenProcessPool:
                del self._own.pool
        raise WorkerDiedError(
            f"the worker's process ended while it was computing, {ATTEMPTS} times: out of memory, "
            "or a crash in compiled code"
        )


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
    If a worker dies, another one computes its cell. A cell that several workers died of becomes a
    failed row (dask's setting distributed.scheduler.allowed-failures).
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


def _end_with_parent() -> None:
    """Leave no worker behind when the process that started it is killed."""

    def wait_for_parent() -> None:
        parent: Any = parent_process()
        parent.join()
        os._exit(1)

    threading.Thread(target=wait_for_parent, daemon=True).start()
