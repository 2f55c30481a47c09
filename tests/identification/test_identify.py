"""The whole identification on invented actuators, and what it says of itself."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from numpy.typing import NDArray
from test_solve import DRIVE, TIME, hysteresis

from dbo_cli.errors import FitError, InputError, LimitError, UsageError
from dbo_cli.identification import Options, Recording, describe
from dbo_cli.identification.clean import clean, spiked_rows
from dbo_cli.identification.identify import identify
from dbo_cli.model import Cascade, dumps_model
from dbo_cli.model.expect import expected_error, longest_rest, move_warnings

Floats = NDArray[np.float64]
NOISE = 0.005 * np.random.default_rng(7).normal(size=len(TIME))
NEW = 50.0 - 50.0 * np.cos(2.0 * np.pi * 0.4 * TIME) * np.cos(0.12 * TIME) ** 2


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


def test_new_moves_are_predicted(model: Cascade) -> None:
    actual = error(model, NEW, hysteresis(NEW))
    assert actual < 0.01 * 4.0
    assert actual < 0.05 * model.fit["line_rmse"]
    assert 0.05 < actual / model.fit["expected_rmse"] < 3.0


def test_figures_are_complete(model: Cascade) -> None:
    fit = model.fit
    assert fit["sign"] == "rising" and not fit["one_amplitude"]
    assert 0.004 < fit["rmse"] < 0.012
    assert fit["logs"][0]["rows"] == len(TIME)
    assert 1 <= len(model.candidates) <= 5
    assert sum(one.weight for one in model.candidates) == pytest.approx(1.0)
    assert model.input.min == pytest.approx(DRIVE.min())
    log = Recording("log", DRIVE, hysteresis(DRIVE) + NOISE, TIME)
    assert "expected error" in describe(model, [log])


def test_same_log_same_bytes(model: Cascade) -> None:
    again = quiet(Recording("log", DRIVE, hysteresis(DRIVE) + NOISE, TIME))
    assert dumps_model(again) == dumps_model(model)


def test_falling_displacement() -> None:
    log = Recording("log", DRIVE, 3.0 - hysteresis(DRIVE), TIME)
    falling = quiet(log)
    assert falling.sign == "falling"
    assert error(falling, NEW, 3.0 - hysteresis(NEW)) < 0.05
    with pytest.raises(LimitError, match="sign"):
        quiet(log, Options(sign="rising"))


def test_one_amplitude_states_more_and_warns(model: Cascade) -> None:
    drive = 50.0 - 50.0 * np.cos(2.0 * np.pi * 0.5 * TIME)
    with pytest.warns(UserWarning, match="one amplitude"):
        one = identify([Recording("log", drive, hysteresis(drive) + NOISE, TIME)])
    assert one.fit["one_amplitude"]
    assert one.fit["expected_rmse"] > 1.5 * model.fit["expected_rmse"]


def test_noise_is_refused() -> None:
    noise = np.random.default_rng(3).normal(size=len(TIME))
    with pytest.raises(FitError, match="straight line"):
        quiet(Recording("noise", DRIVE, noise, TIME))


def test_voltage_that_only_rises_is_refused() -> None:
    with pytest.raises(FitError, match="never turns back"):
        quiet(Recording("ramp", TIME, TIME**2, TIME))


def test_a_delay_is_found() -> None:
    late = np.interp(TIME - 0.02, TIME, hysteresis(DRIVE)) + NOISE
    delayed = quiet(Recording("log", DRIVE, late, TIME))
    new = np.interp(TIME - 0.02, TIME, hysteresis(NEW))
    assert delayed.delay_seconds == pytest.approx(0.02, abs=0.002)
    assert error(delayed, NEW, new) < 0.15
    sensor = quiet(Recording("log", DRIVE, late, TIME), Options(sensor_delay=0.02))
    assert error(sensor, NEW, hysteresis(NEW)) < 0.05


def test_spikes_are_left_out() -> None:
    displacement = hysteresis(DRIVE) + NOISE
    displacement[[500, 1500, 2500]] += 3.0
    logs, notes = clean([Recording("log", DRIVE, displacement, TIME)], Options())
    assert np.flatnonzero(~logs[0].usable).tolist() == [500, 1500, 2500]
    assert "3 rows left out" in notes[0]
    assert not spiked_rows(hysteresis(DRIVE)).any()


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


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"gears": 0}, "gears"),
        ({"delay": -1.0}, "delay"),
        ({"dynamics": 3}, "dynamics"),
    ],
)
def test_options_are_checked(options: dict[str, object], word: str) -> None:
    with pytest.raises(UsageError, match=word):
        Options(**options)  # type: ignore[arg-type]


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
    known = expected_error(model, inside, dt, past_known=True)
    unknown = expected_error(model, inside, dt)
    assert known is not None and unknown is not None
    assert unknown > 2.0 * known
    assert expected_error(model, DRIVE, dt) == expected_error(
        model, DRIVE, dt, past_known=True
    )


def test_moves_unlike_the_logs_warn(model: Cascade) -> None:
    assert move_warnings(model, DRIVE, 0.005) == []
    assert "faster" in move_warnings(model, DRIVE, 0.0005)[0]
    held = np.concatenate((DRIVE, np.full(4000, DRIVE[-1])))
    assert "holds" in move_warnings(model, held, 0.005)[0]
    assert longest_rest(held, np.full(len(held) - 1, 0.005)) == pytest.approx(
        20.0, abs=0.2
    )


def test_validation_logs_are_measured(model: Cascade) -> None:
    log = Recording("log", DRIVE, hysteresis(DRIVE) + NOISE, TIME)
    new = Recording("new", NEW, hysteresis(NEW), TIME)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        tried = identify([log], validation=[new])
    entry = tried.fit["validation"][0]
    assert entry["name"] == "new" and entry["rmse"] < 0.05
