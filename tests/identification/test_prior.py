"""A model refreshed from a short log: what changed comes back, what did not stays as it was."""

import numpy as np
import pytest

from dbo_cli.errors import FitError, ModelError, UsageError
from dbo_cli.identification.prior import _solved, rescale
from dbo_cli.identification.recording import Options, Recording
from dbo_cli.model import Candidate, Cascade, Delay, Gears, Quantity, Relaxation, Scale

RATE = 500.0
NOISE = 0.005


def actuator(gain=1.0, offset=0.0, delay=0.004, grow=0.8):
    """An actuator of 60 gears; ``grow`` widens its loop."""
    widths = np.full(60, 100.0 / 60.0)
    slopes = 1.0 + grow * np.linspace(-0.5, 0.5, 60)
    gears = Gears(widths, 0.1 * widths * slopes, 0.0, 0.0)
    stages = [gears, Scale(gain, offset)]
    if delay:
        stages.append(Delay(delay))
    drive = Quantity("voltage", "V", 0.0, 100.0)
    moved = Quantity("displacement", "um", offset, offset + 10.0 * gain)
    fit = {"expected_rmse": 0.01, "rmse": 0.01, "line_rmse": 0.6}
    other = Candidate(0.5, (gears, Scale(1.02 * gain, offset)))
    return Cascade("forward", drive, moved, tuple(stages), fit, (other,))


def waves(low, high, cycles=4, shape="sine"):
    part = np.arange(int(cycles * RATE)) / RATE
    if shape == "triangle":
        wave = 2.0 * np.abs(part - np.floor(part + 0.5))
    else:
        wave = 0.5 - 0.5 * np.cos(2.0 * np.pi * part)
    return low + (high - low) * wave


def recorded(model, drive, seed=1, skip=0):
    moved, _ = model.simulate(drive, dt=1.0 / RATE, state="empty")
    moved = moved + np.random.default_rng(seed).normal(0.0, NOISE, moved.size)
    time = np.arange(drive.size) / RATE
    return Recording("new.csv", drive[skip:], moved[skip:], time[skip:])


def error(model, truth):
    """RMS error of new moves."""
    rng = np.random.default_rng(5)
    levels = np.concatenate([[0.0, 100.0], rng.uniform(0.0, 100.0, 12)])
    drive = np.interp(np.arange(4000), np.linspace(0, 4000, levels.size), levels)
    wanted, _ = truth.simulate(drive, dt=1.0 / RATE, state="empty")
    moved, _ = model.simulate(drive, dt=1.0 / RATE, state="empty")
    return float(np.sqrt(np.mean((moved - wanted) ** 2)))


def test_gain_offset_and_delay_come_back():
    truth = actuator(1.07, 1.3, 0.011)
    refreshed = rescale(actuator(), [recorded(truth, waves(0.0, 100.0))], Options())
    moved = refreshed.fit["prior"]
    assert moved["gain"] == pytest.approx(1.07, abs=0.004)
    assert moved["offset"] == pytest.approx(1.3, abs=0.02)
    assert moved["delay_seconds"] == pytest.approx(0.007, abs=0.0015)
    assert error(refreshed, truth) < 0.2 * error(actuator(), truth)
    assert 0.0107 < refreshed.fit["expected_rmse"] < 0.016
    assert refreshed.output.span == pytest.approx(10.7, rel=0.005)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("shape", ["sine", "triangle"])
@pytest.mark.parametrize("ends", [(0.0, 100.0), (40.0, 60.0), (75.0, 95.0)])
def test_an_unchanged_actuator_keeps_its_numbers(ends, shape, seed):
    prior = actuator()
    way = np.concatenate([waves(0.0, 90.0, 2), np.linspace(0.0, ends[0], 200)])
    drive = np.concatenate([way, waves(*ends, 3, shape)])
    log = recorded(prior, drive, seed, skip=way.size)
    refreshed = rescale(prior, [log], Options())
    assert error(refreshed, prior) < 0.002


@pytest.mark.parametrize("offset", [0.05, 0.2, 0.4])
@pytest.mark.parametrize("ends", [(0.0, 100.0), (40.0, 60.0)])
def test_a_zero_that_an_unknown_past_may_explain_is_in_the_stated_error(ends, offset):
    """It was taken for the past, and .01 um stated where .4 came."""
    truth = actuator(1.0, offset)
    way = np.concatenate([waves(0.0, 90.0, 2), np.linspace(0.0, ends[0], 200)])
    drive = np.concatenate([way, waves(*ends, 3)])
    refreshed = rescale(actuator(), [recorded(truth, drive, skip=way.size)], Options())
    assert error(refreshed, truth) < 1.5 * refreshed.fit["expected_rmse"]


