"""Text that other programs stored: names, units and remarks in whatever encoding, made fit to be shown."""

from __future__ import annotations


def clean_text(value: object) -> str:
    """Turn stored text into a string that can be shown: UTF-8, or else the Western code page.

    h5py hands on text that is no UTF-8 as lone surrogates (U+DCB5 for Latin-1's micro sign), which no output
    can hold.
    """
    if isinstance(value, str):
        if value.isascii():
            return value.rstrip(chr(0))
        try:
            value.encode("utf-8")
            return value.rstrip(chr(0))
        except UnicodeEncodeError:
            value = value.encode("utf-8", "surrogateescape")
    if isinstance(value, bytes):
        try:
            return value.decode("utf-8").rstrip(chr(0))
        except UnicodeDecodeError:
            return value.decode("cp1252", errors="replace").rstrip(chr(0))
    return str(value)
