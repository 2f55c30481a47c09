"""Fast, repeated and looped moves: rounding, learning from the last pass, the drive of a settled loop."""

from __future__ import annotations

import dataclasses
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import SMALL_MODEL
from trials import Floats

from dbo_cli.errors import InputError, LimitError, UsageError
from dbo_cli.extras.moves.settling import settling_seconds
from dbo_cli.hysteresis.cascade import slow_output_range
from dbo_cli.hysteresis.dynamics import DynamicsStage, Lag, Resonance
from dbo_cli.hysteresis.model import (
    ActuatorModel,
    BacklashStage,
    DelayStage,
    Quantity,
    Relaxation,
    ScaleStage,
    Stage,
)
from dbo_cli.logs.sources import ArraySource, WholeSource
from dbo_cli.runs.api import Model

RATE = 20_000.0
COUNT = 6_000
TIME = np.arange(COUNT) / RATE
VOLTAGE = Quantity("voltage", "V", 0.0, 100.0)


def actuator(
    loop: float = 0.45, frequency: float | None = 800.0, delay: float = 0.0
) -> ActuatorModel:
    """Return an actuator of 60 gears with creep, a lag and a resonance."""
    slopes = (1.0 - loop) + 2.0 * loop * np.linspace(0.0, 1.0, 60)
    widths = np.full(60, 100.0 / 60.0)
    creep = Relaxation(0.0, (0.4, 6.0), (0.001, 0.002))
    stages: list[Stage] = [
        BacklashStage(widths, 0.1 * widths * slopes, 0.0, 0.0, creep),
        ScaleStage(1.2, 0.5),
    ]
    low, high = slow_output_range(stages, 0.0, 100.0)
    if frequency is not None:
        stages.append(DynamicsStage((Lag(2e-4), Resonance(frequency, 0.02))))
    if delay:
        stages.append(DelayStage(delay))
    return ActuatorModel(
        "forward", VOLTAGE, Quantity("displacement", "um", low, high), tuple(stages)
    )


def played(
    plant: ActuatorModel,
    drive: Floats,
    noise: float = 0.002,
    seed: int = 0,
    start: Any = "empty",
) -> tuple[Floats, Floats]:
    """Return what an actuator does, and what a noisy sensor says of it."""
    y = plant.simulate(
        drive, plant.start(float(drive[0]), start), time_step=1.0 / RATE
    ).y
    return y, y + np.random.default_rng(seed).normal(0.0, noise, y.size)


def move(frequency: float = 40.0) -> Floats:
    """Return a burst of 8 um between two rests."""
    rise = np.clip((TIME - 0.005) / 0.05, 0.0, 1.0) * np.clip(
        (TIME[-1] - 0.005 - TIME) / 0.05, 0.0, 1.0
    )
    rise = rise**3 * (10.0 - 15.0 * rise + 6.0 * rise**2)
    wanted: Floats = 6.0 + 4.0 * rise * np.sin(2.0 * np.pi * frequency * TIME)
    return wanted


def rms(x: Floats) -> float:
    return float(np.sqrt(np.mean(x * x)))


WIDE = {
    "sample_rate": RATE,
    "v_min": -40.0,
    "v_max": 140.0,
    "extrapolate": True,
    "state": "empty",
    "details": True,
}


@pytest.mark.parametrize("delay", [0.0, 3.0 / RATE])
def test_a_model_with_dynamics_is_followed_to_rounding(delay: float) -> None:
    plant = actuator(delay=delay)
    wanted = move()
    done = Model(plant).compensate(wanted, **WIDE)
    reached, _ = played(plant, done.values)
    late = round(delay * RATE)
    assert np.abs(reached - wanted)[late:].max() < 1e-9
    again = Model(plant).simulate(done.values, sample_rate=RATE, state="empty")
    assert np.array_equal(again, reached)
    inverse = Model(plant).inverse().simulate(wanted, sample_rate=RATE, state="empty")
    assert np.abs(inverse - done.values).max() < 1e-9
    unaware = Model(actuator(frequency=None)).compensate(wanted, **WIDE)
    assert rms(played(plant, unaware.values)[0] - wanted) > 0.1


