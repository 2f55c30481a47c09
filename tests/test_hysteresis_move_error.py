"""The error to expect of a move: other models played over it, kept with the model."""

from __future__ import annotations

import dataclasses
import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dbo_cli.errors import ModelError
from dbo_cli.hysteresis.model import (
    ActuatorModel,
    BacklashStage,
    DelayStage,
    PointStage,
    Quantity,
    ScaleStage,
)
from dbo_cli.hysteresis.model_file import model_to_bytes
from dbo_cli.hysteresis.move_error import (
    APART,
    GAIN_LATER,
    LEFT_OUT,
    LINE,
    MOST_SWINGS,
    WIDENING,
    Alternative,
    alternatives_of,
    move_error,
    played,
    repeats_small_swings,
    spread,
    thinned,
    travelled,
    unlike,
)
from dbo_cli.hysteresis.operators import Relaxation

STEP = 0.01


def model(gain: float = 2.0, delay: float = 0.0, **fit: Any) -> ActuatorModel:
    """Return a straight model of 0 to 10 V, ``gain`` um a volt."""
    stages: tuple[Any, ...] = (
        BacklashStage([5.0, 5.0], [5.0, 5.0]),
        ScaleStage(gain, 0.0),
    )
    return ActuatorModel(
        "forward",
        Quantity("voltage", "V", 0.0, 10.0),
        Quantity("displacement", "um", 0.0, 10.0 * gain),
        (*stages, DelayStage(delay)) if delay else stages,
        fit,
    )


def with_others(*others: Alternative, **fit: Any) -> ActuatorModel:
    known = {
        "expected_rmse": 9.0,
        "left_out_rmse": 0.3,
        "alternatives": [one.values() for one in others],
    }
    return model(**known | fit)


def ramp(rate: float, top: float = 8.0) -> Any:
    """Return a drive from 0 to ``top`` volt and back, ``rate`` volts a second."""
    up = np.linspace(0.0, top, round(top / rate / STEP) + 1)
    return np.concatenate((up, up[-2::-1]))


def test_another_model_kept_starts_where_the_chosen_one_does() -> None:
    """What bends the drive was rounded: gears to spare counted, and it began 3 of 40 um below."""
    bend = PointStage([1.123456, 2.2], [1.234567, 2.088889], 0.236368, 0.236368)
    low = bend.y0 - 0.5 * bend.dy.sum()
    gears = BacklashStage(
        np.full(8, bend.dy.sum() / 4), np.linspace(0.5, 1.0, 8).round(3), low, 0.0
    )
    drive = Quantity("voltage", "V", bend.x0, bend.x0 + float(bend.dx.sum()))
    chosen = dataclasses.replace(
        model(), input=drive, stages=(bend, gears, ScaleStage(2.0, 0.0))
    )
    assert chosen.spare_bits
    kept = dataclasses.replace(
        chosen, fit={"alternatives": [Alternative("lag", 1.0, chosen).values()]}
    )
    [other] = alternatives_of(kept)
    assert other.model.spare_bits == chosen.spare_bits


def test_what_other_models_say_of_the_very_move_is_added() -> None:
    other = Alternative("bend", 0.5, model(2.2))
    drive = ramp(4.0)
    found = move_error(with_others(other), drive, STEP)
    assert found is not None
    assert found.shape == pytest.approx(
        np.hypot(0.3 * LEFT_OUT, APART * 0.5 * 0.2 * drive.std()), rel=1e-3
    )
    assert found.zero == pytest.approx(
        np.hypot(0.3, APART * 0.5 * 0.2 * drive.mean()), rel=1e-3
    )
    assert found.rmse == pytest.approx(np.hypot(found.shape, found.zero))
    small = move_error(with_others(other), ramp(4.0, 1.0), STEP)
    assert small is not None
    assert 0.3 * LEFT_OUT < small.shape < 0.31 * LEFT_OUT


def test_no_shape_is_stated_worse_than_a_straight_line_leaves() -> None:
    far = Alternative("bend", 1.0, model(9.0))
    [open_ended, closed] = [
        move_error(with_others(far, **more), ramp(4.0), STEP)
        for more in ({}, {"line_left_out_rmse": 0.75})
    ]
    assert open_ended is not None and open_ended.shape > 10.0
    assert closed is not None
    assert (closed.shape, closed.zero) == (
        pytest.approx(LINE * 0.75),
        pytest.approx(open_ended.zero),
    )


