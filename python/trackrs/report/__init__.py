"""Reports: one HTML file that opens offline, with tracks to play, curves, comparisons and tables.

Example:
    >>> import io, trackrs as tr
    >>> page = io.StringIO()
    >>> tr.report.write_report(page, "Trial 7", [tr.report.Prose("Two boats, one radar.")])
    >>> page.getvalue().startswith("<!doctype html>")
    True
"""

from trackrs.report._page import write_report
from trackrs.report.sections import (
    Comparison,
    Curves,
    Interval,
    Line,
    MethodScore,
    Picture,
    Prose,
    Scene,
    Section,
    Table,
)

__all__ = [
    "Comparison",
    "Curves",
    "Interval",
    "Line",
    "MethodScore",
    "Picture",
    "Prose",
    "Scene",
    "Section",
    "Table",
    "write_report",
]
