"""Trajectories that are exact to rounding: polyhedral sets, loads as data, switches located."""

from sweepopt.integrate.exact.on_grid import exact_steps
from sweepopt.integrate.exact.rows import rows_of
from sweepopt.integrate.exact.trajectory import Evaluate, Trajectory, phases_of

__all__ = ["Evaluate", "Trajectory", "exact_steps", "phases_of", "rows_of"]
