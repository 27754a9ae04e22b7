"""What threads share without our doing: cvxpy's numbers of variables, and standard output.

Runs in several threads are, bit for bit, those in one: each compiles programs of its own. What they
cannot have of their own they take in turns here.
"""

from __future__ import annotations

import io
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from typing import Any, ParamSpec, TypeVar, cast

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")

_cvxpy, _stdout = threading.RLock(), threading.Lock()


def in_turn(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """For all that states or solves something in cvxpy: one thread at a time.

    cvxpy numbers its variables by `count += 1`: where two threads do that at once, variables of one
    program get the same number. And a variable that is shared holds one answer only.
    """

    @wraps(function)
    def alone(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Result:
        with _cvxpy:
            return function(*args, **kwargs)

    return alone


PLAIN = io.TextIOBase()  # what a stream that lacks something does: nothing, or say that it cannot


class _ForTheOthers:
    """Standard output of all threads but some; whatever it is, code that is silenced can use it."""

    def __init__(self) -> None:
        self.stream: Any = None
        self.silent: set[int] = set()

    def write(self, text: str) -> int:
        if self.stream is None or threading.get_ident() in self.silent:
            return len(text)
        return self.stream.write(text)

    def __getattr__(self, name: str) -> Any:
        try:
            return getattr(self.stream, name)
        except AttributeError:
            return getattr(PLAIN, name)


# never freed: CPython's print() holds sys.stdout without counting the reference (3.11), so that a
# stream which goes away while another thread prints is a crash
_others = _ForTheOthers()


@contextmanager
def silence() -> Iterator[None]:
    """Nothing that this thread prints is seen; what the others print is.

    Examples
    --------
    >>> with silence():
    ...     print("of no interest")
    """
    me = threading.get_ident()
    with _stdout:
        stream: Any = sys.stdout
        if stream is not _others:
            _others.stream, sys.stdout = stream, cast(Any, _others)
        inside = me in _others.silent
        _others.silent.add(me)
    try:
        yield
    finally:
        with _stdout:
            if not inside:
                _others.silent.discard(me)
            if not _others.silent and cast(Any, sys.stdout) is _others:
                sys.stdout = _others.stream
