"""The cascade: order of stages, inverse, starts, blocks, compensation within limits, delay."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from trials import Floats

from dbo_cli.errors import ModelError
from dbo_cli.hysteresis.cascade import covered_gears, read_ahead, spare_bits
from dbo_cli.hysteresis.model import (
    ActuatorModel,
    BacklashStage,
    DelayStage,
    DriveLimits,
    ModelState,
    PointStage,
    Quantity,
    Relaxation,
    ScaleStage,
    slow_output_range,
)
from dbo_cli.hysteresis.model_state import OutsideError, start_drive, start_state
from dbo_cli.hysteresis.operators import BacklashState, DiscreteBacklashOperator
from dbo_cli.interpolation.smooth import shifted_by_part

VOLTAGE = Quantity("voltage", "V", 0.0, 3.6)
OUTPUT = Quantity("displacement", "um", 0.0, 3.5)
GEARS = BacklashStage([0.144] * 25, np.linspace(0.08, 0.2, 25))


def build(
    seed: int, relaxation: bool = False, delay: float = 0.0, falling: bool = False
) -> ActuatorModel:
    """Return a model with every kind of stage; ``seed`` chooses sizes, slopes and the gain's sign."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 60))
    dx = rng.uniform(0.2, 1.0, n)
    slopes = np.sort(rng.uniform(0.3, 1.7, n))
    terms = (
        Relaxation(0.2, (0.01, 1.0), tuple(rng.uniform(0.0, 0.3, 2).tolist()))
        if relaxation
        else None
    )
    gears = BacklashStage(
        dx,
        dx * (slopes[::-1] if falling else slopes),
        rng.normal(),
        rng.normal(),
        terms,
    )
    low, high = gears.y_range
    points = PointStage(
        rng.uniform(0.5, 1.0, 4) * (high - low) / 3.0, rng.uniform(0.5, 1.0, 4), low
    )
    stages: list[Any] = [gears, points, ScaleStage(-3.0 if seed % 2 else 2.0, 0.7)]
    bottom, top = slow_output_range(stages, *gears.x_range)
    if delay:
        stages.append(DelayStage(delay))
    return ActuatorModel(
        "forward", Quantity("voltage", "V", *gears.x_range), Quantity("displacement", "um", bottom, top),
        tuple(stages),
    )  # fmt: skip


def wanted(
    model: ActuatorModel, seed: int, share: float = 0.45, count: int = 240
) -> Floats:
    """Return a decaying trajectory around the middle of the model's range."""
    k = np.arange(count)
    low, span = model.output.minimum, model.output.span
    trajectory: Floats = low + span * (
        0.5 + share * np.sin(k / 7.0 + seed) * np.exp(-k / 200.0)
    )
    return trajectory


def limits_of(model: ActuatorModel, slew: float | None = None) -> DriveLimits:
    return DriveLimits(model.input.minimum, model.input.maximum, slew)


@pytest.mark.parametrize("relaxation", [False, True])
@pytest.mark.parametrize("falling", [False, True])
def test_simulating_the_compensation_gives_the_trajectory(
    relaxation: bool, falling: bool
) -> None:
    for seed in range(25):
        model = build(seed, relaxation, falling=falling)
        desired = wanted(model, seed, share=0.3 if relaxation else 0.45)
        steps = (
            np.random.default_rng(seed).uniform(0.0, 0.01, desired.size)
            if relaxation
            else None
        )
        begin = model.start_compensation(desired[0], "auto", limits_of(model))
        drive = model.compensate(
            desired, begin, limits=limits_of(model), time_step=steps
        )
        again = model.start(drive.y[0], "auto")
        # the very state in which simulate starts
        assert again.backlash.bits == begin.backlash.bits
        back = model.simulate(drive.y, again, time_step=steps)
        assert back.state == drive.state
        assert (drive.clipped_count, drive.outside_count) == (0, 0)
        error = np.abs(back.y - desired)
        assert error[1:].max() <= 1e-12 * model.output.span
        if drive.first_missed == 0.0:
            assert error[0] <= 1e-8 * model.output.span
        else:
            assert error[0] > 1e-10 * model.output.span


