"""What each rule of identification brings: the table in ``rules.md``, by ``make evidence``.

    python benchmarks/rules.py RECORDINGS TABLE [WORD...]

TABLE is what ``identification.py --save`` left, with all rules. Each rule is switched off
by one constant, and every case is identified again: some two minutes of CPU a rule. With
words only rules whose constants hold one of them are done again; the other lines stay.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from identification import Result, loaded, mean

HERE = Path(__file__).resolve().parent
PAGE = HERE / "rules.md"
GROUPS = ("scanners", "others", "authors", "invented")
RULES = {
    "search.BENDS=()": "no bend of the drive",
    "search.DELAYS=()": "no delay",
    "search.LEVELS=(None,)": "memories at rest at a log's first value",
    "search.BETTER_START=0.0": "gears settled before each log, or unknown",
    "search.BEGUN_STARTS=('settled', 'empty', 'full')": "no start from beyond a log's range",
    "search.BEGUN_LEVELS=(None,)": "starts compared with memories at rest",
    "search.CURVES=(10.0,)": "one smoothness of the curve for four",
    "search.SLOPE_SMOOTHNESS=(2e-4,)": "one smoothness of the slopes for three",
    "search.RULES=('growing',)": "slopes that grow only",
    "search.OTHER_SMOOTHNESS=()": "no candidates that one amplitude cannot judge",
    "search.ONE_WAY=0": "a curve from a single way up and down",
    "cross_validation.PRICE=0.0": "terms for nothing",
    "cross_validation.DRIFT_PRICE=0.1": "a drift as cheap as a memory",
    "problem.SMALL=0.0": "no small swings left out",
    "averaging.WIDTH=1e-9": "the best structure, no average",
    "basis.CELLS=48": "half the cells",
    "basis.TAU_RATIO=9.0": "time constants in steps of nine",
    "solve.PAST_COST=1e6": "no unknown past",
    "problem.KNOWN=1e3": "rows of an unknown past count as others do",
    "solve.BELIEF=0.0": "gains at no cost",
    "stages.LAST=0.0005": "gears beyond the range go on as the last one inside",
    "clean.SPIKE_SIGMAS=1e9": "spikes kept",
    "clean.STUCK_PATH=1e9": "a sensor that stands still kept",
}
HEAD = f"""# What each rule of identification brings

Made by `make evidence`. Each line switches one rule off (`identification.py --set`) and shows the test error
over that with the rule: geometric means of a group, a case at most 4. Above 1 the rule helps. *stated* is the
median of the error over the stated one.

| switched off by | that is | {" | ".join(GROUPS)} | stated |
|---|---|---|---|---|---|---|
"""


def cells(results: list[Result]) -> str:
    """Return the cells of a table of results."""
    found = []
    for group in GROUPS:
        ratios = [one.ratios["before"] for one in results if one.group == group]
        found.append(f"{mean(ratios):.3f}" if ratios else "")
    over = [one.rmse / one.stated_move for one in results
            if one.rmse is not None and one.stated_move]  # fmt: skip
    return " | ".join([*found, f"{np.median(over):.2f}"])


def without(rule: str, recordings: str, table: str) -> str:
    """Return the cells of a rule: all cases are identified without it."""
    with tempfile.TemporaryDirectory() as folder:
        saved = f"{folder}/table.json"
        program = str(HERE / "identification.py")
        words = [recordings, "--before", table, "--set", rule, "--save", saved]
        names = [case["name"] for case in json.loads(Path(table).read_text())]
        subprocess.run([sys.executable, program, *words, *names], check=True,
                       stdout=subprocess.DEVNULL)  # fmt: skip
        return cells(list(loaded(saved).values()))


def main(recordings: str, table: str, *words: str) -> None:
    """Fill the page, line by line."""
    lines = {}
    for line in PAGE.read_text().splitlines() if PAGE.exists() else ():
        if line.startswith("| `"):
            lines[line.split("`")[1]] = line
    for rule, meaning in RULES.items():
        if words and not any(word in rule for word in words):
            continue
        lines[rule] = f"| `{rule}` | {meaning} | {without(rule, recordings, table)} |"
        print(lines[rule], flush=True)
        kept = [lines[name] for name in RULES if name in lines]
        PAGE.write_text(HEAD + "\n".join(kept) + "\n")


if __name__ == "__main__":
    main(*sys.argv[1:])
