"""One table of a batch: a line for every log, whatever became of it.

    python table.py LOGS RESULTS           # writes RESULTS/summary.csv
    python table.py LOGS RESULTS --judge   # says what failed; exit code 1 if anything did

``day.mk`` and ``Snakefile`` call it. It needs nothing but Python.
"""

from __future__ import annotations

import csv
import json
import sys
from pathlib import Path
from statistics import median
from typing import Any

STEPS = {"model.json": "identify", "drive.csv": "compensate", "report.json": "report"}
"""What is made of a log, in this order, and the command that makes it."""

GAIN, ERROR, DELAY = 2.0, 3.0, 3.0
"""Times the median (of the delay: of the distances from it) beyond which a log is unlike the others."""
LEAST_DELAY = 1e-5
"""Seconds: delays closer than this are alike."""
FEWEST = 3
"""Logs from which on a median says what is usual."""

COLUMNS = (
    "log",
    "failed",
    "sign",
    "gain",
    "delay_s",
    "model_rmse",
    "model_expected_rmse",
    "rows",
    "report_rmse",
    "clipped",
    "drive_expected_rmse",
)


def first_error(results: Path, name: str) -> str:
    """Return the command that failed first and its error; nothing where all went well."""
    for product, command in STEPS.items():
        said = results / "errors" / f"{name}.{product}"
        if not said.exists():
            return f"{command}: was not tried"
        lines = said.read_text().splitlines()
        if lines:
            return f"{command}: {lines[-1].removeprefix('dbo: error: ')}"
    return ""


def content(path: Path) -> dict[str, Any]:
    """Return what a JSON file holds; nothing where there is none."""
    if not path.exists():
        return {}
    values: dict[str, Any] = json.loads(path.read_text())
    return values


def line_of(name: str, results: Path) -> dict[str, Any]:
    """Return the line of one log."""
    line: dict[str, Any] = {"log": name, "failed": first_error(results, name)}
    model = content(results / f"{name}.model.json")
    if model:
        into, out, fit = model["input"], model["output"], model["fit"]
        gain = (out["max"] - out["min"]) / (into["max"] - into["min"])
        line["sign"] = fit["sign"]
        line["gain"] = gain if fit["sign"] == "rising" else -gain
        line["delay_s"] = delay_of(model)
        line["model_rmse"] = fit["rmse"]
        line["model_expected_rmse"] = fit["expected_rmse"]
    report = content(results / f"{name}.report.json")
    if report:
        [log] = report["logs"]
        line["rows"] = log["samples"]
        line["report_rmse"] = log["rmse"]
    drive = content(results / f"{name}.drive.json")
    if (results / f"{name}.drive.csv").exists():
        line["clipped"] = drive["clipped"]
        line["drive_expected_rmse"] = drive["expected_rmse"]
    return line


def delay_of(model: dict[str, Any]) -> float:
    """Return the delay (s) of a model; 0 where it has none."""
    stages = [stage for stage in model["stages"] if stage["type"] == "delay"]
    return stages[0]["seconds"] if stages else 0.0


def odd_ones(lines: list[dict[str, str]]) -> list[str]:
    """Return a warning for each log whose gain, error or delay is far from the others'.

    Of the gain beyond twice the median or half of it, of the error beyond three times, of
    the delay beyond three times the median distance from the median, and beyond half of
    the median delay.
    """
    good = [line for line in lines if line["gain"]]
    if len(good) < FEWEST:
        return []
    gains = {line["log"]: abs(float(line["gain"])) for line in good}
    errors = {line["log"]: float(line["model_rmse"]) for line in good}
    delays = {line["log"]: float(line["delay_s"]) for line in good}
    gain, error, delay = (median(each.values()) for each in (gains, errors, delays))
    spread = median(abs(value - delay) for value in delays.values())
    found = []
    for name in gains:
        if not 1.0 / GAIN <= gains[name] / gain <= GAIN:
            found.append(f"{name}: gain {gains[name]:.3g}, the median is {gain:.3g}")
        if errors[name] > ERROR * error:
            found.append(f"{name}: error {errors[name]:.3g}, the median is {error:.3g}")
        if abs(delays[name] - delay) > max(DELAY * spread, 0.5 * delay, LEAST_DELAY):
            found.append(
                f"{name}: delay {delays[name]:.3g} s, the median is {delay:.3g} s"
            )
    return found


def write_table(logs: Path, results: Path) -> None:
    """Write the table, whole or not at all."""
    partial = results / "summary.csv.partial"
    with partial.open("w", newline="") as file:
        table = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        table.writeheader()
        for log in sorted(logs.glob("*.csv")):
            table.writerow(line_of(log.stem, results))
    partial.replace(results / "summary.csv")


def judge(summary: Path) -> int:
    """Say which logs failed, and which have another sign than most; return 1 if any failed."""
    with summary.open(newline="") as file:
        lines = list(csv.DictReader(file))
    failed = [line for line in lines if line["failed"]]
    print(f"{summary}: {len(lines)} logs, {len(failed)} failed", file=sys.stderr)
    for line in failed:
        print(f"  {line['log']}: {line['failed']}", file=sys.stderr)
    names: dict[str, list[str]] = {"rising": [], "falling": []}
    for line in lines:
        if line["sign"]:
            names[line["sign"]].append(line["log"])
    rare, usual = sorted(names, key=lambda sign: len(names[sign]))
    if names[rare]:
        print(f"warning: displacement is {usual} with the voltage in {len(names[usual])} logs and {rare} in "
              f"{', '.join(names[rare])}: a sensor that faces away?", file=sys.stderr)  # fmt: skip
    for text in odd_ones(lines):
        print(f"warning: {text}", file=sys.stderr)
    return int(bool(failed))


def main() -> int:
    """Write the table, or judge the one that was written."""
    logs, results = Path(sys.argv[1]), Path(sys.argv[2])
    if sys.argv[3:] == ["--judge"]:
        return judge(results / "summary.csv")
    write_table(logs, results)
    return 0


if __name__ == "__main__":
    sys.exit(main())
