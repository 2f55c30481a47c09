"""Resonances and lags: found where a sweep shows them, and not elsewhere."""

from dataclasses import replace

import numpy as np
import pytest

import dbo_cli.model as dm
from dbo_cli.errors import FitError
from dbo_cli.identification import Options, dynamics, identify
from dbo_cli.identification.basis import Structure
from dbo_cli.identification.moving import without_fast_memories
from dbo_cli.identification.problem import prepare
from dbo_cli.identification.recording import Recording
from dbo_cli.identification.sections import (
    FastDynamics,
    FastRows,
    Form,
    Sweep,
    split,
)
from dbo_cli.identification.stages import model_of
from tests.drive.actuators import actuator

RATE = 2_000.0


def plant(*sections, delay=0.0):
    """An actuator of 80 gears with dynamics."""
    return actuator(80, growth=7.0 / 3.0, sections=sections, delay=delay)


def swept(slow_seconds=2.0, crest=1.0):
    """Loops of 1 Hz, a way to the middle, a sweep of 2 to 200 Hz, a way back."""
    loops = np.arange(round(slow_seconds * RATE)) / RATE
    slow = 50.0 - 50.0 * np.cos(2.0 * np.pi * loops)
    way = 25.0 - 25.0 * np.cos(np.pi * np.arange(600) / 600)
    part = np.arange(round(1.4 * RATE)) / (1.4 * RATE)
    turns = 2.0 * 1.4 / np.log(100.0) * np.expm1(np.log(100.0) * part)
    fade = np.clip(np.minimum(part, 1.0 - part) / 0.05, 0.0, 1.0)
    sweep = 50.0 + crest * 0.25**part * fade * np.sin(2.0 * np.pi * turns)
    rest = np.full(600, 50.0)
    return np.concatenate([slow, way, rest, sweep, rest, way[::-1]])


def recorded(model, drive, noise=0.002):
    moved, _ = model.simulate(drive, dt=1.0 / RATE, state="empty")
    moved = moved + np.random.default_rng(1).normal(0.0, noise, moved.size)
    return Recording("log.csv", drive, moved, np.arange(moved.size) / RATE)


def rows_of(model, crest=1.0):
    _, fast = split([recorded(model, swept(crest=crest))])
    return FastRows(plant(), fast)


def found(model, wanted="auto"):
    """Sections, delay, and what is left of blocks left out; no sections without a resonance."""
    rows = rows_of(model)
    best = dynamics.find(rows, wanted)
    if not best.form.resonances:
        return (), 0.0, best.left_out
    return rows.sections(best), best.delay, best.left_out


def test_the_sweep_is_told_from_the_loops():
    log = recorded(plant(), swept())
    (slow,), (part,) = split([log])
    assert isinstance(part, Sweep)
    assert part.rows.start > 2.0 * RATE
    expected = np.ones(len(log.voltage), bool)
    expected[part.rows] = False
    assert np.array_equal(slow.usable, expected)  # the way after a sweep counts, too
    assert part.band[0] < 8.0 and part.band[1] == pytest.approx(200.0, rel=0.05)
    loops = recorded(plant(), swept()[:4000])
    (same,), none = split([loops])
    assert same is loops and none == []
    assert split([Recording("log.csv", log.voltage, log.displacement)])[1] == []


@pytest.mark.parametrize(
    ("frequency", "damping", "lag", "wanted"),
    [(60.0, 0.02, 5e-4, "auto"), (110.0, 0.005, 2e-3, 1), (35.0, 0.3, 1e-3, 1)],
)
def test_a_resonance_and_a_lag_come_back(frequency, damping, lag, wanted):
    model = plant(dm.Lag(lag), dm.Resonance(frequency, damping))
    sections, delay, left_out = found(model, wanted)
    *lags, resonance = sections
    assert isinstance(resonance, dm.Resonance)
    assert resonance.frequency == pytest.approx(frequency, rel=0.005)
    assert resonance.damping == pytest.approx(damping, rel=0.1)
    assert sum(one.lag for one in lags) == pytest.approx(lag, abs=2e-4)
    assert delay == 0.0
    assert left_out < 0.003


