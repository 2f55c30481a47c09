"""The amplifier before the gears: undone exactly, within limits; live, exported and saved alike."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_actuators import DT, random_drive, undone

import dbo_cli.model as dm
from dbo_cli.drive import Driver, Lead, Limits
from dbo_cli.drive.live import Controller
from dbo_cli.errors import DboWarning, InputError, ModelError
from dbo_cli.export import export_model
from tests.export.firmware import Firmware

TERMS = dm.Relaxation(1.0, (1e-3, 0.05, 2.0), (0.2, -0.3, 0.1))


def plant(seconds, kind=0, behind=()):
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
    stages = (dm.Amplifier(seconds), *head, gears, *behind)
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


@pytest.mark.parametrize("kind", range(8))
def test_live_goes_on_from_a_first_voltage_that_was_applied_instead(kind):
    model = plant(2e-3, kind)
    live = Controller(model, 1.0 / DT, Limits.within(model.input), state="empty")
    live.plan(6.0)
    live.commit(2.5)
    after = model.run([2.5], model.start(2.5, "empty"), DT).state
    assert live.state.amplifier == pytest.approx(after.amplifier, abs=1e-12)
    played = np.append(2.5, [live.step(7.0) for _ in range(60)])
    reached, _ = model.simulate(played, dt=DT, state="empty")
    assert reached[-1] == pytest.approx(7.0, abs=1e-9)


@pytest.mark.parametrize("kind", range(8))
def test_exported_c_is_the_library(kind, tmp_path):
    """The self-test of an export compares with the library's drives to the bit, after a reset, too."""
    behind = (dm.Dynamics((dm.Resonance(60.0, 0.1), dm.Lag(2e-3))), dm.Delay(1.3e-3))
    model = plant(0.7e-3, kind, behind if kind % 3 == 0 else ())
    limits = Limits.within(model.input, 0.5, 9.5, 800.0 if kind % 4 < 2 else None)
    export = export_model(model, limits, sample_rate=1.0 / DT)
    code, said = Firmware(export, tmp_path).self_test()
    assert code == 0, said
    with pytest.raises(ModelError, match=r"^amplifier: "):
        export_model(model, limits, sample_rate=1.0 / DT, arithmetic="q31")


def test_files_and_states_hold_it(tmp_path):
    model = plant(3e-3, 1)
    drive = random_drive(np.random.default_rng(3), 0.0, 10.0, 300)
    whole, _ = model.simulate(drive, dt=DT)
    _, state = model.simulate(drive[:100], dt=DT)
    (tmp_path / "state.json").write_text(dm.dumps_state(state, model))
    back = dm.read_state(str(tmp_path / "state.json"), model.inverse())
    rest, _ = model.simulate(drive[100:], dt=DT, state=back)
    assert np.array_equal(rest, whole[100:])
    for each in (model, model.inverse()):
        (tmp_path / "model.json").write_text(dm.dumps_model(each))
        again = dm.read_cascade(str(tmp_path / "model.json"))
        assert dm.dumps_model(again) == dm.dumps_model(each)
        assert again.digest == model.digest != plant(3.1e-3, 1).digest
    stages = json.loads(dm.dumps_model(model.inverse()))["stages"]
    kinds = [stage["type"] for stage in stages]
    assert kinds == ["backlash", "point", "amplifier"]


def test_a_compensated_move_is_reached():
    model = plant(0.6e-3, 1)
    time = np.arange(2000) * DT
    desired = 8.0 - 6.0 * np.cos(2 * np.pi * 10.0 * time) * np.minimum(time, 1.0)
    with pytest.warns(DboWarning, match="row 1 starts"):
        lead = Lead(model, Limits.within(model.input))
        drive = Driver(lead).whole(desired, DT)
    reached, _ = model.simulate(drive.voltage, dt=DT, state="auto")
    np.testing.assert_allclose(reached[1:], desired[1:], rtol=0, atol=0.31)
    np.testing.assert_allclose(reached[50:], desired[50:], rtol=0, atol=1e-9)


def test_time_must_go_on():
    with pytest.raises(InputError, match="time step 3: 0 s"):
        plant(1e-3).drive([1.0, 2.0, 3.0], dm.State(0), np.array([0.0, DT, 0.0]))
    with pytest.raises(ModelError, match="seconds"):
        dm.Amplifier(0.0)
