"""The whole identification on invented actuators, and what it says of itself."""

import warnings

import numpy as np
import pytest
from numpy.typing import NDArray
from test_solve import DRIVE, TIME, hysteresis

from dbo_cli.errors import FitError, InputError
from dbo_cli.identification import Options, Recording
from dbo_cli.identification.clean import clean
from dbo_cli.identification.identify import identify
from dbo_cli.model import Cascade
from dbo_cli.model.expect import expected_error, longest_rest, move_warnings

Floats = NDArray[np.float64]
NOISE = 0.005 * np.random.default_rng(7).normal(size=len(TIME))


def quiet(log: Recording, options: Options | None = None) -> Cascade:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return identify([log], options)


@pytest.fixture(scope="module")
def model() -> Cascade:
    return quiet(Recording("log", DRIVE, hysteresis(DRIVE) + NOISE, TIME))


def error(model: Cascade, drive: Floats, displacement: Floats) -> float:
    played, _ = model.simulate(drive, time=TIME)
    return float(np.sqrt(np.mean((played - displacement) ** 2)))


def test_stuck_and_clipped_sensors_are_left_out() -> None:
    stuck = hysteresis(DRIVE) + NOISE
    stuck[1000:1100] = stuck[1000]
    logs, _ = clean([Recording("log", DRIVE, stuck, TIME)], Options())
    assert (~logs[0].usable).sum() == 100
    clipped = np.minimum(hysteresis(DRIVE), 35.0)
    logs, _ = clean([Recording("log", DRIVE, clipped, TIME)], Options())
    assert (~logs[0].usable).sum() > 0.8 * (clipped == clipped.max()).sum()


def test_skip_needs_a_clock() -> None:
    with pytest.raises(FitError, match="skip"):
        clean([Recording("log", DRIVE, hysteresis(DRIVE))], Options(skip=1.0))


def test_recordings_are_checked() -> None:
    with pytest.raises(InputError, match="row 3"):
        Recording("log", DRIVE, np.where(np.arange(len(TIME)) == 2, np.nan, DRIVE))
    with pytest.raises(FitError, match="too few"):
        Recording("log", DRIVE[:10], DRIVE[:10])
    with pytest.raises(InputError, match="sample_rate"):
        Recording("log", DRIVE, DRIVE, np.floor(np.arange(len(DRIVE)) / 5.0))


def test_unknown_past_is_part_of_the_expected_error(model: Cascade) -> None:
    dt = 0.005
    inside = 50.0 + 10.0 * np.sin(TIME)
    error, at_an_end = (expected_error(model, drive, dt) for drive in (inside, DRIVE))
    assert error is not None and at_an_end is not None
    assert error.rms(memory_known=True) > 2.0 * error.known
    assert at_an_end.past < 0.1 * error.past


def test_moves_unlike_the_logs_warn(model: Cascade) -> None:
    assert move_warnings(model, DRIVE, 0.005) == []
    assert "faster" in move_warnings(model, DRIVE, 0.0005)[0]
    held = np.concatenate((DRIVE, np.full(4000, DRIVE[-1])))
    assert "holds" in move_warnings(model, held, 0.005)[0]
    assert longest_rest(held, np.full(len(held) - 1, 0.005)) == pytest.approx(
        20.0, abs=0.2
    )
