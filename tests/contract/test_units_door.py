"""One door for units: files, frames, Series, arrays and typed numbers; nothing is invented."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dbo_cli as dbo

from .program import dbo as shell
from .program import model, refused, values_of, write

TIME = np.arange(400) / 1000.0
pytestmark = pytest.mark.filterwarnings("ignore::dbo_cli.errors.DboWarning")


def without_units(name: str) -> Path:
    """Write a stored model that states no units."""
    values = values_of(name)
    values["input"]["unit"] = values["output"]["unit"] = None
    path = Path("unitless.json")
    path.write_text(json.dumps(values))
    return path


# --- typed numbers ---

PLAIN = "states no unit: type a plain number"


@pytest.mark.parametrize(
    "words",
    [
        "--v-max 200mV",
        "--v-min -1kV --v-max 120",
        "--v-max 50um",
        "--max-slew 1300V/min",
        "--max-slew 25mV/s",
        "--v-max 120 --from 5V",
    ],
)
def test_a_typed_unit_where_the_file_states_none(words: str) -> None:
    write("v.csv", "time_s,voltage", TIME, 98.0 * np.sin(TIME) ** 2)
    assert PLAIN in refused(2, "check", "v.csv", *words.split())
    assert shell("check", "v.csv", "--v-min", 0, "--v-max", 120).code == 0


@pytest.mark.parametrize("figure", ["50mV", "50kV", "50um", "0.05kV", "50V"])
def test_a_typed_unit_where_the_model_states_none(figure: str) -> None:
    path = without_units("creep")
    write("move.csv", "time_s,displacement", TIME, 2.5 - np.cos(30.0 * TIME))
    line = ("compensate", path, "move.csv", "-o", "drive.csv")
    for option in ("--v-max", "--from", "--return"):
        assert PLAIN in refused(2, *line, option, figure)
    assert PLAIN in refused(2, *line, "--max-slew", f"{figure}/s")
    assert PLAIN in refused(2, "export", path, "--v-max", figure, "-o", "firmware")
    actuator = dbo.read_model(path)
    for words in ({"v_max": figure}, {"from_": figure}, {"max_slew": f"{figure}/s"}):
        with pytest.raises(dbo.UsageError, match=PLAIN):
            actuator.compensate(2.5 - np.cos(30.0 * TIME), time=TIME, **words)
        with pytest.raises(dbo.UsageError, match=PLAIN):
            actuator.controller(sample_rate=1000.0, **words)


def test_a_typed_bound_where_the_log_states_no_unit() -> None:
    write("log.csv", "time_s,desired,measured", TIME, TIME, TIME + 0.001)
    assert PLAIN in refused(2, "report", "log.csv", "--max-rmse", "10nm")
    assert shell("report", "log.csv", "--max-rmse", 10).code == 0


@pytest.mark.parametrize("figure", [True, False, np.True_, float("nan"), "5 5"])
def test_what_is_no_number_is_no_limit(figure: Any) -> None:
    actuator = dbo.read_model(model("creep"))
    with pytest.raises(dbo.UsageError, match="v_max"):
        actuator.compensate([2.0, 2.1, 2.2], sample_rate=1000.0, v_max=figure)
