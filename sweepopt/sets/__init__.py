"""Convex sets, their algebra and their motion (MATH: D, K and C(t))."""

from __future__ import annotations

from sweepopt.sets.balls import Ball, Balls
from sweepopt.sets.base import ConvexSet, Features, Witness
from sweepopt.sets.cones import SecondOrderCone
from sweepopt.sets.constraints import Constraints
from sweepopt.sets.ellipsoid import Ellipsoid
from sweepopt.sets.image import image
from sweepopt.sets.moving import Moving, MovingOffsets, MovingSet
from sweepopt.sets.polyhedra import HalfSpace, Polyhedron
from sweepopt.sets.polytope import Polytope
from sweepopt.sets.product import product
from sweepopt.sets.shapes import Box, Orthant, Point, WholeSpace

AnySet = ConvexSet | MovingSet

__all__ = [
    "AnySet",
    "Ball",
    "Balls",
    "Box",
    "Constraints",
    "ConvexSet",
    "Ellipsoid",
    "Features",
    "HalfSpace",
    "Moving",
    "MovingOffsets",
    "MovingSet",
    "Orthant",
    "Point",
    "Polyhedron",
    "Polytope",
    "SecondOrderCone",
    "WholeSpace",
    "Witness",
    "image",
    "product",
]
