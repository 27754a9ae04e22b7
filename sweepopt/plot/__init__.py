"""Pictures: the displacement field with its slip zone, contact histories, trajectories."""

from sweepopt.plot.body import displacement_figure
from sweepopt.plot.canvas import new_figure
from sweepopt.plot.components import plot_solution
from sweepopt.plot.contact import contact_figure

__all__ = ["contact_figure", "displacement_figure", "new_figure", "plot_solution"]