def test_clipping_by_corners_is_told_from_clipping_by_place() -> None:
    corner = np.interp(TIME, [0.0, 0.1, 0.15, 0.2, 0.3], [1.0, 1.0, 12.0, 1.0, 1.0])
    done = Model(actuator()).compensate(
        corner, sample_rate=RATE, on_limit="clip", details=True
    )
    assert done.clipped > 0
    assert any("corners and the speed of the trajectory" in note and "`bandwidth` 267" in note
               for note in done.notes)  # fmt: skip
    clip: dict[str, Any] = {"sample_rate": RATE, "on_limit": "clip", "details": True}
    rounded = Model(actuator()).compensate(corner, bandwidth=100.0, **clip)
    assert rounded.clipped < done.clipped
    (note,) = (note for note in rounded.notes if "takes off" in note)
    assert (
        note == "`wanted`: `bandwidth` 100 takes off 0.0186 um (RMS), 0.248 um at most"
    )


def test_a_rounded_move_goes_on_where_it_ends() -> None:
    """What the inverse reads ahead by is the rounded move; it was one that stops dead at the last row."""
    corners = np.interp(TIME, [0.0, 0.1, 0.2, 0.3], [3.0, 3.0, 9.0, 5.0])
    held = np.concatenate([corners, np.full(2000, corners[-1])])
    for plant in (
        actuator(),
        actuator(delay=0.003),
        actuator(frequency=None, delay=0.003),
    ):
        model = Model(plant)
        drive = model.compensate(
            corners, sample_rate=RATE, bandwidth=100.0, state="empty"
        )
        longer = model.compensate(
            held, sample_rate=RATE, bandwidth=100.0, state="empty"
        )
        assert np.abs(drive - longer[: drive.size]).max() < 1e-9


def test_a_move_that_ends_on_the_move_is_warned_of() -> None:
    wanted = np.interp(TIME, [0.0, 0.1, TIME[-1]], [3.0, 3.0, 9.0])
    done = Model(actuator()).compensate(wanted, **WIDE)
    assert any(
        "ends on the move: its last rows brake" in text for text in done.warnings
    )
    for quiet in (Model(actuator()).compensate(move(), **WIDE),
                  Model(actuator()).compensate(wanted, bandwidth=100.0, **WIDE)):  # fmt: skip
        assert not any("ends on the move" in text for text in quiet.warnings)


def test_a_move_that_begins_on_the_move_is_warned_of() -> None:
    wanted = 6.0 + 3.0 * np.sin(2.0 * np.pi * 80.0 * TIME)
    done = Model(actuator()).compensate(wanted, on_limit="clip", **WIDE)
    assert any("begins on the move" in text for text in done.warnings)
    assert not any(
        "begins on the move" in text
        for text in Model(actuator()).compensate(move(), **WIDE).warnings
    )


@pytest.mark.parametrize(
    ("loop", "frequency", "reached"),
    [(0.36, 800.0, 0.075), (0.45, 760.0, 0.005), (0.45, None, 0.03)],
)
def test_a_repeated_move_is_learned(
    loop: float, frequency: float | None, reached: float
) -> None:
    plant, model, wanted = actuator(), Model(actuator(loop, frequency)), move()
    tracked: Any = ()
    errors = []
    for k in range(5):
        done = model.compensate(wanted, tracked=tracked, absolute=True, **WIDE)
        y, measured = played(plant, done.values, seed=k)
        errors.append(100.0 * rms(y - wanted) / 8.0)
        tracked = (done.values, measured)
    assert errors[2] <= max(reached, errors[0])
    assert errors[4] <= reached
    assert any("the last pass was" in note for note in done.notes)


def test_slow_bands_with_little_in_them_do_not_stop_learning() -> None:
    """A burst has a thousandth of its energy at low frequencies, where another loop's width shows."""
    plant, model, wanted = actuator(0.40, None), Model(actuator(0.45, None)), move()
    tracked: Any = ()
    errors = []
    for k in range(4):
        done = model.compensate(wanted, tracked=tracked, **WIDE)
        y, measured = played(plant, done.values, seed=k)
        errors.append(float(np.std(y - wanted)))
        tracked = (done.values, measured)
    assert max(errors[1:]) < 0.2 * errors[0]


def test_several_recordings_of_one_drive_are_averaged() -> None:
    plant, model, wanted = actuator(), Model(actuator(0.36)), move()
    first = model.compensate(wanted, **WIDE)
    recordings = [
        (first.values, played(plant, first.values, 0.2, seed)[1]) for seed in range(9)
    ]
    errors = []
    for given in (recordings[:1], recordings):
        done = model.compensate(wanted, tracked=given, absolute=True, **WIDE)
        errors.append(rms(played(plant, done.values)[0] - wanted))
    assert errors[1] < 0.6 * errors[0]
    assert any("the mean of 9 recordings" in note for note in done.notes)


