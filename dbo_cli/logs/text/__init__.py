"""Delimited text: from the bytes of a file to a table of columns."""
