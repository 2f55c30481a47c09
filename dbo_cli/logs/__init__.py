"""Logs: tables with units, a clock and roles, read from files and written to them."""

from dbo_cli.logs.frame import frame_table, is_frame, table_in_memory
from dbo_cli.logs.log import Log, open_log, open_table
from dbo_cli.logs.table import Block, Column, Reading, Table, parse_rows
from dbo_cli.logs.write import add_table, create

__all__ = [
    "Block", "Column", "Log", "Reading", "Table", "add_table", "create", "frame_table",
    "is_frame", "open_log", "open_table", "parse_rows", "table_in_memory",
]  # fmt: skip