def refused(wanted: Floats, tracked: Any, **more: Any) -> str:
    with pytest.raises(InputError) as problem:
        Model(actuator(0.36)).compensate(wanted, tracked=tracked, **(WIDE | more))
    return str(problem.value)


def test_a_recording_of_something_else_is_refused() -> None:
    plant, model, wanted = actuator(), Model(actuator(0.36)), move()
    drive = model.compensate(wanted, **WIDE).values
    measured = played(plant, drive)[1]
    assert (
        "5,999 rows from the trajectory's first on, the trajectory has 6,000"
        in refused(wanted, (drive[:-1], measured[:-1]))
    )
    assert "its drive belongs to another trajectory" in refused(
        move(70.0), (drive, measured)
    )
    other = model.compensate(move(70.0), **WIDE).values
    assert "was driven otherwise than" in refused(
        wanted, [(drive, measured), (other, measured)]
    )


def test_an_error_that_grew_is_refused() -> None:
    model, wanted = Model(actuator(0.36)), move()
    first = model.compensate(wanted, **WIDE).values
    short = 6.0 + 0.7 * (wanted - 6.0)
    second = model.compensate(wanted, tracked=(first, short), **WIDE).values
    away = 6.0 + 0.4 * (wanted - 6.0)  # asked for more, it did less
    assert "the error grew" in refused(wanted, (second, away))


def passes_of(
    model: Model, plant: ActuatorModel, count: int, zero: float = 0.0, **more: Any
) -> tuple[list[float], list[Floats]]:
    """Return the error of each pass (RMS without the mean, um) and its drive."""
    wanted, tracked = move(), ()
    errors, drives = [], []
    for k in range(count):
        done = model.compensate(
            wanted, **(WIDE | more | ({"tracked": tracked} if tracked else {}))
        )
        y, measured = played(plant, done.values, seed=k)
        errors.append(float(np.std(y - wanted)))
        drives.append(done.values)
        tracked = (done.values, measured + zero)
    return errors, drives


def test_noise_is_not_taken_for_growth() -> None:
    model, plant, wanted = Model(actuator(0.43, 780.0)), actuator(), move()
    drive = model.compensate(wanted, **WIDE).values
    for k in range(20):  # noise of 0.6 % of the move: more than is left to learn
        measured = played(plant, drive, noise=0.05, seed=k)[1]
        drive = model.compensate(wanted, tracked=(drive, measured), **WIDE).values
    assert float(np.std(played(plant, drive)[0] - wanted)) < 0.02


@pytest.mark.parametrize("frequency", [600.0, 1_000.0])
def test_a_resonance_a_quarter_off_does_not_diverge(frequency: float) -> None:
    errors, _ = passes_of(Model(actuator(0.36)), actuator(frequency=frequency), 16)
    assert max(errors[10:]) <= 1.05 * max(errors[4:10]) < 0.05 * errors[0]


def test_the_sensor_s_zero_is_not_learned() -> None:
    model, plant = Model(actuator(0.36)), actuator()
    exact, drives = passes_of(model, plant, 3)
    off, others = passes_of(model, plant, 3, zero=3.6)
    assert off == pytest.approx(exact, rel=1e-6)
    assert np.abs(drives[2] - others[2]).max() < 1e-9
    wanted = move()
    measured = played(plant, drives[0])[1] + 3.6
    done = model.compensate(wanted, tracked=(drives[0], measured), **WIDE)
    (note,) = (text for text in done.notes if "sensor's zero" in text)
    assert note == (
        f"`tracked` 1: the mean of the error, {float(np.mean(wanted - measured)):.3g} um, is taken for the "
        "sensor's zero and not learned (`absolute` learns it)"
    )
    kept = model.compensate(
        wanted, tracked=(drives[0], measured), absolute=True, **WIDE
    )
    assert not any("sensor's zero" in text for text in kept.notes)
    assert float(np.mean(kept.values - done.values)) < -10.0


def test_a_zero_that_jumps_within_the_pass_is_warned_of() -> None:
    model, plant = Model(actuator(0.36)), actuator()
    drive = model.compensate(move(), **WIDE).values
    measured = played(plant, drive)[1]
    assert not model.compensate(move(), tracked=(drive, measured), **WIDE).warnings[1:]
    measured[2_500:] += 0.5
    done = model.compensate(move(), tracked=(drive, measured), **WIDE)
    (text,) = (text for text in done.warnings if "jumps" in text)
    start = r"`tracked` 1: the measured displacement jumps by 0\.4\d* um at row 2,501 of the pass"
    assert re.match(start, text)


