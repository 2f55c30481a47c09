"""One table of a batch: a line for every log, whatever became of it.

    python table.py LOGS RESULTS           # writes RESULTS/summary.csv
    python table.py LOGS RESULTS --judge   # says what failed; exit code 1 if anything did

``Makefile`` and ``Snakefile`` call it. Of each log it reads what stands in RESULTS: the
model, the summary of its drive, its report, and in RESULTS/errors the errors of the
steps. It needs nothing but Python.
"""

from __future__ import annotations

import csv
import json
import os
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

ENDING = re.compile(r"\.(csv|csv\.gz|dat|txt|tsv|h5|hdf5)$")

STEPS = {
    "model.json": "identify",
    "drive.csv": "compensate",
    "report.json": "report",
    "report.csv": "report",
}
"""What is made of a log, in this order, and the command that makes it."""

OF_THE_MODEL = ("failed", "sign", "gain", "rows", "model_expected_rmse")
OF_THE_DRIVE = ("clipped", "expected_rmse", "expected_percent")


def logs_in(folder: Path) -> dict[str, Path]:
    """Return the logs of a folder by the names of their actuators, in the names' order."""
    logs = {}
    for path in sorted(folder.iterdir()):
        if ENDING.search(path.name):
            logs[ENDING.sub("", path.name)] = path
    return logs


def first_error(results: Path, name: str) -> str:
    """Return the command that failed first, and the first line of its error; nothing where all went well."""
    for product, command in STEPS.items():
        try:
            lines = (results / "errors" / f"{name}.{product}").read_text().splitlines()
        except FileNotFoundError:
            lines = (
                [] if (results / f"{name}.{product}").exists() else ["it was not tried"]
            )
        if not lines:
            continue
        # Libraries may have said something before.
        errors = [line for line in lines if line.startswith("dbo: error: ")]
        line = errors[0] if errors else lines[0]
        return f"{command}: {line.removeprefix('dbo: error: ')}"
    return ""


def content(file: Path) -> dict[str, Any]:
    """Return what a JSON file holds; nothing where there is none."""
    if not file.exists():
        return {}
    values: dict[str, Any] = json.loads(file.read_text())
    return values


def of_model(file: Path) -> dict[str, Any]:
    """Return what the table says of a model: sign, gain (displacement per voltage, end to end), rows, error.

    The error is the one to expect of any new move; that of the trajectory stands with
    the drive.
    """
    model = content(file)
    if not model:
        return {}
    sign = model["fit"]["sign"]
    gain = (model["output"]["max"] - model["output"]["min"]) / (
        model["input"]["max"] - model["input"]["min"]
    )
    rows = sum(log["rows"] for log in model["provenance"]["inputs"])
    return {
        "sign": sign,
        "gain": gain if sign == "rising" else -gain,
        "rows": rows,
        "model_expected_rmse": model["fit"]["expected_rmse"],
    }


def lines_of(logs: Path, results: Path) -> Iterator[dict[str, Any]]:
    """Give the line of each log: its report's columns, and what its model and its drive say."""
    for name, log in logs_in(logs).items():
        line: dict[str, Any] = {"name": log.name, "failed": first_error(results, name)}
        line |= of_model(results / f"{name}.model.json")
        report = results / f"{name}.report.csv"
        if report.exists():
            with report.open(newline="") as file:
                for row in csv.DictReader(file):
                    line |= row
        drive = content(results / f"{name}.drive.json")
        for key in OF_THE_DRIVE:
            line[key] = drive.get(key)
        yield line


def write_table(logs: Path, results: Path) -> None:
    """Write the table under a name of its own until it is complete: another batch may be writing the same."""
    lines = list(lines_of(logs, results))
    columns = ["name", *OF_THE_MODEL]
    for line in lines:
        columns += [
            key for key in line if key not in columns and key not in OF_THE_DRIVE
        ]
    columns += OF_THE_DRIVE
    partial = results / f"summary.csv.{os.getpid()}.partial"
    with partial.open("w", newline="") as file:
        table = csv.DictWriter(file, columns, lineterminator="\n")
        table.writeheader()
        table.writerows(lines)
    partial.replace(results / "summary.csv")


def judge(table: Path) -> int:
    """Say on standard error which logs failed, and which have another sign than most; 1 if any failed."""
    with table.open(newline="") as file:
        lines = list(csv.DictReader(file))
    failed = [line for line in lines if line["failed"]]
    print(f"{table}: {len(lines):,} logs, {len(failed):,} failed", file=sys.stderr)
    for line in failed:
        print(f"  {line['name']}: {line['failed']}", file=sys.stderr)
    if failed:
        print(
            "  options that a message names go into READ, for all commands",
            file=sys.stderr,
        )
    names: dict[str, list[str]] = {"rising": [], "falling": []}
    for line in lines:
        if line["sign"]:
            names[line["sign"]].append(line["name"])
    rare, usual = sorted(names, key=lambda sign: len(names[sign]))
    if names[rare]:
        print(
            f"warning: displacement is {usual} with the voltage in {len(names[usual]):,} logs, and {rare} in "
            f"{', '.join(names[rare])}: are leads exchanged, or does a sensor face away?",
            file=sys.stderr,
        )
    return 1 if failed else 0


def main() -> int:
    """Write the table, or judge the one that was written."""
    logs, results = Path(sys.argv[1]), Path(sys.argv[2])
    if sys.argv[3:] == ["--judge"]:
        return judge(results / "summary.csv")
    write_table(logs, results)
    return 0


if __name__ == "__main__":
    sys.exit(main())
