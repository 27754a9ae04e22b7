"""Trajectories that are exact to rounding: polyhedral sets, loads as data, switches located."""

from sweepopt.integrate.exact.on_grid import exact_steps
from sweepopt.integrate.exact.trajectory import Trajectory

__all__ = ["Trajectory", "exact_steps"]
