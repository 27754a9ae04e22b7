"""What accuracy costs, and what a certified frictional step costs.

table = run(read_study("accuracy.toml"), "results/accuracy")   # a work-precision study, resumable
work_precision(table); write_report(table, "report.html")      # a diagram, an HTML page
rows = bench(cells=[32, 100])                                  # every path against loops by hand

`equal_error` sets all schemes beside a smoothed friction law at one error, `peers` beside others.
"""

from sweepopt.study.bench import bench
from sweepopt.study.diagram import work_precision
from sweepopt.study.executors import Processes, dask_executor
from sweepopt.study.files import read_study
from sweepopt.study.report import Trajectory, write_report
from sweepopt.study.rows import Row, machine, table
from sweepopt.study.study import Study, read_table, run

__all__ = [
    "Processes",
    "Row",
    "Study",
    "Trajectory",
    "bench",
    "dask_executor",
    "machine",
    "read_study",
    "read_table",
    "run",
    "table",
    "work_precision",
    "write_report",
]
