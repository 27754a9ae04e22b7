"""What accuracy costs, and what a certified frictional step costs.

table = run(read_study("accuracy.toml"), "results/accuracy")      # work-precision, resumable
rows = bench(cells=[32, 100])                                     # against loops by hand
"""

from sweepopt.study.bench import bench
from sweepopt.study.executors import Processes, dask_executor
from sweepopt.study.files import read_study
from sweepopt.study.rows import Row, machine, table
from sweepopt.study.study import Study, read_table, run

__all__ = [
    "Processes",
    "Row",
    "Study",
    "bench",
    "dask_executor",
    "machine",
    "read_study",
    "read_table",
    "run",
    "table",
]
