"""What the commands say: figures with what they are figures of, and nothing that harms a terminal."""

from __future__ import annotations

import os
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from .conftest import creep_log
from .program import dbo, done, model, process, refused, table, write

QUICK = "--relaxation 0 --gears 20 --points 0 --delay 0".split()


# --- validation ---


def test_each_validation_log_has_its_line(log: Path) -> None:
    creep_log("other.csv", seed=2)
    done("identify", log, *QUICK, "-o", "model.json", "-q")
    words = ("identify", log, *QUICK, "-o", "model.json", "--validate", "other.csv")
    once = done(*words)
    [line] = [line for line in once.said if "other.csv" in line]
    error = table("other.csv")["displacement_um"]
    done("simulate", "model.json", "other.csv", "-o", "out.csv", "-q")
    error = error - table("out.csv")["displacement_um"]
    assert f"error {np.sqrt(np.mean(error**2)):.3g} um" in line
    assert f"{np.std(error):.3g} without" in line
    assert not [text for text in once.warnings if "other.csv" in text]


def test_a_validation_log_that_is_far_off_is_a_warning(log: Path) -> None:
    columns = table(log)
    wrong = 1.3 * columns["displacement_um"]
    header = "time_s,voltage_V,displacement_um"
    write("other.csv", header, columns["time_s"], columns["voltage_V"], wrong)
    words = ("identify", log, *QUICK, "-o", "model.json", "--validate", "other.csv")
    [warning] = [text for text in done(*words).warnings if "other.csv" in text]
    assert "times the stated error" in warning


def test_a_validation_log_of_the_fit_is_a_warning(log: Path) -> None:
    shutil.copy(log, "copy.csv")
    words = ("identify", log, *QUICK, "-o", "model.json", "--validate", "copy.csv")
    [warning] = [text for text in done(*words).warnings if "copy.csv" in text]
    assert "of the fit" in warning


# --- exchanged columns ---


def test_exchanged_columns_are_said(log: Path) -> None:
    right = done("identify", log, *QUICK, "-o", "model.json")
    assert right.lines[0].endswith("(rising)")
    assert not [text for text in right.warnings if "leads" in text]
    exchanged = ("--voltage", "displacement_um", "--displacement", "voltage_V")
    wrong = done("identify", log, *exchanged, *QUICK, "-o", "model.json", "--force")
    assert wrong.lines[0].endswith("(rising, leads the drive)")
    [warning] = [text for text in wrong.warnings if "leads" in text]
    assert "--voltage" in warning and "--clock-offset" in warning


def test_a_falling_actuator_does_not_lead(log: Path) -> None:
    columns = table(log)
    header = "time_s,voltage_V,displacement_um"
    write("falling.csv", header, columns["time_s"], columns["voltage_V"],
          -columns["displacement_um"])  # fmt: skip
    outcome = done("identify", "falling.csv", *QUICK, "-o", "model.json")
    assert outcome.lines[0].endswith("(falling)")


def test_percent_of_range_is_of_what_the_log_moved(log: Path) -> None:
    outcome = done("identify", log, *QUICK, "-o", "model.json", "--summary", "s.json")
    [line] = [line for line in outcome.said if "% of range" in line]
    expected, percent = re.findall(r"error (\S+) um \((\S+) % of range", line)[0]
    moved = float(np.ptp(table(log)["displacement_um"]))
    # two digits: half a unit of the second is a twentieth at most
    assert float(percent) == pytest.approx(100.0 * float(expected) / moved, rel=0.05)


# --- names ---

EVIL = "a\x1b[31m\x9b1m\u202eb.csv"
SIGNS = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e]")


@pytest.mark.parametrize("name", [EVIL, os.fsdecode(b"b\xff\x1b.csv")])
def test_no_name_of_a_file_reaches_a_terminal_as_it_is(log: Path, name: str) -> None:
    try:
        shutil.copy(log, name)
    except OSError:
        pytest.skip("the file system does not take such a name")
    done("identify", name, *QUICK, "-o", "model.json")
    columns = table(log)
    pair = name.replace(".csv", "2.csv")
    wanted = columns["displacement_um"]
    header = "time_s,desired_um,measured_um,voltage_V"
    write(pair, header, columns["time_s"], wanted, wanted + 0.01, columns["voltage_V"])
    shutil.copy("model.json", f"{name}.json")
    for words in (
        ("identify", name, *QUICK),
        ("identify", name, *QUICK, "--validate", name, "--verbose"),
        ("show", "model.json"),
        ("show", f"{name}.json", "--format", "json"),
        ("check", name, "--v-max", "200"),
        ("check", name, "--v-max", "200", "--format", "json"),
        ("report", pair, pair),
        ("report", pair, "--format", "json"),
        ("report", pair, "--format", "csv"),
        ("report", pair, "--format", "html"),
        ("report", pair, "--expected", name),
        ("simulate", f"{name}.json", name),
        ("compensate", f"{name}.json", name, "--v-max", "50", "--on-limit", "clip"),
        ("simulate", name, name),
    ):
        outcome = dbo(*words)
        assert "internal error" not in outcome.err and "Traceback" not in outcome.err
        assert not SIGNS.search(outcome.out), (words, outcome.out[:300])
        assert not SIGNS.search(outcome.err), (words, outcome.err)


# --- limits, codes, figures ---


def test_a_limit_on_one_side_is_above_or_below(drive: Path) -> None:
    above = dbo("check", drive, "--v-max", "5")
    assert above.code == 3 and "above 5" in above.out and "inf" not in above.out
    below = dbo("check", drive, "--v-min", "5", "--from", "1")
    assert below.code == 3 and "below 5" in below.out and "inf" not in below.out


def test_the_help_page_names_the_exit_codes() -> None:
    page = " ".join(done("--help").out.split())
    for text in (
        "0 done",
        "1 input",
        "2 wrong command line",
        "3 outside",
        "130 interr",
    ):
        assert text in page


def test_figures_need_no_backend_of_a_notebook() -> None:
    environment = {**os.environ, "MPLBACKEND": "of another program"}
    words = ("show", model("small"), "--figures", "figures")
    ended = process(*words, env=environment)
    assert ended.returncode == 0, ended.stderr
    assert list(Path("figures").glob("*.png"))


@pytest.mark.parametrize("line", ["--lag 1e9", "--lag soon", "--lag 0.5"])
def test_no_words_of_a_library_reach_the_user(line: str) -> None:
    said = refused(2, "report", "pair.csv", *line.split())
    assert "--lag" in said and "whole number" in said and "Input" not in said
    said = refused(2, "check", "drive.csv", "--gain", "much")
    assert "--gain" in said and "give a number" in said and "Input" not in said
