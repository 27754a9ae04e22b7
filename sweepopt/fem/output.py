"""Files that outlive a run: NetCDF, a summary in JSON and VTU files for ParaView.

Every file is written beside its place and then moved there, so that a reader never meets half of
one, and a run that fails leaves the files of the run before it whole.
"""

from __future__ import annotations

from sweepopt.fem.netcdf import write_netcdf
from sweepopt.fem.report import Report, Units, make_report
from sweepopt.fem.summary import SUMMARY, summary_of, write_summary
from sweepopt.fem.vtu import MOST_VTU, write_vtu
from sweepopt.io import replacing

__all__ = [
    "MOST_VTU",
    "SUMMARY",
    "Report",
    "Units",
    "make_report",
    "replacing",
    "summary_of",
    "write_netcdf",
    "write_summary",
    "write_vtu",
]
