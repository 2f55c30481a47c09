"""Names and units as they may be shown: nothing in them that a terminal or a page would obey."""

from __future__ import annotations

import unicodedata

# Control characters (escapes that colour, move or clear a terminal), lone surrogates (a file name that is not
# UTF-8), line and paragraph separators, and the marks that turn the direction of what follows.
_UNSHOWN = frozenset({"Cc", "Cs", "Zl", "Zp"})
_TURNING = frozenset("\u061c\u200e\u200f\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069\ufeff")
REPLACEMENT = "\ufffd"


def printable(text: str) -> str:
    """Return ``text`` with U+FFFD in place of every character that is obeyed instead of shown."""
    if text.isprintable():
        return text
    return "".join(
        REPLACEMENT if unicodedata.category(sign) in _UNSHOWN or sign in _TURNING else sign for sign in text
    )
