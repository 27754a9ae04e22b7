"""Sets that a user states in cvxpy, in conic form, as cvxpy reads them, in units of their own.


    C = { w : h - G w - H v in K for some v },    K a product of cones, block after block.

Its support function is the dual program,

    sigma(C, p) = min { <h, y> : G^T y = p, H^T y = 0, y in the dual cone of K }.

What units of w and v do to h, G and H is a diagonal scaling: D h, D G and D H E state the same set
for every automorphism D of K and every diagonal E > 0. Curtis and Reid (J. Inst. Math. Appl. 10,
1972) choose D and E so that the logarithms of all entries are as near to 0 as can be in least
squares; here h is measured in one more unknown, the size of C. So a solver sees numbers near 1 in
any units. As h counts little beside G and H, these mostly stay as they are while h moves.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import lsmr

from sweepopt.checks import Array, dimension
from sweepopt.errors import (
    EmptySetError,
    InputError,
    SweepoptError,
    SweepoptWarning,
    shown,
    warn,
)
from sweepopt.sets.base import ConvexSet, Features
from sweepopt.sets.programs import in_turn, normal_by_program, support_by_program

if TYPE_CHECKING:
    import cvxpy as cp

WEIGHT = 2.0**-8  # of an entry of h beside one of G and H: small, as h moves and they do not


class Constraints(ConvexSet):
    """{ w : the cvxpy constraints that `build(w)` returns }, for sets the shapes do not cover.

    They are read once, in conic form, with the values that parameters have then. A step of scheme
    "auto" takes about 0.1 s, and no solver's answer can be proved: a run ends with the status
    "uncertified" and is as accurate as Clarabel is, about 5 digits. Linear constraints are better
    given as a `Polyhedron`, balls and ellipsoids as `Ball` and `Ellipsoid`, what is made of these
    by `C & D`, `C + D` and `image`: these prove their answers.

    Forces may have any units. In others, answers are the same to the last bit if no number of the
    constraints is rounded otherwise (powers of two), and else to Clarabel's accuracy.

    Parameters
    ----------
    dim : int
    build : callable
        Takes a cvxpy Variable of shape (dim,), returns a list of cvxpy constraints.

    Raises
    ------
    InputError
        If build fails or returns anything but convex constraints with finite data.
    EmptySetError
        From `project`, `support` and `require_nonempty`, if no w satisfies them.

    Warns
    -----
    SweepoptWarning
        Always: what a step costs, and which sets to take where they do.

    Examples
    --------
    >>> import cvxpy as cp
    >>> C = Constraints(2, lambda w: [cp.norm(w, 1) <= 1])
    >>> round(C.support([3.0, 4.0]), 6)
    4.0
    """

    certifiable = exact = False
    fixed = ("G", "H")

    @in_turn
    def __init__(self, dim: int, build: Any) -> None:
        import cvxpy as cp

        if not callable(build):
            raise InputError(
                "build must be a function from a cvxpy Variable to constraints: "
                "Constraints(dim, lambda w: [cp.norm(w) <= 1])"
            )
        self.dim = dimension(dim)
        w = cp.Variable(self.dim)
        try:
            constraints = build(w)
        except Exception as error:  # whatever a user's function raises
            raise InputError(f"build(w) raised {type(error).__name__}: {error}") from error
        if not isinstance(constraints, (list, tuple)):
            raise InputError(
                "build must return a list of cvxpy constraints, such as [w <= 1], got "
                f"{shown(constraints)}"
            )
        for i, constraint in enumerate(constraints):
            _check(constraint, f"constraint {i} of build(w)")
        form = conic(w, list(constraints))
        if not all(np.isfinite(numbers).all() for numbers in (form.h, form.G.data, form.H.data)):
            raise InputError("the constraints of build(w) hold a number that is not finite")
        self.offsets, self.G, self.H, self.cones = in_own_units(form)
        better = "balls, ellipsoids or linear constraints as so.Ball, so.Ellipsoid, so.Polyhedron"
        if {block.kind for block in self.cones} <= {"zero", "nonneg"}:
            better = "these constraints, as they are linear, as so.Polyhedron(G, h)"
        warn(
            "Constraints: a step takes about 100 ms, and no answer can be proved; give "
            f"{better}, whose steps are proved and take 2 to 10 ms",
            SweepoptWarning,
        )

    def support(self, z: Array) -> float:
        value = support_by_program(self, z)
        if value == np.inf:
            self.require_nonempty()
        return value

    def project(self, w: Array) -> Array:
        return w - normal_by_program(self, w)

    def features(self, p: cp.Expression) -> Features:
        import cvxpy as cp

        if not self.offsets.size:
            return Features([], [p == 0])
        y = cp.Variable(self.offsets.size, "y")
        rows = (("G", self.G, p), ("H", self.H, 0))
        ties = [cp.Constant(M, name).T @ y == right for name, M, right in rows if M.shape[1]]
        return Features([y], [*ties, *in_dual(y, self.cones)])

    def normal_pair(self, p: Any, w: Any, tau: Any) -> None:
        return None

    def same_cone(self, other: ConvexSet) -> bool:
        same = isinstance(other, Constraints) and self.cones == other.cones
        return same and super().same_cone(other)

    def magnitude(self) -> float:
        try:
            return super().magnitude()
        except EmptySetError:
            raise
        except SweepoptError:  # unbounded without a ray, like a parabola: no solver calls it so
            return float("inf")

    def require_nonempty(self, where: str = "C") -> None:
        try:
            self.project(np.zeros(self.dim))
        except EmptySetError:
            raise EmptySetError(f"{where} is empty: no w satisfies the constraints") from None


def _check(constraint: Any, name: str) -> None:
    """Refuse what is no convex constraint with numbers for data."""
    import cvxpy as cp

    if not (isinstance(constraint, cp.Constraint) and constraint.is_dcp()):
        raise InputError(f"{name} is not a convex cvxpy constraint")
    if any(parameter.value is None for parameter in constraint.parameters()):
        raise InputError(f"{name} has a parameter without a value")
    leaves = [*constraint.constants(), *constraint.parameters()]
    if any(not np.isfinite(np.sum(leaf.value)) for leaf in leaves):
        raise InputError(f"{name} holds a number that is not finite")
    whole = [v.attributes["integer"] or v.attributes["boolean"] for v in constraint.variables()]
    if any(whole) or isinstance(constraint, cp.FiniteSet):
        raise InputError(f"{name} has an integer variable: not convex")


# ---- the conic form -------------------------------------------------------------------------


class Block(NamedTuple):
    """A factor of K: its kind, its rows, and the order or exponents it has.

    The kinds, of a block s, are "zero" and "nonneg", row by row; "soc", |s[1:]| <= s[0]; "psd", a
    positive semidefinite matrix of order n in n (n + 1) / 2 rows, the upper triangle by columns,
    times sqrt 2 off the diagonal; "exp", s[1] exp(s[0] / s[1]) <= s[2]; and "power",
    |s[-1]| <= prod s[i]^a[i] with exponents a > 0 whose sum is 1.
    """

    kind: str
    rows: slice
    more: Any


class Conic(NamedTuple):
    """C = { w : h - G w - H v in K for some v }."""

    h: Array
    G: sp.csr_array
    H: sp.csr_array
    K: list[Block]


def conic(w: cp.Variable, constraints: list[cp.Constraint]) -> Conic:
    """What cvxpy makes of constraints for Clarabel; parameters count with the values they have."""
    import cvxpy as cp

    # the objective only makes sure that w takes part
    problem = cp.Problem(cp.Minimize(cp.sum(w)), constraints)
    with np.errstate(over="ignore", invalid="ignore"):  # who calls looks for it
        data, _, _ = problem.get_problem_data(cp.CLARABEL, ignore_dpp=True)
    A, dims = sp.csc_array(data["A"]), data["dims"]
    column = np.arange(A.shape[1]) - data["param_prob"].var_id_to_col[w.id]
    of_w = (column >= 0) & (column < w.size)
    exponents: list[tuple[float, ...]] = [(float(a), 1 - float(a)) for a in dims.p3d]
    exponents += [tuple(map(float, a)) for a in dims.pnd]
    sizes: list[tuple[str, int, Any]] = [
        *[("zero", dims.zero, None), ("nonneg", dims.nonneg, None)],
        *(("soc", size, None) for size in dims.soc),
        *(("psd", n * (n + 1) // 2, n) for n in dims.psd),
        *(("exp", 3, None) for _ in range(dims.exp)),
        *(("power", len(a) + 1, a) for a in exponents),
    ]
    ends = np.cumsum([size for _, size, _ in sizes]).tolist()
    K = [
        Block(kind, slice(end - size, end), more)
        for end, (kind, size, more) in zip(ends, sizes, strict=True)
    ]
    h = np.array(data["b"], dtype=float)
    return Conic(h, sp.csr_array(A[:, of_w]), sp.csr_array(A[:, ~of_w]), K)


def in_own_units(C: Conic) -> Conic:
    """The same set, from numbers near 1 whatever the units of w and v."""
    n, K = C.G.shape[1], C.K
    A, turn = sp.hstack([C.G, C.H, C.h[:, None]]), _turn(K, C.h.size)
    turned = sp.csr_array(turn @ A)
    turned.eliminate_zeros()
    D, E = _exponents(turned, _symmetries(K), n)
    scaled = sp.diags_array(np.exp2(D)) @ turned @ sp.diags_array(np.exp2(E))
    back = sp.diags_array(1 / (turn @ turn).diagonal()) @ turn
    A = sp.csr_array(_shear(K, D) @ (back @ scaled))
    A.eliminate_zeros()
    return Conic(A[:, [-1]].toarray().ravel(), A[:, :n], A[:, n:-1], K)


def _turn(K: list[Block], size: int) -> sp.csr_array:
    """s0 + s1 and s0 - s1 for the first rows of second-order cones; its square is diagonal."""
    turn = sp.eye_array(size, format="lil")
    for kind, rows, _ in K:
        if kind == "soc" and rows.stop - rows.start > 1:
            first = slice(rows.start, rows.start + 2)
            turn[first, first] = [[1, 1], [1, -1]]
    return sp.csr_array(turn)


def _shear(K: list[Block], D: Array) -> sp.csr_array:
    """s0 + s1 log r in exponential cones whose s2 is multiplied by r times as much as s1."""
    shear = sp.eye_array(D.size, format="lil")
    for kind, rows, _ in K:
        if kind == "exp":
            i = rows.start
            shear[i, i + 1] = np.log(2.0) * (D[i + 2] - D[i + 1])
    return sp.csr_array(shear)


def _symmetries(K: list[Block]) -> sp.csr_array:
    """S: for every x, shear turn^-1 diag(2^(S x)) turn is an automorphism of K.

    Each linear row has a unit of its own, every other block one for all of its rows. Matrices P s P
    with diagonal P > 0 are positive semidefinite too. In power cones the s[i] may have any units,
    so may s2 in exponential ones, s0 corrected, and in second-order cones the two factors of
    (s0 + s1) (s0 - s1) >= |s[2:]|^2: this is how cvxpy states |w|^2 <= t.
    """
    parts: list[Any] = []
    for kind, rows, more in K:
        part: Any = np.ones((rows.stop - rows.start, 1))
        if kind in ("zero", "nonneg"):
            part = sp.eye_array(len(part))
        elif kind == "soc" and len(part) > 1:
            part = np.pad(part, ((0, 0), (0, 1)))
            part[:2, 1] = [1, -1]
        elif kind == "exp":
            part = np.column_stack([part, [0, 0, 1]])
        elif kind == "psd":
            # halves: the unit of P is the root of that of s
            j, i = np.tril_indices(more)
            part = 0.5 * (np.eye(more)[i] + np.eye(more)[j])
        elif kind == "power":
            part = np.vstack([np.eye(len(more)), more])
        parts.append(part)
    return sp.csr_array(sp.block_diag(parts))


def _exponents(A: sp.csr_array, symmetries: sp.csr_array, n: int) -> tuple[Array, Array]:
    """D = S x and E with 2^D_i |A_ij| 2^E_j near 1, x and E whole numbers.

    The first n columns count as one, by their largest entries, and keep their unit: E_j is 0. So it
    is for the last one, but only after its own unit, the size of C, is found with all others.
    """
    A = abs(A)
    entries = sp.coo_array(sp.hstack([A[:, :n].max(axis=1).reshape(-1, 1), A[:, n:]]))
    units = sp.eye_array(entries.shape[1], format="csr")[:, 1:]
    equations = sp.hstack([symmetries[entries.row], units[entries.col]])
    weight = np.where(entries.col < entries.shape[1] - 1, 1.0, WEIGHT)
    goal = -weight * np.log2(entries.data)
    solution = lsmr(sp.diags_array(weight) @ equations, goal, maxiter=10 * sum(equations.shape))
    x, E = np.split(np.round(solution[0]), [symmetries.shape[1]])
    return symmetries @ x, np.concatenate([np.zeros(n), E[:-1], [0.0]])


def in_dual(y: cp.Expression, K: list[Block]) -> list[cp.Constraint]:
    """y in the dual cone of K: <y, s> >= 0 for all s in K."""
    import cvxpy as cp

    dual = []
    for kind, rows, more in K:
        part = y[rows]
        if kind == "nonneg" and part.size:
            dual.append(part >= 0)
        elif kind == "soc":
            dual.append(cp.SOC(part[0], part[1:]))
        elif kind == "psd":
            # columns of one triangle are, backwards, rows of the other; the diagonal adds up
            shares = np.full(part.size, np.sqrt(0.5))
            shares[np.cumsum(np.arange(more) + 1) - 1] = 0.5
            triangle = cp.vec_to_upper_tri(cp.multiply(shares, part)[::-1])
            dual.append(triangle + triangle.T >> 0)
        elif kind == "exp":
            dual.append(cp.ExpCone(-part[1], -part[0], np.e * part[2]))
        elif kind == "power":
            a = np.array(more)
            dual.append(cp.PowConeND(cp.multiply(1 / a, part[:-1]), part[-1], a))
    return dual