def test_a_very_wrong_model_learns_and_one_that_diverges_is_refused() -> None:
    slow = dataclasses.replace(actuator(0.0), stages=(*actuator(0.0).stages[:1], ScaleStage(0.75, 0.5),
                                                      *actuator(0.0).stages[2:]))  # fmt: skip
    errors, _ = passes_of(Model(actuator(0.36)), slow, 12)
    assert errors[11] < 0.1 * errors[0]
    with pytest.raises(
        InputError,
        match=r"the error grew: above 300 Hz this pass is .* a lower `bandwidth`",
    ):
        passes_of(Model(actuator(0.36)), actuator(frequency=600.0), 6, bandwidth=600.0)


def test_a_history_keeps_the_error_and_refuses_growth(tmp_path: Path) -> None:
    path = tmp_path / "history.json"
    model, plant, wanted = Model(actuator(0.36)), actuator(), move()
    errors, drives = passes_of(model, plant, 4)
    for drive in drives[:3]:
        model.compensate(
            wanted,
            tracked=(drive, played(plant, drive, 0.0)[1]),
            history=str(path),
            **WIDE,
        )
    kept = json.loads(path.read_text())
    assert (kept["format"], kept["version"]) == ("dbo-history", 1)
    assert [one["rmse"] for one in kept["passes"]] == pytest.approx(
        errors[:3], rel=1e-9
    )
    worse = played(plant, drives[3], 0.0)[1] + 0.05 * np.sin(np.arange(COUNT))
    with pytest.raises(InputError) as problem:
        model.compensate(wanted, tracked=(drives[3], worse), history=str(path), **WIDE)
    assert "the error grew: this pass is 0.0356 um off (RMS), the last one was" in str(
        problem.value
    )
    assert "(learn from the recording of pass 3 again" in str(problem.value)
    assert json.loads(path.read_text()) == kept
    model.compensate(
        wanted,
        tracked=(drives[0], played(plant, drives[0])[1]),
        history=str(path),
        **WIDE,
    )
    # begun again from the first pass
    assert len(json.loads(path.read_text())["passes"]) == 1
    path.write_text('{"format": "dbo-model"}')
    with pytest.raises(InputError, match="is no history"):
        model.compensate(wanted, tracked=(drives[0], wanted), history=str(path), **WIDE)
    with pytest.raises(
        UsageError,
        match="`history` keeps the error of the passes that `tracked` recorded",
    ):
        model.compensate(wanted, history=str(path), **WIDE)


def period(count: int = 500) -> Floats:
    phase = 2.0 * np.pi * np.arange(count) / count
    wanted: Floats = 6.0 + 3.0 * np.sin(phase + 0.7) + np.sin(2.0 * phase)
    return wanted


@pytest.mark.parametrize("passes", [0, 2])
@pytest.mark.parametrize("delay", [0.0, 7.0 / RATE])
def test_the_drive_of_a_loop_settles_without_a_seam(passes: int, delay: float) -> None:
    plant, wanted = actuator(delay=delay), period()
    done = Model(plant).compensate(wanted, periodic=True, passes=passes, **WIDE)
    assert done.time is not None and done.values.size == (passes + 1) * 500
    assert done.time[[0, -1]] == pytest.approx([-passes * 500 / RATE, 499 / RATE])
    drive = done.values[-500:]
    assert abs(drive[0] - drive[-1]) <= np.abs(np.diff(drive)).max()
    long = np.concatenate([done.values, np.tile(drive, 4_000)])
    reached, _ = played(plant, long)
    assert np.abs(reached[-500:] - wanted).max() < 1e-6
    if passes:  # by the end of the run-in only creep is left to settle
        assert np.abs(reached[passes * 500 :][:500] - wanted).max() < 0.15


def test_a_loop_is_learned() -> None:
    plant, model, wanted = actuator(), Model(actuator(0.36, 780.0)), period()
    tracked: Any = ()
    errors = []
    for k in range(4):
        done = model.compensate(
            wanted, periodic=True, passes=0, tracked=tracked, absolute=True, **WIDE
        )
        y, measured = played(plant, np.tile(done.values, 3_000), seed=k)
        errors.append(rms(y[-500:] - wanted))
        tracked = (done.values, measured[-500:])
    assert errors[0] > 0.05
    assert errors[3] < 0.1 * errors[0]


