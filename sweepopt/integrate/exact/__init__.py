"""Trajectories that are exact to rounding: polyhedral sets, loads as data, switches located."""

from sweepopt.integrate.exact.follow import mover
from sweepopt.integrate.exact.trajectory import Lifting, Trajectory

__all__ = ["Lifting", "Trajectory", "mover"]
