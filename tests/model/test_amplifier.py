"""The amplifier before the gears: undone exactly, within limits; in blocks and live alike."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_actuators import DT, random_drive, undone

import dbo_cli.model as dm
from dbo_cli.drive import Limits
from dbo_cli.drive.live import Controller
from dbo_cli.errors import InputError, ModelError

TERMS = dm.Relaxation(1.0, (1e-3, 0.05, 2.0), (0.2, -0.3, 0.1))


def plant(seconds, kind=0):
    """A scanner of 100 gears behind an amplifier; bent, falling, without memory by its kind."""
    head = ()
    if kind % 2:
        head = (dm.Points([4.0, 6.0], [6.0, 4.0]),)
    if kind // 2 % 2:
        head = (*head, dm.Scale(-1.0, 10.0))
    terms = TERMS if kind < 4 else None
    gears = dm.Gears([0.1] * 100, np.linspace(0.1, 0.3, 100), 0.0, 0.0, terms)
    voltage = dm.Quantity("voltage", "V", 0.0, 10.0)
    displacement = dm.Quantity("displacement", "um", 0.0, 20.0)
    stages = (dm.Amplifier(seconds), *head, gears)
    return dm.Cascade("forward", voltage, displacement, stages)


lags = st.floats(-2.0, 1.5).map(lambda power: DT * 10.0**power)
kinds = st.integers(0, 7)
seeds = st.integers(0, 10**6)


@settings(max_examples=200)
@given(lags, kinds, seeds)
def test_the_inverse_is_exact(seconds, kind, seed):
    """Rounding of the voltage behind the amplifier comes back times 1/(1 - a)."""
    model, rng = plant(seconds, kind), np.random.default_rng(seed)
    drive = random_drive(rng, 0.0, 10.0, 200)
    y, after = model.simulate(drive, dt=DT)
    start = model.start(float(drive[0]))
    back, back_after = undone(model, y, DT, start)
    share = float(model.amplifier.share(DT)[0])
    np.testing.assert_allclose(back, drive, rtol=0, atol=1e-11 / share)
    assert back_after.amplifier == pytest.approx(after.amplifier, abs=1e-11)


@settings(max_examples=60)
@given(lags, kinds, seeds, st.floats(1e2, 1e5))
def test_blocks_and_live_are_the_batch(seconds, kind, seed, slew):
    model, rng = plant(seconds, kind), np.random.default_rng(seed)
    desired = random_drive(rng, -1.0, 18.0, 150)
    limits = Limits.within(model.input, 0.5, 9.5, slew)
    start = model.start_drive(float(desired[0]), "auto", *limits.move)
    batch = model.drive(desired, start, DT, limits.move, limits.slew)
    state, blocks = start, []
    for block in np.split(desired, [1, 7, 8, 60]):
        done = model.drive(block, state, DT, limits.move, limits.slew)
        state = done.state
        blocks.append(done.y)
    assert np.array_equal(np.concatenate(blocks), batch.y)
    assert state == batch.state
    live = Controller(model, 1.0 / DT, limits)
    values = [live.step(float(value)) for value in desired]
    assert np.array_equal(values, batch.y)
    assert live.state.amplifier == batch.state.amplifier
    assert live.state.bits == batch.state.bits


def test_time_must_go_on():
    with pytest.raises(InputError, match="time step 3: 0 s"):
        plant(1e-3).drive([1.0, 2.0, 3.0], dm.State(0), np.array([0.0, DT, 0.0]))
    with pytest.raises(ModelError, match="seconds"):
        dm.Amplifier(0.0)
