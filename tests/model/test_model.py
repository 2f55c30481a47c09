"""Models: the exact inverse, blocks, starts, limits, and what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dbo_cli.errors import InputError, ModelError
from dbo_cli.model import (
    Amplifier,
    Cascade,
    Delay,
    Dynamics,
    Gears,
    Lag,
    Mode,
    Points,
    Quantity,
    Relaxation,
    Resonance,
    Scale,
    Stage,
    State,
)
from tests.model.random_models import DT, Floats, random_drive, random_model

VOLTAGE = Quantity("voltage", "V", 0.0, 10.0)
DISPLACEMENT = Quantity("displacement", "um", 0.0, 20.0)
TERMS = Relaxation(1.0, (1e-3, 0.05, 2.0), (0.2, -0.3, 0.1))


def plant(*behind: Stage, relaxation: Relaxation | None = TERMS) -> Cascade:
    """A scanner of 100 gears, a few curves, and what stands behind them."""
    gears = Gears([0.1] * 100, np.linspace(0.1, 0.3, 100), 0.0, 0.0, relaxation)
    low, high = gears.y_range
    curve = Points([1.0, high - low - 1.0], [1.2, high - low - 1.2], low, low)
    return Cascade("forward", VOLTAGE, DISPLACEMENT, (gears, curve, *behind))


@pytest.mark.parametrize("batch", range(10))
def test_the_inverse_is_exact(batch: int) -> None:
    """1,000 random models, half of them with negative gains."""
    for seed in range(100 * batch, 100 * batch + 100):
        rng = np.random.default_rng(seed)
        assert round_trip_error(rng, random_model(rng, negative=seed % 2 == 0)) <= 1e-12


def round_trip_error(rng: np.random.Generator, model: Cascade) -> float:
    """The worst error of the drive after the model and its inverse, over the range."""
    low, high = model.input.min, model.input.max
    drive = random_drive(rng, low, high, 300)
    drive[:25], drive[-25:] = drive[0], drive[-1]  # a delay holds back what was before
    displacement, _ = model.simulate(drive, dt=DT)
    begun = model.start(float(drive[0]))
    back, _ = model.inverse().simulate(displacement, dt=DT, state=begun)
    return float(np.abs(back - drive)[:-25].max()) / (high - low)


@pytest.mark.parametrize("seed", range(40))
def test_the_inverse_is_exact_on_any_clock(seed: int) -> None:
    rng = np.random.default_rng(seed)
    model = random_model(rng, delays=False, negative=True)
    low, high = model.input.min, model.input.max
    drive = random_drive(rng, low, high, 300)
    time = np.cumsum(10.0 ** rng.uniform(-5, 1, 300))
    displacement, _ = model.simulate(drive, time=time)
    begun = model.start(float(drive[0]))
    back, _ = model.inverse().simulate(displacement, time=time, state=begun)
    np.testing.assert_allclose(back, drive, rtol=0, atol=1e-12 * (high - low))


def in_blocks(rng: np.random.Generator, x: Floats) -> list[Floats]:
    """A signal cut at random."""
    edges = np.sort(rng.integers(0, x.size, 12))
    return np.split(x, edges)


@pytest.mark.parametrize("seed", range(30))
def test_blocks_change_nothing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    sections = (
        Resonance(80.0, 0.03, Mode(95.0, 0.05)),
        Lag(4e-3, 1e-3),
        Resonance(150.0, 0.1),
    )
    delay = Delay(float(rng.choice([0.0, 3e-3, 0.4e-3, 2.3e-3, 17.7e-3])))
    model = plant(Dynamics(sections), delay)
    drive = random_drive(rng, 0.0, 10.0, 600)
    whole, after = model.simulate(drive, dt=DT)
    state, parts = model.start(float(drive[0])), []
    for block in in_blocks(rng, drive):
        done = model.run(block, state, DT)
        state = done.state
        parts.append(done.y)
    assert np.array_equal(np.concatenate(parts), whole)
    assert state == after


def smooth_move(model: Cascade, rows: int) -> Floats:
    """A sine that grows out of a rest at the lower end, where the start is known."""
    lowest = model.simulate([0.0], dt=DT)[0][0]
    k = np.maximum(np.arange(rows) - 100, 0)
    grown = np.minimum(1.0, k / 1000) ** 2
    return np.asarray(lowest + 7.0 * grown * (1.0 - np.cos(2.0 * np.pi * k * 4.0 * DT)))


@pytest.mark.parametrize("seconds", [0.2e-3, 1.2e-3, 2.2e-3, 9.7e-3])
def test_one_row_at_a_time_is_read_ahead_as_all(seconds: float) -> None:
    model = plant(Delay(seconds))
    wanted = np.cumsum(np.random.default_rng(2).normal(size=60))
    ahead = model.inverter(DT).ahead
    whole, _ = model.inverter(DT).run(wanted)
    undoing = None
    for row in range(60 - ahead):
        value, undoing = model.inverter(DT).run(wanted[row : row + 1 + ahead], undoing)
        assert value == pytest.approx([whole[row]], abs=1e-12)


@pytest.mark.parametrize("seconds", [0.0, 2e-3, 1.37e-3])
@pytest.mark.parametrize("damping", [0.02, 0.3])
def test_dynamics_and_delay_are_undone(seconds: float, damping: float) -> None:
    """A smooth move from the lower end comes out as wanted; a part of a sample leaves interpolation."""
    model = plant(Dynamics((Resonance(60.0, damping), Lag(2e-3))), Delay(seconds))
    wanted = smooth_move(model, 3000)
    known = np.concatenate([wanted, np.full(model.inverter(DT).ahead, wanted[-1])])
    u, _ = model.inverter(DT).run(known)
    state = model.start_drive(float(u[0]))
    voltage = model.drive(u, state, DT).y
    reached, _ = model.simulate(voltage, dt=DT)
    error = np.abs(reached - wanted)[50:-50].max()
    assert error < (1e-12 if seconds != 1.37e-3 else 2e-6) * 8.0


@pytest.mark.parametrize("seconds", [0.4e-3, 1.5e-3, 2.5e-3, 9.7e-3])
def test_a_delay_is_the_same_by_count_and_by_time(seconds: float) -> None:
    """Before the first sample the first value holds, however the clock is given."""
    x = np.cumsum(np.random.default_rng(1).normal(size=40))
    counted = Delay(seconds).run(x, State(), DT).y
    looked_up = Delay(seconds).run(x, State(), np.full(40, DT)).y
    np.testing.assert_allclose(looked_up, counted, rtol=0, atol=1e-9)


def test_a_resonance_too_fast_for_the_rate_is_refused() -> None:
    model = plant(Dynamics((Resonance(301.0, 0.02),)))
    with pytest.raises(InputError, match="resample"):
        model.inverter(DT)
    plant(Dynamics((Resonance(299.0, 0.02),))).inverter(DT)


def test_dynamics_are_the_continuous_ones() -> None:
    """A ramp and a rest between samples: the recursion against the exact solution."""
    section = Resonance(50.0, 0.1)
    time = np.arange(400) * DT
    x = np.minimum(time, 0.1)
    y = Dynamics((section,)).run(x, State(), DT).y
    omega, zeta = 2 * np.pi * 50.0, 0.1
    damped = omega * np.sqrt(1 - zeta**2)

    def ramp(t: Floats) -> Floats:
        late = 2 * zeta / omega
        swing = late * np.cos(damped * t) + (2 * zeta**2 - 1) / damped * np.sin(
            damped * t
        )
        return np.where(t > 0, t - late + np.exp(-zeta * omega * t) * swing, 0.0)

    np.testing.assert_allclose(y, ramp(time) - ramp(time - 0.1), rtol=0, atol=1e-12)


def test_loops_are_settled() -> None:
    model = plant(Dynamics((Resonance(60.0, 0.02, Mode(90.0, 0.01)),)), Delay(1.3e-3))
    period = 5.0 + np.sin(2 * np.pi * np.arange(200) / 200)
    undone = model.inverter(DT).loop(period)
    back = model.follow_loop(undone, DT)
    np.testing.assert_allclose(back, period, rtol=0, atol=2e-5)
    assert model.dynamics is not None and model.delay is not None
    many = model.dynamics.run(np.tile(undone, 200), State(), DT)
    late = model.delay.run(many.y, State(), DT).y
    np.testing.assert_allclose(late[-200:], back, rtol=0, atol=1e-9)


def test_a_model_of_many_gears_runs() -> None:
    gears = Gears(np.full(100_000, 1e-4), np.full(100_000, 2e-4))
    model = Cascade(
        "forward",
        Quantity("voltage", "V", 0.0, 10.0),
        Quantity("x", None, 0.0, 20.0),
        (gears,),
    )
    drive = random_drive(np.random.default_rng(0), 0.0, 10.0, 2000)
    y, _ = model.simulate(drive)
    back, _ = model.inverse().simulate(y, state=model.start(float(drive[0])))
    np.testing.assert_allclose(back, drive, rtol=0, atol=1e-11)
    assert replace(model, fit={}).digest == model.digest


# ---- starts ----


def test_starts() -> None:
    model = plant()
    assert model.start(-1.0).bits == 0
    assert model.start(5.0, "empty").bits == 0
    assert model.start(5.0, "full").bits == (1 << model.gears.n) - 1
    assert model.start(5.0).bits == model.gears.settled(5.0)
    with pytest.raises(ModelError, match="auto, empty, full, settled"):
        model.start(5.0, "sideways")
    assert model.start_drive(5.0, "full").drive == pytest.approx(10.0)
    assert model.start_drive(5.0, "full", 0.0, 9.0).drive == 9.0


@pytest.mark.parametrize("wanted", np.linspace(-3.0, 22.0, 21))
def test_a_drive_starts_as_the_model_driven_by_it(wanted: float) -> None:
    model = plant()
    begun = model.start_drive(float(wanted), "auto", 0.0, 10.0)
    assert begun.first is not None
    assert model.start(begun.first).bits == begun.bits
    reached = model.simulate([begun.first], dt=DT)[0]
    if 0.0 < begun.first < 10.0:
        assert abs(reached[0] - wanted) < 0.4


def test_undoing_goes_on_behind_played_voltages() -> None:
    """What undoing remembers follows from the state of the forward dynamics."""
    model = plant(Dynamics((Resonance(60.0, 0.05, Mode(80.0, 0.1)), Lag(3e-3))))
    u, undoing = model.inverter(DT).run(smooth_move(model, 800))
    done = model.drive(u, model.start_drive(float(u[0])), DT)
    again = model.inverter(DT).behind(done.state)
    assert undoing is not None and again is not None
    np.testing.assert_allclose(again[1], undoing[1], rtol=0, atol=1e-8)
    kept = replace(done.state, undoing=undoing)
    assert model.inverter(DT).behind(kept) is undoing
    assert model.inverter(DT).behind(State(0)) is None


# ---- what is outside, and what is refused ----


@pytest.mark.parametrize(
    ("stages", "place"),
    [
        ((Scale(1.0, 0.0),), "stages: "),
        ((Gears([1], [1]), Gears([1], [1])), "stages[1]: "),
        ((Gears([1], [1]), Delay(1.0), Scale(1.0, 0.0)), "stages[2]: "),
        ((Dynamics((Lag(1.0),)), Gears([1], [1])), "stages[1]: "),
        ((Gears([1], [1]), Amplifier(1.0)), "stages[1]: "),
        ((Amplifier(1.0), Amplifier(1.0), Gears([1], [1])), "stages[1]: "),
    ],
)
def test_bad_cascades_are_named(stages: tuple[Stage, ...], place: str) -> None:
    with pytest.raises(ModelError) as problem:
        Cascade("forward", VOLTAGE, DISPLACEMENT, stages)
    assert str(problem.value).startswith(place)
