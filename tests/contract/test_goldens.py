"""Stored models give the stored numbers, for ever: 1e-9, relative and absolute.

The numbers were made with the version before 1.0, on 150 rows at 1 kHz: a drive and what
each model makes of it, a wish and its drive, free and within limits. The ends of ``late``
(a delay between samples: rows 4 and 5, the last five of its drives) are 1.0's own: before
it they depended on whether the clock was typed or read.
"""

from pathlib import Path

import numpy as np
import pytest


from .program import (
    DRIVE, GOLDENS, MOVE, compensated, done, load, model, simulated, table, values_of, write,
)  # fmt: skip

NAMES = ("small", "creep", "bent", "moving", "late")
pytestmark = pytest.mark.filterwarnings("ignore::dbo_cli.errors.DboWarning")


def golden(name):
    return table(GOLDENS / f"{name}.csv")


def close(values, expected):
    np.testing.assert_allclose(values, expected, rtol=1e-9, atol=1e-9)


def limits_of(name):
    """Return the highest voltage and the fastest change of the stored drive within limits."""
    drive = values_of(name)["input"]
    span = drive["max"] - drive["min"]
    return drive["max"] - 0.22 * span, 55.0 * span


@pytest.mark.parametrize("name", NAMES)
def test_simulate(name):
    stored = golden(name)
    write("drive.csv", DRIVE, stored["time_s"], stored["voltage_V"])
    written = table(done("simulate", model(name), "drive.csv"))
    assert list(written) == ["time_s", "voltage_V", "displacement_um"]
    close(written["displacement_um"], stored["displacement_um"])


@pytest.mark.parametrize("name", NAMES)
def test_compensate(name):
    """Free, by the inverse model, and within limits."""
    stored = golden(name)
    write("wish.csv", MOVE, stored["time_s"], stored["desired_um"])
    written = compensated(name)
    assert list(written) == ["time_s", "desired_um", "voltage_V"]
    close(written["voltage_V"], stored["drive_V"])
    done("invert", model(name), "-o", "inverse.json")
    close(simulated(Path("inverse.json"), "wish.csv"), stored["drive_V"])
    highest, slew = limits_of(name)
    words = ("--v-max", highest, "--max-slew", slew, "--on-limit", "clip")
    close(compensated(name, *words)["voltage_V"], stored["limited_V"])


REPORTS = load(GOLDENS / "report.json")
"""Figures of a report of ``pair.csv``, by the options that were typed."""


@pytest.mark.parametrize("options", REPORTS)
def test_report(options):
    words = ("--format", "json", *options.split())
    written = done("report", GOLDENS / "pair.csv", *words).json
    assert (written["format"], written["version"]) == ("dbo-report", 1)
    assert written["unit"] == "um"
    merits = written["logs"][0]
    for key, value in REPORTS[options].items():
        assert merits[key] == pytest.approx(value, rel=1e-9, abs=1e-9), key
