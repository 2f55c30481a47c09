"""Numbers, units, names and tables as people read them."""

import json
from collections.abc import Mapping, Sequence
from typing import Any


def digits(value: float | None, places: int = 4) -> str:
    """Return a number to some significant digits, plain from 1e-3 to 1e6; None is ``-``."""
    if value is None:
        return "-"
    if value == 0.0:
        return "0"
    if not 1e-3 <= abs(value) < 1e6:
        return f"{value:.{places - 1}e}"
    text = f"{value:#.{places}g}"
    if "e" in text:
        return f"{value:.0f}"
    return text.rstrip(".")


def shown_unit(unit: str | None) -> str:
    """Return a unit as people write it; nothing where it is not known."""
    return {"um": "µm", "us": "µs"}.get(unit or "", unit or "")


def text_table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return columns two blanks apart, the first to the left, the others to the right."""
    table = [list(headings), *[list(row) for row in rows]]
    widths = []
    for number in range(len(headings)):
        widths.append(max(len(row[number]) for row in table))
    lines = []
    for row in table:
        cells = [row[0].ljust(widths[0])]
        for cell, width in zip(row[1:], widths[1:], strict=True):
            cells.append(cell.rjust(width))
        lines.append("  ".join(cells).rstrip())
    return "\n".join(lines)


def json_text(content: Mapping[str, Any]) -> str:
    """Return plain values as JSON text."""
    return json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
