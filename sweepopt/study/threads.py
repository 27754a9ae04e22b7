"""One thread for the linear algebra: times compare, and results are the same bit for bit."""

from __future__ import annotations

from contextlib import AbstractContextManager

from sweepopt.errors import brought_by


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
