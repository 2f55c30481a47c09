"""--time-unit and --scale on every command that reads a log: the same bytes as from a log without them."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

ROWS = 240
TURN = [math.cos(k / 19.0) for k in range(ROWS)]


def write(name: str, header: str, *columns: list[float]) -> None:
    rows = "".join(
        ",".join(map(repr, row)) + "\n" for row in zip(*columns, strict=True)
    )
    Path(name).write_text(f"{header}\n{rows}")


def test_simulate(dbo: Any, model_file: Path) -> None:
    drive = [float(round(5 - 5 * turn)) for turn in TURN]
    write("plain.csv", "time_s,voltage_V", [k / 1000 for k in range(ROWS)], drive)
    write(
        "other.csv",
        "counter,monitor voltage_mV",
        [float(k) for k in range(ROWS)],
        [50 * u for u in drive],
    )
    plain = dbo("simulate", "model.json", "plain.csv")
    other = dbo(
        "simulate", "model.json", "other.csv", "--time", "counter", "--time-unit", "ms",
        "--scale", "voltage=0.02V/mV",
    )  # fmt: skip
    assert plain.code == other.code == 0
    assert other.out.splitlines()[1:] == plain.out.splitlines()[1:]


def test_compensate(dbo: Any, model_file: Path) -> None:
    wanted = [4 - 3 * turn for turn in TURN]
    write("plain.csv", "time_s,x_um", [k / 1000 for k in range(ROWS)], wanted)
    write(
        "other.csv",
        "time,sensor_V",
        [float(k) for k in range(ROWS)],
        [x / 4 for x in wanted],
    )
    plain = dbo("compensate", "model.json", "plain.csv")
    scaled = ("--scale", "displacement=4um/V")
    other = dbo("compensate", "model.json", "other.csv", "--time-unit", "ms", *scaled)
    assert other.out == plain.out
    warned = dbo("compensate", "model.json", "other.csv", *scaled)
    assert (
        "warning: other.csv: the time column 'time' has no unit and counts whole numbers"
        in warned.err
    )
    assert (
        "(--time-unit ms, us, … or s says what they count, or --sample-rate HZ)"
        in warned.err
    )


def test_report(dbo: Any) -> None:
    wanted = [4 - 3 * turn for turn in TURN]
    stamps = [float(k) for k in range(ROWS)]
    found = [x + 0.5 for x in wanted]
    write(
        "plain.csv",
        "time_s,desired_um,measured_um",
        [k / 1000 for k in stamps],
        wanted,
        found,
    )
    write(
        "other.csv", "time,desired_um,sensor_V", stamps, wanted, [x / 4 for x in found]
    )
    plain = dbo("report", "plain.csv", "--format", "csv")
    other = dbo(
        "report",
        "other.csv",
        "--format",
        "csv",
        "--time-unit",
        "ms",
        "--scale",
        "measured=4um/V",
    )
    assert plain.code == other.code == 0
    assert other.out.replace("other.csv", "plain.csv") == plain.out


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (
            ("--time-unit", "parsecs"),
            "--time-unit parsecs: give s, ms, us, ns, ps, min, h or d, or a number",
        ),
        (
            ("--scale", "voltage"),
            "--scale voltage: give ROLE=FACTOR or ROLE=FACTORUNIT/UNIT",
        ),
        (
            ("--scale", "force=2"),
            "--scale force=2: there is no force here, but voltage",
        ),
        (
            ("--time-unit", "ms", "--sample-rate", "5"),
            "--time-unit and --sample-rate exclude each other",
        ),
    ],
)
def test_what_cannot_be_meant_is_refused(
    dbo: Any, model_file: Path, words: tuple[str, ...], told: str
) -> None:
    write("plain.csv", "time_s,voltage_V", [k / 1000 for k in range(ROWS)], TURN)
    outcome = dbo("simulate", "model.json", "plain.csv", *words)
    assert (outcome.code, outcome.out) == (2, "")
    assert told in outcome.err