def test_first_value_that_the_settled_curve_steps_over_is_taken_nearest() -> None:
    model = ActuatorModel(
        "forward", Quantity("voltage", "V", 0.0, 4.0), Quantity("displacement", None, 0.0, 10.0),
        (BacklashStage([1.0] * 4, [1.0, 2.0, 3.0, 4.0]),),
    )  # fmt: skip
    reached = [
        model.simulate([v], model.start(v)).y[0] for v in np.linspace(0.0, 4.0, 4001)
    ]
    jump = int(np.argmax(np.diff(reached)))
    target = 0.25 * reached[jump] + 0.75 * reached[jump + 1]
    begin = model.start_compensation(target, "auto", limits_of(model))
    drive = model.compensate([target, target], begin, limits=limits_of(model))
    back = model.simulate(drive.y, model.start(drive.y[0]))
    assert back.y[0] == pytest.approx(reached[jump + 1], abs=0.02)
    assert drive.first_missed == pytest.approx(target - back.y[0], abs=1e-12)
    assert back.y[1] == pytest.approx(target, abs=1e-12)
    assert drive.clipped_count == 0


def test_what_the_start_misses_is_told_in_the_unit_of_what_was_wanted() -> None:
    gears = BacklashStage([1.0] * 4, [1.0, 2.0, 3.0, 4.0])
    plain = ActuatorModel(
        "forward",
        Quantity("v", "V", 0.0, 4.0),
        Quantity("y", "um", 0.0, 10.0),
        (gears,),
    )
    scaled = ActuatorModel(
        "forward",
        plain.input,
        Quantity("y", "nm", 0.0, 1e4),
        (gears, ScaleStage(1e3, 0.0)),
    )
    limits = DriveLimits(0.0, 4.0)
    reached = np.array(
        [plain.simulate([v], plain.start(v)).y[0] for v in np.linspace(0.0, 4.0, 401)]
    )
    jump = int(np.argmax(np.diff(reached)))
    target = float(0.3 * reached[jump] + 0.7 * reached[jump + 1])
    missed = []
    for model, factor in ((plain, 1.0), (scaled, 1e3)):
        begin = model.start_compensation(factor * target, "auto", limits)
        missed.append(
            model.compensate([factor * target], begin, limits=limits).first_missed
            / factor
        )
    assert abs(missed[0]) > 0.01
    assert missed[1] == pytest.approx(missed[0], rel=1e-9)


def test_a_start_beside_a_step_survives_rounding() -> None:
    """The voltage of a start is written, read and scaled: a few last digits must not begin another state."""
    rng = np.random.default_rng(5)
    beside = 0
    for _ in range(60):
        gears = BacklashStage(
            [0.144] * 25, 0.144 * np.sort(rng.uniform(0.3, 1.7, 25)), 0.3
        )
        low, high = gears.y_range
        for target in rng.uniform(low, high, 8):
            found = start_drive(gears, float(target))
            beside += abs(found.reached - target) > 1e-6
            for nudged in (
                found.voltage * (1.0 + 4e-16),
                found.voltage * (1.0 - 4e-16),
            ):
                assert start_state(gears, nudged, "auto") == found.state
    assert beside > 5  # the settled curve has steps, and some values lie in them