def test_two_modes_that_add_up_have_an_antiresonance():
    notch = dm.Resonance(150.0, 0.02, dm.Mode(120.0, 0.02))
    sections, _, _ = found(plant(dm.Resonance(60.0, 0.02), notch))
    first, second = (one for one in sections if isinstance(one, dm.Resonance))
    assert first.frequency == pytest.approx(60.0, rel=0.005)
    assert second.antiresonance is not None
    assert second.frequency == pytest.approx(150.0, rel=0.01)
    assert second.antiresonance.frequency == pytest.approx(120.0, rel=0.01)


def test_no_resonance_is_found_where_there_is_none():
    assert found(plant(dm.Lag(1e-3)))[:2] == ((), 0.0)
    sections, _, _ = found(plant(dm.Lag(1e-3)), 0)
    assert sections == ()


def test_a_late_sensor_hides_no_resonance():
    sections, delay, _ = found(plant(dm.Resonance(60.0, 0.02), delay=0.02), 1)
    resonance = sections[-1]
    assert isinstance(resonance, dm.Resonance)
    assert resonance.frequency == pytest.approx(60.0, rel=0.005)
    late = delay + sum(one.lag for one in sections if isinstance(one, dm.Lag))
    assert late == pytest.approx(0.02, rel=0.05)


def test_refining_keeps_what_fits_and_offers_one_more():
    model = plant(dm.Resonance(60.0, 0.02), dm.Resonance(150.0, 0.02))
    begun = FastDynamics(Form(1), np.log([61.0, 0.03, 1e-6]))
    refined = dynamics.refine(rows_of(model), begun)
    frequencies = [one.frequency for one in refined.resonances]
    assert frequencies == pytest.approx([60.0, 150.0], rel=0.01)


@pytest.mark.parametrize(
    ("crest", "is_behind", "is_found_before"),
    [(1.0, False, True), (15.0, False, True), (15.0, True, False)],
)
def test_a_lag_stands_before_the_gears_unless_a_large_sweep_shows_it_behind(
    crest, is_behind, is_found_before
):
    resonance = dm.Resonance(60.0, 0.05)
    model = plant(*((dm.Lag(2e-3), resonance) if is_behind else (resonance,)))
    if not is_behind:
        model = model.with_stages((dm.Amplifier(2e-3), *model.stages))
    begun = FastDynamics(Form(1), np.log([61.0, 0.05, 2e-3]))
    refined = dynamics.refine(rows_of(model, crest), begun, 1)
    assert (refined.amplifier > 0.0) == is_found_before
    assert refined.amplifier + refined.lag == pytest.approx(2e-3, rel=0.1)


def test_resonances_without_a_sweep_are_refused():
    log = recorded(plant(), swept()[:4000])
    with pytest.raises(FitError, match="`dynamics` 1"):
        identify([log], Options(dynamics=1, relaxation=(), points=0, delay=0.0))


def test_fast_memories_act_at_once_and_slow_ones_stay():
    time = np.arange(2000) / 100.0
    drive = 50.0 - 50.0 * np.cos(2.0 * np.pi * 0.1 * time)
    log = Recording("log.csv", drive, 0.1 * drive, time)
    problem = prepare([log], Options(relaxation=(1e-4, 5.0)))
    structure = Structure(memories="tr")
    fit = problem.equations(structure).solve()
    fit = replace(fit, gains=np.array([0.1, 0.2, 0.3, 0.05]))
    slower, steeper = without_fast_memories(problem, fit, 0.1)
    assert slower.taus.tolist() == [5.0]
    assert steeper.gains.tolist() == [0.2, 0.05]
    first = model_of(problem, fit, log, Options())
    second = model_of(slower, steeper, log, Options())
    with_memory, _ = first.simulate(drive, time=time)
    without, _ = second.simulate(drive, time=time)
    assert np.abs(with_memory - without).max() < 1e-3
