"""A lag before the gears: exact inverse, any blocks, limits that hold it back, its place, and its files."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from trials import Floats, random_operator

from dbo_cli.errors import ModelError
from dbo_cli.extras.repeat.settled_loops import settled_drive, settled_run, undone_loop
from dbo_cli.hysteresis import drive_lag
from dbo_cli.hysteresis.cascade import slow_output_range
from dbo_cli.hysteresis.dynamics import DynamicsStage, Lag, Resonance
from dbo_cli.hysteresis.model import (
    ActuatorModel,
    DriveLimits,
    PointStage,
    Quantity,
    ScaleStage,
    Stage,
)
from dbo_cli.hysteresis.model_file import (
    model_to_bytes,
    read_model,
    read_state,
    state_to_bytes,
)
from dbo_cli.hysteresis.model_state import ModelState, OutsideError

STEP = 1.0 / 20_000.0
LAG = DynamicsStage((Lag(2e-4),))


def actuator(
    seed: int, gears: int = 60, first: DynamicsStage = LAG, behind: bool = False
) -> ActuatorModel:
    """Return an actuator with points on both sides of its gears."""
    rng = np.random.default_rng(seed)
    operator = random_operator(rng, gears, relaxation=bool(seed % 2))
    low, high = operator.x_range
    widths = rng.uniform(0.5, 1.0, 3)
    bend = PointStage(
        widths / widths.sum() * (high - low),
        widths / widths.sum() * (high - low),
        low,
        low,
    )
    stages: list[Stage] = [bend, operator, ScaleStage(-2.0, 0.3)]
    bottom, top = slow_output_range(stages, low, high)
    if behind:
        stages.append(DynamicsStage((Resonance(800.0, 0.02),)))
    return ActuatorModel(
        "forward",
        Quantity("v", "V", low, high),
        Quantity("x", "um", bottom, top),
        (first, *stages),
    )


def compensated(
    model: ActuatorModel,
    wanted: Floats,
    limits: DriveLimits,
    start: str,
    cuts: list[int],
) -> tuple[Floats, ModelState, int]:
    state = model.start_compensation(float(wanted[0]), start, limits)  # type: ignore[arg-type]
    drives, clipped = [], 0
    for part in np.split(wanted, cuts):
        done = model.compensate(part, state, limits=limits, time_step=STEP)
        state, clipped = done.state, clipped + done.clipped_count
        drives.append(done.y)
    return np.concatenate(drives), state, clipped


def test_a_lag_before_the_gears_is_late_and_rounds_what_they_see() -> None:
    model = actuator(0)
    v = model.input.minimum + model.input.span * (
        0.5 - 0.5 * np.cos(0.05 * np.arange(2_000))
    )
    w, _ = LAG.run(v, STEP, None)
    bare = dataclasses.replace(model, stages=model.stages[1:])
    expected = bare.simulate(w, bare.start(float(w[0]), "empty")).y
    got = model.simulate(v, model.start(float(v[0]), "empty"), time_step=STEP).y
    assert np.array_equal(got, expected)
    assert model.needs_time and model.dynamics is None and model.drive_lag == LAG


@pytest.mark.parametrize("seed", range(8))
def test_inverse_after_forward_is_the_identity_at_any_cut(seed: int) -> None:
    model, rng = actuator(seed), np.random.default_rng(seed)
    wanted = model.output.minimum + model.output.span * (
        0.5 + 0.4 * np.sin(0.03 * np.arange(900))
    )
    wide = DriveLimits(-1e6, 1e6)
    drive, _, clipped = compensated(model, wanted, wide, "empty", [])
    assert clipped == 0
    reached = model.simulate(
        drive, model.start(float(drive[0]), "empty"), time_step=STEP
    ).y
    assert np.abs(reached - wanted).max() < 1e-10 * model.output.span
    again, _, _ = compensated(
        model, wanted, wide, "empty", np.sort(rng.integers(0, 900, 5)).tolist()
    )
    assert again.tobytes() == drive.tobytes()
    inverse = model.inverse()
    begun = inverse.start(float(wanted[0]), "empty")
    assert np.allclose(
        inverse.simulate(wanted, begun, time_step=STEP).y, drive, rtol=0.0, atol=1e-9
    )


@pytest.mark.parametrize("slew", [None, 0.02])
@pytest.mark.parametrize("seed", range(6))
def test_what_limits_cut_off_does_not_reach_the_gears(
    seed: int, slew: float | None
) -> None:
    model, span = actuator(seed), actuator(seed).input.span
    rate = np.random.default_rng(seed).uniform(0.02, 0.5)
    wanted = model.output.minimum + model.output.span * (
        0.5 + 0.6 * np.sin(rate * np.arange(300))
    )
    limits = DriveLimits(
        model.input.minimum + 0.1 * span, model.input.maximum - 0.1 * span,
        None if slew is None else slew * span / STEP,
    )  # fmt: skip
    for start in ("empty", "auto"):
        drive, state, clipped = compensated(model, wanted, limits, start, [])
        assert (
            drive.min() >= limits.v_min and drive.max() <= limits.v_max and clipped > 0
        )
        if limits.max_slew is not None:
            assert np.abs(np.diff(drive)).max() <= limits.max_slew * STEP * (1.0 + 1e-9)
        cut, end, count = compensated(model, wanted, limits, start, [1, 50, 51, 200])
        assert cut.tobytes() == drive.tobytes() and end == state and count == clipped
        played = model.simulate(
            drive, model.start(float(drive[0]), start), time_step=STEP
        )  # type: ignore[arg-type]
        assert played.state.backlash.bits == state.backlash.bits
        inside = (drive > limits.v_min) & (drive < limits.v_max)
        inside[0] = False  # a settled start may step over the first value
        if slew is None:
            assert np.abs(played.y - wanted)[inside].max() < 1e-9 * model.output.span


def test_a_loop_settles_through_the_lag() -> None:
    model = actuator(4, behind=True, first=DynamicsStage((Lag(3e-3),)))
    turn = 2.0 * np.pi * np.arange(200) / 200
    period = model.output.minimum + model.output.span * (0.5 + 0.3 * np.sin(turn))
    limits = DriveLimits(model.input.minimum - 1e3, model.input.maximum + 1e3)
    undone = undone_loop(model, period, STEP)
    state = model.start_compensation(float(undone[0]), "auto", limits)
    settled = settled_drive(model, undone, STEP, state, limits)
    assert settled.converged
    once = settled_run(model, settled.done.y, STEP, settled.before)
    assert np.abs(once.y - period).max() < 1e-8 * model.output.span
    # the resonance at rest
    begun = ModelState(settled.before.backlash, drive_lag=settled.before.drive_lag)
    played = model.simulate(np.tile(settled.done.y, 60), begun, time_step=STEP).y
    assert np.abs(played[-200:] - period).max() < 1e-6 * model.output.span


def test_the_state_goes_on_through_its_file(tmp_path: Path) -> None:
    model = actuator(2, behind=True)
    path = tmp_path / "model.json"
    path.write_bytes(model_to_bytes(model))
    again = read_model(str(path))
    assert model_to_bytes(again) == path.read_bytes() and again.drive_lag == LAG
    turned = read_model_of(model.inverse(), tmp_path)
    assert turned.drive_lag is not None and turned.drive_lag.inverted
    v = np.linspace(model.input.minimum, model.input.maximum, 100)
    whole = again.simulate(v, again.start(float(v[0]), "empty"), time_step=STEP)
    half = again.simulate(v[:37], again.start(float(v[0]), "empty"), time_step=STEP)
    file = tmp_path / "state.json"
    file.write_bytes(state_to_bytes(half.state, model))
    rest = again.simulate(v[37:], read_state(str(file), again), time_step=STEP)
    assert np.array_equal(np.concatenate([half.y, rest.y]), whole.y)
    bare = dataclasses.replace(model, stages=model.stages[1:])
    text = file.read_text().replace(model.digest, bare.digest)
    file.write_text(text)
    with pytest.raises(ModelError, match="drive_lag: the model has none"):
        read_state(str(file), bare)


def read_model_of(model: ActuatorModel, folder: Path) -> ActuatorModel:
    path = folder / "other.json"
    path.write_bytes(model_to_bytes(model))
    return read_model(str(path))


def test_one_lag_alone_stands_first_and_nowhere_else_before_the_gears() -> None:
    gears = actuator(0).stages[1:]
    quantities = (Quantity("v", "V", 0.0, 1.0), Quantity("x", "um", 0.0, 1.0))
    resonant, two = (
        DynamicsStage((Resonance(800.0, 0.02),)),
        DynamicsStage((Lag(1e-3), Lag(1e-4))),
    )
    for stages, text in (
        ((resonant, *gears), r"stages\[0\].sections: one lag alone may stand first"),
        ((two, *gears), r"stages\[0\].sections: one lag alone may stand first"),
        (
            (gears[0], LAG, *gears[1:]),
            r"stages\[1\]: dynamics on the drive's side stand first, and once",
        ),
        (
            (LAG, LAG, *gears),
            r"stages\[1\]: dynamics on the drive's side stand first, and once",
        ),
    ):
        with pytest.raises(ModelError, match=text):
            ActuatorModel("forward", *quantities, tuple(stages))


def test_a_drive_beyond_the_range_is_refused_though_the_lag_rounds_it() -> None:
    model = actuator(0)
    v = np.full(50, model.input.minimum + 0.5 * model.input.span)
    v[20] = model.input.maximum + 0.1 * model.input.span
    start = model.start(float(v[0]), "empty")
    assert model.simulate(v, start, time_step=STEP).first_outside == 20
    with pytest.raises(OutsideError) as caught:
        model.simulate(v, start, time_step=STEP, outside="error")
    assert caught.value.index == 20 and caught.value.value == v[20]


@pytest.mark.parametrize("points", [False, True])
@pytest.mark.parametrize("seed", range(4))
def test_a_drive_held_back_runs_on_in_blocks_with_the_bits_of_single_samples(
    seed: int, points: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = actuator(seed)
    if not points:
        model = dataclasses.replace(model, stages=(model.stages[0], *model.stages[2:]))
    span, turns = model.input.span, np.sign(np.sin(0.02 * np.arange(600) + 0.3))
    wanted = model.output.minimum + model.output.span * (0.5 + 0.45 * turns)
    limits = DriveLimits(model.input.minimum, model.input.maximum, 0.004 * span / STEP)
    alone, state, count = compensated(
        model, wanted, limits, "empty", list(range(1, 600))
    )
    tried = []

    def counted(*arguments: Any) -> Any:
        tried.append(arguments)
        return held_back(*arguments)

    held_back = drive_lag._held_back
    monkeypatch.setattr(drive_lag, "_held_back", counted)
    whole, end, clipped = compensated(model, wanted, limits, "empty", [])
    assert (
        whole.tobytes() == alone.tobytes() and end == state and clipped == count > 300
    )
    assert len(tried) < 0.2 * clipped


@pytest.mark.parametrize("v_max", [60.0, np.inf])
def test_a_repeated_time_moves_no_drive_that_comes_from_outside_the_limits(
    v_max: float,
) -> None:
    """In no time a lag passes nothing on: the drive comes in to its limit, and stays at it."""
    model = actuator(3)
    rest = model.simulate([8.0], model.start(8.0, "empty"), time_step=STEP)
    wanted = np.full(6, float(rest.y[-1]))
    limits = DriveLimits(55.0, v_max)
    steps = np.array([0.0, 0.0, STEP, 0.0, STEP, STEP])
    drive = model.compensate(wanted, rest.state, limits=limits, time_step=steps).y
    assert drive.tolist() == [55.0] * 6


def test_a_repeated_time_asks_no_infinite_drive_of_a_move_above_the_limits() -> None:
    """In no time nothing reaches what is wanted: the drive stays where it stands, with no limit above."""
    model = actuator(3)
    rest = model.simulate([8.0], model.start(8.0, "empty"), time_step=STEP)
    above = model.simulate([70.0], model.start(70.0, "empty"), time_step=STEP)
    wanted = np.full(3, float(above.y[-1]))
    done = model.compensate(
        wanted, rest.state, limits=DriveLimits(55.0, np.inf), time_step=np.zeros(3)
    )
    assert done.y.tolist() == [55.0] * 3


@pytest.mark.parametrize("behind", [False, True])
def test_a_rest_beyond_the_range_is_worked_out_at_once_and_counted(
    behind: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Once the lag has come to the end of the range, its output is the bound to the last digit."""
    bare = dataclasses.replace(
        actuator(1, behind=behind), stages=(LAG, *actuator(1).stages[2:])
    )
    low, span = bare.input.minimum, bare.input.span
    limits = DriveLimits(low, low + 0.6 * span)
    ends = slow_output_range(bare.stages[1:], low, low + span)
    way = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, 3_000))
    wanted = np.concatenate(
        [ends[1] + (ends[0] - ends[1]) * way, np.full(500, ends[0] + 0.01)]
    )
    alone = compensated(bare, wanted, limits, "full", list(range(1, wanted.size)))
    held_back = drive_lag._held_back
    calls = []

    def counted(*words: Any) -> Any:
        calls.append(words)
        return held_back(*words)

    monkeypatch.setattr(drive_lag, "_held_back", counted)
    drive, state, clipped = compensated(bare, wanted, limits, "full", [])
    assert drive.tolist() == alone[0].tolist()
    assert (clipped, state.backlash) == (alone[2], alone[1].backlash)
    held = np.count_nonzero(drive == limits.v_max)
    assert held > 1_000
    assert clipped >= held - 20
    assert len(calls) < 40
