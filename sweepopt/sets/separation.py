"""Whether a hyperplane proves that { s in S : F s = 0 } has no point.

0 is not in F S if there is a p with <p, F s> < 0 for all s in S. Of p = v - w, w the projection of
v on F S, <p, F s> is largest at w, up to rounding: <p, w> < 0 by more than that proves it. What
rounds in p is least from afar, and where F S is curved the normal of the point next to 0 is found
from near: v goes away from 0 step by step, along the last p.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

import numpy as np

from sweepopt.checks import Array
from sweepopt.errors import SweepoptError
from sweepopt.linalg import dense, euclidean
from sweepopt.sets.base import DENSE, RANK, ROUNDING, ConvexSet, Form, placed
from sweepopt.sets.projection import Projection, Projector

# How far v is from 0, of the width of F S: from 1e-6, where p of a curved set turns by less than
# that, to all of it. Twice from the nearest, as p at 0 is rounded most.
AWAY = 2.0 ** np.array([-20, -20, -14, -7, 0])
SEEN = 1e6  # the width of unbounded sets, of what is seen of them: no point beyond it is looked for


def is_separated(form: Form) -> bool | None:
    """Whether 0 is proved to be outside of F S, given without rows of its own.

    None if to rounding no s in S has F s = 0 either.
    """
    project = Projector(form)
    near, widths = project(np.zeros(form.E.shape[0])), _widths(form.parts)
    sizes = [np.abs(part.offsets).max(initial=0.0) for part in form.parts]
    polyhedral = all(part.polyhedral for part in form.parts)
    known = np.isfinite(widths)
    width = euclidean(abs(form.E[:, known]) @ widths[known]) or 1.0
    p = -near.w
    for away in AWAY:
        size = max(np.abs(near.start.s).max(), *sizes)
        meets = euclidean(near.w) <= 10 * ROUNDING * size
        # no width is needed where the nearest point is linear in the data
        if near.exact and (meets or polyhedral):
            return not meets
        near = project(away * width / euclidean(p) * p, near.start)
        p = near.p
        if p @ near.w < -_rounding(near, widths * near.splitting.units):
            return True
    return None


def _widths(parts: Sequence[ConvexSet]) -> Array:
    """sigma(S, e) + sigma(S, -e) along the axes e of the parts; inf where it is not known."""
    widths = np.full(sum(part.dim for part in parts), np.inf)
    for part, at in placed(parts):
        axes = np.eye(part.dim)
        with suppress(SweepoptError):  # needles
            widths[at] = part.support_rows(axes) + part.support_rows(-axes)
    return widths


def _rounding(near: Projection, widths: Array) -> float:
    """What <p, F s> may be beyond <p, w>, for all s in S that may have F s = 0.

    A part's point s_i and normal n_i = x_i - s_i are the projection of x_i to rounding, so that
    <n_i, s - s_i> <= 0 to rounding; F_i^T p - n_i acts on no more than the width of S_i. Parts
    without a width have one where the others move in their bounds and F s = 0.
    """
    splitting, s, p = near.splitting, near.s, near.p
    n, scale = near.image - s, near.scale
    E, free, widths = splitting.E, np.isinf(widths), widths.copy()
    if free.any():
        widths[free] = SEEN * max(np.abs(s).max(), splitting.extent)
        if not free.all() and free.sum() <= DENSE:
            sizes = np.linalg.svd(dense(E[:, free]), compute_uv=False)
            moved = euclidean(near.w) + euclidean(abs(E[:, ~free]) @ widths[~free])
            if sizes.size == free.sum() and sizes[-1] > RANK * sizes[0]:
                widths[free] = moved / sizes[-1]
    off = np.abs(n - E.T @ p) + ROUNDING / 4 * scale
    of_w = ROUNDING / 4 * np.abs(p) @ (abs(E) @ (np.abs(s) + scale))
    return float(ROUNDING / 4 * scale @ np.abs(n) + off @ widths + of_w)
