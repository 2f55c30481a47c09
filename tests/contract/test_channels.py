"""Many channels of one log: ``{}`` in the names of columns, and a set of models as one file."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from .program import Floats, dbo, done, model, refused, table, values_of, write

TIME = np.arange(600) / 500.0
NAMES = ("a", "b", "c")
QUICK = "--gears 20 --points 0 --delay 0 --relaxation 0 --dynamics 0 --force".split()
SIDES = ("--voltage", "V{}", "--displacement", "D{}")


def swings(number: int) -> Floats:
    size = np.where(TIME < 0.7, 5.0, 3.0)
    return 5.0 - size * np.cos(2.0 * np.pi * 2.5 * TIME + 0.3 * number)


@pytest.fixture
def channels() -> Path:
    """Return a log of three channels, and write ``set.json`` with a model for each."""
    columns, models = {"time_s": TIME}, {}
    for number, name in enumerate(NAMES):
        drive = np.clip(swings(number), 0.0, 10.0)
        write("one.csv", "time_s,voltage_V", TIME, drive)
        moved = table(done("simulate", model("small"), "one.csv", "-q"))
        columns[f"V{name}_V"] = drive
        columns[f"D{name}_um"] = (1.0 + 0.1 * number) * moved["displacement_um"]
        values = values_of("small")
        values["stages"][1] |= {"gain": 1.6 + 0.1 * number}
        models[name] = values
    Path("one.csv").unlink()
    held = {"format": "dbo-model-set", "version": 1, "models": models}
    Path("set.json").write_text(json.dumps(held))
    return write("mirror.csv", ",".join(columns), *columns.values())


def test_identify_makes_the_model_of_each_channel(channels: Path) -> None:
    done("identify", channels, *SIDES, *QUICK, "-o", "models.json", "-q")
    held = json.loads(Path("models.json").read_text())
    assert (held["format"], held["version"]) == ("dbo-model-set", 1)
    assert list(held["models"]) == list(NAMES)
    alone = ("--voltage", "Vc_V", "--displacement", "Dc_um")
    done("identify", channels, *alone, *QUICK, "-o", "alone.json", "-q")
    single = json.loads(Path("alone.json").read_text())
    last = list(held["models"].values())[-1]
    assert last["stages"] == single["stages"]


def test_simulate_writes_all_channels_side_by_side(channels: Path) -> None:
    done("simulate", "set.json", channels, "--input", "V{}_V", "-o", "out.csv", "-q")
    written = table("out.csv")
    for name in NAMES:
        alone = ("--input", f"V{name}_V", "-q")
        single = table(done("simulate", f"set.json::{name}", channels, *alone))
        ours = [
            key for key in written if name in key.split("_") and "displacement" in key
        ]
        assert len(ours) == 1, list(written)
        np.testing.assert_allclose(
            written[ours[0]], single["displacement_um"], atol=1e-12
        )


def test_compensate_drives_each_channel_within_limits(channels: Path) -> None:
    words = ("--displacement", "D{}_um", "--v-max", 9, "--on-limit", "clip", "-q")
    done("compensate", "set.json", channels, *words, "-o", "drives.csv")
    written = table("drives.csv")
    for name in NAMES:
        ours = [key for key in written if name in key.split("_") and "voltage" in key]
        assert len(ours) == 1, list(written)
        assert written[ours[0]].max() <= 9.0
        single = ("--displacement", f"D{name}_um", *words[2:])
        done("compensate", f"set.json::{name}", channels, *single, "-o", "one.csv")
        np.testing.assert_allclose(
            written[ours[0]], table("one.csv")["voltage_V"], atol=1e-12
        )


def test_a_pattern_that_finds_nothing_is_refused(channels: Path) -> None:
    error = refused(1, "simulate", "set.json", channels, "--input", "Q{}")
    assert "mirror.csv" in error and "Q{}" in error


def test_a_channel_that_the_set_lacks_is_named(channels: Path) -> None:
    held = json.loads(Path("set.json").read_text())
    del held["models"]["b"]
    Path("set.json").write_text(json.dumps(held))
    error = refused(1, "simulate", "set.json", channels, "--input", "V{}_V")
    assert "b" in error and "set.json" in error


def test_an_error_of_one_channel_names_it(channels: Path) -> None:
    lines = channels.read_text().splitlines()
    cells = lines[50].split(",")
    cells[3] = "OVLD"  # the drive of channel b
    lines[50] = ",".join(cells)
    channels.write_text("\n".join(lines) + "\n")
    error = refused(1, "simulate", "set.json", channels, "--input", "V{}_V")
    assert "Vb" in error and "OVLD" in error


def test_options_for_one_channel_at_a_time_are_refused(channels: Path) -> None:
    words = ("--displacement", "D{}_um", "-o", "drives.csv")
    for option in ("--condition", "--summary s.json", "--bandwidth 20", "--passes 2"):
        more = option.split()
        error = refused(2, "compensate", "set.json", channels, *words, *more)
        assert more[0] in error
    refused(2, "identify", channels, *SIDES, "--summary", "s.json", "-o", "x.json")
    words = ("--input", "V{}_V", "--save-state", "s.json", "-o", "moved.csv")
    refused(2, "simulate", "set.json", channels, *words)


def test_a_warning_names_the_channel(channels: Path) -> None:
    words = ("--displacement", "D{}_um", "--v-max", "7", "--on-limit", "clip")
    warned = dbo("compensate", "set.json", channels, *words, "-o", "x.csv").err
    for name in NAMES:
        assert f"warning: channel {name}: " in warned
