"""Drives: pieces on one clock through one state past one gate; no limit broken, no step at a join."""

from __future__ import annotations

import itertools
import re
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_hysteresis_model import build, wanted
from test_runs_repeated import RATE, actuator, move, period
from trials import Floats

from dbo_cli.drives.gate import DriveGate, GateError
from dbo_cli.drives.options import require_one_unit
from dbo_cli.errors import InputError, LimitError, UsageError
from dbo_cli.extras.live.converter import Converter
from dbo_cli.hysteresis.dynamics import DynamicsStage, Lag
from dbo_cli.hysteresis.model import ActuatorModel, DriveLimits
from dbo_cli.hysteresis.stepper import may_follow
from dbo_cli.runs.api import Model


def steps_of(drive: Floats) -> Floats:
    found: Floats = np.abs(np.diff(drive))
    return found


def exactly_kept(
    drive: Floats, limits: DriveLimits, seconds: float, last: float | None = None
) -> bool:
    """Tell whether every row keeps the limits in rational arithmetic, the last digits of a step aside."""
    rows = ([] if last is None else [last]) + drive.tolist()
    inside = all(
        limits.v_min <= v <= limits.v_max for v in rows[int(last is not None) :]
    )
    if limits.max_slew is None:
        return inside
    most = Fraction(limits.max_slew) * Fraction(seconds)
    digits = Fraction(2) ** -49 * max(
        abs(Fraction(limits.v_min)), abs(Fraction(limits.v_max))
    )
    # than this by their difference alone, whose rounding is far below
    slower = float(most) * (1.0 - 1e-9)
    return inside and all(
        abs(b - a) < slower or abs(Fraction(b) - Fraction(a)) <= most + digits
        for a, b in itertools.pairwise(rows)
    )


def prompt(**more: Any) -> dict[str, Any]:
    return {"sample_rate": RATE, "details": True, "on_limit": "clip", **more}


@pytest.mark.parametrize("delay", [0.0, 2.5 / RATE])
@pytest.mark.parametrize("frequency", [None, 800.0])
@pytest.mark.parametrize(
    "more", [{}, {"periodic": True}, {"from_": 20.0, "approach": "auto"}]
)
def test_what_clipped_samples_cost_is_what_the_model_misses(
    delay: float, frequency: float | None, more: dict[str, Any]
) -> None:
    model, wanted = (
        actuator(frequency=frequency, delay=delay),
        period() if "periodic" in more else move(10.0),
    )
    done = Model(model).compensate(wanted, **prompt(v_max=60.0, **more))
    found = re.search(
        r"by which the move misses (\S+) um RMS, (\S+) um at worst", done.warnings[0]
    )
    assert found is not None
    drive = np.tile(done.values, 40) if "periodic" in more else done.values
    begun = model.start(float(drive[0]), "auto")
    missed = (
        model.simulate(drive, begun, time_step=1.0 / RATE).y[-wanted.size :] - wanted
    )
    assert float(found[1]) == pytest.approx(
        float(np.sqrt(np.mean(missed**2))), rel=0.03
    )
    assert float(found[2]) == pytest.approx(float(np.abs(missed).max()), rel=0.06)


# --- the gate ---


def test_the_gate_names_the_first_row_that_breaks_a_limit() -> None:
    gate = DriveGate(DriveLimits(0.0, 10.0, 100.0), last=5.0)
    gate.admit(np.array([5.5, 6.0, 7.0]), 0.01)
    with pytest.raises(
        GateError, match=r"from 7 to 8\.5 in one row is faster than 100 per second"
    ):
        gate.admit(np.array([8.5]), 0.01)
    for row, text in ((10.5, "10.5 is outside 0 to 10"), (np.nan, "nan is no voltage")):
        with pytest.raises(GateError, match=text):
            DriveGate(DriveLimits(0.0, 10.0)).admit(np.array([1.0, row]))
    assert GateError.exit_code == 1


