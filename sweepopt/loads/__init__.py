"""Loads as data: scalar histories and ``f(t) = sum_k phi_k(t) f_k``.

A guaranteed error bound needs the variation of the load on a step, and a cheap step needs the
load's few shapes. A black-box callable has neither, so histories here are small records that know
their exact variation and their breakpoints, and `Separable` keeps shapes and histories apart.
"""

from sweepopt.loads.history import (
    Constant,
    History,
    Modulated,
    Piece,
    Polynomial,
    Sine,
    Slope,
    Triangle,
    breakpoints,
)
from sweepopt.loads.separable import Separable
from sweepopt.loads.table import Table, VectorTable, check_points