def gears_alone(count: int) -> ActuatorModel:
    widths = np.full(count, 100.0 / count)
    stage = BacklashStage(widths, 0.1 * widths * np.linspace(0.5, 1.5, count), 0.0, 0.0)
    return ActuatorModel(
        "forward", VOLTAGE, Quantity("displacement", "um", 0.0, 10.0), (stage,)
    )


def test_a_loop_from_any_start_is_what_the_model_repeats_or_is_refused() -> None:
    model, refused, exact = gears_alone(64), 0, 0
    for k in range(12):
        random = np.random.default_rng(k)
        phase = 2.0 * np.pi * np.arange(300) / 300 + random.uniform(0.0, 6.0)
        wanted = random.uniform(3.0, 7.0) + random.uniform(0.5, 2.5) * np.sin(phase)
        for start in ("auto", "empty", "full"):
            asked = {
                "sample_rate": RATE,
                "state": start,
                "periodic": True,
                "on_limit": "error",
            }
            try:
                drive = Model(model).compensate(wanted, **asked)
            except LimitError as problem:
                assert start == "auto" and "no start leads to it" in str(problem)
                refused += 1
                continue
            reached, _ = played(model, np.tile(drive, 3), start=start)
            assert np.abs(reached[-300:] - wanted).max() < 1e-9
            exact += 1
    assert (exact, refused) == (36, 0)


def test_a_loop_that_no_start_leads_to_has_a_row_before_it() -> None:
    model, wanted = (
        gears_alone(2),
        5.0 + 0.5 * np.sin(2.0 * np.pi * np.arange(300) / 300),
    )
    asked = {
        "sample_rate": RATE,
        "periodic": True,
        "details": True,
        "on_limit": "error",
    }
    for start in ("auto", "settled"):
        done = Model(model).compensate(wanted, state=start, **asked)
        (text,) = (
            text for text in done.warnings if "no start leads to the loop" in text
        )
        before, drive = done.values[:-300], done.values[-300:]
        assert f"{before.size} rows from {before[0]:.6g} V on, where" in text
        assert done.time[0] == pytest.approx(-before.size / RATE)
        assert (
            np.abs(np.diff(done.values)).max() <= 1.001 * np.abs(np.diff(drive)).max()
        )
        reached, _ = played(
            model, np.concatenate([before, np.tile(drive, 3)]), start=start
        )
        assert np.abs(reached[-300:] - wanted).max() < 1e-9
    with pytest.raises(
        LimitError,
        match="the drive comes from 0 V, and 2000 V per second does not bring it to",
    ):
        Model(model).compensate(wanted, from_=0.0, max_slew=2000.0, **asked)


@pytest.mark.parametrize("slew", [None, 300.0])
def test_a_loop_of_which_the_limits_leave_one_voltage_is_written(
    slew: float | None,
) -> None:
    wanted = 5.0 + 0.5 * np.cos(2.0 * np.pi * np.arange(60) / 60)
    asked: dict[str, Any] = {
        "sample_rate": 1000.0,
        "periodic": True,
        "details": True,
        "max_slew": slew,
    }
    done = Model(gears_alone(2)).compensate(
        wanted, v_min=49.0, v_max=50.0, on_limit="clip", **asked
    )
    before, drive = done.values[:-60], done.values[-60:]
    assert drive.tolist() == [49.0] * 60 and before.size == (1 if slew is None else 4)
    assert 49.0 <= done.values.min() and done.values.max() <= 50.0
    assert np.abs(np.diff(done.values)).max() <= (
        1.0 if slew is None else slew / 1000.0
    )


def test_a_loop_that_a_lag_s_first_pass_pushes_away_begins_on_the_lag() -> None:
    """From rest, the lag's first pass crosses a gear that it does not reach if that one is crossed."""
    gears, lag = 256, Lag(0.0015)
    for k, rows in ((0, 0), (11, 2), (217, 5)):
        random = np.random.default_rng([4, k])
        slopes = np.linspace(0.6, 1.4, gears)
        widths = np.full(gears, 100.0 / gears)
        stage = BacklashStage(widths, 0.1 * widths * slopes, 0.0, 0.0)
        plant = ActuatorModel(
            "forward",
            VOLTAGE,
            Quantity("displacement", "um", 0.0, 10.0),
            (DynamicsStage((lag,)), stage),
        )
        phase = 2.0 * np.pi * np.arange(400) / 400 + random.uniform(0.0, 6.3)
        wanted = random.uniform(4.0, 6.0) + random.uniform(0.5, 2.0) * np.sin(phase)
        asked = {
            "sample_rate": 1e4,
            "v_min": -60.0,
            "v_max": 180.0,
            "periodic": True,
            "on_limit": "error",
        }
        done = Model(plant).compensate(wanted, state="empty", details=True, **asked)
        before, drive = done.values[:-400], done.values[-400:]
        assert before.size == rows
        repeated = np.concatenate([before, np.tile(drive, 30)])
        reached = plant.simulate(
            repeated, plant.start(float(repeated[0]), "empty"), time_step=1e-4
        ).y
        assert np.abs(reached[-400:] - wanted).max() < 1e-9


