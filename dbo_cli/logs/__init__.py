"""Logs: tables with units, a clock and roles, read from files and written to them."""

from __future__ import annotations

from dbo_cli.logs.frame import FrameTable, frame_table, is_frame, numbers, stated_unit
from dbo_cli.logs.log import Log, columns_of, open_log, parse_rows
from dbo_cli.logs.table import Block, Column, Reading
from dbo_cli.logs.write import Outputs, check_outputs, create, write_text

__all__ = [
    "Block", "Column", "FrameTable", "Log", "Outputs", "Reading", "check_outputs", "columns_of",
    "create", "frame_table", "is_frame", "numbers", "open_log", "parse_rows", "stated_unit", "write_text",
]  # fmt: skip
