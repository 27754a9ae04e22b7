"""Trajectories that are exact to rounding: polyhedral sets, loads as data, switches located."""

from sweepopt.integrate.exact.trajectory import Trajectory, exact_steps
