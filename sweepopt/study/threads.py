"""One thread for the linear algebra: times compare, and results are the same bit for bit."""

from __future__ import annotations

from contextlib import AbstractContextManager

from sweepopt.errors import MissingExtraError


def one_thread() -> AbstractContextManager[object]:
    """Limit the BLAS and OpenMP libraries that are loaded to one thread.

    Raises
    ------
    MissingExtraError
        If threadpoolctl is not installed.
    """
    try:
        from threadpoolctl import threadpool_limits
    except ImportError as error:
        raise MissingExtraError("threadpoolctl", "study") from error
    limits: AbstractContextManager[object] = threadpool_limits(limits=1)
    return limits
