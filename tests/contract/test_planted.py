"""Figures that are easily another one: each test kills a fault that was planted and lived."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest

from .program import dbo, done, table, values_of, write

QUICK = "--relaxation 0 --gears 20 --points 0 --delay 0".split()


def test_the_lag_that_was_typed_and_the_lag_that_is_left_have_seconds_of_their_own() -> (
    None
):
    time = np.arange(1000) / 500.0
    desired, measured = (5.0 - 3.0 * np.cos(12.0 * (time - s)) for s in (0.0, 0.02))
    write("late.csv", "time_s,desired_um,measured_um", time, desired, measured)
    words = ("report", "late.csv", "--lag", 4, "--format", "json")
    figures = done(*words).json["logs"][0]
    assert (figures["lag_samples"], figures["lag_s"]) == (4, pytest.approx(0.008))
    assert figures["lag_left_s"] == pytest.approx(0.012, abs=5e-4)


def test_each_column_of_a_channel_has_its_own_unit() -> None:
    models = {"x": values_of("small"), "y": values_of("small")}
    content = {"format": "dbo-model-set", "version": 1, "models": models}
    Path("set.json").write_text(json.dumps(content))
    drive = np.linspace(1.0, 9.0, 50)
    write("set.csv", "time_s,x_V,y_V", drive / 500.0, drive, drive)
    done("simulate", "set.json", "set.csv", "--input", "{}_V", "-o", "out.csv")
    header = Path("out.csv").read_text().splitlines()[0]
    names = ("voltage_x_V", "displacement_x_um", "voltage_y_V", "displacement_y_um")
    assert header == ",".join(("time_s", *names))


@pytest.mark.parametrize(
    ("unit", "pascal"),
    [("psi", 6894.757293), ("bar", 1e5), ("mbar", 100.0), ("kPa", 1000.0)],
)
def test_a_pressure_is_converted_to_ten_digits(unit: str, pascal: float) -> None:
    for factor, passes in ((1.0 - 1e-9, True), (1.0 + 1e-9, False)):
        rows = [0.0, pascal * factor]
        write("air.csv", "time_s,pressure_Pa", np.arange(2.0), np.array(rows))
        words = ("check", "air.csv", "--voltage", "pressure_Pa", "--v-max", f"1{unit}")
        assert dbo(*words).code == (0 if passes else 3)


def test_a_generator_is_set_to_the_middle_of_the_drive() -> None:
    time = np.arange(1000) / 1000.0
    write("drive.csv", "time_s,voltage_V", time, 50.0 - 30.0 * np.cos(20.0 * time))
    outcome = done("waveform", "drive.csv", "--to", "npy", "--gain", 10, "-o", "d.npy")
    said = re.search(r"([\d.]+) Vpp, offset ([\d.]+) V at gain 10", outcome.err)
    written = np.load("d.npy")
    assert said is not None
    assert float(said[1]) == pytest.approx(np.ptp(written), rel=1e-4)
    middle = 0.5 * (written.max() + written.min())
    assert float(said[2]) == pytest.approx(middle, rel=1e-4)


def test_the_error_of_several_logs_is_that_of_all_their_rows(log: Path) -> None:
    columns = table(log)
    noisy = {name: values[:700].copy() for name, values in columns.items()}
    noise = np.random.default_rng(5).normal(0.0, 0.3, 700)
    noisy["displacement_um"] += noise
    write("noisy.csv", ",".join(noisy), *noisy.values())
    done(
        "identify",
        "log.csv",
        "noisy.csv",
        *QUICK,
        "-o",
        "m.json",
        "--summary",
        "s.json",
    )
    fit = json.loads(Path("s.json").read_text())
    squares = sum(log["rows"] * log["rmse"] ** 2 for log in fit["logs"])
    rows = sum(log["rows"] for log in fit["logs"])
    assert rows == 700 + len(columns["time_s"])
    errors = [log["rmse"] for log in fit["logs"]]
    assert errors[1] > 2.0 * errors[0]
    assert fit["rmse"] == pytest.approx(math.sqrt(squares / rows), rel=1e-9)
