"""Figures that are easily another one: each test kills a fault that was planted and lived."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from .program import done, model, table, write

QUICK = "--relaxation 0 --gears 20 --points 0 --delay 0".split()


def test_the_sample_period_of_several_logs_is_the_shortest(log: Path) -> None:
    columns = table(log)
    thinned = [values[::2] for values in columns.values()]
    write("slow.csv", "time_s,voltage_V,displacement_um", *thinned)
    for names in (("log.csv", "slow.csv"), ("slow.csv", "log.csv")):
        done("identify", *names, *QUICK, "-o", "m.json", "--summary", "s.json", "-q")
        stated = json.loads(Path("s.json").read_text())["sample_period"]
        assert stated == pytest.approx(0.002, rel=1e-9)


def test_the_step_behind_a_gap_of_a_joined_log_is_the_gap() -> None:
    """A model that creeps tells each step of time: joined, or from one file without the gap's rows."""
    time = np.arange(400) / 500.0
    voltage = 50.0 - 50.0 * np.cos(8.0 * time)
    recorded = (time < 0.2) | (time > 0.5)
    write("base.csv", "time_s,displacement_um", time, 0.1 * voltage)
    write("guest.csv", "time_s,voltage_V", time[recorded], voltage[recorded])
    write("one.csv", "time_s,voltage_V", time[recorded], voltage[recorded])
    creep = model("creep")
    words = ("simulate", creep, "base.csv", "--input", "guest.csv::voltage_V")
    joined = table(done(*words, "--time", "time_s"))
    whole = table(done("simulate", creep, "one.csv"))
    for name, values in whole.items():
        np.testing.assert_allclose(joined[name], values, rtol=0.0, atol=1e-12)
