"""Frozen tasks, starts held out for validation and test, and the table of scores."""

from fishrl.benchmark.rows import Row, list_rows, rank, read_row, show_table
from fishrl.benchmark.versions import (
    FREE,
    SPLITS,
    Version,
    compare,
    find_version,
    identify,
    list_versions,
)

__all__ = [
    "FREE",
    "SPLITS",
    "Row",
    "Version",
    "compare",
    "find_version",
    "identify",
    "list_rows",
    "list_versions",
    "rank",
    "read_row",
    "show_table",
]
