"""The procedure in Python against the kernel, and one-sample steps against blocks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dbo_cli.errors import DboError, DboWarning
from dbo_cli.model import (
    Cascade,
    Delay,
    Dynamics,
    Gears,
    Lag,
    Quantity,
    Resonance,
    State,
    kernel,
)
from dbo_cli.model.gears import OPEN
from tests.model.random_models import (
    DT,
    Floats,
    random_drive,
    random_gears,
    random_model,
)


def everything(seed: int) -> list[Floats]:
    """What simulate, invert and compensate make of a random model."""
    rng = np.random.default_rng(seed)
    model = random_model(rng, delays=False)
    sections = (Resonance(80.0, 0.05), Lag(3e-3, 1e-3))
    seconds = float(rng.choice([0.0, 2e-3, 0.7e-3, 5.3e-3]))
    model = model.with_stages((*model.stages, Dynamics(sections), Delay(seconds)))
    low, high = model.input.min, model.input.max
    drive = random_drive(rng, low, high, 250)
    y, state = model.simulate(drive, dt=DT, outside="hold")
    clock = np.cumsum(rng.uniform(0.5 * DT, 1.5 * DT, 250))
    uneven, _ = model.static.simulate(drive, time=clock)
    known = np.concatenate([y, np.full(model.inverter(DT).ahead, y[-1])])
    u, _ = model.inverter(DT).run(known)
    width = 0.9 * (high - low)
    window = low, low + width
    begun = model.start_drive(float(u[0]), "auto", low, low + width)
    driven = model.drive(u, begun, DT, window, 20.0 * width)
    counts = np.array([driven.clipped, driven.first_clipped, state.bits % 2**30])
    inverse, _ = model.inverse().simulate(y, dt=DT)
    return [y, uneven, u, driven.y, counts, inverse]


@pytest.mark.parametrize("seed", range(12))
def test_the_fallback_is_the_kernel(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    compiled = everything(seed)
    monkeypatch.setattr(kernel, "extension", None)
    kernel._fallback.cache_clear()
    with pytest.warns(DboWarning, match="compiled part") as warned:
        plain = everything(seed)
    assert len([w for w in warned if w.category is DboWarning]) == 1
    for fast, slow in zip(compiled, plain, strict=True):
        np.testing.assert_allclose(
            slow, fast, rtol=0, atol=1e-9 * max(np.ptp(fast), 1.0)
        )


def test_what_needs_the_compiled_part_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kernel, "extension", None)
    with pytest.raises(DboError, match="identification needs the compiled part"):
        Gears([1.0], [1.0]).engagement([0.5])
    with pytest.raises(DboError, match="live control"):
        Gears([1.0], [1.0]).inverse().stepper(State(0), DT, OPEN, None)
    with pytest.raises(DboError, match="uneven clock needs the compiled part"):
        Delay(0.0015).run(np.arange(9.0), np.full(9, 1e-3))


@pytest.mark.parametrize("seed", range(30))
def test_steps_are_those_of_blocks(seed: int) -> None:
    rng = np.random.default_rng(seed)
    inverse = random_gears(rng).inverse()
    wanted = random_drive(rng, *inverse.x_range, 200)
    low, high = inverse.y_range
    window, slew = (low, low + 0.8 * (high - low)), 0.05 * (high - low) / DT
    memory = None
    if inverse.relaxation is not None:
        memory = (0.1,) * inverse.gain.size
    begun = State(0, memory, low)
    whole = inverse.run(wanted, begun, DT, window=window, slew=slew)
    live = inverse.stepper(begun, DT, window, slew)
    values = []
    for value in wanted.tolist():
        live.plan(float(rng.normal()))  # what is not committed leaves nothing behind
        values.append(live.plan(value))
        live.commit()
    assert np.array_equal(values, whole.y)
    last = whole.state.drive
    assert replace(inverse.committed(live), drive=last) == whole.state


@pytest.mark.parametrize("seed", range(20))
def test_another_voltage_that_was_applied_is_followed(seed: int) -> None:
    """``commit(applied)``: the state is that of the forward gears driven by what was applied."""
    rng = np.random.default_rng(seed)
    forward = random_gears(rng, negative=True)
    applied = random_drive(rng, *forward.x_range, 100)
    assert forward.relaxation is not None
    memory = (0.1,) * forward.gain.size
    begun = State(0, memory, float(applied[0]))
    live = forward.inverse().stepper(begun, DT, OPEN, None)
    for value in applied.tolist():
        live.plan(float(forward.y_range[0]))
        live.follow(value)
        live.commit()
    done = forward.run(applied, begun, DT).state
    after = forward.inverse().committed(live)
    assert after.bits == done.bits
    assert after.memory == pytest.approx(done.memory, rel=1e-12, abs=1e-12)
    with pytest.raises(ValueError, match="nothing was planned"):
        live.commit()


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
