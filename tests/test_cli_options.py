"""What the text of an option becomes: numbers in the unit that the program works in."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from conftest import SMALL_MODEL

from dbo_cli.cli.options import (
    in_hertz,
    in_seconds,
    not_negative,
    percentage,
    span,
    times,
    whole,
)
from dbo_cli.errors import UsageError


@pytest.mark.parametrize(
    ("text", "percent"),
    [("5ppm", 5e-4), ("250 ppm", 0.025), ("0.2%", 0.2), ("0.2", 0.2), ("0", 0.0)],
)
def test_a_share_is_in_percent(text: str, percent: float) -> None:
    assert percentage("noise", text) == pytest.approx(percent, rel=1e-12, abs=0.0)


@pytest.mark.parametrize(
    ("text", "seconds"),
    [("2.4ms", 0.0024), ("7us", 7e-6), ("30 ns", 3e-8), ("2min", 120.0), ("1.5 h", 5400.0), ("1d", 86400.0),
     ("3 s", 3.0), ("0.25", 0.25)],
)  # fmt: skip
def test_a_time_is_in_seconds(text: str, seconds: float) -> None:
    assert float(in_seconds("delay", text)) == pytest.approx(seconds, rel=1e-12)


@pytest.mark.parametrize(
    ("text", "hertz"),
    [("5kHz", 5000.0), ("2 MHz", 2e6), ("300Hz", 300.0), ("250", 250.0)],
)
def test_a_rate_is_in_hertz(text: str, hertz: float) -> None:
    assert float(in_hertz("sample_rate", text)) == pytest.approx(hertz, rel=1e-12)


def test_time_constants_come_in_order_and_zero_means_none() -> None:
    assert times("relaxation", "3,20ms,0.5") == (0.02, 0.5, 3.0)
    assert times("relaxation", "0") == ()
    for text in ("0,1", "2,2"):
        with pytest.raises(UsageError, match="must differ and be above 0"):
            times("relaxation", text)


def test_a_range_has_two_ends_the_lower_one_first() -> None:
    assert span("volts", "-2:5") == (-2.0, 5.0)
    for text, why in {
        "5:5": "5 is not below 5",
        "6:5": "6 is not below 5",
        "5": "give LOW:HIGH",
    }.items():
        with pytest.raises(UsageError, match=why):
            span("volts", text)


def test_the_least_value_of_a_number_is_taken_and_the_one_below_is_not() -> None:
    assert whole(3)("gears", "3") == 3
    with pytest.raises(UsageError, match="must be at least 3, not 2"):
        whole(3)("gears", "2")
    assert not_negative("skip", "0") == 0.0
    with pytest.raises(UsageError, match="must not be below 0"):
        not_negative("skip", "-0.1")


def test_an_hdf5_output_has_the_rate_of_its_log(dbo: Any) -> None:
    """An attribute in Hz, where the log had no column of time."""

    Path("model.json").write_text(json.dumps(SMALL_MODEL))
    rows = "".join(f"{volts}\n" for volts in np.linspace(0.0, 10.0, 50).tolist())
    Path("drive.csv").write_text("voltage_V\n" + rows)
    done = dbo(
        "simulate", "model.json", "drive.csv", "--sample-rate", "4kHz", "-o", "out.h5"
    )
    assert done.code == 0
    with h5py.File("out.h5") as file:
        assert file.attrs["sample_rate"] == 4000.0


def test_both_ends_of_a_rating_are_given(dbo: Any) -> None:
    Path("log.csv").write_text("time_s,voltage_V,displacement_um\n0,0,0\n")
    for words in (["--v-min", "0"], ["--v-max", "100"]):
        done = dbo("identify", "log.csv", *words)
        assert (done.code, done.out) == (2, "")
        assert "--v-min and --v-max belong together: the rated range" in done.err