def test_the_range_holds_to_the_last_bit_behind_points() -> None:
    worst = 0.0
    for seed in range(120):
        rng = np.random.default_rng(seed)
        points = PointStage(
            rng.uniform(0.5, 1.5, 5),
            rng.uniform(0.5, 1.5, 5),
            rng.normal(),
            rng.normal(),
        )
        low, high = points.y_range
        gears = BacklashStage(
            np.full(9, (high - low) / 9), rng.uniform(0.3, 1.7, 9), low
        )
        model = ActuatorModel(
            "forward",
            Quantity("v", "V", *points.x_range),
            Quantity("y", None, 0.0, 9.0),
            (points, gears),
        )
        ends = np.sort(rng.uniform(*points.x_range, 2))
        limits = DriveLimits(float(ends[0]), float(ends[1]))
        desired = rng.uniform(-3.0, 12.0, 60)
        begin = model.start_compensation(float(desired[0]), "auto", limits)
        drive = model.compensate(desired, begin, limits=limits).y
        worst = max(
            worst,
            float((drive - limits.v_max).max()),
            float((limits.v_min - drive).max()),
        )
    assert worst <= 0.0


def test_the_step_before_the_very_first_sample_does_not_matter() -> None:
    model = build(4, relaxation=True, delay=0.02)
    x = np.linspace(*model.backlash.x_range, 40)
    outputs = []
    for first in (0.0, 0.005, 123.0, -7.0):
        steps = np.full(40, 0.005)
        steps[0] = first
        outputs.append(
            model.simulate(x, model.start(x[0]), time_step=steps).y.tobytes()
        )
    assert outputs[1:] == outputs[:1] * 3


@pytest.mark.parametrize("start", ["empty", "full"])
def test_a_slew_limit_holds_from_the_end_where_the_actuator_stands(start: Any) -> None:
    model = build(2)
    low, high = model.input.minimum, model.input.maximum
    limits = DriveLimits(low, high, 0.05 * (high - low))
    middle = model.output.minimum + 0.5 * model.output.span
    begin = model.start_compensation(middle, start, limits)
    drive = model.compensate([middle, middle], begin, limits=limits, time_step=1.0).y
    way = drive - low if start == "empty" else high - drive
    assert way == pytest.approx([0.05 * (high - low), 0.1 * (high - low)])


def test_a_state_serves_model_and_inverse_though_a_gain_inverted_twice_is_rounded() -> (
    None
):
    rounded = 0
    for gain in np.random.default_rng(8).uniform(1.0, 20.0, 50):
        model = ActuatorModel(
            "forward", VOLTAGE, OUTPUT, (GEARS, ScaleStage(float(gain), 0.7))
        )
        again = model.inverse().inverse()
        rounded += again.stages[1] != model.stages[1]
        assert again.digest == model.inverse().digest == model.digest
    assert rounded > 3


def test_a_whole_number_of_even_samples_shifts_exactly_though_the_quotient_is_rounded() -> (
    None
):
    assert 0.3 / 0.1 < 3.0
    x = 5.0 + np.random.default_rng(7).normal(size=50)
    for steps in (0.1, np.full(50, 0.1)):
        y, history = DelayStage(0.3).lag(x, steps, None)
        assert y[3:].tobytes() == x[:-3].tobytes()
        # before the first sample the first value holds
        assert y[:3].tolist() == [x[0]] * 3
        assert history is not None
        rest, _ = DelayStage(0.3).lag(x, steps, history)
        assert rest[:3].tobytes() == x[-3:].tobytes()


def test_a_stamped_clock_shifts_whole_samples_exactly_there_and_back() -> None:
    x = np.random.default_rng(6).normal(size=200)
    time = 0.1 + np.arange(200) * 0.1
    shifted, _ = DelayStage(0.3).lag(x, np.diff(time, prepend=0.0), None)
    assert shifted[3:].tobytes() == x[:-3].tobytes()
    [(_, ahead)] = read_ahead([(None, time, shifted)], 0.3)
    assert ahead[:-3].tobytes() == x[:-3].tobytes()


