"""Formats of one library each: every module has a reader that makes a table of columns of a file."""
