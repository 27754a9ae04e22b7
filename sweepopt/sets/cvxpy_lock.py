"""What threads share without our doing: cvxpy's numbers of variables.

Runs in several threads are, bit for bit, those in one: each compiles programs of its own. What they
cannot have of their own they take in turns here.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")

_cvxpy = threading.RLock()


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
