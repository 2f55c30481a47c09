"""Live use: the bits of ``compensate``, a plan that leaves no trace, codes, and what needs the future."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import SMALL_MODEL
from test_hysteresis_model import build
from test_runs_repeated import actuator, move, rms

from dbo_cli import InputError, Model, ModelError, UsageError
from dbo_cli.extras.live.bank import Bank
from dbo_cli.hysteresis.dynamics import DynamicsStage, Lag, Resonance

RATE = 200.0


def models() -> list[Model]:
    """Return models with and without relaxation and points, one with a bend before the gears."""
    return [Model(build(seed, relaxation=seed % 2 == 0)) for seed in range(6)]


def moves(model: Model, seed: int, samples: int = 300) -> np.ndarray[Any, Any]:
    rng = np.random.default_rng(seed)
    low, high = model.output.minimum, model.output.maximum
    return 0.5 * (low + high) + 0.48 * (high - low) * np.sin(
        np.cumsum(rng.normal(0.0, 0.4, samples))
    )


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
    result = model.compensate(
        wanted, sample_rate=RATE, state=state, on_limit="clip", details=True, **limits
    )
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
            else min(
                max(volts + 0.01 * model.input.span, model.input.minimum),
                model.input.maximum,
            )
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
    _, state = model.simulate(
        curve[np.array(codes)], sample_rate=RATE, return_state=True
    )
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
        "controller does not know (with `ahead` or `lookahead` the caller passes it)"
    )
    t = np.arange(400) / 1000
    wanted = 5.0 + 3.0 * np.sin(2 * np.pi * 3 * t)
    live = delayed.controller(1000.0, ahead=True)
    ahead = np.concatenate([wanted[20:], np.full(20, wanted[-1])])
    assert [live.step(x) for x in ahead] == delayed.compensate(
        wanted, sample_rate=1000.0
    ).tolist()


def test_senseless_controllers_are_refused() -> None:
    model = models()[0]
    with pytest.raises(
        UsageError, match=r"need the time between samples \(`sample_rate` HZ\)$"
    ):
        model.controller()
    with pytest.raises(UsageError, match=r"^`sample_rate` 0: "):
        model.controller(0.0)
    with pytest.raises(
        ModelError, match="is an inverse model where a forward one is needed"
    ):
        model.inverse().controller(RATE)
    with pytest.raises(UsageError, match=r"^`dac`: give the voltage of every code"):
        model.controller(RATE, dac=[1.0, 1.0])
    live = model.controller(RATE)
    with pytest.raises(InputError, match="is not a finite number: nan"):
        live.plan(float("nan"))
    with pytest.raises(UsageError, match="nothing was planned"):
        live.commit()


LIVE = 20_000.0  # samples/s, of the actuators with dynamics
LAG, RING = DynamicsStage((Lag(2e-4),)), DynamicsStage((Resonance(800.0, 0.02),))


def moving(kind: str) -> Model:
    """Return an actuator with a resonance at 800 Hz, a lag on either side of the gears, perhaps a delay."""
    if kind == "points":
        bent = build(3, relaxation=True)
        return Model(dataclasses.replace(bent, stages=(LAG, *bent.stages, RING)))
    plant = actuator(delay={"delay": 7.0 / LIVE, "between": 7.3 / LIVE}.get(kind, 0.0))
    if kind == "drive lag":
        plant = dataclasses.replace(plant, stages=(LAG, *plant.stages[:-1], RING))
    if kind == "lag alone":
        plant = dataclasses.replace(plant, stages=(LAG, *plant.stages[:-1]))
    return Model(plant)


PATTERNS = {
    "noise": lambda rng: 6.0 + np.cumsum(rng.normal(0.0, 0.02, 240)),
    "steps": lambda rng: np.repeat(rng.uniform(2.0, 10.0, 4), 60),
    "rests": lambda rng: np.repeat(6.0, 100),
    "sine": lambda rng: 6.0 + 4.0 * np.sin(2.0 * np.pi * 80.0 * np.arange(300) / LIVE),
}


@pytest.mark.parametrize(
    "kind", ["plain", "delay", "between", "drive lag", "lag alone", "points"]
)
@pytest.mark.parametrize("pattern", PATTERNS)
@pytest.mark.parametrize("limits", [{}, {"max_slew": 2e4}])
def test_a_controller_with_dynamics_gives_the_bits_of_compensate(
    kind: str, pattern: str, limits: dict[str, float]
) -> None:
    model, wanted = moving(kind), PATTERNS[pattern](np.random.default_rng(5))
    wanted = model.output.minimum + model.output.span * (wanted - 0.5) / 12.36
    limits = {name: value * model.input.span / 100.0 for name, value in limits.items()}
    live = model.controller(LIVE, lookahead="auto", state="empty", **limits)
    got = [live.step(x) for x in wanted]
    lead = {"lead": "auto"} if live.lookahead else {}
    done = model.compensate(
        wanted, sample_rate=LIVE, state="empty", rows=f":{wanted.size - live.lookahead}", details=True,
        on_limit="clip", **lead, **limits,
    )  # fmt: skip
    assert got == done.values.tolist()
    assert live.state is not None
    assert live.state.backlash.bits == done.state.backlash.bits
    assert live.state.undoing == done.state.undoing
    for name in ("dynamics", "drive_lag"):
        held, expected = getattr(live.state, name), getattr(done.state, name)
        assert (held is None) == (expected is None)
        assert held is None or np.allclose(held, expected, rtol=1e-9, atol=1e-9)


def test_a_plan_with_dynamics_leaves_no_trace_and_more_lookahead_is_later() -> None:
    model, wanted = moving("between"), PATTERNS["sine"](None)[:150]
    plain, hesitant = (
        model.controller(LIVE, lookahead="auto", state="empty") for _ in range(2)
    )
    # 30 of the resonance, 7.3 of the delay and three samples behind it
    assert plain.lookahead == 40
    first = [plain.step(x) for x in wanted]
    for k, x in enumerate(wanted):
        hesitant.plan(9.0)
        hesitant.plan(3.0)
        if k % 50 == 20:
            assert hesitant.state is not None  # looking at it changes nothing
        assert hesitant.plan(x) == first[k]
        hesitant.commit()
    later = model.controller(LIVE, lookahead=100 / LIVE, state="empty")
    assert later.lookahead == 100
    shifted = [later.step(x) for x in wanted]
    # creep began earlier
    assert np.allclose(shifted[60:], first[:-60], rtol=0.0, atol=1e-2)
    done = model.compensate(
        wanted,
        sample_rate=LIVE,
        state="empty",
        lead=100 / LIVE,
        rows=":50",
        details=True,
        on_limit="clip",
    )
    assert shifted == done.values.tolist()


def test_a_live_positioner_errs_as_compensate_does() -> None:
    """At a tenth of the resonance, on an actuator whose resonance is 10 % off."""
    model, plant = moving("plain"), actuator(frequency=720.0)
    wanted = move(80.0)
    live = model.controller(LIVE, lookahead="auto", state="empty")
    late = live.lookahead
    sent = np.array(
        [live.step(x) for x in np.append(wanted, np.full(late, wanted[-1]))],
        dtype=np.float64,
    )
    drives = (
        model.compensate(
            wanted, sample_rate=LIVE, state="empty", on_limit="clip", details=True
        ).values,
        sent,
    )
    reached = [
        Model(plant).simulate(drive, sample_rate=LIVE, state="empty")
        for drive in drives
    ]
    error, error_live = rms(reached[0] - wanted), rms(reached[1][late:] - wanted)
    assert 0.005 < error < 0.1
    assert error_live < 1.1 * error
    assert error_live > 0.9 * error


@pytest.mark.parametrize("kind", ["plain", "drive lag"])
def test_with_dynamics_what_was_applied_counts_and_a_state_goes_on(kind: str) -> None:
    model, wanted = moving(kind), PATTERNS["noise"](np.random.default_rng(3))
    live = model.controller(LIVE, lookahead="auto", state="empty")
    curve = np.linspace(model.input.minimum, model.input.maximum, 4096)
    coded = model.controller(LIVE, lookahead="auto", state="empty", dac=curve)
    applied = []
    for k, x in enumerate(wanted):
        volts = float(live.plan(x))
        applied.append(volts if k % 3 else min(volts + 0.5, 100.0))
        live.commit(applied[-1])
    codes = [coded.step(x) for x in wanted]
    for one, drive in ((live, np.array(applied)), (coded, curve[np.array(codes)])):
        played, state = model.simulate(
            drive, sample_rate=LIVE, state="empty", return_state=True
        )
        assert one.state is not None
        assert one.state.backlash.bits == state.backlash.bits
        assert np.allclose(
            one.state.dynamics or (), state.dynamics or (), rtol=1e-9, atol=1e-9
        )
        rest = np.full(400, wanted[-1])
        again = model.controller(LIVE, lookahead="auto", state=one.state)
        drive = np.array([again.step(x) for x in rest])
        expected = model.compensate(
            rest,
            sample_rate=LIVE,
            state=one.state,
            lead="auto",
            on_limit="clip",
            details=True,
        )
        assert drive.tolist() == expected.values[: rest.size].tolist()
        assert played.size == wanted.size
    way = live.close(seconds=0.01)
    assert way[-1] == 0.0
    assert live.state is not None and live.state.undoing is None
    begun = live.state
    anew = [live.step(x) for x in rest]
    expected = model.compensate(
        rest, sample_rate=LIVE, state=begun, lead="auto", on_limit="clip", details=True
    )
    assert anew == expected.values[: rest.size].tolist()


def test_a_lookahead_that_is_none_is_refused() -> None:
    model = moving("plain")
    with pytest.raises(UsageError) as raised:
        model.controller(LIVE, lookahead=0.001)
    assert str(raised.value) == (
        "`lookahead` 0.001 s is 20 samples, and the inverse of this model reads 30 ahead (`lookahead` 0.0015 "
        "or auto)"
    )
    with pytest.raises(
        UsageError, match=r"is 29 samples, and the inverse of this model reads 30 ahead"
    ):
        model.controller(LIVE, lookahead=29 / LIVE)
    with pytest.raises(
        UsageError, match=r"^`ahead` and `lookahead` exclude each other: "
    ):
        model.controller(LIVE, lookahead="auto", ahead=True)
    with pytest.raises(
        UsageError, match=r"need the time between samples \(`sample_rate` HZ\)$"
    ):
        models()[1].controller(lookahead="auto")
    with pytest.raises(UsageError) as raised:
        model.controller(LIVE, lookahead="soon")
    assert str(raised.value) == "`lookahead` soon: give seconds above 0, or auto"
    with pytest.raises(InputError, match="above half the sampling rate of 1000 Hz"):
        model.controller(1000.0, lookahead="auto")


def test_a_bank_of_models_with_dynamics_gives_the_bits_of_each() -> None:
    models = {"a": moving("plain").actuator, "b": moving("drive lag").actuator}
    bank = Bank(models, LIVE, lookahead=0.002)
    alone = [Model(one).controller(LIVE, lookahead=0.002) for one in models.values()]
    for x in PATTERNS["noise"](np.random.default_rng(8))[:60]:
        assert bank.step([x, x + 0.5]).tolist() == [
            alone[0].step(x),
            alone[1].step(x + 0.5),
        ]
    states = bank.states
    assert [states[name] for name in models] == [one.state for one in alone]
