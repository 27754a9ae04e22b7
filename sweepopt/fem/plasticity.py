"""Plasticity: strains that stay, with kinematic and isotropic hardening.

With the elastic energy of e(u) - p, p a deviator at each point of the quadrature,

    int G |dev e(u) - p|^2 + Hk/2 |p|^2 + Hi/2 alpha^2,        J = int sqrt(2/3) sigma_y |p'|,

alpha' = sqrt(2/3) |p'| and Perzyna's dissipation eta/2 |p'|^2: the deviator s of the stress is in
|s - Hk p - eta p'| <= sqrt(2/3) (sigma_y + Hi alpha) (Simo and Hughes, Computational Inelasticity,
1998, chapters 1 to 3; Han and Reddy, Plasticity, 2013, chapter 7).

For Hi > 0 the unknowns of a point are (a, p) with sqrt(3/2) alpha = theta a, theta a power of two:
J = int sqrt(2/3) sigma_y theta a' on the cone theta a' >= |p'|. Stiffness is exchanged between a
and p (`ConvexSet.exchange`) until both have the same; theta^2 >= 1 + 2 (2 G + Hk) / (2/3 Hi) leaves
at least half of Hi with p, so that the matrix is positive definite for Hk = 0 too.

In plane stress the strain e_zz is an unknown of the points as well, by its distance from the one of
an elastic body, -lam/(lam + 2 G) (e_xx + e_yy).
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from sweepopt.errors import InputError
from sweepopt.fem.contact import Rows, Yield
from sweepopt.fem.effects import (
    Contribution,
    Kinematics,
    Record,
    Stress,
    deviators,
)
from sweepopt.fem.fields import Array, Coefficient, Datum, Indices
from sweepopt.fem.spaces import Discretisation, Place

LEAST = 1e-7
"""Of 2 mu: with 6e-8 of it B of the plate is indefinite by rounding, with 9e-9 a step of the ring
takes minutes."""
ZZ = -2 / np.sqrt(6)  # of e_zz in the second deviator


@dataclass(frozen=True)
class Plasticity(Record):
    """``J(p') = int sqrt(2/3) sigma_y |p'|`` of plastic strains p: von Mises's yield stress.

    Stresses are those of the scene's elasticity on e(u) - p. Several of a kind act on subdomains.
    A bar and the edges of a lumped chain are in tension: sigma_y is a force (N), Hk and Hi have the
    unit of kappa, eta that times a time.

    Parameters
    ----------
    sigma_y : number, formula, mapping of subdomain to number, Profile or callable
        Yield stress in uniaxial tension (Pa), >= 0.
    Hk : as sigma_y
        Kinematic hardening (Pa), >= 0: the back stress is Hk p. A tangent modulus E_t in tension
        has Hk = 2/3 E E_t / (E - E_t).
    Hi : as sigma_y
        Isotropic hardening (Pa), zero or > 0 everywhere: the yield stress is sigma_y + Hi alpha. A
        tangent modulus E_t in tension has Hi = E E_t / (E - E_t).
    eta : as sigma_y
        Perzyna's viscosity of p (Pa s), >= 0.
    on : str or sequence of str, optional
        Subdomains; all of the body by default.

    Raises
    ------
    InputError
        If a value is negative or not finite, or nothing hardens somewhere: perfect plasticity; if
        the scene has no elasticity, several, or one with a tensor.

    Examples
    --------
    >>> Plasticity(sigma_y=250.0, Hk=470.0, on="core").on
    ('core',)
    """

    sigma_y: Datum
    Hk: Datum = 0.0
    Hi: Datum = 0.0
    eta: Datum = 0.0
    on: Sequence[str] | None = None
    data = tuple(Coefficient(name, 0.0) for name in ("sigma_y", "Hk", "Hi", "eta"))

    def contribute(self, body: Discretisation) -> Contribution:
        """Couplings of strains and plastic strains, and a ball or a cone for each point."""
        place, bar = self._place(body), _of_bars(body)
        sigma_y, Hk, Hi, eta = (bar * np.ravel(x) for x in self.values_at(place))
        at_points = self._moduli(body)
        if body.kind == "plane stress" and any(
            hasattr(one, "moduli") and not hasattr(one, "lame") for one in body.effects
        ):
            raise InputError(
                "on: in plane stress viscosity and Maxwell branches beside plasticity are not "
                "offered: they would lack its strain across the plane; take kind = 'solid'"
            )
        self._check_alone(body)
        lam, mu = map(np.ravel, at_points)
        _check_hardening(Hk, Hi, eta, mu)
        strains = deviators(body, place, *at_points)
        w, n = place.basis.dx.ravel(), body.dim
        beside = w.size if body.kind == "plane stress" else 0
        size = strains.shape[0] // w.size
        block = size + bool(Hi.any())
        total = n + beside + block * w.size
        at = n + beside + np.arange(block * w.size).reshape(w.size, block)
        p, theta = at[:, block - size :].ravel(), np.ones(w.size)
        diagonal, viscous = np.zeros((2, total))
        diagonal[n : n + beside] = ((lam + 2 * mu) * w)[:beside]
        diagonal[p], viscous[p] = (np.repeat(x * w, size) for x in (2 * mu + Hk, eta))
        if block > size:
            theta = 2.0 ** np.ceil(0.5 * np.log2(1 + 3 * (2 * mu + Hk) / Hi))
            diagonal[at[:, 0]] = 2 / 3 * Hi * theta**2 * w
        x = np.full(beside, ZZ), (1 + size * np.arange(beside), np.arange(beside))
        strains = sp.hstack([strains, sp.csr_array(x, shape=(p.size, total - n))], format="csr")
        of_p = sp.csr_array((np.repeat(2 * mu * w, size), (np.arange(p.size), p)), strains.shape)
        coupling = strains.T @ of_p
        return Contribution(
            A=sp.csc_array(sp.diags_array(viscous)) if eta.any() else None,
            B=sp.csc_array(sp.diags_array(diagonal) - coupling - coupling.T),
            yields=[
                Yield(
                    Rows(sp.eye_array(total, format="csr")[at.ravel()], block, w, "internal"),
                    np.sqrt(2 / 3 / bar) * sigma_y * theta,
                    slopes=1 / theta if block > size else None,
                )
            ],
            internal=total - n,
        )

    def _check_alone(self, body: Discretisation) -> None:
        times = np.zeros(body.mesh.nelements)
        for one in body.effects:
            if isinstance(one, Plasticity):
                with suppress(InputError):  # which the other one tells under its own name
                    times[one.cells(body)] += 1
        if times.max() > 1:
            raise InputError(
                "on: two plasticities act in one cell, where neither would see the strain of the "
                "other; name subdomains that do not overlap"
            )

    def cells(self, body: Discretisation) -> Indices:
        """Where it acts."""
        return np.arange(body.mesh.nelements)[self._place(body).basis.tind].ravel()

    def _place(self, body: Discretisation) -> Place:
        """The points of strains where it acts."""
        return body.place(self.on or (), strains=True)

    def _moduli(self, body: Discretisation) -> list[Array]:
        """lam and mu of the scene's elasticity at points where it acts."""
        elastic = [one for one in body.effects if hasattr(one, "lame")]
        if len(elastic) != 1:
            raise InputError("elasticity: plasticity needs one, of E and nu, in the scene")
        lam, mu = elastic[0].lame(body, body.whole)
        if mu is None:
            raise InputError("elasticity: plasticity needs an isotropic one, of E and nu")
        return [np.broadcast_to(x, body.basis.dx.shape)[self.cells(body)] for x in (lam, mu)]

    def stress(self, body: Discretisation) -> Stress | None:
        """-2 mu p."""

        def share(motion: Kinematics) -> Array:
            _, p, zz = self._strains(body, motion.internal)
            if zz.size:
                p[..., 1] -= ZZ * zz
            stress = np.zeros((len(p), body.mesh.nelements, *p.shape[2:]))
            stress[:, self.cells(body)] = -2 * self._moduli(body)[1][..., None] * p
            return stress

        return share

    def plastic_strain(self, body: Discretisation, internal: Array) -> Array:
        """sqrt(2/3) |p|, its mean in each cell, shape (k, cells)."""
        place, p, _ = self._strains(body, internal)
        strain = np.zeros((len(p), body.mesh.nelements))
        size = (place.shares * np.linalg.norm(p, axis=3)).sum(axis=2)
        strain[:, self.cells(body)] = np.sqrt(2 / 3 * _of_bars(body)) * size
        return strain

    def _strains(self, body: Discretisation, internal: Array) -> tuple[Place, Array, Array]:
        """The points, p of each and, in plane stress, the part of e_zz."""
        place = self._place(body)
        shape = len(internal), *place.basis.dx.shape
        beside = place.basis.dx.size if body.kind == "plane stress" else 0
        _, _, Hi, _ = self.values_at(place)
        zz = internal[:, :beside].reshape(shape if beside else (0,))
        p = internal[:, beside:].reshape(*shape, -1)[..., int(Hi.any()) :].copy()
        return place, p, zz


def _of_bars(body: Discretisation) -> float:
    """(sigma_y / tau_y)^2 for a bar in tension, whose strain is written as a shear; else 1."""
    return 3.0 if body.mesh.dim() == 1 else 1.0


def _check_hardening(Hk: Array, Hi: Array, eta: Array, mu: Array) -> None:
    if ((eta == 0) & (Hk + Hi <= LEAST * 2 * mu)).any():
        raise InputError(
            "Hk: nothing hardens where eta is zero, and Hk + Hi zero or rounding of 2 mu. Perfect "
            "plasticity has no bounded velocity and is not in the class; give Hk or Hi (at least "
            f"{LEAST:g} of 2 mu), or a viscosity eta"
        )
    if Hi.any() and Hi.min() <= 0:
        raise InputError("Hi: must be > 0 everywhere or 0; state two effects, on two subdomains")
