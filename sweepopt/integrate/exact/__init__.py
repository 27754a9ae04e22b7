"""Trajectories that are exact to rounding: polyhedral sets, loads as data, switches located."""

from sweepopt.integrate.exact.trajectory import Trajectory, exact_steps

__all__ = ["Trajectory", "exact_steps"]
