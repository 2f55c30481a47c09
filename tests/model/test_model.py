"""Models: the exact inverse, blocks, starts, limits, and what is refused."""

import numpy as np
import pytest
from random_actuators import DT, random_drive, random_model, undone

import dbo_cli.model as dm
from dbo_cli.errors import ModelError

VOLTAGE = dm.Quantity("voltage", "V", 0.0, 10.0)
DISPLACEMENT = dm.Quantity("displacement", "um", 0.0, 20.0)
TERMS = dm.Relaxation(1.0, (1e-3, 0.05, 2.0), (0.2, -0.3, 0.1))


def plant(*behind, relaxation=TERMS):
    """A scanner of 100 gears, a few curves, and what stands behind them."""
    gears = dm.Gears([0.1] * 100, np.linspace(0.1, 0.3, 100), 0.0, 0.0, relaxation)
    low, high = gears.y_range
    curve = dm.Points([1.0, high - low - 1.0], [1.2, high - low - 1.2], low, low)
    return dm.Cascade("forward", VOLTAGE, DISPLACEMENT, (gears, curve, *behind))


@pytest.mark.parametrize("batch", range(10))
def test_the_inverse_is_exact(batch):
    """1,000 random models, half of them with negative gains."""
    for seed in range(100 * batch, 100 * batch + 100):
        rng = np.random.default_rng(seed)
        assert round_trip_error(rng, random_model(rng, negative=seed % 2 == 0)) <= 1e-12


def round_trip_error(rng, model):
    """The worst error of the drive after the model and its inverse, over the range."""
    low, high = model.input.min, model.input.max
    drive = random_drive(rng, low, high, 300)
    drive[:25], drive[-25:] = drive[0], drive[-1]  # a delay holds back what was before
    displacement, _ = model.simulate(drive, dt=DT)
    begun = model.start(float(drive[0]))
    back, _ = undone(model, displacement, DT, begun)
    return float(np.abs(back - drive)[:-25].max()) / (high - low)


@pytest.mark.parametrize("seed", range(40))
def test_the_inverse_is_exact_on_any_clock(seed):
    """Rounding of the voltage behind an amplifier comes back times 1/(1 - a)."""
    rng = np.random.default_rng(seed)
    model = random_model(rng, delays=False, negative=True)
    low, high = model.input.min, model.input.max
    drive = random_drive(rng, low, high, 300)
    time = np.cumsum(10.0 ** rng.uniform(-5, 1, 300))
    steps, share = dm.steps_of(time), 1.0
    if seed % 2:
        amplifier = dm.Amplifier(10.0 ** rng.uniform(-5.0, -1.5))
        model = model.with_stages((amplifier, *model.stages))
        share = amplifier.share(steps)[1:].min()
    displacement, after = model.simulate(drive, time=time)
    begun = model.start(float(drive[0]))
    back, back_after = undone(model, displacement, steps, begun)
    rounding = 1e-12 * (high - low) / share
    np.testing.assert_allclose(back, drive, rtol=0, atol=rounding)
    assert back_after.amplifier == pytest.approx(after.amplifier, abs=rounding)


def smooth_move(model, rows):
    """A sine that grows out of a rest at the lower end, where the start is known."""
    lowest = model.simulate([0.0], dt=DT)[0][0]
    k = np.maximum(np.arange(rows) - 100, 0)
    grown = np.minimum(1.0, k / 1000) ** 2
    return np.asarray(lowest + 7.0 * grown * (1.0 - np.cos(2.0 * np.pi * k * 4.0 * DT)))


@pytest.mark.parametrize("seconds", [0.0, 2e-3, 1.37e-3])
@pytest.mark.parametrize("damping", [0.02, 0.3])
def test_dynamics_and_delay_are_undone(seconds, damping):
    """A smooth move from the lower end comes out as wanted; a part of a sample leaves interpolation."""
    model = plant(
        dm.Dynamics((dm.Resonance(60.0, damping), dm.Lag(2e-3))), dm.Delay(seconds)
    )
    wanted = smooth_move(model, 3000)
    known = np.concatenate([wanted, np.full(model.inverter(DT).ahead, wanted[-1])])
    u, _ = model.inverter(DT).run(known)
    state = model.start_drive(float(u[0]))
    voltage = model.drive(u, state, DT).y
    reached, _ = model.simulate(voltage, dt=DT)
    error = np.abs(reached - wanted)[50:-50].max()
    assert error < (1e-12 if seconds != 1.37e-3 else 2e-6) * 8.0


def test_dynamics_are_the_continuous_ones():
    """A ramp and a rest between samples: the recursion against the exact solution."""
    section = dm.Resonance(50.0, 0.1)
    time = np.arange(400) * DT
    x = np.minimum(time, 0.1)
    y = dm.Dynamics((section,)).run(x, dm.State(), DT).y
    omega, zeta = 2 * np.pi * 50.0, 0.1
    damped = omega * np.sqrt(1 - zeta**2)

    def ramp(t):
        late = 2 * zeta / omega
        swing = late * np.cos(damped * t)
        swing += (2 * zeta**2 - 1) / damped * np.sin(damped * t)
        return np.where(t > 0, t - late + np.exp(-zeta * omega * t) * swing, 0.0)

    np.testing.assert_allclose(y, ramp(time) - ramp(time - 0.1), rtol=0, atol=1e-12)


def test_starts():
    model = plant()
    assert model.start(-1.0).bits == 0
    assert model.start(5.0, "empty").bits == 0
    assert model.start(5.0, "full").bits == (1 << model.gears.n) - 1
    assert model.start(5.0).bits == model.starts.bits(5.0, "settled")
    with pytest.raises(ModelError, match="auto, empty, full, settled"):
        model.start(5.0, "sideways")
    assert model.start_drive(5.0, "full").drive == pytest.approx(10.0)
    assert model.start_drive(5.0, "full", 0.0, 9.0).drive == 9.0