def test_what_was_unsure_of_a_prior_is_found_again_and_no_part_of_its_shape():
    """The stated error grew with each refreshing, and another shape was accepted then."""
    drive = waves(40.0, 60.0, 3)
    stated, model = [], actuator()
    for _ in range(3):
        model = rescale(model, [recorded(actuator(), drive)], Options())
        stated.append(model.fit["expected_rmse"])
    assert stated[0] > 0.02 and stated[2] == pytest.approx(stated[0], rel=0.05)
    with pytest.raises(FitError, match="shape has changed"):
        rescale(model, [recorded(actuator(grow=1.6), waves(0.0, 100.0))], Options())


def test_a_changed_shape_is_refused_and_kept_by_force():
    log = recorded(actuator(grow=1.6), waves(0.0, 100.0))
    with pytest.raises(FitError, match=r"new\.csv"):
        rescale(actuator(), [log], Options())
    kept = rescale(actuator(), [log], Options(force=True))
    assert len(kept.fit["warnings"]) == 1
    assert kept.fit["expected_rmse"] > 0.02


def test_what_cannot_be_refreshed_is_refused():
    log = recorded(actuator(), waves(0.0, 100.0))
    against = Recording("new.csv", log.voltage, -log.displacement, log.time)
    with pytest.raises(FitError, match="runs against"):
        rescale(actuator(), [against], Options())
    with pytest.raises(ModelError):
        rescale(actuator().inverse(), [log], Options())
    gears = actuator().gears
    slow = Gears(gears.dx, gears.dy, 0.0, 0.0, Relaxation(0.0, (1.0,), (0.01,)))
    without_clock = Recording("new.csv", log.voltage, log.displacement)
    with pytest.raises(UsageError, match="`time`"):
        rescale(actuator().with_stages((slow,)), [without_clock], Options())
    prior = actuator(delay=0.0)
    log = recorded(prior, waves(0.0, 100.0))
    without_clock = Recording("new.csv", log.voltage, log.displacement)
    assert rescale(prior, [without_clock], Options()).delay_seconds == 0.0


def test_errors_are_those_of_the_stated_size_and_a_past_between_the_ends():
    """n rows with s swings count as s; a past that the rows do not show is uniform on -1 to 1."""
    table = np.zeros((40, 5))
    table[:, :4] = np.linalg.qr(np.random.default_rng(1).normal(size=(40, 4)))[0]
    numbers, errors = _solved(table, np.zeros(40), 3, 0.02)
    np.testing.assert_allclose(errors[:4], 0.02 * np.sqrt(40.0 / 3.0), rtol=1e-12)
    assert errors[4] == pytest.approx(np.sqrt(1.0 / 3.0), rel=1e-12)
    assert not numbers.any()
    rough = 5.0 * np.random.default_rng(2).normal(size=40)
    numbers, errors = _solved(table, rough, 3, 0.02)
    left = np.sqrt(np.mean((rough - table @ numbers) ** 2))
    np.testing.assert_allclose(errors[:4], left * np.sqrt(40.0 / 3.0), rtol=1e-3)


def test_chance_in_the_noise_of_a_short_log_is_no_change_of_the_shape():
    """The prior states a tenth of the sensor's noise, whose variance a short log shows to a few per cent.

    Of sixty seeds those whose noise is most like a change.
    """
    prior = actuator()
    prior.fit.update(expected_rmse=0.0005, rmse=0.0005)
    drive = waves(0.0, 100.0, 1)
    for seed in (21, 32, 50, 55):
        rescale(prior, [recorded(actuator(), drive, seed)], Options())


def test_a_scale_before_the_gears_stays_there():
    prior = actuator(delay=0.0)
    before = Scale(0.5, 3.0)
    prior = Cascade(
        "forward", prior.input, prior.output, (before, *prior.stages), prior.fit
    )
    drive = waves(0.0, 100.0)
    moved, _ = prior.simulate(drive, dt=1.0 / RATE)
    log = Recording("new.csv", drive, 1.2 * moved + 0.4, np.arange(drive.size) / RATE)
    again = rescale(prior, [log], Options())
    assert again.stages[0] == before and len(again.stages) == 3
    found, _ = again.simulate(drive, dt=1.0 / RATE)
    np.testing.assert_allclose(found, log.displacement, atol=0.1)
