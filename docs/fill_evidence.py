"""Put a table that ``benchmarks/identification.py`` saved into evidence.md.

python docs/fill_evidence.py FILE
"""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import Any

import numpy as np

PAGE = Path(__file__).with_name("evidence.md")
BEGIN, END = "<!-- table -->", "<!-- end of table -->"
GROUPS = {"scanners": "AFM scanners", "others": "other recordings"}
HEAD = (
    "| recording | error | over best | over fair | over stated |\n|---|---|---|---|---|"
)


def row(case: dict[str, Any]) -> str:
    """Return the line of a case; the error is in the unit of its log."""
    name = case["name"].replace("|", "/").replace(">", "&gt;")
    ratios = case["ratios"]
    if case["rmse"] is None:
        return f"| {name} | refused | | | |"
    stated = case["rmse"] / case["stated_move"] if case["stated_move"] else None
    shown = "" if stated is None else f"{stated:.2f}"
    best, fair = ratios.get("best", math.nan), ratios.get("fair", math.nan)
    return f"| {name} | {case['rmse']:.4g} | {best:.2f} | {fair:.2f} | {shown} |"


def mean_of(cases: list[dict[str, Any]], key: str) -> float:
    """Return the geometric mean of a ratio; a refusal counts as the benchmark counts it."""
    logs = [math.log(case["ratios"][key]) for case in cases]
    return math.exp(sum(logs) / len(logs))


def table(cases: list[dict[str, Any]]) -> str:
    """Return the table of all recordings, with the means of each group."""
    lines = [HEAD]
    for group, title in GROUPS.items():
        some = [case for case in cases if case["group"] == group]
        lines += [row(case) for case in some]
        best, fair = mean_of(some, "best"), mean_of(some, "fair")
        lines.append(
            f"| **{len(some)} {title}, mean** | | **{best:.2f}** | **{fair:.2f}** | |"
        )
    return "\n".join(lines) + "\n\n" + honesty(cases)


def honesty(cases: list[dict[str, Any]]) -> str:
    """Return how the errors that came compare with those that were stated."""
    over = []
    for case in cases:
        if case["group"] in GROUPS and case["rmse"] is not None and case["stated_move"]:
            over.append(case["rmse"] / case["stated_move"])
    low, middle, high = np.percentile(over, (10.0, 50.0, 90.0))
    return (
        f"Error over stated at the tenth, fiftieth and ninetieth percentile of these recordings: {low:.2f},"
        f" {middle:.2f} and {high:.2f}; {max(over):.1f} at most."
    )


def main(path: str) -> None:
    """Fill the page."""
    cases = json.loads(Path(path).read_text(encoding="utf-8"))
    page = PAGE.read_text(encoding="utf-8")
    before, _, rest = page.partition(BEGIN)
    behind = rest.partition(END)[2]
    filled = f"{before}{BEGIN}\n{table(cases)}\n\n{END}{behind}"
    PAGE.write_text(filled, encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1])