@pytest.mark.parametrize("last", [None, 0.0, np.inf, -np.inf])
@pytest.mark.parametrize("row", [np.inf, -np.inf, np.nan])
def test_the_gate_lets_no_infinite_row_through_whatever_its_range(
    row: float, last: float | None
) -> None:
    for limits in (
        DriveLimits(-np.inf, np.inf),
        DriveLimits(0.0, np.inf),
        DriveLimits(-np.inf, 5.0),
    ):
        with pytest.raises(GateError, match=f"breaks its limits: {row} is no voltage;"):
            DriveGate(limits, last).admit(np.array([1.0, row, 2.0]))
        assert DriveGate(limits, last).broken(np.array([row])).all()
    assert (
        DriveGate(DriveLimits(-np.inf, np.inf), last).violation(np.array([1e308])) == ""
    )


@pytest.mark.parametrize("volts", [np.inf, -np.inf, np.nan])
@pytest.mark.parametrize("last", [np.nan, 0.0])
def test_no_infinite_row_follows_another(volts: float, last: float) -> None:
    assert not may_follow(volts, last, -np.inf, np.inf, np.inf)
    assert may_follow(1e308, last, -np.inf, np.inf, np.inf)


def test_from_outside_its_range_a_drive_may_only_come_inwards() -> None:
    limits = DriveLimits(0.0, 10.0)
    assert (
        DriveGate(limits, last=14.0).violation(np.array([13.0, 12.0, 9.0, 8.0])) == ""
    )
    found = DriveGate(limits, last=14.0).violation(np.array([13.0, 13.5, 9.0]))
    assert found == "13.5 is outside 0 to 10"
    bad = DriveGate(limits, last=-3.0).broken(np.array([-1.0, 5.0, -0.5]))
    assert bad.tolist() == [False, False, True]


def test_infinite_limits_switch_nothing_off() -> None:
    times = np.array([0.0, 0.0, 0.01, 0.02])
    model = Model(build(1, False))
    top = model.input.minimum + 0.4 * model.input.span
    clip: dict[str, Any] = {"details": True, "state": "empty", "on_limit": "clip"}
    for more in ({"max_slew": np.inf}, {"max_slew": np.inf, "v_min": -np.inf}, {}):
        ends = [
            model.output.maximum,
            model.output.minimum,
            model.output.maximum,
            model.output.maximum,
        ]
        done = model.compensate(ends, **clip, time=times, v_max=top, **more)
        assert done.values.max() == top and done.clipped > 0
    far = [model.output.maximum + 0.05] * 3
    wide = model.compensate(far, **clip, sample_rate=10.0, v_max=1e12)
    # the gain is negative: more displacement than the lower limit gives
    assert wide.clipped == 3


# --- joins ---


@pytest.mark.parametrize("slew", [None, 9000.0, 2000.0])
def test_a_sweep_joins_the_move_of_a_model_with_dynamics(slew: float | None) -> None:
    """As the issue measured it: the last row of the sweep was 0 V, the first of the move 150 V."""
    plant = actuator()
    for first in (1.5, 6.0, 10.0):
        done = Model(plant).compensate(
            first + 0.05 * (move() - 6.0), **prompt(condition=True, max_slew=slew)
        )
        join = int(np.searchsorted(done.time, -1e-9))
        steps = steps_of(done.values)
        assert steps[join - 3 : join + 3].max() <= max(
            steps[: join - 3].max(), steps[join + 3 :].max()
        )
        assert exactly_kept(done.values, DriveLimits(0.0, 100.0, slew), 1.0 / RATE)
        whole = plant.simulate(done.values, plant.start(0.0), time_step=1.0 / RATE).y
        away = np.abs(whole[join:] - (first + 0.05 * (move() - 6.0)))
        assert away.max() < 1e-6 * plant.output.span
        assert done.clipped == 0


