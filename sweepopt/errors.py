"""What can go wrong: statuses are sentences, every exception of ours is a SweepoptError.

The contract for any input: in time a certified, finite answer or one of these. What a function that
a user passes raises goes through as it is, with a note that says which function, and at what time.
"""

from __future__ import annotations

import re
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from difflib import get_close_matches
from enum import Enum
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np

    from sweepopt.results import Solution


def shown(value: object) -> str:
    """What a user passed, as a message can show it."""
    if isinstance(value, type) and value.__module__.startswith("sweepopt."):
        return f"the class {value.__name__} itself; call it: {value.__name__}(...)"
    try:
        text = re.sub(" at 0x[0-9a-f]+", "", " ".join(repr(value).split()))
        return text if len(text) <= 80 else f"{text:.77}..."
    except (ValueError, RecursionError):  # thousands of digits, lists in lists without end
        return f"{type(value).__name__} too long to print"


def suggestion(word: object, known: Iterable[str]) -> str:
    """The known word that is nearest to an unknown one in any case, as the end of a message.

    The part behind a hyphen is enough: "euler" and "backward-euler" are near "implicit-euler"; and
    so is a word that begins with the other, of three letters or more.
    """
    words = {part: one for one in known for part in (one.lower().rpartition("-")[2], one.lower())}
    last = word.lower().rpartition("-")[2] if isinstance(word, str) else ""
    near = get_close_matches(last, words, 1)
    if len(last) > 2 and not near:
        near = [one for one in words if one[2:] and last.startswith(one[: len(last)])]
    return f"; did you mean {words[near[0]]}?" if near else ""


def result_of(function: Callable[[Any], Any], argument: Any, name: str) -> Any:
    """What a user's function gives; on what it raises is noted which one it was, and at what time.

    Errors of ours say it already.
    """
    try:
        return function(argument)
    except Exception as error:
        time = f", at t = {argument:g}" if isinstance(argument, (int, float)) else ""
        note(error, f"This was raised in the function that was given for {name}{time}.")
        raise


def note(error: Exception, words: str) -> None:
    """Say once where an error of a user's own was raised."""
    if not isinstance(error, SweepoptError) and words not in getattr(error, "__notes__", ()):
        error.add_note(words)


class Status(Enum):
    """How a run ended; the value is the sentence shown to the user."""

    SUCCESS = "The run reached t_end and every step is certified within tol."
    UNCERTIFIED = (
        "The run reached t_end, but it is uncertified: the set cannot turn a solver's answer into "
        "a proof (a user's Constraints, a polyhedron with rows in over 1000 dimensions). State it "
        "with other shapes, such as a Box or the image of a small set, to get certificates."
    )
    INEXACT = (
        "The run stopped early: a step missed tol with every solver tried. The steps before it are "
        "certified. Loosen tol, change the solver or look at the step's data."
    )
    SWITCHING = (
        "The run stopped early: it has over 100,000 phases between switches, or 20 to 40 a row "
        "within 1.5e-8 of the run. The steps before it are exact. Use implicit-euler, midpoint or "
        "sdirk2, which need no switch times."
    )
    STOPPED = "The callback stopped the run; all steps computed until then are returned."
    INTERRUPTED = "The run was interrupted; all steps computed until then are returned."

    def __eq__(self, other: object) -> bool:
        return self is other or other == self.name.lower()

    def __hash__(self) -> int:
        return hash(self.name.lower())


class SweepoptError(Exception):
    """Base of every error the library raises on purpose."""


class InputError(SweepoptError, ValueError):
    """An argument is not what the problem needs; the message names it, the entry and the remedy."""


class EmptySetError(InputError):
    """A constraint set has no point (at some time)."""


class TouchingError(InputError):
    """Two sets touch, so that rounding hides the projection on what they share."""


class IndefiniteError(InputError):
    """A matrix is not positive definite, or not to rounding."""