@pytest.mark.parametrize("slew", [None, 40.0])
def test_limits_clip_count_and_keep_the_state(slew: float | None) -> None:
    for seed in range(12):
        model = build(seed, relaxation=seed % 2 == 0)
        desired = wanted(model, seed, share=0.8)
        span = model.input.span
        bounds = DriveLimits(model.input.minimum + 0.1 * span, model.input.maximum - 0.1 * span,
                             None if slew is None else slew * span)  # fmt: skip
        begin = model.start_compensation(desired[0], "auto", bounds)
        drive = model.compensate(desired, begin, limits=bounds, time_step=0.001)
        assert drive.clipped_count > 0
        assert drive.y.min() >= bounds.v_min
        assert drive.y.max() <= bounds.v_max
        if slew is not None:
            assert np.abs(np.diff(drive.y)).max() <= 0.001 * slew * span * (1.0 + 1e-9)
        back = model.simulate(drive.y, model.start(drive.y[0]), time_step=0.001)
        assert back.state == drive.state


def bent(seed: int, relaxation: bool = False) -> ActuatorModel:
    """Return a model whose drive passes points before it meets the gears."""
    straight = build(seed, relaxation)
    low, high = straight.input.minimum, straight.input.maximum
    rises = np.random.default_rng(seed).uniform(0.5, 1.5, 8)
    points = PointStage(
        [(high - low) / 8.0] * 8, rises * (high - low) / rises.sum(), low, low
    )
    return ActuatorModel(
        "forward", straight.input, straight.output, (points, *straight.stages)
    )


@pytest.mark.parametrize("slew", [None, 40.0])
def test_points_before_the_gears_invert_and_keep_the_limits(slew: float | None) -> None:
    for seed in range(12):
        model = bent(seed, relaxation=seed % 2 == 0)
        assert (
            model.inverse().inverse().backlash.dx.tolist() == model.backlash.dx.tolist()
        )
        assert slow_output_range(
            model.stages, model.input.minimum, model.input.maximum
        ) == pytest.approx((model.output.minimum, model.output.maximum), rel=1e-12)
        span = model.input.span
        bounds = DriveLimits(model.input.minimum + 0.1 * span, model.input.maximum - 0.1 * span,
                             None if slew is None else slew * span)  # fmt: skip
        desired = wanted(model, seed, share=0.8)
        drive = model.compensate(
            desired,
            model.start_compensation(desired[0], "auto", bounds),
            limits=bounds,
            time_step=0.001,
        )
        assert drive.clipped_count > 0
        assert drive.y.min() >= bounds.v_min
        assert drive.y.max() <= bounds.v_max
        if slew is not None:
            assert np.abs(np.diff(drive.y)).max() <= 0.001 * slew * span * (1.0 + 1e-9)
        back = model.simulate(drive.y, model.start(drive.y[0]), time_step=0.001)
        assert back.state.backlash.bits == drive.state.backlash.bits
        free = wanted(model, seed, share=0.25)
        drive = model.compensate(
            free, model.start_compensation(free[0], "auto", limits_of(model)), limits=limits_of(model),
            time_step=0.001,
        )  # fmt: skip
        back = model.simulate(drive.y, model.start(drive.y[0]), time_step=0.001)
        assert drive.clipped_count == 0
        assert np.abs(back.y - free)[1:].max() <= 1e-10 * model.output.span


@pytest.mark.parametrize("delay", [0.0, 0.003, 0.0137])
@pytest.mark.parametrize("even", [True, False])
def test_blocks_of_any_size_give_the_same_bits(delay: float, even: bool) -> None:
    model = build(4, relaxation=True, delay=delay)
    rng = np.random.default_rng(6)
    x = rng.uniform(*model.forward_backlash.x_range, 200)
    steps: Any = 0.001 if even else rng.uniform(0.0, 0.004, 200)
    inverse = model.inverse()
    for one, signal in ((model, x), (inverse, wanted(model, 1, count=200))):
        whole = one.simulate(signal, one.start(signal[0]), time_step=steps)
        for size in (1, 3, 64, 199):
            state, parts = one.start(signal[0]), []
            for begin in range(0, 200, size):
                own = steps if even else steps[begin : begin + size]
                part = one.simulate(signal[begin : begin + size], state, time_step=own)
                state = part.state
                parts.append(part.y)
            assert np.concatenate(parts).tobytes() == whole.y.tobytes()
            assert state == whole.state