@pytest.mark.parametrize("relaxation", [False, True])
def test_a_sweep_leads_to_the_state_the_move_goes_on_from(relaxation: bool) -> None:
    for seed in range(6):
        actuator_ = build(seed, relaxation)
        desired, slew = wanted(actuator_, seed, share=0.3), 200.0 * actuator_.input.span
        done = Model(actuator_).compensate(
            desired, sample_rate=1000.0, condition=True, max_slew=slew, details=True
        )
        assert done.time is not None
        assert np.diff(done.time) == pytest.approx(0.001)
        assert exactly_kept(done.values, limits_of(actuator_, slew), 0.001)
        back = actuator_.simulate(
            done.values, actuator_.start(float(done.values[0])), time_step=0.001
        )
        assert back.state.backlash == done.state.backlash
        assert (
            np.abs(back.y[-desired.size :] - desired)[100:].max()
            <= 1e-11 * actuator_.output.span
        )


def limits_of(model: ActuatorModel, slew: float | None) -> DriveLimits:
    return DriveLimits(model.input.minimum, model.input.maximum, slew)


def test_a_sweep_stays_within_the_identified_range() -> None:
    model = Model(actuator(frequency=None))
    wide = prompt(condition=True, v_min=-50.0, v_max=150.0, extrapolate=True)
    done = model.compensate(np.full(200, 5.0), **wide)
    assert (
        done.values.min() == pytest.approx(0.0, abs=1e-4) and done.values.max() == 100.0
    )
    with pytest.raises(UsageError) as refused:
        model.compensate(np.full(200, 5.0), **wide | {"v_min": 120.0})
    assert str(refused.value) == (
        "`condition` sweeps the range on which the model was identified, 0 to 100 V, and the limits leave "
        "nothing of it"
    )


@pytest.mark.parametrize("passes", [0, 1, 2, 3])
@pytest.mark.parametrize("slew", [None, 900.0, 5000.0])
def test_a_loop_its_run_in_and_its_seam_keep_the_slew(
    passes: int, slew: float | None
) -> None:
    plant, desired = actuator(frequency=None), period()
    limits = DriveLimits(0.0, 100.0, slew)
    try:
        done = Model(plant).compensate(
            desired, **prompt(periodic=True, passes=passes, max_slew=slew)
        )
    except LimitError as refused:
        assert slew == 900.0 and "loop" in str(refused)
        return
    drive = done.values
    assert drive.size == (passes + 1) * desired.size
    assert exactly_kept(drive, limits, 1.0 / RATE)
    loop = drive[-desired.size :]
    assert exactly_kept(np.append(loop, loop[0]), limits, 1.0 / RATE)
    inside = max(
        steps_of(loop).max(), steps_of(drive[: -desired.size]).max(initial=0.0)
    )
    if passes:
        assert abs(drive[-desired.size] - drive[-desired.size - 1]) <= inside


def test_what_the_run_in_cannot_reach_is_refused() -> None:
    model, desired = Model(actuator(frequency=None)), period()
    with pytest.raises(LimitError, match="beyond what the limits of the drive allow"):
        model.compensate(
            desired, **prompt(periodic=True, passes=1, max_slew=300.0, on_limit="error")
        )


def test_a_saved_state_is_where_the_drive_comes_from() -> None:
    model = Model(actuator(frequency=None))
    _, state = model.simulate(np.full(20, 91.9), sample_rate=RATE, return_state=True)
    fall = np.full(400, 5.0)
    with pytest.raises(
        LimitError, match=r"comes from 91\.9 V, .*`approach` SECONDS ramps there"
    ):
        model.compensate(fall, **prompt(state=state, v_max=50.0, max_slew=100.0))
    done = model.compensate(
        fall, **prompt(state=state, v_max=50.0, max_slew=2000.0, approach="auto")
    )
    assert done.time is not None and done.time[0] < 0.0 and done.values[0] < 91.9
    outside = done.values > 50.0
    assert (
        np.all(np.diff(done.values[outside]) < 0.0)
        and not outside[np.argmin(outside) :].any()
    )
    assert abs(done.values[0] - 91.9) <= 2000.0 / RATE * (1 + 1e-9)
    assert steps_of(done.values).max() <= 2000.0 / RATE * (1 + 1e-9)
    loop = dict(periodic=True, state=state, max_slew=200.0)
    with pytest.raises(LimitError, match="`approach`"):
        model.compensate(period(), **prompt(**loop))
    for passes in (0, 2):
        more = loop | {"max_slew": 8000.0, "passes": passes, "approach": "auto"}
        done = model.compensate(period(), **prompt(**more))
        assert exactly_kept(
            done.values, DriveLimits(0.0, 100.0, 8000.0), 1.0 / RATE, last=91.9
        )