def test_a_zero_that_moved_along_the_logs_is_in_the_zero_alone() -> None:
    still, moved = (
        move_error(with_others(zero_drift=drift), ramp(4.0), STEP)
        for drift in (0.0, 0.4)
    )
    assert still is not None and moved is not None
    assert (still.shape, still.zero) == (pytest.approx(0.3 * LEFT_OUT), 0.3)
    assert (moved.shape, moved.zero) == (
        pytest.approx(0.3 * LEFT_OUT),
        pytest.approx(0.5),
    )


def looped(**fit: Any) -> ActuatorModel:
    """Return a model with a loop: what was before a move from the middle matters."""
    stages = (
        BacklashStage(np.full(40, 0.25), np.linspace(0.1, 0.4, 40)),
        ScaleStage(2.0, 0.0),
    )
    ends = (
        Quantity("voltage", "V", 0.0, 10.0),
        Quantity("displacement", "um", 0.0, 20.0),
    )
    return ActuatorModel(
        "forward", *ends, stages, {"expected_rmse": 0.1, "left_out_rmse": 0.01} | fit
    )


def test_the_past_is_in_the_error_from_any_past_and_the_truth_within_it() -> None:
    """The model itself is the actuator: it comes from any past, the prediction from the assumed one."""
    middle = 4.0 + np.sin(np.linspace(0.0, 20.0, 400))
    found = move_error(looped(), middle, STEP)
    assert found is not None and found.past_matters
    assert 0.01 < found.rmse < 0.04
    predicted = played(looped(), middle, STEP)
    for start in ("empty", "full", "settled"):
        came = float(
            np.sqrt(np.mean((played(looped(), middle, STEP, start) - predicted) ** 2))
        )  # type: ignore[arg-type]
        assert came <= found.from_any_past
    swept = np.concatenate(
        (
            np.linspace(4.0, 0.0, 50),
            np.linspace(0.0, 10.0, 99),
            np.linspace(10.0, 4.0, 50),
        )
    )
    after = move_error(looped(), np.concatenate((swept, middle)), STEP, len(swept))
    assert after is not None and not after.past_matters
    assert after.from_any_past == pytest.approx(after.rmse, rel=1e-6)


def test_a_lag_costs_as_much_as_the_move_is_fast() -> None:
    doubtful = with_others(
        Alternative("lag", 1.0, model(delay=0.05)), left_out_rmse=0.0
    )
    slow, fast = (move_error(doubtful, ramp(rate), STEP) for rate in (0.5, 5.0))
    assert slow is not None
    assert fast is not None
    assert slow.rmse == pytest.approx(APART * 2.0 * 0.5 * 0.05, rel=0.03)
    assert fast.rmse == pytest.approx(APART * 2.0 * 5.0 * 0.05, rel=0.08)
    # late on the way up and on the way down
    assert fast.zero == pytest.approx(0.0, abs=0.1 * fast.shape)


def test_of_each_kind_the_farthest_counts() -> None:
    own, ones = np.zeros(4), np.ones(4)
    others = [
        (Alternative("bend", 1.0, model()), 3.0 * ones),
        (Alternative("bend", 1.0, model()), 2.0 * ones),
        (Alternative("lag", 0.5, model()), -8.0 * ones),
    ]
    apart = spread(own, others)
    assert (apart.shape, apart.still_zero) == (0.0, pytest.approx(5.0))


def test_a_gain_that_changes_adds_its_part_of_the_move() -> None:
    drive = ramp(4.0)
    found = move_error(with_others(left_out_rmse=0.0, gain_trend=-0.02), drive, STEP)
    assert found is not None
    assert found.shape == pytest.approx(GAIN_LATER * 0.02 * 2.0 * drive.std(), rel=1e-9)
    assert found.zero == pytest.approx(GAIN_LATER * 0.02 * 2.0 * drive.mean(), rel=1e-9)


