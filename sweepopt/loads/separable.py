"""``f(t) = sum_k phi_k(t) f_k``: shapes and histories apart."""

from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import ArrayLike

from sweepopt.checks import at_path, entries, instant, read_only
from sweepopt.errors import InputError, result_of, shown
from sweepopt.loads.history import Array, History, NoArithmetic, breakpoints


class Separable(NoArithmetic):
    """A load ``f(t) = sum_k phi_k(t) f_k``.

    Parameters
    ----------
    terms : iterable of (callable, array_like of shape (dim,))
        Histories ``phi_k`` and shapes ``f_k``.

    Attributes
    ----------
    terms : tuple of (callable, ndarray)
    shapes : ndarray, shape (dim, k)
        The shapes as columns, so that one evaluation is one product.
    dim : int

    Raises
    ------
    InputError
        If a term is no pair, a history not callable, or the shapes differ in size; when called, if
        a history does not return one finite number.

    Examples
    --------
    >>> from sweepopt.loads import Constant, Sine
    >>> f = Separable([(Constant(1.0), [1.0, 0.0]), (Sine(1.0, period=4.0), [0.0, 2.0])])
    >>> f(1.0)
    array([1., 2.])
    >>> f.variation(0.0, 4.0)
    8.0
    """

    def __init__(self, terms: Iterable[tuple[Callable[[float], ArrayLike], ArrayLike]]) -> None:
        try:
            pairs = list(terms)
        except TypeError:  # also of an array without axes, which has an __iter__
            pairs = []
        if not pairs:
            raise InputError(f"terms must hold one pair (phi, f) or more, got {shown(terms)}")
        columns = []
        for k, pair in enumerate(pairs):
            try:
                history, shape = pair
            except (TypeError, ValueError):
                raise InputError(
                    f"terms[{k}] must be a pair (phi, f), got {shown(pair)}; give a list of pairs"
                ) from None
            if not callable(history) or isinstance(history, type):
                raise InputError(
                    f"terms[{k}][0] must be callable, a history like so.Sine(1.0, 2.0) before "
                    f"its direction, got {shown(history)}"
                )
            columns.append(entries(f"terms[{k}][1]", shape))
            if columns[k].size != columns[0].size:
                raise InputError(
                    f"terms[{k}][1] has {columns[k].size} entries, terms[0][1] has "
                    f"{columns[0].size}; all must agree"
                )
        self.shapes = read_only(np.column_stack(columns))
        self.terms = tuple((pair[0], column) for pair, column in zip(pairs, columns, strict=True))
        self.dim: int = self.shapes.shape[0]

    def coefficients(self, t: float) -> Array:
        """Values ``phi_k(t)``, shape (k,)."""
        return np.array([self.value(k, t) for k in range(len(self.terms))])

    def values(self, times: Array) -> Array:
        """Values ``phi_k(t)`` at many times, shape (len(times), k)."""
        table = np.empty((len(times), len(self.terms)))
        for k, (history, _) in enumerate(self.terms):
            if isinstance(history, History):  # takes all times at once
                with at_path(f"terms[{k}][0]: "):
                    table[:, k] = history(times)
            else:
                table[:, k] = [self.value(k, t) for t in times.tolist()]
        return table

    def value(self, k: int, t: float) -> float:
        """phi_k(t)."""
        name = f"terms[{k}][0]"
        try:
            value = result_of(self.terms[k][0], t, name)
        except InputError as error:  # a table that is too short
            raise type(error)(f"{name}: {error}") from None
        try:
            return instant("phi", value)
        except InputError:
            raise InputError(
                f"{name} is {shown(value)} at t = {t:g}; it must be one finite number"
            ) from None

    def at_many(self, times: Array) -> Array:
        """The load at many times, shape (len(times), dim)."""
        return self.values(times) @ self.shapes.T

    def __call__(self, t: float) -> Array:
        return self.shapes.dot(self.coefficients(t))

    def variation(self, a: float, b: float, norm: Callable[[Array], float] | None = None) -> float:
        """Upper bound ``sum_k var(phi_k; a, b) |f_k|`` of the load's variation on [a, b].

        Parameters
        ----------
        norm : callable, optional
            The norm of forces; Euclidean by default. The theory's is the dual norm of A.
        """
        total = 0.0
        for k, (history, shape) in enumerate(self.terms):
            if not hasattr(history, "variation"):
                raise InputError(
                    f"terms[{k}][0], {shown(history)}, does not tell its variation; use Table, "
                    "Sine, Triangle, Polynomial or Constant, or give it a method variation(a, b)"
                )
            size = np.linalg.norm(shape) if norm is None else norm(shape)
            total += float(history.variation(a, b)) * float(size)
        return total

    def breakpoints(self, a: float, b: float) -> Array:
        """Breakpoints of all histories strictly inside (a, b), increasing."""
        return breakpoints((history for history, _ in self.terms), a, b)

    def __repr__(self) -> str:
        terms = len(self.terms)
        return f"Separable(dim {self.dim}, {terms} term{'s'[: terms - 1]})"
