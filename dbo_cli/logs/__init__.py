"""Logs: tables with units, a clock and roles, read from files and written to them."""
