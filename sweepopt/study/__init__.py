"""What a certified frictional step costs: every path of the library against loops by hand.

rows = bench(cells=[32, 100])
print(table(rows))

What accuracy costs is shown by `work_precision` (a diagram) and `write_report` (an HTML page).
"""

from sweepopt.study.bench import bench
from sweepopt.study.diagram import work_precision
from sweepopt.study.report import Trajectory, write_report
from sweepopt.study.rows import Row, machine, table

__all__ = ["Row", "Trajectory", "bench", "machine", "table", "work_precision", "write_report"]
