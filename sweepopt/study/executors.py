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
from contextlib import contextmanager
from multiprocessing import get_context, parent_process
from typing import Any

from sweepopt.checks import count
from sweepopt.errors import InputError, SweepoptError, brought_by

ATTEMPTS = 2  # as dask's scheduler: a second death is the cell's doing


class WorkerDiedError(SweepoptError):
    """The process of a worker ended while it was computing, each time it was tried."""


class Processes(Executor):
    """Worker processes that are replaced when they die.

    Each is a pool of its own with a thread that attends to it: `ProcessPoolExecutor` gives up all
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
        self._threads = ThreadPoolExecutor(count("workers", workers))
        self._own = threading.local()
        self._pools: list[ProcessPoolExecutor] = []

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Have the next free worker compute; a second one if it dies.

        The future raises WorkerDiedError if that dies too.
        """
        return self._threads.submit(self._attend, fn, args, kwargs)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the workers when what they compute is done."""
        self._threads.shutdown(wait=wait, cancel_futures=cancel_futures)
        for pool in self._pools:
            pool.shutdown(wait=wait, cancel_futures=cancel_futures)

    def _attend(self, fn: Callable[..., Any], args: Any, kwargs: Any) -> Any:
        for _ in range(ATTEMPTS):
            pool = getattr(self._own, "pool", None)
            if pool is None:
                pool = ProcessPoolExecutor(1, get_context("spawn"), _end_with_parent)
                self._own.pool = pool
                self._pools.append(pool)
            try:
                return pool.submit(fn, *args, **kwargs).result()
            except BrokenProcessPool:
                self._own.pool = None
                pool.shutdown()
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
    if isinstance(client, str):
        try:
            connected = Client(client, timeout=10)
        except (OSError, ValueError) as error:
            raise InputError(f"scheduler {client!r} does not answer: {error}") from error
        with connected, dask_executor(connected) as executor:
            yield executor
        return
    workers = client.scheduler_info(n_workers=-1)["workers"]
    for address, worker in workers.items():
        if worker["nthreads"] > 1:
            raise InputError(
                f"worker {address} has {worker['nthreads']} threads, which would share a cell's "
                "time; start workers with --nthreads 1"
            )
    with warnings.catch_warnings():
        # the references of large problems, each of which a worker needs once
        warnings.filterwarnings("ignore", message="Sending large graph")
        yield client.get_executor(pure=False)


def _end_with_parent() -> None:
    """Leave no worker behind when the process that started it is killed."""
    parent = parent_process()
    if parent is not None:

        def wait_for_parent() -> None:
            parent.join()
            os._exit(1)

        threading.Thread(target=wait_for_parent, daemon=True).start()
