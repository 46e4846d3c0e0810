"""Tables in and out. Needs polars: `pip install "trackrs[cli]"`."""

from trackrs.io._files import TableError, replacing
from trackrs.io.tables import (
    Recording,
    ScanTable,
    read_scan_table,
    read_scans,
    read_tracks,
    read_truth,
    write_tracks,
)

__all__ = [
    "Recording",
    "ScanTable",
    "TableError",
    "read_scan_table",
    "read_scans",
    "read_tracks",
    "read_truth",
    "replacing",
    "write_tracks",
]
