"""Live use: the bits of ``compensate``, a plan that leaves no trace, codes, and what needs the future."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import SMALL_MODEL
from test_hysteresis_model import build

from dbo_cli import InputError, Model, ModelError, UsageError

RATE = 200.0


def models() -> list[Model]:
    """Return models with and without relaxation and points, one with a bend before the gears."""
    return [Model(build(seed, relaxation=seed % 2 == 0)) for seed in range(6)]


def moves(model: Model, seed: int, samples: int = 300) -> np.ndarray[Any, Any]:
    rng = np.random.default_rng(seed)
    low, high = model.output.minimum, model.output.maximum
    return 0.5 * (low + high) + 0.48 * (high - low) * np.sin(np.cumsum(rng.normal(0.0, 0.4, samples)))


@pytest.mark.parametrize("number", range(6))
@pytest.mark.parametrize("state", ["auto", "empty"])
def test_a_controller_gives_the_bits_of_compensate(number: int, state: str) -> None:
    model = models()[number]
    span = model.input.span
    limits: dict[str, Any] = {
        "v_min": model.input.minimum + 0.1 * span, "v_max": model.input.maximum, "max_slew": 20.0 * span
    }  # fmt: skip
    wanted = moves(model, number)
    live = model.controller(RATE, state=state, **limits)
    got = [live.step(x) for x in wanted]
    result = model.compensate(wanted, sample_rate=RATE, state=state, details=True, **limits)
    assert got == result.values.tolist()
    assert live.clipped == result.clipped
    assert live.state is not None
    assert live.state.backlash == result.state.backlash


def test_a_plan_that_is_not_committed_leaves_no_trace() -> None:
    model = models()[0]
    wanted = moves(model, 3)
    plain, hesitant = model.controller(RATE), model.controller(RATE)
    for x in wanted:
        hesitant.plan(float(wanted.max()))
        hesitant.plan(float(wanted.min()))
        planned = hesitant.plan(x)
        hesitant.commit()
        assert planned == plain.step(x)


@pytest.mark.parametrize("number", [0, 1])
def test_what_was_applied_instead_is_what_counts(number: int) -> None:
    model = models()[number]
    wanted = moves(model, 5, 120)
    live = model.controller(RATE)
    applied, state = [], None
    for k, x in enumerate(wanted):
        volts = float(live.plan(x))
        volts = (
            volts
            if k % 3
            else min(max(volts + 0.01 * model.input.span, model.input.minimum), model.input.maximum)
        )
        live.commit(volts)
        applied.append(volts)
    _, state = model.simulate(applied, sample_rate=RATE, return_state=True)
    assert live.state is not None
    assert live.state.backlash.bits == state.backlash.bits
    held, expected = live.state.backlash.memory, state.backlash.memory
    assert (held is None) == (expected is None)
    assert held is None or held == pytest.approx(expected, rel=1e-12)


def test_a_converter_plans_codes_and_the_state_follows_their_voltage() -> None:
    model = models()[1]
    curve = np.linspace(model.input.minimum, model.input.maximum, 1024)
    live = model.controller(RATE, dac=curve)
    codes = [live.step(x) for x in moves(model, 7)]
    assert all(isinstance(code, int) and 0 <= code < 1024 for code in codes)
    _, state = model.simulate(curve[np.array(codes)], sample_rate=RATE, return_state=True)
    assert live.state is not None
    assert live.state.backlash.bits == state.backlash.bits
    reached = model.simulate(curve[np.array(codes)], sample_rate=RATE)
    steepest = float((model.actuator.backlash.dy / model.actuator.backlash.dx).max())
    gain = model.output.span / float(model.actuator.backlash.dy.sum())
    off = np.abs(reached - moves(model, 7))[1:]
    assert np.median(off) < steepest * gain * (curve[1] - curve[0])


@pytest.fixture
def delayed(tmp_path: Path) -> Model:
    document = json.loads(json.dumps(SMALL_MODEL))
    document["stages"].append({"type": "delay", "seconds": 0.02})
    path = tmp_path / "delayed.json"
    path.write_text(json.dumps(document))
    from dbo_cli import read_model

    return read_model(path)


def test_a_delay_needs_the_future(delayed: Model) -> None:
    with pytest.raises(ModelError) as raised:
        delayed.controller(1000.0)
    assert str(raised.value) == (
        "the model has a delay of 0.02 s, so the drive depends on what is wanted that much later, which a "
        "controller does not know (with `ahead` the caller passes it)"
    )
    t = np.arange(400) / 1000
    wanted = 5.0 + 3.0 * np.sin(2 * np.pi * 3 * t)
    live = delayed.controller(1000.0, ahead=True)
    ahead = np.concatenate([wanted[20:], np.full(20, wanted[-1])])
    assert [live.step(x) for x in ahead] == delayed.compensate(wanted, sample_rate=1000.0).tolist()


def test_senseless_controllers_are_refused() -> None:
    model = models()[0]
    with pytest.raises(UsageError, match=r"need the time between samples \(`sample_rate` HZ\)$"):
        model.controller()
    with pytest.raises(UsageError, match=r"^`sample_rate` 0: "):
        model.controller(0.0)
    with pytest.raises(ModelError, match="is an inverse model where a forward one is needed"):
        model.inverse().controller(RATE)
    with pytest.raises(UsageError, match=r"^`dac`: give the voltage of every code"):
        model.controller(RATE, dac=[1.0, 1.0])
    live = model.controller(RATE)
    with pytest.raises(InputError, match="is not a finite number: nan"):
        live.plan(float("nan"))
    with pytest.raises(UsageError, match="nothing was planned"):
        live.commit()
