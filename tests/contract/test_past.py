"""The past of a log is unknown, and the stated error is the one that a user meets."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import dbo_cli
from dbo_cli.errors import FitError

pytestmark = pytest.mark.filterwarnings("ignore::dbo_cli.errors.DboWarning")
RATE = 100.0
TIME = np.arange(1200) / RATE
REACH = np.linspace(0.0, 40.0, 9)
SPRINGS = np.linspace(2.0, 0.4, 9)


def moved(drive: np.ndarray, before: float = 100.0) -> np.ndarray:
    """Return a sum of plays of a drive that was at 0 and then at ``before`` first."""
    plays = np.clip(np.full(9, before), before - REACH, before + REACH)
    rows = []
    for value in drive:
        plays = np.clip(plays, value - REACH, value + REACH)
        rows.append(plays)
    return 0.05 * np.asarray(rows) @ SPRINGS


def fading() -> np.ndarray:
    """Return a decaying sine over 0 to 100 V."""
    fade = np.exp(-TIME / 6.0)
    return 50.0 - 50.0 * np.cos(2.0 * np.pi * 0.5 * TIME) * fade


def identified(drive: np.ndarray, moved: np.ndarray) -> dbo_cli.Model:
    return dbo_cli.identify(
        drive, moved, sample_rate=RATE, relaxation=(0.0,), delay=0.0
    )


def error(model: dbo_cli.Model, drive: np.ndarray, came: np.ndarray) -> float:
    """Return the error (RMS) of a model behind the first swings, where no past shows."""
    left = model.simulate(drive, sample_rate=RATE) - came
    return float(np.std(left[300:]))


@pytest.mark.parametrize("cut", [0.02, 0.05])
def test_a_beginning_that_is_cut_off_makes_little_difference(cut: float) -> None:
    drive = fading()
    came = moved(drive)
    first = int(cut * len(drive))
    test = 50.0 - 45.0 * np.cos(2.0 * np.pi * 0.4 * TIME) * (0.6 + 0.4 * TIME / 12.0)
    truth = moved(test)
    whole, shorter = identified(drive, came), identified(drive[first:], came[first:])
    errors = [error(model, test, truth) for model in (whole, shorter)]
    assert errors[1] < 2.0 * errors[0] + 2e-3 * np.ptp(came)


def test_a_log_that_begins_inside_its_range_keeps_all_its_rows() -> None:
    drive = np.concatenate([np.linspace(60.0, 0.0, 100), fading()])[: len(TIME)]
    came = moved(drive, 0.0)
    model = identified(drive, came)
    assert not any("left out" in note for note in model.fit["notes"])
    assert model.fit["logs"][0]["rows"] == len(drive)
    assert error(model, fading(), moved(fading())) < 0.01 * np.ptp(came)


@pytest.mark.parametrize("seed", range(2))
def test_walks_that_have_nothing_to_do_with_each_other_are_refused(seed: int) -> None:
    rng = np.random.default_rng(seed)
    drive, other = np.cumsum(rng.standard_normal((2, 800)), axis=1)
    with pytest.raises(FitError, match="force"):
        identified(drive, other)


def test_a_drift_above_the_range_is_refused() -> None:
    drive = fading()
    came = moved(drive)
    drifting = came + 3.0 * np.ptp(came) * TIME / TIME[-1]
    with pytest.raises(FitError, match="drift"):
        identified(drive, drifting)


def test_noise_of_the_sensor_is_no_error_of_the_actuator() -> None:
    drive = fading()
    came = moved(drive)
    size = 0.02 * float(np.ptp(came))
    model = identified(drive, came + size * np.random.default_rng(1).normal(size=1200))
    assert model.fit["noise_rms"] == pytest.approx(size, rel=0.15)
    assert model.fit["expected_rmse"] < 0.8 * size < model.fit["rmse"]


def test_memories_that_may_have_rested_elsewhere_are_in_the_stated_error() -> None:
    from dbo_cli.model import Candidate, Cascade, Gears, Quantity, Relaxation
    from dbo_cli.model.expect import expected_error

    width = np.full(100, 1.0)
    memory = Relaxation(0.0, (1e4,), (0.02,))
    gears = Gears(width, 0.1 * width, 0.0, 0.0, memory)
    volts, microns = (
        Quantity("voltage", "V", 0.0, 100.0),
        Quantity("d", "um", 0.0, 12.0),
    )
    model = Cascade("forward", volts, microns, (gears,), fit={"left_out_rmse": 0.01},
                    candidates=(Candidate(1.0, (gears,)),))  # fmt: skip
    drive = 50.0 + 10.0 * np.sin(TIME)
    error = expected_error(model, drive, 0.01)
    assert error is not None
    assert error.known == pytest.approx(0.01)
    # 100 V times 0.02 um/V, equally likely anywhere: a twelfth of the square
    unknown = error.rms(past_known=True)
    assert unknown == pytest.approx(2.0 / np.sqrt(12.0), rel=0.01)


def test_the_range_is_that_of_the_drive_and_not_of_its_noise() -> None:
    drive = fading()
    came = moved(drive)
    noisy = drive + 0.5 * np.random.default_rng(2).normal(size=drive.size)
    clean, read_back = identified(drive, came), identified(noisy, came)
    assert (clean.input.min, clean.input.max) == (drive.min(), drive.max())
    assert -0.7 < read_back.input.min < 0.7
    assert noisy.min() <= read_back.input.min <= noisy.min() + 2.0
    rounded = np.round(drive, 2)
    low, high = rounded.min(), rounded.max()
    assert identified(rounded, came).input.min == low
    assert identified(rounded, came).input.max == high


def test_the_development_table_refuses_a_constant_that_is_none(tmp_path: Path) -> None:
    script = Path(__file__).parents[2] / "benchmarks" / "identification.py"
    command = [sys.executable, script, tmp_path, "none", "--set", "search.BENDS=()"]
    run = subprocess.run([*command, "--set", "search.NOPE=1"], capture_output=True)
    assert run.returncode != 0
    assert b"NOPE" in run.stderr and b"BENDS" not in run.stderr.splitlines()[-1]
