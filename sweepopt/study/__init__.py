"""What accuracy costs, and how hard cases are met.

table = run(read_study("accuracy.toml"), "results/accuracy")   # a work-precision study, resumable
work_precision(table)                                          # its diagram
write_report(table, "report.html")                             # its page
compare(find_source("tube"))                                   # all solvers on a run's programs
"""

from sweepopt.errors import brought_by

with brought_by("study"):
    import matplotlib
    import pandas
    import plotly
    import threadpoolctl

from sweepopt.checks import public
from sweepopt.study.cell import machine
from sweepopt.study.comparison import compare, comparison_text
from sweepopt.study.diagram import work_precision
from sweepopt.study.problems import find_source, own_source
from sweepopt.study.report import advice, halving, summary, write_report
from sweepopt.study.study import Study, dask_executor, processes, read_study, read_table, run

__all__ = [
    "Study",
    "advice",
    "compare",
    "comparison_text",
    "dask_executor",
    "find_source",
    "halving",
    "machine",
    "own_source",
    "processes",
    "read_study",
    "read_table",
    "run",
    "summary",
    "work_precision",
    "write_report",
]

globals().update({name: public(globals()[name]) for name in __all__})


def __dir__() -> list[str]:
    return __all__
