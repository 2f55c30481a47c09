"""Text from files and instruments made safe to show: names, units and paths of any bytes."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    pattern = re.compile
else:

    class pattern:
        """A regular expression, compiled when it is first used: most never are (3 of the start's 100 ms)."""

        def __init__(self, *given: Any) -> None:
            self._given = given

        def __getattr__(self, name: str) -> Any:
            """Compile it, and keep the method that is asked for."""
            method = self.__dict__[name] = getattr(re.compile(*self._given), name)
            return method


# C0 and C1 controls (among them the escape that begins a terminal's commands), the
# marks that turn the direction of writing round, and halves of surrogate pairs, which
# no encoding takes.
_UNSAFE = pattern(
    "[\x00-\x1f\x7f-\x9f\u200e\u200f\u202a-\u202e\u2066-\u2069\ud800-\udfff\ufeff]"
)


_SHOWN = 40  # characters of what a user or a file gave are enough for a message


def shortened(text: str) -> str:
    """Return what a user or a file gave as messages show it."""
    return text if len(text) <= _SHOWN else text[: _SHOWN - 3] + "..."


def counted(count: int, noun: str) -> str:
    """Return so many of something: ``1 cell``, ``3 cells``, ``-1 sample``."""
    return f"{count} {noun}{'' if abs(count) == 1 else 's'}"


def decoded(data: bytes) -> str:
    """Turn bytes of unknown origin into text: UTF-8, or else the Western code page of old instruments."""
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError:
        return data.decode("cp1252", errors="replace")


def _unescaped(text: str) -> str:
    """Decode the bytes that Python or h5py could not, and handed on as lone surrogates."""
    try:
        return decoded(text.encode("utf-8", "surrogateescape"))
    except UnicodeEncodeError:  # surrogates that stand for no bytes
        return text


def cleaned(text: str) -> str:
    """Return text that any output takes and no terminal obeys, on one line.

    Bytes that were no UTF-8 (a file's name, an HDF5 attribute) are read as the Western
    code page; control characters become blanks, and runs of blanks one.
    """
    if text.isascii() and text.isprintable() and "  " not in text:
        return text.strip()
    return " ".join(_UNSAFE.sub(" ", _unescaped(text)).split())


def clean_text(value: object) -> str:
    """Turn what another program stored (a name, a unit, a remark) into text, in whatever encoding it is."""
    text = decoded(value) if isinstance(value, bytes) else str(value)
    return (text if text.isascii() else _unescaped(text)).rstrip("\0")


_PARAMETER = pattern(r"`([a-z]\w*)`")


def as_options(text: str) -> str:
    """Return a message with its parameters spelled as the shell's options."""
    return _PARAMETER.sub(
        lambda match: "--" + match[1].rstrip("_").replace("_", "-"), text
    )