def test_swings_unlike_those_of_the_logs_widen_it() -> None:
    known = with_others(swings=[[0.0, 8.0], [8.0, 0.0]])
    seen = move_error(known, ramp(4.0), STEP)
    assert seen is not None
    assert seen.shape == pytest.approx(0.3 * LEFT_OUT)
    assert seen.unlike < 0.01
    up = np.linspace(6.0, 8.0, 51)
    high = move_error(
        known, np.concatenate((np.linspace(0.0, 6.0, 50), up, up[-2::-1])), STEP, 99
    )
    # from 8 to 6, where the logs go on to 0: six tenths of the range away
    assert high is not None
    assert high.shape == pytest.approx(
        0.3 * LEFT_OUT * (1.0 + WIDENING * 0.6), rel=0.02
    )
    assert high.unlike == pytest.approx(0.6, rel=0.02)
    with pytest.raises(ModelError, match=r"^fit\.swings: needs pairs of voltages$"):
        move_error(with_others(swings=[1.0]), ramp(4.0), STEP)


def test_swings_close_together_are_kept_once() -> None:
    many = np.random.default_rng(1).uniform(0.0, 10.0, (20_000, 2))
    kept = thinned(many, 10.0)
    assert 64 < len(kept) <= MOST_SWINGS
    assert unlike(np.array([2.0, 7.0, 3.0]), kept, 10.0) < 0.1
    assert unlike(np.zeros(5), kept, 10.0, 5) == 0.0


def test_rows_before_the_move_do_not_count_and_a_straight_line_is_judged_alike() -> (
    None
):
    drive = np.concatenate((ramp(4.0), np.zeros(50)))
    found = move_error(
        with_others(Alternative("bend", 1.0, model(2.2))), drive, STEP, len(drive) - 50
    )
    assert found is not None
    assert found.shape == pytest.approx(0.3 * LEFT_OUT)
    assert found.straight_line == pytest.approx(0.0, abs=1e-12)


def test_models_without_others_keep_their_figure_and_without_any_none() -> None:
    assert move_error(model(expected_rmse=0.7), ramp(4.0), None).rmse == 0.7  # type: ignore[union-attr]
    assert move_error(model(expected_rmse=None), ramp(4.0), None) is None
    late = with_others(Alternative("lag", 1.0, model(delay=0.05)))
    assert move_error(late, ramp(4.0), None).shape == 0.3 * LEFT_OUT  # type: ignore[union-attr]  # no clock, no lag


def test_others_come_back_from_the_file_to_four_digits(tmp_path: Path) -> None:
    from dbo_cli.hysteresis.model_file import read_model

    path = tmp_path / "model.json"
    path.write_bytes(
        model_to_bytes(with_others(Alternative("lag", 0.25, model(2.123456789, 0.05))))
    )
    [other] = alternatives_of(read_model(str(path)))
    assert (other.kind, other.weight) == ("lag", 0.25)
    assert other.model.stages[1:] == (ScaleStage(2.123, 0.0), DelayStage(0.05))


def test_a_memory_of_the_way_gone_counts_whatever_the_time(tmp_path: Path) -> None:
    """L' = |u'| (u - L) / tau: it stays behind by tau, up and down, but for what fades since the turn."""
    from dbo_cli.hysteresis.model_file import read_model

    path = tmp_path / "model.json"
    memory = Relaxation(0.0, (2.0,), (0.5,))
    path.write_bytes(
        model_to_bytes(with_others(Alternative("forgetting", 1.0, model(), memory)))
    )
    [other] = alternatives_of(read_model(str(path)))
    assert other.forgetting == memory
    up, down = np.linspace(0.0, 8.0, 4001), np.linspace(8.0, 4.0, 2001)[1:]
    drive = np.concatenate((up, down))
    behind = 2.0 * (1.0 - np.exp(-up / 2.0))
    turned = -2.0 + (behind[-1] + 2.0) * np.exp((down - 8.0) / 2.0)
    lag = drive - np.concatenate((behind, turned))
    for step in (STEP, 100.0, None):
        assert other.played(drive, step) == pytest.approx(
            2.0 * (drive + 0.5 * lag), abs=2e-3
        )


