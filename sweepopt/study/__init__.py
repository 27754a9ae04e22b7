"""What accuracy costs, and how hard cases are met.

table = run(read_study("accuracy.toml"), "results/accuracy")   # a work-precision study, resumable
work_precision(table)                                          # its diagram
write_report(table, "report.html")                             # its page
compare(find_source("tube"))                                   # all solvers on a run's programs
"""

from sweepopt import checks, errors

with errors.brought_by("study"):
    import matplotlib
    import pandas
    import plotly
    import threadpoolctl

from sweepopt.study.cell import machine
from sweepopt.study.comparison import compare, comparison_text
from sweepopt.study.diagram import work_precision
from sweepopt.study.problems import find_source, own_source
from sweepopt.study.report import advice, halving, summary, write_report
from sweepopt.study.study import Study, dask_executor, processes, read_study, read_table, run

__all__ = checks.face(globals())