def test_what_is_read_whole_is_handed_on_in_parts() -> None:
    wanted = np.arange(150_000.0)
    whole = WholeSource(ArraySource({"displacement": wanted}, sample_rate=1e3))
    parts = [block.values["displacement"] for block in whole.blocks()]
    assert [part.size for part in parts] == [131_072, 18_928]
    assert np.array_equal(np.concatenate(parts), wanted)


@pytest.mark.parametrize("known", [True, False])
def test_a_rest_brings_the_creep_where_a_loop_needs_it(known: bool) -> None:
    plant, wanted, within = actuator(), period(), 1e-3 * float(np.ptp(period()))
    asked = (
        {**WIDE, "periodic": True}
        if known
        else {**WIDE, "periodic": True, "state": "auto"}
    )

    def first_pass(**more: Any) -> tuple[Any, Floats]:
        done = Model(plant).compensate(wanted, **asked, **more)
        reached, _ = played(plant, done.values, start=asked["state"])
        return done, reached[-wanted.size :] - wanted

    _, error = first_pass(passes=2)
    assert abs(error.mean()) > 4.0 * within
    done, error = first_pass(lead="auto")
    assert rms(error) < within
    (text,) = (text for text in done.notes if "for the creep the drive rests" in text)
    found = re.search(r"rests (\S+) s at (\S+) V before the run-in", text)
    assert found is not None
    held = np.abs(done.values - float(found[2])) < 1e-3
    assert held.sum() / RATE == pytest.approx(float(found[1]), rel=0.01)
    assert f"before the first period stand {done.values.size - 500:,} rows" in " ".join(
        done.notes
    )
    assert "settled from its first pass on" in " ".join(done.notes)
    shorter, _ = first_pass(lead=0.05)
    assert 1000 < shorter.values.size - 500 < done.values.size / 4 + 20_000


def test_the_passes_until_a_loop_settles_are_the_model_s(dbo: Any) -> None:
    plant, wanted = actuator(), period()
    done = Model(plant).compensate(wanted, periodic=True, **WIDE)
    (text,) = (text for text in done.notes if "the loop settles in" in text)
    found = re.search(
        r"settles in ([\d,]+) passes, ([\d.]+) s: the mean of the first is (\S+) um off",
        text,
    )
    assert found is not None
    passes = int(found[1].replace(",", ""))
    reached, _ = played(plant, np.tile(done.values, passes + 400))
    means = (reached.reshape(-1, 500) - wanted).mean(axis=1)
    assert float(found[3]) == pytest.approx(means[0], rel=0.1)
    within = 1e-3 * float(np.ptp(wanted))
    last = int(np.flatnonzero(np.abs(means) > within)[-1]) + 1
    assert passes == pytest.approx(last, rel=0.1)


def test_what_other_pasts_cost_the_first_pass_is_said_and_is_so() -> None:
    """The model is the actuator: settled it is right from the first pass on, from either end it is not."""
    plant, wanted, within = (
        actuator(frequency=None),
        period(),
        1e-3 * float(np.ptp(period())),
    )
    done = Model(plant).compensate(
        wanted, **WIDE | {"state": "auto"}, periodic=True, lead="auto"
    )
    notes = " ".join(done.notes)
    assert (
        "by the model, from the start assumed, the loop is settled from its first pass on"
        in notes
    )
    stated = re.search(
        r"first pass is (\S+) um off \(RMS\), from its upper end (\S+) um: ", notes
    )
    assert stated is not None
    for start, said in (
        ("settled", None),
        ("empty", float(stated[1])),
        ("full", float(stated[2])),
    ):
        y, _ = played(plant, done.values, start=start)
        came = rms(y[-wanted.size :] - wanted)
        if said is None:
            assert came < within
        else:
            assert came > within
            assert came == pytest.approx(said, rel=0.05)