def test_noise_is_no_way() -> None:
    rng = np.random.default_rng(3)
    gone = travelled(ramp(4.0) + 0.02 * rng.normal(size=len(ramp(4.0))), 10.0)
    assert gone[-1] == pytest.approx(16.0, abs=0.3)
    assert np.all(np.diff(gone) >= 0.0)
    assert gone[len(gone) // 2] == pytest.approx(8.0, abs=0.2)


def test_dynamics_that_were_found_besides_are_put_behind_the_others() -> None:
    from dbo_cli.hysteresis.dynamics import DynamicsStage, Resonance

    moving = DynamicsStage((Resonance(100.0, 0.1),))
    bare = with_others(Alternative("lag", 1.0, model(2.2, 0.05)))
    own = dataclasses.replace(bare, stages=(*bare.stages, moving, DelayStage(0.02)))
    [other] = alternatives_of(own)
    assert other.model.stages[1:] == (ScaleStage(2.2, 0.0), moving, DelayStage(0.02))


@pytest.mark.parametrize(
    ("kept", "said"),
    [
        (
            [{"weight": 1.0, "stages": []}],
            "fit.alternatives[0]: needs `changed`, `weight` and `stages`",
        ),
        (["bend"], "fit.alternatives[0]: needs `changed`, `weight` and `stages`"),
        (
            [{"changed": "forgetting", "weight": 1.0, "stages": [], "forgetting": {}}],
            "the model: fit.alternatives[0].forgetting.on: is missing",
        ),
        (
            [{"changed": "bend", "weight": 1.0, "stages": 3}],
            "the model: fit.alternatives[0].stages: is not a list",
        ),
    ],
)
def test_malformed_others_are_refused(kept: Any, said: str) -> None:
    with pytest.raises(ModelError) as refused:
        alternatives_of(model(alternatives=kept))
    assert str(refused.value) == said


def test_compensate_says_what_to_expect_of_the_very_move(dbo: Any) -> None:
    Path("model.json").write_bytes(
        model_to_bytes(with_others(Alternative("bend", 1.0, model(2.2))))
    )
    stated = []
    for top in (1.0, 16.0):
        wanted = 2.0 * ramp(4.0, top / 2.0)
        rows = "".join(
            f"{STEP * k!r},{value!r}\n" for k, value in enumerate(wanted.tolist())
        )
        Path("move.csv").write_text(f"time_s,displacement_um\n{rows}")
        for block in ("7", "65536"):
            call = (
                "compensate",
                "model.json",
                "move.csv",
                "-o",
                "drive.csv",
                "--summary",
                "s.json",
            )
            done = dbo(*call, "--block-rows", block)
            assert done.code == 0, done.err
            assert "is no better than that of a straight line, " in done.err
            stated.append(json.loads(Path("s.json").read_text())["expected_rmse"])
    assert (
        stated[0]
        == stated[1]
        == pytest.approx(np.hypot(0.3 * LEFT_OUT, 0.304), abs=0.002)
    )
    both_parts = np.hypot(0.3 * LEFT_OUT, 0.3)
    apart = APART * 0.1 * 2.0 * 8.0 / np.sqrt(3.0)
    assert (
        stated[2] == stated[3] == pytest.approx(np.hypot(both_parts, apart), rel=0.01)
    )


def zigzag(*turns: float) -> Any:
    """Return a drive in even steps of 0.05 V from turn to turn."""
    parts = [np.zeros(1)]
    for begin, end in itertools.pairwise(turns):
        count = round(abs(end - begin) / 0.05)
        parts.append(begin + (end - begin) * np.arange(1, count + 1) / count)
    return np.concatenate(parts)


@pytest.mark.parametrize(
    ("turns", "repeats"),
    [
        ([0.0, *[4.0, 5.0] * 6], True),
        ([0.0, *[2.0, 8.0] * 6], False),  # large swings
        (
            [0.0, 4.0, 5.0, 3.0, 4.5, 2.5, 4.2, 5.8],
            False,
        ),  # small, and none like the one before
        ([0.0, 10.0, 0.0, 10.0, 0.0, 4.0, 5.0, 4.0, 5.0], False),  # most of it is large
        ([0.0, 10.0], False),
    ],
)
def test_small_swings_that_repeat_are_known(turns: list[float], repeats: bool) -> None:
    assert repeats_small_swings(zigzag(*turns), 10.0) is repeats


def test_only_rows_from_the_move_on_repeat() -> None:
    drive = np.concatenate(
        (zigzag(0.0, 10.0, 0.0, 10.0, 0.0), zigzag(0.0, *[4.0, 5.0] * 6))
    )
    assert not repeats_small_swings(drive, 10.0)
    assert repeats_small_swings(drive, 10.0, 801)
