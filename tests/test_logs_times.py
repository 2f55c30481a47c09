"""What is odd about a clock is said with its place; even sampling is made only where it is asked for."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dbo_cli.errors import InputError, UsageError
from dbo_cli.interpolation.smooth import interpolated
from dbo_cli.logs.columns import ColumnWish
from dbo_cli.logs.request import ReadingOptions, checked_rate, parse_rows
from dbo_cli.logs.sample_block import (
    SampleBlock,
    TimeCheck,
    even_step,
    joined,
    require_even,
    resampled,
)
from dbo_cli.logs.signal_log import open_log

WANT = {"voltage": ColumnWish(None, ("voltage",))}


def notes_of(folder: Path, times: list[float], block_rows: int = 1 << 18) -> list[str]:
    path = folder / "log.csv"
    path.write_text("time_s,voltage_V\n" + "".join(f"{time!r},1\n" for time in times))
    with open_log(str(path), WANT, ReadingOptions(block_rows=block_rows)) as log:
        log.read()
    return [note.removeprefix(str(path)) for note in log.notes]


EVEN = [k / 100 for k in range(50)]
ODD = {
    "even": (EVEN, []),
    "backwards": (
        [*EVEN[:10], 0.05, *EVEN[10:]],
        [": time goes backwards at line 12 (from 0.09 s to 0.05 s)",
         ": a gap at line 13 (from 0.05 s to 0.1 s, usual step 0.01 s)"],
    ),
    "repeats": (
        [*EVEN[:10], 0.09, 0.09, *EVEN[10:]],
        [": the time stamp 0.09 s repeats at line 12, and 1 more"],
    ),
    "gap": (EVEN[:10] + EVEN[20:], [": a gap at line 12 (from 0.09 s to 0.2 s, usual step 0.01 s)"]),
    "clock starts again": (EVEN + EVEN, [": the clock starts again at line 52 (from 0.49 s to 0 s)"]),
    "jitter": (
        [0.0, 0.01, 0.0213, *EVEN[3:]],
        [": time steps vary from 0.0087 s to 0.0113 s (usual step 0.01 s)"],
    ),
    "standing still": ([1.0, 1.0, 1.0], [": the time stamp 1 s repeats at line 3, and 1 more"]),
}  # fmt: skip


@pytest.mark.parametrize("kind", ODD)
@pytest.mark.parametrize("block_rows", [1, 7, 1 << 18])
def test_odd_clocks_are_told(kind: str, block_rows: int, tmp_path: Path) -> None:
    times, expected = ODD[kind]
    assert notes_of(tmp_path, times, block_rows) == expected


def test_line_numbers_count_what_is_between_the_rows(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("time_s,voltage_V\n0,1\n# a remark\n\n0.01,1\n0.02,1\n0.02,1\n")
    with open_log(str(path), WANT) as log:
        log.read()
    assert log.notes == [f"{path}: the time stamp 0.02 s repeats at line 7"]


@settings(derandomize=True, deadline=None, max_examples=50)
@given(st.integers(0, 2**32 - 1), st.integers(1, 3000))
def test_the_verdict_does_not_depend_on_the_blocks(seed: int, size: int) -> None:
    random = np.random.default_rng(seed)
    time = np.cumsum(random.choice([0.0, 0.01, 0.01, 0.01, 0.03, -0.02], 3000))
    block = SampleBlock(range(1, 3001), range(1, 3001), time, {})
    whole, pieces = TimeCheck("log"), TimeCheck("log")
    whole.feed(block)
    for start in range(0, 3000, size):
        pieces.feed(block.part(start, start + size))
    assert whole.notes() == pieces.notes()


def test_dropped_rows_are_counted_and_keep_their_time(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("voltage\n1\nOVLD\n3\n\n4\nOVLD\n")
    with open_log(
        str(path), WANT, ReadingOptions(sample_rate=10.0, skip_bad=True)
    ) as log:
        block = log.read()
    assert block.time is not None
    assert block.time.tolist() == [0.0, 0.2, 0.3]
    assert block.values["voltage"].tolist() == [1.0, 3.0, 4.0]
    assert list(block.rows) == [1, 3, 4]
    assert block.lines is not None
    assert list(block.lines) == [2, 4, 6]
    assert log.notes == [
        f"{path}:3: column 'voltage' is not a number: 'OVLD' and 1 more: 2 rows dropped"
    ]


def test_rows_of_a_log_keep_their_time(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("voltage\n" + "".join(f"{k}\n" for k in range(10)) + "x\n")
    for rows, expected in (("3:5", [2, 3, 4]), ("9:10", [8, 9]), (":2", [0, 1])):
        with open_log(
            str(path), WANT, ReadingOptions(sample_rate=1.0, rows=parse_rows(rows))
        ) as log:
            block = log.read()
        # the bad row is outside and does not matter
        assert block.values["voltage"].tolist() == expected
        assert block.time is not None
        assert block.time.tolist() == expected


def test_rows() -> None:
    assert parse_rows("3:5") == (3, 5)
    assert parse_rows((3, 5)) == (3, 5)
    assert parse_rows((3, None)) == (3, None)
    assert parse_rows(":5") == (1, 5)
    assert parse_rows("3:") == (3, None)
    assert parse_rows(":") == (1, None)


@pytest.mark.parametrize(
    "rows", [5, (1,), (1, 2, 3), (1.5, 2), ("1", 2), (True, 2), None, b"1:2"]
)
def test_rows_that_are_none_are_refused(rows: object) -> None:
    with pytest.raises(UsageError) as raised:
        parse_rows(rows)
    assert (
        str(raised.value)
        == f"`rows` {rows}: give A:B, data rows counted from 1, both ends included"
    )
    with pytest.raises(UsageError):
        ReadingOptions(rows=rows)  # type: ignore[arg-type]


def test_even_step() -> None:
    assert even_step(np.arange(100) / 3000) == pytest.approx(1 / 3000, rel=1e-12)
    # too few digits
    assert even_step(np.round(np.arange(100) / 300, 3)) == pytest.approx(
        1 / 300, rel=1e-2
    )
    assert even_step(np.arange(100) / 300 + 0.001 * (np.arange(100) % 2)) is None
    assert even_step(np.array([0.0, 1.0, 3.0])) is None
    assert even_step(np.array([0.0, 0.0])) is None
    with pytest.raises(InputError) as raised:
        require_even("log.csv", np.array([0.0, 1.0, 3.0]), "`lag` auto needs that")
    assert str(raised.value) == (
        "log.csv: the samples are not evenly spaced in time, and `lag` auto needs that "
        "(`resample` HZ interpolates)"
    )


@settings(derandomize=True, deadline=None, max_examples=60)
@given(
    st.integers(0, 2**32 - 1),
    st.integers(1, 60),
    st.sampled_from([3.0, 10.0, 47.0, 1000.0]),
)
def test_resampling_equals_interpolation_for_any_block_size(
    seed: int, size: int, rate: float
) -> None:
    random = np.random.default_rng(seed)
    time = 5.0 + np.cumsum(random.uniform(0.01, 0.2, 60))
    voltage = random.normal(size=60)
    whole = SampleBlock(range(1, 61), range(2, 62), time, {"voltage": voltage})
    cuts = range(0, 60, size)
    pieces = [
        SampleBlock(range(k + 1, k + size + 1)[: len(time[k : k + size])], None, time[k : k + size],
              {"voltage": voltage[k : k + size]})
        for k in cuts
    ]  # fmt: skip
    expected = joined(list(resampled("log", iter([whole]), rate)))
    got = list(resampled("log", iter(pieces), rate))
    values = np.concatenate([block.values["voltage"] for block in got])
    assert values.tolist() == expected.values["voltage"].tolist()
    assert expected.time is not None
    assert values.tolist() == interpolated(time, voltage, expected.time)[0].tolist()
    assert expected.time[0] == time[0]
    assert time[-1] - expected.time[-1] <= 1.0 / rate


def test_resampling_through_the_log(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("time_ms,voltage\n0,0\n10,1\n30,3\n40,4\n")
    with open_log(str(path), WANT, ReadingOptions(resample=100.0)) as log:
        block = log.read()
    assert block.values["voltage"].tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert list(block.rows) == [1, 2, 3, 4, 5]


def test_resampling_refuses_a_clock_that_does_not_advance(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("time,voltage\n0,0\n1,1\n1,3\n2,4\n")
    for block_rows in (1, 2, 100):
        with (
            pytest.raises(InputError) as raised,
            open_log(
                str(path), WANT, ReadingOptions(resample=1.0, block_rows=block_rows)
            ) as log,
        ):
            log.read()
        assert str(raised.value) == (
            f"{path}: time does not advance at line 4 (from 1 s to 1 s), so it cannot be resampled "
            "(cut the log with `rows` A:B)"
        )


def test_time_is_required_only_where_it_is_needed(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("voltage\n0\n1\n")
    with open_log(str(path), WANT) as log:
        assert log.read().time is None
        with pytest.raises(InputError) as raised:
            log.require_time("the model has a delay")
    assert str(raised.value) == (
        f"{path}: no time column and no sample rate, and the model has a delay "
        "(`time` COLUMN or `sample_rate` HZ)"
    )


def test_a_sample_rate_replaces_a_guessed_time_column(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("time,voltage\n0,5\n7,6\n")
    with open_log(str(path), WANT, ReadingOptions(sample_rate=4.0)) as log:
        block = log.read()
    assert block.time is not None
    assert block.time.tolist() == [0.0, 0.25]
    assert log.notes == [f"{path}: `sample_rate` replaces the column 'time'"]


@pytest.mark.parametrize(
    ("rate", "said"),
    [
        (math.inf, "`sample_rate` inf: give a positive number of samples a second"),
        (math.nan, "`sample_rate` nan: give a positive number of samples a second"),
        (0.0, "`sample_rate` 0: give a positive number of samples a second"),
        (1e13, "`sample_rate` 1e+13: give between 1e-09 and 1e+12 samples a second"),
        (1e-10, "`sample_rate` 1e-10: give between 1e-09 and 1e+12 samples a second"),
    ],
)
def test_a_rate_that_no_clock_has_is_refused(rate: float, said: str) -> None:
    with pytest.raises(UsageError) as raised:
        checked_rate(rate)
    assert str(raised.value) == said