@pytest.mark.parametrize("start", ["empty", "full"])
def test_a_start_that_is_stated_has_no_other_past(start: str) -> None:
    plant, wanted = actuator(frequency=None), period()
    done = Model(plant).compensate(
        wanted, **WIDE | {"state": start}, periodic=True, lead="auto"
    )
    notes = " ".join(done.notes)
    assert "by the model the loop is settled from its first pass on" in notes
    assert "what was before is not known" not in notes
    y, _ = played(plant, done.values, start=start)
    assert rms(y[-wanted.size :] - wanted) < 1e-3 * float(np.ptp(wanted))


@pytest.mark.parametrize(
    ("distance", "frequency"), [(0.01, None), (0.05, 800.0), (1.0, 800.0)]
)
def test_the_settling_time_is_that_of_a_long_simulation(
    distance: float, frequency: float | None
) -> None:
    plant = actuator(frequency=frequency)
    seconds = settling_seconds(plant, 10.0, 60.0, distance)
    rows = int(100.0 * RATE)
    drive = np.full(rows, 60.0)
    drive[: rows // 2] = 10.0
    y, _ = played(plant, drive, start="auto")
    away = np.abs(y[rows // 2 :] - y[-1])
    assert seconds == pytest.approx(
        (np.flatnonzero(away > distance)[-1] + 1) / RATE, rel=0.1
    )


def test_compensate_says_how_long_to_hold_a_step() -> None:
    done = Model(actuator()).compensate(move(), settle=0.05, **WIDE)
    (text,) = (text for text in done.notes if "creep and ringing" in text)
    assert re.search(
        r"that is held, creep and ringing stay within 0.05 um after [\d.]+ s$", text
    )
    with pytest.raises(UsageError, match=r"`settle` -1\.0: give a distance above 0"):
        Model(actuator()).compensate(move(), settle=-1.0, **WIDE)


def test_a_period_that_does_not_close_is_refused() -> None:
    with pytest.raises(
        InputError,
        match=r"does not close: from the last row, .* without its first row again",
    ):
        Model(actuator()).compensate(np.linspace(2.0, 9.0, 400), periodic=True, **WIDE)
    with pytest.raises(
        InputError, match=r"3 rows are no period of a loop \(at least 4\)"
    ):
        Model(actuator()).compensate(np.array([1.0, 2.0, 1.0]), periodic=True, **WIDE)
    for more, text in (
        (
            {"periodic": True, "condition": True, "state": "auto"},
            "`periodic` and `condition` exclude each other",
        ),
        ({"passes": 2}, "`passes` is the run-in of a loop"),
        ({"bandwidth": 0.0}, "`bandwidth` 0: give a positive number of Hz"),
        (
            {"bandwidth": 11_000.0},
            "`bandwidth` 11000: above half the sampling rate of 20000 Hz",
        ),
    ):
        with pytest.raises(UsageError) as problem:
            Model(actuator()).compensate(period(), **(WIDE | more))
        assert text in str(problem.value)


def test_a_move_shorter_than_the_read_ahead_and_an_uneven_clock_are_refused() -> None:
    with pytest.raises(
        InputError,
        match=r"20 samples are fewer than the 30 that the inverse .* reads ahead",
    ):
        Model(actuator()).compensate(move()[:20], **WIDE)
    uneven = TIME + np.where(np.arange(COUNT) > 3_000, 0.4 / RATE, 0.0)
    with pytest.raises(
        InputError, match=r"row 3002: a time step of 7e-05 s among .* \(`resample` HZ"
    ):
        Model(actuator()).compensate(move(), time=uneven, v_max=140.0)
    with pytest.raises(
        InputError, match=r"the model has dynamics|resonance at 800 Hz is above half"
    ):
        Model(actuator()).compensate(move(), sample_rate=1_000.0)


def test_the_commands_give_the_bits_of_the_library(dbo: Any) -> None:
    plant, model = actuator(), Model(actuator(0.36))
    model.save("model.json")
    write = "time_s,displacement_um\n" + "".join(f"{t!r},{x!r}\n" for t, x in
                                                 np.column_stack([TIME, move()]).tolist())  # fmt: skip
    Path("move.csv").write_text(write)
    words: Any = [
        "compensate",
        "model.json",
        "move.csv",
        "--v-min",
        "-40",
        "--v-max",
        "140",
        "--state",
        "empty",
    ]
    assert dbo(*words, "-o", "drive.csv").code == 0
    drive = np.loadtxt("drive.csv", delimiter=",", skiprows=1)
    limits: Any = {"v_min": -40.0, "v_max": 140.0, "state": "empty", "details": True}
    expected = model.compensate(move(), time=TIME, **limits)
    assert np.array_equal(drive[:, 2], expected.values)
    measured = played(plant, drive[:, 2])[1]
    rows = np.column_stack([drive, measured]).tolist()
    Path("pass.csv").write_text("time_s,desired_um,voltage_V,displacement_um\n" + "".join(
        ",".join(map(repr, row)) + "\n" for row in rows))  # fmt: skip
    told = dbo(*words, "--tracked", "pass.csv", "-o", "next.csv")
    assert told.code == 0 and "which this pass takes off" in told.err
    after = np.loadtxt("next.csv", delimiter=",", skiprows=1)
    learned = model.compensate(move(), time=TIME, tracked="pass.csv", **limits)
    assert np.array_equal(after[:, 2], learned.values)
    assert np.array_equal(after[:, 1], drive[:, 1])
    for _ in range(2):  # the same recording again replaces its own pass
        kept = dbo(
            *words,
            "--tracked",
            "pass.csv",
            "--history",
            "passes.json",
            "-o",
            "again.csv",
        )
        assert (
            kept.code == 0
            and Path("again.csv").read_bytes() == Path("next.csv").read_bytes()
        )
        assert len(json.loads(Path("passes.json").read_text())["passes"]) == 1
    level = dbo(*words, "--tracked", "pass.csv", "--absolute", "-o", "level.csv")
    assert (
        level.code == 0
        and "sensor's zero" in kept.err
        and "sensor's zero" not in level.err
    )
    assert dbo(*words, "--history", "passes.json").code == 2
    clash = dbo(
        *words, "--tracked", "pass.csv", "--history", "same.json", "-o", "same.json"
    )
    assert clash.code == 2 and not Path("same.json").exists()
    Path("bare.csv").write_text("time_s,displacement_um\n0,1\n1,2\n")
    bare = dbo(*words, "--tracked", "bare.csv")
    assert bare.code == 1 and "voltage" in bare.err
    small = dict(SMALL_MODEL) | {"version": 2}
    Path("small.json").write_text(json.dumps(small))
    loop = "time_s,displacement_um\n" + "".join(f"{k / 100},{5 + 3 * np.sin(k * np.pi / 50)!r}\n" for k in
                                                range(100))  # fmt: skip
    Path("loop.csv").write_text(loop.replace("np.float64(", "").replace(")", ""))
    once = dbo("compensate", "small.json", "loop.csv", "--periodic", "-n", "1")
    assert (
        once.code == 0
        and once.out.count("\n") == 201
        and "settled from its first pass on" in once.err
    )
    alone = dbo("compensate", "small.json", "loop.csv", "--periodic")
    # which loops do not take
    assert "depends on the past" in alone.err and "--condition" not in alone.err


def test_show_tells_the_dynamics(dbo: Any) -> None:
    Model(actuator()).save("model.json")
    assert (
        "dynamics: a lag of 0.2 ms; a resonance at 800 Hz, damping 0.02\n"
        in dbo("show", "model.json").out
    )
    told = json.loads(dbo("show", "model.json", "--format", "json").out)
    assert told["dynamics"] == [{"lag": 2e-4}, {"frequency": 800.0, "damping": 0.02}]


def test_a_controller_refuses_dynamics() -> None:
    from dbo_cli.errors import ModelError

    with pytest.raises(
        ModelError,
        match=r"the model has dynamics, so the drive depends on what is wanted after",
    ):
        Model(actuator()).controller(RATE)


def test_dynamics_survive_the_model_file_and_stand_where_they_must(
    tmp_path: Path,
) -> None:
    from dbo_cli.errors import ModelError
    from dbo_cli.hysteresis.model_file import read_model

    model = actuator(delay=1e-3)
    for one in (model, model.inverse()):
        Model(one).save(tmp_path / "m.json")
        again = read_model(str(tmp_path / "m.json"))
        assert again.dynamics == one.dynamics
        assert again.digest == model.digest
    early = (model.stages[2], *model.stages[:2])
    with pytest.raises(
        ModelError, match=r"stages\[0\].sections: one lag alone may stand first"
    ):
        dataclasses.replace(model, stages=early)
