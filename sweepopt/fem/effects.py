"""Effects: each is one record that contributes what it has, and nothing else.

A new effect is one frozen dataclass with a method `contribute`, and one line in
`EFFECTS` of scene_file.py; its fields are its keys in a scene file. Errors start with the name of
the field at fault.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray

from sweepopt.errors import InputError, shown
from sweepopt.fem.contact import BOUND, Contact, contact_on
from sweepopt.fem.fields import Coefficient, Datum
from sweepopt.fem.spaces import LOAD, STIFFNESS, Discretisation, assemble, boundary_names

Array = NDArray[np.float64]
Phi = Callable[[float], ArrayLike]

ETA, KAPPA = Coefficient("eta", 0.0, strict=True), Coefficient("kappa", 0.0)
F0, F2 = Coefficient("f0"), Coefficient("f2")


@dataclass(frozen=True, eq=False)
class Contribution:
    """What an effect adds to the problem; what is None does not exist.

    Attributes
    ----------
    A, B : sparse, shape (dim, dim), or None
        Part of the matrix of u' or of u.
    load : (history, ndarray of shape (dim,)) or None
        A term ``phi(t) f`` of the load.
    contact : Contact or None
        A part of the dissipation.
    """

    A: sp.csc_array | None = None
    B: sp.csc_array | None = None
    load: tuple[Phi, Array] | None = None
    contact: Contact | None = None


class Effect(Protocol):
    """What a scene asks of an effect."""

    def contribute(self, body: Discretisation) -> Contribution:
        """The effect's matrix, load term or contact on a body."""
        ...


@dataclass(frozen=True)
class Viscosity:
    """``a(u', v) = int eta grad u' . grad v``.

    Parameters
    ----------
    eta : number, mapping of subdomain to number, Profile or callable
        Viscosity (Pa s), > 0. A mapping covers every subdomain.

    Raises
    ------
    InputError
        If a value is not a finite number > 0.

    Examples
    --------
    >>> Viscosity({"core": 1.0, "sleeve": 0.2}).eta["sleeve"]
    0.2
    """

    eta: Datum

    def __post_init__(self) -> None:
        ETA.check(self.eta)

    def contribute(self, body: Discretisation) -> Contribution:
        """The matrix A."""
        return Contribution(A=assemble(body, STIFFNESS, ETA, self.eta))


@dataclass(frozen=True)
class Elasticity:
    """``b(u, v) = int kappa grad u . grad v``.

    Parameters
    ----------
    kappa : number, mapping of subdomain to number, Profile or callable
        Shear modulus (Pa), >= 0. A mapping covers every subdomain.

    Raises
    ------
    InputError
        If a value is not a finite number >= 0.

    Examples
    --------
    >>> Elasticity(2.0).kappa
    2.0
    """

    kappa: Datum

    def __post_init__(self) -> None:
        KAPPA.check(self.kappa)

    def contribute(self, body: Discretisation) -> Contribution:
        """The matrix B; none if kappa is zero everywhere."""
        B = assemble(body, STIFFNESS, KAPPA, self.kappa)
        return Contribution(B=B if B.count_nonzero() else None)


@dataclass(frozen=True)
class Friction:
    """``J(v) = int_{Gamma_3} g |v|``, lumped at the nodes of the boundary (see `contact_on`).

    Parameters
    ----------
    on : str or sequence of str
        The boundaries that make up Gamma_3.
    g : number, mapping of boundary to number, Profile or callable
        Friction bound (Pa), >= 0. Where it is zero there is no friction and nothing to simulate;
        where it is inf the body is glued: it stays where u0 has it.

    Raises
    ------
    InputError
        If a name is missing or given twice, or a bound is negative.

    Examples
    --------
    >>> Friction("contact", g=0.3).on
    ('contact',)
    """

    on: Sequence[str]
    g: Datum

    def __post_init__(self) -> None:
        object.__setattr__(self, "on", boundary_names("on", self.on))
        BOUND.check(self.g)

    def contribute(self, body: Discretisation) -> Contribution:
        """The contact; none if g is zero everywhere."""
        contact = contact_on(body, self.on, self.g)
        return Contribution(contact=contact if len(contact) else None)


@dataclass(frozen=True)
class BodyForce:
    """``<f, v> = phi(t) int_Omega f0 v``.

    Parameters
    ----------
    history : callable
        phi(t): Table, Sine, Triangle, Constant; or any function, whose variation is not known.
    f0 : number, mapping of subdomain to number, Profile or callable
        Density at phi = 1 (Pa/m).

    Raises
    ------
    InputError
        If the history is no function, or a value is not finite.

    Examples
    --------
    >>> from sweepopt.loads import Sine
    >>> BodyForce(Sine(1.0, period=4.0), f0=2.0).f0
    2.0
    """

    history: Phi
    f0: Datum = 1.0

    def __post_init__(self) -> None:
        check_history(self.history)
        F0.check(self.f0)

    def contribute(self, body: Discretisation) -> Contribution:
        """One term of the load."""
        return Contribution(load=(self.history, assemble(body, LOAD, F0, self.f0)))


@dataclass(frozen=True)
class Traction:
    """``<f, v> = phi(t) int_{Gamma_2} f2 v``.

    Parameters
    ----------
    on : str or sequence of str
        The boundaries that make up Gamma_2.
    history : callable
        phi(t): Table, Sine, Triangle, Constant; or any function, whose variation is not known.
    f2 : number, mapping of boundary to number, Profile or callable
        Traction at phi = 1 (Pa).

    Raises
    ------
    InputError
        If a name is missing or given twice, the history is no function, or a value is not finite.

    Examples
    --------
    >>> from sweepopt.loads import Table
    >>> Traction(["left", "right"], Table([0.0, 1.0], [0.0, 2.0])).on
    ('left', 'right')
    """

    on: Sequence[str]
    history: Phi
    f2: Datum = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "on", boundary_names("on", self.on))
        check_history(self.history)
        F2.check(self.f2)

    def contribute(self, body: Discretisation) -> Contribution:
        """One term of the load."""
        return Contribution(load=(self.history, assemble(body, LOAD, F2, self.f2, self.on)))


def check_history(history: object) -> None:
    """Refuse a history that is not a function of time."""
    if not callable(history):
        raise InputError(
            f"history must be a function of time such as Table or Sine, got {shown(history)}"
        )
