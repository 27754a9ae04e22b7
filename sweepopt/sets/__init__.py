"""Convex sets, their algebra and their motion (MATH: D, K and C(t))."""

from __future__ import annotations

from sweepopt.sets.aligned import Aligned, Similar, kind_without_certificate, shape_of
from sweepopt.sets.balls import Ball, Balls, Ellipsoid, SecondOrderCone
from sweepopt.sets.base import (
    ROUNDING,
    Blocks,
    ConvexSet,
    Features,
    NoHalfspacesError,
    Selection,
    binary,
    exchange_matrix,
    placed,
    same_array,
)
from sweepopt.sets.constraints import Constraints
from sweepopt.sets.curves import GAUSS, THIRDS, WEIGHTS, basis, products, to_bernstein
from sweepopt.sets.facets import facets
from sweepopt.sets.least_distance import (
    exact_multipliers,
    exact_solution,
    least_distance,
    parallel_rows,
    shortest_on,
)
from sweepopt.sets.lifted import Lifted, points_of_sum
from sweepopt.sets.moving import AnySet, Moving, MovingOffsets, MovingSet, StateDependent, Summands
from sweepopt.sets.operations import image, images, product
from sweepopt.sets.polyhedra import HalfSpace, Polyhedron
from sweepopt.sets.polytope import HULL, Polytope
from sweepopt.sets.programs import CAREFUL, check_features, in_turn
from sweepopt.sets.projection import InMetric
from sweepopt.sets.shapes import Box, Orthant, Point, WholeSpace
