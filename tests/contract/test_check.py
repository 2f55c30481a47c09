"""``dbo check``: whether any program's drive keeps limits, and whether it is what was played."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from .program import Outcome, dbo, done, write

TIME = np.arange(400) / 1000.0
DRIVE = 50.0 + 40.0 * np.sin(2.0 * np.pi * 5.0 * TIME)
PAIR = "time_s,voltage_V"


@pytest.fixture(autouse=True)
def drive_file(folder: Path) -> None:
    write("drive.csv", PAIR, TIME, DRIVE)


def failed(*words: object) -> Outcome:
    """Run a check that does not pass: exit 3, a report, and one line."""
    outcome = dbo("check", *words)
    assert outcome.code == 3, outcome.err
    assert len(outcome.lines[-1]) < 300
    return outcome


def test_a_drive_within_its_limits_passes() -> None:
    words = ("--v-min", 10, "--v-max", 90, "--max-slew", 1260, "--loop")
    outcome = done("check", "drive.csv", *words)
    for word in ("drive.csv", "400", "90"):
        assert word in outcome.out


BROKEN = {
    "--v-max 89": "row 44",
    "--v-min 11": "row 144",
    "--max-slew 1000": "row 2",
    "--max-slew 1V/ms": "row 2",
    "--from 0 --max-slew 2000": "row 1",
    "--rows 1:250 --loop": "loop",
}


def test_the_first_row_that_breaks_a_limit_is_named() -> None:
    for words, row in BROKEN.items():
        outcome = failed("drive.csv", *words.split())
        assert row in outcome.lines[-1] + outcome.out
        found = json.loads(failed("drive.csv", *words.split(), "--format", "json").out)
        assert found["format"] == "dbo-check" and found["passed"] is False
        assert row in " ".join(found["problems"])


def test_limits_touched_exactly_are_kept() -> None:
    write("edge.csv", PAIR, TIME, np.round(DRIVE))
    low, high = np.round(DRIVE).min(), np.round(DRIVE).max()
    done("check", "edge.csv", "--v-min", low, "--v-max", high)


BAD_ROWS = {
    "a word": (21, "0.020,OVLD"),
    "nothing": (21, "0.020,"),
    "not a number": (21, "0.020,nan"),
    "infinite": (21, "0.020,inf"),
    "one cell": (21, "0.020"),
    "three cells": (21, "0.020,50,50"),
    "a repeated stamp": (21, "0.019,55\n0.020,55"),
    "a stamp that goes back": (21, "0.001,52"),
}


@pytest.mark.parametrize("fault", BAD_ROWS)
def test_what_a_reader_would_drop_is_a_problem(fault: str) -> None:
    """As strict as the writer: a row that is dropped, guessed or cut does not pass."""
    row, text = BAD_ROWS[fault]
    lines = Path("drive.csv").read_text().splitlines()
    lines[row] = text
    Path("drive.csv").write_text("\n".join(lines) + "\n")
    outcome = dbo("check", "drive.csv", "--v-min", 0, "--v-max", 100)
    assert outcome.code in (1, 3), outcome.err
    assert "2" in outcome.lines[-1]


def test_a_gap_in_time_is_a_problem() -> None:
    time = TIME.copy()
    time[100:] += 0.05
    write("gap.csv", PAIR, time, DRIVE)
    assert "gap" in failed("gap.csv", "--v-max", 100).lines[-1]


@pytest.mark.parametrize("left", ["0.399", "0.399,"])
def test_a_file_that_is_cut_in_its_last_row_does_not_pass(left: str) -> None:
    lines = Path("drive.csv").read_text().splitlines()
    Path("cut.csv").write_text("\n".join([*lines[:400], left]))
    assert "40" in failed("cut.csv", "--v-min", 0, "--v-max", 100).lines[-1]


def test_a_loop_closes_or_not() -> None:
    done("check", "drive.csv", "--loop")
    assert "loop" in failed("drive.csv", "--rows", "1:205", "--loop").lines[-1]


# --- is it what was played ---


def played(name: str, *columns: np.ndarray) -> str:
    write(name, "time_s,monitor_V", *columns)
    return name


def against(name: str, *words: object) -> Outcome:
    return dbo("check", name, "--against", "drive.csv", *words)


def test_what_was_played_later_is_found() -> None:
    late = np.concatenate([np.full(7, DRIVE[0]), DRIVE])
    outcome = against(played("p.csv", np.arange(407) / 1000.0, late))
    assert outcome.code == 0, outcome.err
    assert "7" in outcome.out


def test_noise_of_a_recording_is_no_difference() -> None:
    noise = np.random.default_rng(2).normal(0.0, 0.02, 400)
    assert against(played("p.csv", TIME, DRIVE + noise), "--tolerance", 0.2).code == 0


def test_another_gain_is_a_difference() -> None:
    outcome = against(played("p.csv", TIME, 1.02 * DRIVE + 0.3), "--tolerance", 0.1)
    assert outcome.code == 3
    assert "1.02" in outcome.err and "0.1" in outcome.err


def test_a_part_is_a_difference() -> None:
    outcome = against(played("p.csv", TIME[:150], DRIVE[:150]))
    assert outcome.code == 3 and "250" in outcome.err


def test_another_drive_is_a_difference() -> None:
    noise = np.random.default_rng(1).normal(50.0, 20.0, 400)
    assert against(played("p.csv", TIME, noise)).code == 3


def test_a_recording_at_another_rate_is_compared() -> None:
    slow = np.arange(200) / 500.0
    outcome = against(played("p.csv", slow, np.interp(slow, TIME, DRIVE)))
    assert outcome.code == 0, outcome.err


def test_one_row_that_differs_is_found() -> None:
    odd = DRIVE.copy()
    odd[217] += 3.0
    outcome = against(played("p.csv", TIME, odd), "--tolerance", 0.5)
    assert outcome.code == 3


def test_what_stands_before_the_amplifier_has_its_gain() -> None:
    name = played("p.csv", TIME, DRIVE / 20.0)
    assert against(name, "--gain", 20).code == 0
    assert against(name).code == 3
