"""What a certified frictional step costs: every path of the library against loops by hand.

rows = bench(cells=[32, 100])
print(table(rows))
"""

from sweepopt.study.bench import bench
from sweepopt.study.rows import Row, machine, table

__all__ = ["Row", "bench", "machine", "table"]