def test_where_the_amplifier_stands_can_be_said_and_must_not_contradict() -> None:
    model = Model(actuator(frequency=None))
    wanted_ = np.full(400, 6.0)
    done = model.compensate(wanted_, **prompt(from_=20.0, max_slew=100.0))
    assert abs(done.values[0] - 20.0) <= 100.0 / RATE * (1 + 1e-9)
    ramped = model.compensate(wanted_, **prompt(from_=20.0, approach=0.1))
    assert ramped.values[0] == 20.0 and ramped.time is not None
    assert ramped.time[0] == pytest.approx(-0.1, abs=2.0 / RATE)
    # the creep is held up
    assert np.all(np.diff(ramped.values[ramped.time < 0.0]) >= -1e-4)
    _, state = model.simulate([30.0, 31.0], sample_rate=RATE, return_state=True)
    with pytest.raises(
        UsageError, match="`from_` 20 contradicts `state`, which was left at 31"
    ):
        model.compensate(wanted_, **prompt(from_=20.0, state=state))
    with pytest.raises(UsageError, match="`approach` needs `from_` VOLT"):
        model.compensate(wanted_, **prompt(approach="auto"))
    with pytest.raises(
        LimitError, match=r"`approach` 0\.01: faster than the slew limit allows"
    ):
        model.compensate(wanted_, **prompt(from_=90.0, approach=0.01, max_slew=100.0))
    (note,) = (
        n for n in model.compensate(wanted_, **prompt()).notes if "begins at" in n
    )
    assert "from where the amplifier comes is not known" in note


def test_a_return_ends_where_the_drive_came_from() -> None:
    model = Model(actuator())
    done = model.compensate(
        move(), **prompt(from_=12.0, approach="auto", return_=0.2, max_slew=9000.0)
    )
    assert done.values[-1] == 12.0 and done.time is not None
    assert done.time[-1] == pytest.approx(move().size / RATE + 0.2, abs=2 / RATE)
    assert exactly_kept(done.values, DriveLimits(0.0, 100.0, 9000.0), 1.0 / RATE)
    assert steps_of(done.values)[-4200:-3900].max() < steps_of(done.values).max()


@pytest.mark.parametrize("delay", [0.0, 3.0 / RATE])
@pytest.mark.parametrize("frequency", [200.0, 800.0, 3000.0])
def test_a_lead_makes_a_move_that_begins_in_motion_exact(
    frequency: float, delay: float
) -> None:
    plant = actuator(frequency=frequency, delay=delay)
    t = np.arange(800) / RATE
    moving = 6.0 + 0.4 * np.sin(2.0 * np.pi * 30.0 * t + 0.7)
    wide = prompt(v_min=-200.0, v_max=300.0, extrapolate=True, state="empty")
    plain = Model(plant).compensate(moving, **wide)
    assert (
        any(
            "begins on the move" in text and "`lead` auto" in text
            for text in plain.warnings
        )
        or delay
    )
    led = Model(plant).compensate(moving, **wide, lead="auto")
    assert led.time is not None
    before = int(np.searchsorted(led.time, -1e-12))
    assert before > 0
    reached = plant.simulate(
        led.values, plant.start(float(led.values[0]), "empty"), time_step=1.0 / RATE
    ).y
    assert np.abs(reached[before:] - moving)[0] <= 1e-9 * np.ptp(moving)
    assert np.abs(reached[before:] - moving).max() <= 1e-9 * np.ptp(moving)


