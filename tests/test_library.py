"""What ``import dbo_cli as dbo`` takes: indices, files and models. The numbers are held by the contract."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import dbo_cli as dbo

MODELS = Path(__file__).resolve().parent / "contract" / "models"
TIME = np.arange(400) / 1000.0
DRIVE = 50.0 - 50.0 * np.cos(30.0 * TIME)


@pytest.fixture
def creep() -> Any:
    return dbo.read_model(MODELS / "creep.json")


@pytest.mark.parametrize("zone", [None, "UTC", "Asia/Tokyo"])
def test_dates_with_and_without_a_zone_are_a_clock(creep: Any, zone: str) -> None:
    index = pd.date_range("2026-01-01", periods=400, freq="1ms", tz=zone)
    expected = creep.simulate(DRIVE, time=TIME)
    np.testing.assert_allclose(
        creep.simulate(pd.Series(DRIVE, index=index)), expected, atol=1e-9
    )
    stamps = pd.Series(index)
    np.testing.assert_allclose(creep.simulate(DRIVE, time=stamps), expected, atol=1e-9)


def test_a_plain_count_is_no_clock(creep: Any) -> None:
    with pytest.raises(dbo.DboError, match="sample_rate"):
        creep.simulate(pd.Series(DRIVE))


def test_a_report_of_a_model(creep: Any) -> None:
    moved = creep.simulate(DRIVE, time=TIME) + 0.25
    by_time = dbo.report(DRIVE, moved, time=TIME, model=creep)
    by_rate = dbo.report(DRIVE, moved, sample_rate=1000.0, model=creep)
    assert by_time.rmse == pytest.approx(0.25)
    assert by_rate.rmse == pytest.approx(0.25)


def test_a_set_is_a_mapping_of_models(tmp_path: Path) -> None:
    models = dbo.read_model(MODELS / "set.json")
    assert list(models) == ["x", "y"]
    models.save(tmp_path / "set.json")
    assert dbo.read_model(tmp_path / "set.json") == models
    assert dbo.read_model(f"{tmp_path}/set.json::y") == models["y"]
    assert models["x"].inverse() != models["x"]
    with pytest.raises(KeyError):
        models["z"]


def test_an_attribute_that_there_is_not(creep: Any) -> None:
    assert creep.sign == "rising" and creep.input.unit == "V"
    with pytest.raises(AttributeError):
        creep.colour  # noqa: B018
