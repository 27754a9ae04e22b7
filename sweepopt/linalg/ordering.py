"""Orders of the unknowns with little fill: nested dissection in solids, else minimum degree.

A level of a breadth-first search from the far end of a body separates what is before it from what
is behind it: it is ordered last, the two parts before it in the same way, and small parts by AMD
(A. George, SIAM J. Numer. Anal. 10, 1973). In the plane AMD is better. Of a block of cubes of six
tetrahedra, entries of the factor in millions and seconds to factorise it in blocks:

    unknowns     AMD            nested dissection
    2,464        0.41  0.008    0.32  0.006
    18,879       12.6  0.62     7.1   0.27
"""

import math
from typing import Any

import numpy as np
import scipy.sparse as sp
import scipy.sparse.csgraph as csgraph

from sweepopt.checks import Array, Matrix

PIECE = 200  # unknowns that AMD orders; with 100 or 500 factors are as small to 5 %


def is_solid(M: Matrix) -> bool:
    """Whether levels of a search in a sparse M's graph are as large as those of a body in space.

    They are from 6,000 unknowns on in that block; of fewer both orders serve. In the plane levels
    have 0.9 to 1.9 times sqrt(n) unknowns on average. The largest component decides.
    """
    if M.shape[0] <= PIECE:
        return False
    graph = _graph(M)
    component = _components(graph)
    body = np.flatnonzero(component == np.bincount(component).argmax())
    n = body.size
    return n > PIECE and n > 2.2 * math.sqrt(n) * (1 + _levels(graph[body][:, body]).max())


def fill_reducing(M: Matrix) -> Array:
    """An order of the unknowns of a symmetric sparse M."""
    return _nested_dissection(_graph(M)) if is_solid(M) else _minimum_degree(M)


def _graph(M: Matrix) -> sp.csr_array:
    rows = sp.csr_array(M)
    return sp.csr_array((np.ones(rows.nnz), rows.indices, rows.indptr), rows.shape)


def _components(graph: sp.csr_array) -> Array:
    """Which component each unknown is in; strong ones, so that a search reaches all of its own."""
    return csgraph.connected_components(graph, connection="strong")[1]


def _levels(graph: sp.csr_array) -> Array:
    """How far each unknown of a connected graph is from one that is farthest from the first."""
    end = 0
    for _ in range(2):
        levels = csgraph.dijkstra(graph, indices=end, unweighted=True).astype(int)
        end = int(levels.argmax())
    return levels


def _minimum_degree(M: Matrix) -> Array:
    """The order of AMD."""
    from cvxopt import amd

    return np.ravel(amd.order(triangle(M))).astype(np.int64)


def _nested_dissection(graph: sp.csr_array) -> Array:
    """Of a connected graph the unknowns before a level, those behind it, then the level itself.

    Of others the components one after the other, the small ones together.
    """
    part = _components(graph)
    small = np.bincount(part)[part] <= PIECE
    if small.all():
        return _minimum_degree(graph)
    if part.any():
        part[small] = -1
    else:
        levels = _levels(graph)
        sizes = np.bincount(levels)
        ahead = np.cumsum(sizes) - sizes
        smaller = np.minimum(ahead, levels.size - ahead - sizes)
        # few unknowns beside those that they separate, an eighth on each side: nothing recurses far
        worth = np.where(8 * smaller > levels.size, smaller / sizes, 0.0)
        if not worth.any():
            return _minimum_degree(graph)
        side = np.sign(levels - worth.argmax())
        part = np.where(side, side, 2)
    groups = [np.flatnonzero(part == k) for k in np.unique(part)]
    return np.concatenate([some[_nested_dissection(graph[some][:, some])] for some in groups])


def triangle(M: Matrix) -> Any:
    """The lower triangle of a sparse M, for CHOLMOD."""
    from cvxopt import spmatrix

    lower = sp.tril(M, format="coo")
    rows, columns = lower.row.astype(np.int64), lower.col.astype(np.int64)
    return spmatrix(lower.data, rows, columns, M.shape)