def test_a_drive_lag_keeps_range_and_slew_to_the_bit() -> None:
    plant = actuator(frequency=None)
    lagging = ActuatorModel(
        "forward",
        plant.input,
        plant.output,
        (DynamicsStage((Lag(2e-3),)), *plant.stages),
    )
    rng = np.random.default_rng(5)
    desired = 6.0 + np.cumsum(rng.normal(0.0, 0.05, 400))
    for slew, top in ((1000.0, 1e12), (300.0, 60.0), (None, 60.0)):
        done = Model(lagging).compensate(
            desired, **prompt(max_slew=slew, v_max=top, state="empty")
        )
        assert exactly_kept(done.values, DriveLimits(0.0, top, slew), 1.0 / RATE)


# --- the amplifier ---


def test_a_current_is_a_slew_limit_and_the_load_is_said() -> None:
    model = Model(actuator(frequency=None))
    done = model.compensate(
        move(), **prompt(max_current=0.01, capacitance=2e-6, state="empty")
    )
    assert exactly_kept(done.values, DriveLimits(0.0, 100.0, 0.01 / 2e-6), 1.0 / RATE)
    (note,) = (n for n in done.notes if "into 2e-06 F" in n)
    assert "0.01 A at most" in note
    with pytest.raises(
        UsageError, match="`max_current` and `capacitance` belong together"
    ):
        model.compensate(move(), **prompt(max_current=0.01))


# --- converters ---


def test_a_converter_never_leaves_the_limits_and_never_stands_still() -> None:
    model = Model(actuator(frequency=None))
    rng = np.random.default_rng(3)
    for bits in (4, 8, 10, 16):
        curve = np.linspace(0.0, 100.0, 2**bits)
        for slew in (20.0, 200.0, 50_000.0, None):
            low, high = (0.0, 100.0) if bits == 4 else (30.0, 32.0)
            live = model.controller(
                RATE, v_min=low, v_max=high, max_slew=slew, dac=curve
            )
            moves = np.repeat(rng.uniform(1.0, 11.0, 40), 30)
            codes = [int(live.step(float(x))) for x in moves]
            volts = curve[codes]
            assert volts.min() >= low and volts.max() <= high
            if slew is not None:
                gap = curve[1] - curve[0]
                assert steps_of(volts).max(initial=0.0) <= max(slew / RATE, gap) * (
                    1.0 + 1e-9
                )
                travelled = np.cumsum(steps_of(volts))
                for span in (10, 100, 1000):
                    most = (travelled[span:] - travelled[:-span]).max()
                    assert most <= slew * span / RATE + gap * (1.0 + 1e-9)
    slow = model.controller(
        RATE,
        max_slew=200.0,
        dac=np.linspace(0.0, 100.0, 1024),
        state="empty",
        from_=0.0,
    )
    codes = [int(slow.step(11.0)) for _ in range(int(RATE))]
    assert 0.9 * 100.0 <= codes[-1] * 100.0 / 1023 <= 100.0  # half a second would do


def test_a_converter_without_a_code_inside_is_refused() -> None:
    with pytest.raises(
        UsageError,
        match=r"no code lies within the limits of the drive, 30\.15 to 30\.3",
    ):
        Converter(np.linspace(0.0, 120.0, 256), DriveLimits(30.15, 30.3), None)


def test_a_controller_goes_to_rest_by_a_ramp() -> None:
    model = Model(actuator(frequency=None))
    live = model.controller(RATE, max_slew=4000.0)
    for x in (5.0, 6.0, 7.0):
        live.step(x)
    way = np.array(live.close())
    assert way[-1] == 0.0 and steps_of(way).max() <= 4000.0 / RATE * (1 + 1e-12)
    codes = model.controller(RATE, max_slew=4000.0, dac=np.linspace(0.0, 100.0, 4096))
    codes.step(5.0)
    assert codes.close()[-1] == 0


# --- one way in ---


