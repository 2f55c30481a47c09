"""Logs: tables with units, a clock and roles, read from files and written to them."""

from __future__ import annotations

from dbo_cli.logs.log import Log, columns_of, columns_of_names, open_log, parse_rows
from dbo_cli.logs.table import Block, Column, Reading
from dbo_cli.logs.write import add_table, create

__all__ = [
    "Block", "Column", "Log", "Reading", "add_table", "columns_of", "columns_of_names",
    "create", "open_log", "parse_rows",
]  # fmt: skip