def test_delay_shifts_whole_samples_exactly_and_interpolates_between() -> None:
    plain = ActuatorModel(
        "forward", VOLTAGE, Quantity("displacement", "um", 0.0, 3.5), (GEARS,)
    )
    x = 1.8 - 1.8 * np.cos(np.arange(100) / 9.0)
    undelayed = plain.simulate(x, plain.start(x[0])).y
    late = ActuatorModel("forward", VOLTAGE, plain.output, (GEARS, DelayStage(0.015)))
    y = late.simulate(x, late.start(x[0]), time_step=0.005).y
    assert y[3:].tobytes() == undelayed[:-3].tobytes()
    assert y[:3].tolist() == [undelayed[0]] * 3
    by_time = late.simulate(x, late.start(x[0]), time_step=np.full(100, 0.005)).y
    np.testing.assert_allclose(by_time, y, rtol=0.0, atol=1e-12)
    half = ActuatorModel("forward", VOLTAGE, plain.output, (GEARS, DelayStage(0.0125)))
    y = half.simulate(x, half.start(x[0]), time_step=0.005).y
    between = shifted_by_part(undelayed, 2, 0.5)
    np.testing.assert_allclose(y[5:], between, rtol=0.0, atol=1e-12)
    linear = dataclasses.replace(half, stages=(GEARS, DelayStage(0.0125, "linear")))
    y = linear.simulate(x, linear.start(x[0]), time_step=0.005).y
    np.testing.assert_allclose(
        y[3:], 0.5 * (undelayed[1:-2] + undelayed[:-3]), rtol=0.0, atol=1e-12
    )
    assert late.delay_seconds == late.inverse().delay_seconds == 0.015
    assert late.inverse().inverse().stages[-1] == DelayStage(0.015)


def test_starts() -> None:
    model = ActuatorModel(
        "forward", VOLTAGE, Quantity("displacement", "um", 0.0, 3.5), (GEARS,)
    )
    assert model.start(0.0).backlash == model.start(-1.0).backlash == GEARS.empty()
    assert (
        model.start(2.0).backlash
        == model.start(2.0, "settled").backlash
        == GEARS.settled(2.0)
    )
    assert model.start(2.0, "full").backlash == GEARS.full()
    assert model.start(2.0, "empty").backlash == GEARS.empty()
    saved = ModelState(BacklashState(5))
    assert model.start(2.0, saved) is saved
    with pytest.raises(ModelError) as problem:
        model.start(2.0, "half")  # type: ignore[arg-type]
    assert str(problem.value) == (
        "no initial state is called 'half'; there are: auto, empty, full, settled"
    )
    with pytest.raises(ModelError, match="no initial state is called 'half'"):
        model.inverse().start(2.0, "half")  # type: ignore[arg-type]


