"""Put the tables of ``make evidence`` into evidence.md.

python docs/fill_evidence.py RECORDINGS TABLE LINEAR

TABLE is what ``benchmarks/identification.py`` saved, LINEAR what
``benchmarks/linear_output_error.py`` did; names and errors of the rivals stand in the
``case.json`` of each folder of RECORDINGS.
"""

from __future__ import annotations

import json
import math
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np

PAGE = Path(__file__).with_name("evidence.md")
GROUPS = {"scanners": "AFM scanners", "others": "other recordings"}
MOST = 4.0  # what a case counts as at most in a mean, and a refusal at least
HEAD = (
    "| recording | source | error | over line | over linear | over best | over fair | over stated |\n"
    "|---|---|---|---|---|---|---|---|"
)
KEYS = ("line", "linear", "best", "fair")
Rival = tuple[float, str]


def rivals_of(facts: dict[str, Any], linear: list[float]) -> dict[str, Rival]:
    """Return the errors of a case's rivals and their names; the best of all may be a linear one."""
    order = int(np.argmin(linear))
    found = {"line": (facts["line"], ""), "linear": (linear[order], "")}
    best = facts["best_rival"]
    fair = facts["rival_by_its_own_left_out"] or best
    for key, rival in (("best", best), ("fair", fair)):
        name = rival["name"].partition("(")[0].strip()
        found[key] = (rival["rmse"], name.replace("best of a dozen", "?"))
    if linear[order] < found["best"][0]:
        found["best"] = (linear[order], f"linear {order + 1}")
    return found


def row(case: dict[str, Any], facts: dict[str, Any], rivals: dict[str, Rival]) -> str:
    """Return the line of a case; the error is in the unit of its log."""
    source = facts["source"].split("@")[0].split()[0]
    name = case["name"].replace("|", "/").replace(">", "&gt;")
    link = f"[{source.split('/')[1]}](https://github.com/{source})"
    if case["rmse"] is None:
        return f"| {name} | {link} | refused | | | | | |"
    cells = [f"{case['rmse']:.3g}"]
    for error, rival in (rivals[key] for key in KEYS):
        cells.append(f"{case['rmse'] / error:.2f} {rival}".strip())
    stated = case["stated_move"]
    cells.append(f"{case['rmse'] / stated:.2f}" if stated else "")
    return f"| {name} | {link} | {' | '.join(cells)} |"


def means(cases: list[dict[str, Any]], rivals: dict[str, dict[str, Rival]]) -> str:
    """Return the cells of the geometric means over each rival, each case at most MOST."""
    cells = []
    for key in KEYS:
        logs = []
        for case in cases:
            error = rivals[case["name"]][key][0]
            ratio = MOST if case["rmse"] is None else case["rmse"] / error
            logs.append(math.log(min(ratio, MOST)))
        cells.append(f"**{math.exp(sum(logs) / len(logs)):.2f}**")
    return " | ".join(cells)


def stated(cases: list[dict[str, Any]]) -> str:
    """Return how the errors that came compare with those that were stated."""
    over = []
    for case in cases:
        if case["rmse"] is not None and case["stated_move"]:
            over.append(case["rmse"] / case["stated_move"])
    low, middle, high = np.percentile(over, (10.0, 50.0, 90.0))
    return (
        f"Error over stated at the tenth, fiftieth and ninetieth percentile of these recordings: {low:.2f},"
        f" {middle:.2f} and {high:.2f}; {max(over):.1f} at most."
    )


def main(recordings: str, table: str, linear: str) -> None:
    """Fill the page."""
    cases = json.loads(Path(table).read_text(encoding="utf-8"))
    cases = [case for case in cases if case["group"] in GROUPS]
    orders = json.loads(Path(linear).read_text(encoding="utf-8"))
    facts, rivals = {}, {}
    for path in Path(recordings).glob("*/case.json"):
        known = json.loads(path.read_text(encoding="utf-8"))
        facts[known["name"]] = known
        rivals[known["name"]] = rivals_of(known, orders[known["name"]])
    blocks = {"stated": stated(cases)}
    for group, title in GROUPS.items():
        some = [case for case in cases if case["group"] == group]
        names = [case["name"] for case in some]
        lines = [row(case, facts[name], rivals[name])
                 for case, name in zip(some, names, strict=True)]  # fmt: skip
        last = f"| **{len(some)} {title}, mean** | | | {means(some, rivals)} | |"
        blocks[group] = "\n".join([HEAD, *lines, last])
    page = PAGE.read_text(encoding="utf-8")
    for name, text in blocks.items():
        begin = f"<!-- {name} -->"
        pattern = re.compile(f"{begin}.*?<!-- end -->", re.DOTALL)
        page = pattern.sub(lambda _, b=begin, t=text: f"{b}\n{t}\n<!-- end -->", page)
    PAGE.write_text(page, encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
