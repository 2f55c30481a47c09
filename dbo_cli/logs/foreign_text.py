"""Text that other programs stored: names, units and remarks in whatever encoding, made fit to be shown."""

from __future__ import annotations


def clean_text(value: object) -> str:
    """Turn stored text into a string that can be shown and written: UTF-8, or else the Western code page.

    h5py hands text that is no UTF-8 on as lone surrogates (``\\udcb5m`` for a Latin-1 ``µm``), which no output
    can hold.
    """
    if isinstance(value, str):
        if value.isascii():
            return value.rstrip("\x00")
        try:
            value.encode("utf-8")
            return value.rstrip("\x00")
        except UnicodeEncodeError:
            value = value.encode("utf-8", "surrogateescape")
    if isinstance(value, bytes):
        try:
            return value.decode("utf-8").rstrip("\x00")
        except UnicodeDecodeError:
            return value.decode("cp1252", errors="replace").rstrip("\x00")
    return str(value)
