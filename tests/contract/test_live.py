"""Live control: a sample at a time, the numbers of ``compensate``, and never beyond a limit."""

import numpy as np
import pytest

import dbo_cli as dbo

from .program import model, store, values_of

RATE = 1000.0
TIME = np.arange(400) / RATE
pytestmark = pytest.mark.filterwarnings("ignore::dbo_cli.errors.DboWarning")


def actuator(name):
    return dbo.read_model(model(name))


def wish(name):
    """Return a move inside the range, from its lower end."""
    out = actuator(name).output
    middle, span = 0.45 * (out.min + out.max), out.max - out.min
    return middle - 0.35 * span * np.cos(2.0 * np.pi * 5.0 * TIME)


def followed(live, wanted):
    volts = []
    for value in wanted:
        volts.append(live.plan(float(value)))
        live.commit()
    return np.array(volts)


@pytest.mark.parametrize("is_limited", [False, True])
@pytest.mark.parametrize("name", ["small", "creep", "bent", "soft", "amplified"])
def test_plan_and_commit_give_the_drive_of_compensate(name, is_limited):
    """Calls in any order, and voltages applied instead: ``tests/drive/test_never_beyond.py``."""
    made, limits = actuator(name), {}
    low, high = made.input.min, made.input.max
    if is_limited:
        part = 0.2 * (high - low)
        limits = {"v_min": low + part, "v_max": high - part, "max_slew": 40.0 * part}
    found = followed(made.controller(sample_rate=RATE, **limits), wish(name))
    limits |= {"sample_rate": RATE, "on_limit": "clip"}
    expected = made.compensate(wish(name), **limits)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10)


@pytest.mark.parametrize("behind", [(), ({"type": "amplifier", "seconds": 2e-3},)])
@pytest.mark.parametrize("rows", [1, 20])
def test_what_was_applied_instead_counts(rows, behind):
    """Behind any voltages, of which the first is far from the plan's, the wish is still reached."""
    values = values_of("creep")
    values["stages"] = [*behind, *values["stages"]]
    creep = dbo.read_model(store("model.json", values))
    options = {"sample_rate": RATE, "state": "empty"}
    applied = 60.0 + np.random.default_rng(1).normal(0.0, 9.0, rows)
    live = creep.controller(**options)
    for volts in applied:
        live.plan(2.0)
        live.commit(volts)
    played = np.append(applied, live.plan(3.0))
    assert creep.simulate(played, **options)[-1] == pytest.approx(3.0, abs=1e-9)


@pytest.mark.parametrize("is_applied", [False, True])
@pytest.mark.parametrize("step", [None, 0.04])
@pytest.mark.parametrize("end", ["min", "max"])
@pytest.mark.parametrize("name", ["small", "creep", "bent", "soft"])
def test_from_outside_it_goes_to_the_nearer_end(name, end, step, is_applied):
    """Each sample is as near as the slew allows, and the first inside the range is its nearer end."""
    made = actuator(name)
    low, high = made.input.min, made.input.max
    margin = 0.1 * (high - low)
    nearer, outwards = (low, -margin) if end == "min" else (high, margin)
    slew = None if step is None else step * (high - low) * RATE
    live = made.controller(
        sample_rate=RATE,
        v_min=low - margin,
        v_max=high + margin,
        max_slew=slew,
        from_=None if is_applied else nearer + outwards,
    )
    middle = 0.5 * (made.output.min + made.output.max)
    if is_applied:
        live.plan(middle)
        live.commit(nearer + outwards)
    clipped = live.clipped
    outside = [1.0, 0.6, 0.2, 0.0] if step else [1.0, 0.0]
    way = nearer + outwards * np.array(outside[1:])
    found = followed(live, np.full(way.size, middle))
    np.testing.assert_allclose(found, way, rtol=0, atol=1e-9 * (high - low))
    assert found[-1] == nearer
    assert live.clipped == clipped + way.size
    assert low <= live.plan(middle) <= high


def test_a_controller_goes_on_from_the_state_of_another():
    """With what undoing a delay and a resonance remembers; what was wanted ahead is passed again."""
    options = {"sample_rate": RATE, "lookahead": "auto"}
    live = actuator("moving").controller(**options)
    wanted = wish("moving")[:150]
    followed(live, wanted)
    hold = np.full(live.lookahead, wanted[-1])
    followed(live, hold)
    later = actuator("moving").controller(state=live.state, **options)
    assert later.last == live.last
    np.testing.assert_allclose(
        followed(later, hold), followed(live, hold), rtol=0, atol=1e-9
    )