def test_units_are_brought_to_the_models_from_files_and_tables(tmp_path: Path) -> None:
    import pandas

    model = Model(actuator(frequency=None))
    volts = np.linspace(0.0, 90.0, 50)
    expected = model.simulate(volts, sample_rate=10.0)
    t = np.arange(50) / 10.0
    frame = pandas.DataFrame({"time_s": t, "voltage_kV": volts / 1000.0})
    frame.to_csv(tmp_path / "kv.csv", index=False)
    plain = pandas.DataFrame({"t": t, "voltage": volts / 1000.0})
    plain.attrs["units"] = {"voltage": "kV"}
    for given in (str(tmp_path / "kv.csv"), frame):
        assert np.allclose(model.simulate(given), expected, rtol=0.0, atol=1e-12)
    assert np.allclose(model.simulate(plain, time="t"), expected, rtol=0.0, atol=1e-12)
    with pytest.raises(InputError, match="displacement in um"):
        model.compensate(pandas.DataFrame({"time_s": t, "displacement_V": t}))


def test_dates_and_durations_are_times() -> None:
    model = Model(actuator(frequency=None))
    volts, t = np.linspace(0.0, 90.0, 50), np.arange(50) / 8.0
    expected = model.simulate(volts, time=t)
    for unit in ("ns", "us", "ms"):
        span = np.array(
            np.round(t * {"ns": 1e9, "us": 1e6, "ms": 1e3}[unit]),
            dtype=f"timedelta64[{unit}]",
        )
        assert np.array_equal(model.simulate(volts, time=span), expected)
        stamps = np.datetime64("2024-05-01T12:00:00", unit) + span
        assert np.allclose(
            model.simulate(volts, time=stamps), expected, rtol=0.0, atol=1e-9
        )
    with pytest.raises(InputError, match="sample 2 is missing"):
        model.simulate(
            [1.0, 2.0], time=np.array(["2024-01-01", "NaT"], dtype="datetime64[s]")
        )


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (
            np.ma.masked_array([1.0, 2.0, 3.0], mask=[False, True, False]),
            "sample 2 is masked",
        ),
        (np.array([True, False]), "is no array of numbers"),
        (np.array(["1", "2"]), "is no array of numbers"),
    ],
)
def test_what_holds_no_numbers_is_refused(given: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        Model(actuator(frequency=None)).simulate(given, sample_rate=10.0)


def test_truth_is_no_rate_and_a_state_is_of_its_model() -> None:
    model = Model(actuator(frequency=None))
    with pytest.raises(UsageError, match="`sample_rate` True: give a positive number"):
        model.simulate([1.0], sample_rate=True)
    other = Model(actuator(loop=0.3, frequency=None))
    _, state = other.simulate([1.0, 2.0], sample_rate=10.0, return_state=True)
    with pytest.raises(UsageError, match="`state`: is of another model"):
        model.simulate([1.0], sample_rate=10.0, state=state)


def test_going_on_at_a_repeated_stamp_gives_the_bits_of_one_run() -> None:
    model = Model(actuator(frequency=None))
    t = np.array([0.0, 0.1, 0.2, 0.2, 0.3, 0.4])
    volts = np.array([0.0, 30.0, 60.0, 70.0, 80.0, 20.0])
    whole = model.simulate(volts, time=t, details=True)
    first = model.simulate(volts[:3], time=t[:3], details=True)
    rest = model.simulate(volts[3:], time=t[3:], state=first.state, details=True)
    assert np.array_equal(np.concatenate([first.values, rest.values]), whole.values)


def test_rows_of_arrays_are_read_ahead_as_those_of_files() -> None:
    plant = actuator(delay=4.0 / RATE)
    whole = Model(plant).compensate(move(), **prompt(state="empty"))
    first = Model(plant).compensate(move(), rows="1:2500", **prompt(state="empty"))
    rest = Model(plant).compensate(move(), rows="2501:", **prompt(state=first.state))
    assert np.array_equal(np.concatenate([first.values, rest.values]), whole.values)


def two_units() -> dict[str, str | None]:
    return {"a": "V", "b": "kV"}


def test_plain_limits_of_channels_in_different_units_are_refused() -> None:
    with pytest.raises(UsageError) as refused:
        require_one_unit(two_units(), v_min=0.0, v_max=15.0)
    assert str(refused.value) == (
        "`v_max` 15: channel a is driven in V and channel b in kV: give the limit's unit"
    )
    require_one_unit(two_units(), v_min=0, v_max="15V")
    require_one_unit({"a": "V", "b": "V"}, v_max=15.0)
