"""A recording joined with a trajectory in another file."""

from __future__ import annotations

import numpy as np
import pytest

from dbo_cli.errors import InputError
from dbo_cli.logs.sample_block import SampleBlock
from dbo_cli.reports.sample_pairs import TrajectoryMatch, row_numbers


def blocks(size, time=None, **values):
    count = len(next(iter(values.values())))
    for start in range(0, count, size):
        part = slice(start, min(start + size, count))
        yield SampleBlock(
            range(part.start + 1, part.stop + 1),
            None,
            None if time is None else time[part],
            {role: signal[part] for role, signal in values.items()},
        )


def joined(match):
    """Return all pairs as arrays: row, desired, measured, time."""
    parts = list(match.pairs())
    stack = [
        [row_numbers(part) for part in parts],
        [part.values["desired"] for part in parts],
        [part.values["measured"] for part in parts],
        [
            part.time if part.time is not None else np.full(len(part), np.nan)
            for part in parts
        ],
    ]
    return [np.concatenate(column) for column in stack]


def curve(time):
    return 5.0 - 4.0 * np.cos(2.0 * np.pi * time)


FAST, SLOW = np.arange(4000) / 1000.0 - 0.3, np.arange(1500) / 500.0


def by_time(recorded=997, wanted=101):
    return TrajectoryMatch(
        "run.csv",
        "drive.csv",
        blocks(recorded, FAST, measured=curve(FAST)),
        blocks(wanted, SLOW, desired=curve(SLOW)),
        by_time=True,
    )


def test_by_time_a_recording_of_another_rate_finds_its_desired_values():
    match = by_time()
    row, desired, measured, time = joined(match)
    inside = (FAST >= 0.0) & (FAST <= SLOW[-1])
    assert np.array_equal(time, FAST[inside])
    assert np.array_equal(row, np.flatnonzero(inside) + 1)
    assert np.allclose(
        desired, np.interp(FAST[inside], SLOW, curve(SLOW)), rtol=0.0, atol=1e-12
    )
    assert np.allclose(desired, measured, atol=1e-3)
    assert match.left_out == 4000 - inside.sum()
    assert match.notes() == [
        "run.csv: 1,001 rows outside the time of drive.csv take no part"
    ]


@pytest.mark.parametrize(
    ("recorded", "wanted"), [(1, 1), (7, 1500), (4000, 3), (4000, 1500)]
)
def test_how_either_is_cut_changes_no_bit(recorded, wanted):
    first, second = by_time(), by_time(recorded, wanted)
    for one, other in zip(joined(first), joined(second), strict=True):
        assert np.array_equal(one, other)
    assert first.notes() == second.notes()


def test_equal_stamps_give_the_very_values_though_they_are_rounded():
    wanted = np.random.default_rng(1).normal(size=500)
    time = np.arange(500) / 500.0
    recorded = np.round(time * 1e9 + 0.4) / 1e9  # a tenth of a nanosecond off
    match = TrajectoryMatch(
        "a",
        "b",
        blocks(64, recorded, measured=wanted),
        blocks(50, time, desired=wanted),
        by_time=True,
    )
    assert np.allclose(joined(match)[1], wanted, rtol=0.0, atol=1e-6)
    assert match.left_out == 0


def test_a_clock_that_steps_back_is_left_out():
    time = np.concatenate([np.arange(100), np.arange(50, 80)]) / 100.0
    for size in (7, 130):
        match = TrajectoryMatch(
            "a",
            "b",
            blocks(size, time, measured=time),
            blocks(9, time[:100], desired=time[:100]),
            by_time=True,
        )
        assert len(joined(match)[0]) == 100
        assert match.left_out == 30


def test_by_rows_the_time_is_the_trajectorys():
    wanted, found = np.arange(10.0), np.arange(12.0) + 0.5
    for size in (1, 5, 100):
        match = TrajectoryMatch(
            "a",
            "b",
            blocks(size, None, measured=found),
            blocks(3, np.arange(10.0) - 2.0, desired=wanted),
            by_time=False,
        )
        row, desired, measured, time = joined(match)
        assert np.array_equal(desired, wanted) and np.array_equal(measured, found[:10])
        assert np.array_equal(time, np.arange(10.0) - 2.0) and row[-1] == 10
        assert match.notes() == ["a: 2 rows more than in b take no part"]
    match = TrajectoryMatch(
        "a",
        "b",
        blocks(4, None, measured=found),
        blocks(3, None, desired=np.zeros(50)),
        by_time=False,
    )
    assert len(joined(match)[0]) == 12
    assert match.notes() == ["b: goes on behind the last row of a"]


def test_refusals():
    late = TrajectoryMatch(
        "a",
        "b",
        blocks(4, SLOW + 99.0, measured=SLOW),
        blocks(4, SLOW, desired=SLOW),
        by_time=True,
    )
    with pytest.raises(InputError) as caught:
        joined(late)
    assert str(caught.value) == (
        "a: no sample lies within the times of b (where their clocks differ, `match` them by rows)"
    )
    back = np.array([0.0, 1.0, 0.5, 2.0])
    for size in (1, 2, 4):
        match = TrajectoryMatch(
            "a",
            "b",
            blocks(9, back * 2.0, measured=back),
            blocks(size, back, desired=back),
            by_time=True,
        )
        with pytest.raises(InputError) as caught:
            joined(match)
        assert str(caught.value) == (
            "b: row 3: time goes backwards (cut the trajectory there, or `match` by rows)"
        )


def test_a_stamp_a_hair_beyond_the_end_belongs_to_it_in_whatever_block_it_comes():
    # after a block, two samples of the trajectory stay: their step tells how far beyond
    # is still the end
    wanted = np.arange(4.0)
    recorded = np.array([0.0, 1.0, 2.0, 3.0, 3.0 + 5e-7, 3.0 + 2e-6])
    for size in (4, 6):
        match = TrajectoryMatch(
            "run.csv",
            "drive.csv",
            blocks(size, recorded, measured=recorded),
            blocks(4, wanted, desired=10.0 * wanted),
            by_time=True,
        )
        row, desired, _, _ = joined(match)
        assert row.tolist() == [1, 2, 3, 4, 5]
        assert desired.tolist() == [0.0, 10.0, 20.0, 30.0, 30.0]
        assert match.left_out == 1