class PathError(InputError):
    """path= names a way to simulate that this process or scheme does not allow."""


class SolverRefusedError(InputError):
    """The chosen solver cannot treat the set (a cone set given to OSQP), or is not known."""


class MissingExtraError(SweepoptError, ImportError):
    """An optional package is not installed; the message names the extra that brings it."""


@contextmanager
def brought_by(extra: str) -> Iterator[None]:
    """For imports of optional packages: a missing one is a MissingExtraError.

    Examples
    --------
    >>> with brought_by("speed"):
    ...     import no_such_package
    Traceback (most recent call last):
    sweepopt.errors.MissingExtraError: no_such_package is not installed; run: pip install ...
    """
    try:
        yield
    except ImportError as error:
        package = (error.name or "a package").partition(".")[0]
        message = f'{package} is not installed; run: pip install "sweepopt[{extra}]"'
        raise MissingExtraError(message) from error


class UnstableStepError(SweepoptError):
    """The explicit part of a scheme would amplify errors at this step size."""


class CheckpointError(SweepoptError):
    """A checkpoint could not be written or is damaged; the message says what is left of the run."""


class DamagedFileError(CheckpointError):
    """A file is not as it was written."""


class _Failure(SweepoptError):
    """An error that has what is known beside its message."""

    def __init__(self, message: str, **known: Any) -> None:
        super().__init__(message)
        vars(self).update(known)


class SaveError(_Failure):
    """The file that `save` names could not be written.

    Attributes
    ----------
    solution : Solution
        The steps that are done, with their states.
    """

    solution: Solution


class StepError(_Failure):
    """A step missed its tolerance with every solver tried, whole and in parts.

    The message says why, as far as that can be told.

    Attributes
    ----------
    t : float
        Beginning of the step.
    step : int
        Index of the step, counted from 0.
    u : ndarray, shape (dim,)
        The last good state, at the beginning of the step.
    certificate : float
        Best certificate reached, relative to max(\\|z\\|_M, \\|M^-1 q\\|_M).
    """

    t: float
    step: int
    u: np.ndarray
    certificate: float


class AccuracyError(_Failure):
    """A run could not be refined to the error that was asked for.

    Attributes
    ----------
    solution : Solution
        The finest run; `solution.error_bound()` is its bound.
    """

    solution: Solution


class VelocityError(_Failure):
    """A velocity that was asked for directly missed its tolerance with every solver tried.

    Attributes
    ----------
    t : float
    u : ndarray, shape (dim,)
    certificate : float
        Best certificate reached, relative to max(\\|z\\|_A, \\|A^-1 q\\|_A).
    """

    t: float
    u: np.ndarray
    certificate: float


class SweepoptWarning(UserWarning):
    """Base of every warning of the library."""


def warn(message: str, category: type[SweepoptWarning]) -> None:
    """Warn at the line outside of the library that led here."""
    level, frame = 1, sys._getframe()
    while frame.f_back and frame.f_globals.get("__name__", "").partition(".")[0] == __package__:
        level, frame = level + 1, frame.f_back
    warnings.warn(message, category, stacklevel=level)


class InitialStateWarning(SweepoptWarning):
    """B u0 is not in C(0): with A coercive the solution exists, but it starts with a velocity.

    Of an `EvolutionVI`: f(0) - B u0 is not in the dissipation set, plus the polar cone of K.
    """


class VariationWarning(SweepoptWarning):
    """C(t) jumps, so that it is not absolutely continuous; infinitely far, or by what is named."""


class StabilityWarning(SweepoptWarning):
    """Steps are so long that a scheme rings, overshoots to a wrong stuck state or misses waves."""


class BoundWarning(SweepoptWarning):
    """An error bound is sampled, not guaranteed; its `reason` says what is not known."""


class CheckpointWarning(SweepoptWarning):
    """A run is continued from an older checkpoint, or with other versions than it began with.

    Or a file is read with a process that is not that of its run to the last bit.
    """