def test_inverse_starts_where_the_forward_model_would() -> None:
    """Even widths and slopes that grow: the settled curve never falls, the first voltage is found again."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        n = int(rng.integers(1, 130))
        gears = BacklashStage(
            np.full(n, 0.1), 0.1 * np.sort(rng.uniform(0.3, 1.7, n)), 1.0, -2.0
        )
        low, high = gears.x_range
        model = ActuatorModel(
            "forward", Quantity("voltage", "V", low, high), OUTPUT, (gears,)
        )
        for voltage in (
            low,
            low - 0.5,
            high,
            high + 0.5,
            low + rng.uniform() * (high - low),
        ):
            begin = model.start(voltage)
            y = model.simulate([voltage], begin).y[0]
            found = model.inverse().start(y)
            assert found.backlash == begin.backlash
            back = model.inverse().simulate([y], found)
            assert back.y[0] == pytest.approx(
                voltage, rel=0.0, abs=1e-11 * (high - low)
            )


def test_trajectory_beyond_reach_is_clipped_and_counted() -> None:
    model = build(3)
    limits = limits_of(model)
    low, span = model.output.minimum, model.output.span
    desired = low + span * np.array([1.2, 1.0, 0.5, -0.1])
    drive = model.compensate(
        desired, model.start_compensation(desired[0], "auto", limits), limits=limits
    )
    assert (drive.clipped_count, drive.first_clipped, drive.first_missed) == (2, 0, 0.0)
    assert {float(drive.y[0]), float(drive.y[3])} == {limits.v_min, limits.v_max}
    full_scale = low + span * np.array([0.0, 1.0, 0.0, 1.0])
    begin = model.start_compensation(full_scale[0], "auto", limits)
    assert model.compensate(full_scale, begin, limits=limits).clipped_count == 0


def test_outside_error_names_the_sample() -> None:
    model = ActuatorModel(
        "forward", VOLTAGE, Quantity("displacement", "um", 0.0, 3.5), (GEARS,)
    )
    with pytest.raises(OutsideError) as problem:
        model.simulate([1.0, 2.0, 4.0], model.start(1.0), outside="error")
    assert (problem.value.index, problem.value.value) == (2, 4.0)
    assert str(problem.value).startswith(
        "sample 3: 4.0 is outside the range of the model, 0.0 to 3.6"
    )


def test_slow_output_range_includes_relaxation_at_rest_and_the_sign() -> None:
    gears = BacklashStage(
        [1.0, 1.0], [1.0, 3.0], 0.0, 0.0, Relaxation(0.5, (1.0, 9.0), (0.25, 0.25))
    )
    assert slow_output_range([gears], 0.0, 2.0) == (-0.25, 4.75)
    assert slow_output_range([gears, ScaleStage(-2.0, 1.0)], 0.0, 2.0) == (-8.5, 1.5)
    assert slow_output_range([gears, DelayStage(1.0)], -1.0, 3.0) == (-3.75, 8.25)


def test_needs_time_is_said() -> None:
    for model in (build(1, relaxation=True), build(1, delay=0.01)):
        assert model.needs_time
        with pytest.raises(ModelError) as problem:
            model.simulate([1.0, 2.0], model.start(1.0))
        assert (
            str(problem.value)
            == "this needs the time between samples (a time column, or `sample_rate`)"
        )
    assert not build(1).needs_time
    assert not build(1, delay=0.01).inverse().needs_time


def test_require_names_the_remedy() -> None:
    model = build(1)
    with pytest.raises(ModelError) as problem:
        model.inverse().require("forward", "inv.json")
    assert str(problem.value) == (
        "inv.json: is an inverse model where a forward one is needed (dbo invert turns it)"
    )
    with pytest.raises(
        ModelError,
        match=r"^the model: is a forward model where an inverse one is needed",
    ):
        model.require("inverse")


CREEPING = BacklashStage([1.0], [1.0], 0.0, 0.0, Relaxation(0.0, (1.0,), (0.1,)))
WRONG: list[tuple[Any, tuple[Any, ...], str]] = [
    ("forward", (), "stages: no backlash stage is among them"),
    ("inverse", (ScaleStage(1.0, 0.0),), "stages: no backlash stage is among them"),
    ("forward", (GEARS, GEARS), "stages[1]: only one backlash stage is possible"),
    ("forward", (GEARS, DelayStage(0.1), ScaleStage(1.0, 0.0)), "stages[1]: a delay stands last"),
    ("inverse", (ScaleStage(1.0, 0.0), DelayStage(-0.1), GEARS), "stages[1]: a delay stands first"),
    ("forward", (GEARS, DelayStage(-0.1)), "stages[1].seconds: -0.1 has the wrong sign here"),
    ("inverse", (CREEPING,), "stages[0].relaxation.on: must be 'output' in this direction"),
]  # fmt: skip


@pytest.mark.parametrize(("direction", "stages", "message"), WRONG)
def test_cascades_that_are_refused(direction: Any, stages: Any, message: str) -> None:
    with pytest.raises(ModelError) as problem:
        ActuatorModel(direction, VOLTAGE, OUTPUT, stages)
    assert str(problem.value) == message


def test_digest_is_of_the_gears_not_of_the_direction() -> None:
    assert build(1).digest == build(1).inverse().digest != build(2).digest


def test_gears_beyond_what_the_model_covers_do_not_move_its_starts() -> None:
    """More gears at the end than the input range needs: full, settled and hold stay inside the range."""
    widths, slopes = np.full(40, 0.25), np.linspace(0.5, 1.5, 40)
    covered = ActuatorModel(
        "forward", Quantity("voltage", "V", 0.0, 10.0), Quantity("displacement", "um", 0.0, 10.0),
        (BacklashStage(widths, widths * slopes),),
    )  # fmt: skip
    more = ActuatorModel(
        "forward", covered.input, covered.output,
        (BacklashStage(np.full(45, 0.25), 0.25 * np.append(slopes, np.full(5, 1.5))),),
    )  # fmt: skip
    for model, twin in ((more, covered), (more.inverse(), covered.inverse())):
        for state in ("auto", "settled", "full", "empty"):
            for first in (0.0, 3.3, 7.7, 9.9):
                assert (
                    model.start(first, state).backlash.bits
                    == twin.start(first, state).backlash.bits
                )  # type: ignore[arg-type]
    beyond = [2.0, 9.0, 12.0, 15.0, 9.0]
    held = more.simulate(beyond, more.start(2.0), outside="hold")
    assert (
        held.y.tolist()
        == covered.simulate(beyond, covered.start(2.0), outside="hold").y.tolist()
    )
    assert (held.outside_count, held.first_outside) == (2, 2)
    # it turns there as inside
    assert more.simulate([10.5, 10.0], more.start(0.0, "empty")).y[1] > 10.0


def test_an_inverse_read_without_its_axis_starts_like_the_one_made() -> None:
    forward = build(3)
    made = forward.inverse()
    gears = made.backlash
    read = ActuatorModel(
        "inverse", made.input, made.output,
        (*made.stages[:-1], BacklashStage(gears.dx, gears.dy, gears.x0, gears.y0)),
    )  # fmt: skip
    middle = 0.5 * (made.input.minimum + made.input.maximum)
    for state in ("auto", "settled", "full", "empty"):
        assert read.start(middle, state) == made.start(middle, state)  # type: ignore[arg-type]


def test_digest_tells_models_of_another_gain_or_curve_apart() -> None:
    model = build(2)
    louder = ActuatorModel(
        "forward",
        model.input,
        model.output,
        (*model.stages[:-1], ScaleStage(14.0, 0.7)),
    )
    straight = ActuatorModel(
        "forward", model.input, model.output, (model.stages[0], model.stages[2])
    )
    assert len({model.digest, louder.digest, straight.digest}) == 3
    assert model.inverse().digest == model.digest


def test_gears_to_spare_are_told_whatever_the_range_is() -> None:
    """The edges of gears are sums of rounded widths, which no start may hang on."""
    chance = np.random.default_rng(1)
    for _ in range(60):
        low = float(chance.uniform(-50.0, 50.0)) * float(chance.random() < 0.5)
        span = float(chance.uniform(1.0, 300.0))
        count = int(chance.choice([1024, 4096]))
        spare = count // 8
        widths = np.full(count + 2 * spare, span / count)
        heights = np.full(widths.size, 1.0 / count)
        gears = DiscreteBacklashOperator(
            widths, heights, low - spare * widths[0], -spare / count
        )
        covered = covered_gears(gears, low, low + span)
        assert spare_bits(gears, low, low + span) == ((1 << spare) - 1) << count
        assert (covered.x0, covered.n) == (low, count)
