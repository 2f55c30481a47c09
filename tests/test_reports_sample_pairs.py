"""Lags, batches, cycles and spans: which samples are compared, and where they are cut."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from trials import pairs

import dbo_cli as dbo
from dbo_cli.errors import InputError, UsageError
from dbo_cli.logs.sample_block import SampleBlock
from dbo_cli.reports.report import cycles, spans
from dbo_cli.reports.sample_pairs import (
    BATCH,
    batched,
    find_lag,
    lagged,
    rows_to_read,
    with_values,
)


def blocks_of(desired, measured, chunk=7, time=None, first=1):
    for start in range(0, len(desired), chunk):
        stop = min(start + chunk, len(desired))
        rows = range(first + start, first + stop)
        clock = None if time is None else time[start:stop]
        yield pairs(
            rows, desired[start:stop], measured[start:stop], clock, -desired[start:stop]
        )


def joined(blocks):
    blocks = list(blocks)
    return {
        "rows": np.concatenate([block.rows for block in blocks]),
        **{
            name: np.concatenate([block.values[name] for block in blocks])
            for name in blocks[0].values
        },
    }


def lengths_of(parts):
    lengths, count = [], 0
    for part in parts:
        if part is None:
            lengths.append(count)
            count = 0
        else:
            count += len(part)
    return [*lengths, count]


@given(st.integers(-30, 30), st.integers(1, 40))
@settings(max_examples=60, derandomize=True, deadline=None)
def test_lag_pairs_each_desired_sample_with_a_later_measured_one(lag, chunk):
    desired, measured = np.arange(50.0), np.arange(50.0) + 1000.0
    found = joined(lagged("run.csv", blocks_of(desired, measured, chunk), lag))
    assert np.array_equal(found["measured"] - 1000.0, found["desired"] + lag)
    assert np.array_equal(found["rows"], found["desired"] + 1.0)
    assert np.array_equal(found["voltage"], -found["desired"])
    assert len(found["rows"]) == 50 - abs(lag)


@pytest.mark.parametrize("lag", [50, -50, 400])
def test_lag_longer_than_the_log(lag):
    with pytest.raises(InputError) as caught:
        list(lagged("run.csv", blocks_of(np.arange(50.0), np.arange(50.0)), lag))
    assert str(caught.value) == (
        f"run.csv: a lag of {lag} samples leaves nothing of 50 rows (`lag` must be shorter than the log)"
    )


def test_no_rows():
    with pytest.raises(
        InputError, match=r"^run.csv: no data rows to compare \(look at `rows`\)$"
    ):
        list(lagged("run.csv", iter(()), 0))


def test_columns_of_different_length():
    with pytest.raises(
        InputError, match=r"^`measured` has 4 samples where `desired` has 5$"
    ):
        dbo.report(np.zeros(5), np.zeros(4))


@pytest.mark.parametrize(
    ("rows", "lag", "read"),
    [
        ((5052, 6051), 1, (5052, 6052)),
        ((5052, 6051), -3, (5049, 6051)),
        ((2, 9), -5, (1, 9)),
        ((5, None), 4, (5, None)),
        ((1, 9), 4, (1, 13)),
        ((1, 9), -4, (1, 9)),
        ((5, 9), 0, (5, 9)),
    ],
)
def test_rows_count_desired_samples(rows, lag, read):
    assert rows_to_read(rows, lag) == read


def test_a_prediction_takes_the_place_of_what_was_desired_and_nothing_is_copied():
    values = {"desired": np.zeros(5), "measured": np.ones(5), "voltage": np.ones(5)}
    block = SampleBlock(range(3, 8), None, np.arange(5.0), values)
    predicted = np.full(5, 7.0)
    pair = with_values(block, desired=predicted)
    assert (
        pair.values["desired"] is predicted
        and pair.values["measured"] is values["measured"]
    )
    assert (
        pair.values["voltage"] is values["voltage"]
        and pair.time is block.time
        and pair.rows is block.rows
    )


@pytest.mark.parametrize("lag", [-17, -1, 0, 3, 40])
def test_lag_is_found(lag):
    rng = np.random.default_rng(1)
    time = np.arange(3000) / 200.0
    signal = 20.0 * np.sin(2.0 * np.pi * time) + 5.0 * np.sin(2.0 * np.pi * 3.3 * time)
    desired = signal[100:2900]
    measured = (
        0.95 * signal[100 - lag : 2900 - lag] - 96.0 + rng.normal(0.0, 0.05, 2800)
    )
    found, again = find_lag("run.csv", blocks_of(desired, measured, 333))
    assert found == lag
    assert np.array_equal(joined(again)["measured"], measured)


def test_lag_of_a_periodic_signal_is_not_a_period_more():
    desired = np.sin(2.0 * np.pi * np.arange(4000) / 200.0)
    assert find_lag("run.csv", blocks_of(desired, np.roll(desired, 12)))[0] == 12


def test_of_lags_that_fit_alike_the_smallest_is_taken():
    """A straight line, its offset aside, fits itself at any lag."""
    desired = np.arange(400.0)
    block = pairs(range(1, 401), desired, desired + 5.0)
    assert find_lag("log", [block])[0] == 0


def test_lag_of_a_constant_is_zero_and_of_no_number_an_error():
    assert find_lag("run.csv", blocks_of(np.ones(50), np.arange(50.0)))[0] == 0
    assert find_lag("run.csv", iter(()))[0] == 0
    with pytest.raises(
        InputError, match=r"^run.csv: no sample is a number, so no lag can be found$"
    ):
        find_lag("run.csv", blocks_of(np.ones(50), np.full(50, np.nan)))


@pytest.mark.parametrize("chunk", [1000, BATCH, 3 * BATCH, 50_001])
def test_batched_keeps_everything(chunk):
    desired = np.arange(70_000.0)
    blocks = list(batched(blocks_of(desired, desired + 1.0, chunk, first=11)))
    assert [len(block) for block in blocks] == [BATCH, BATCH, 70_000 - 2 * BATCH]
    assert np.array_equal(joined(blocks)["desired"], desired)
    assert np.array_equal(joined(blocks)["rows"], np.arange(11, 70_011))


@pytest.mark.parametrize("chunk", [1, 13, 5000])
def test_cycles_end_at_the_minima(chunk):
    desired = -np.cos(2.0 * np.pi * np.arange(1000) / 200.0)
    assert lengths_of(cycles(blocks_of(desired, desired, chunk))) == [200] * 5
    late = desired[50:]  # begins at mid-range, rising
    assert lengths_of(cycles(blocks_of(late, late, chunk))) == [150, 200, 200, 200, 200]


@pytest.mark.parametrize("chunk", [1, 13, 5000])
def test_noise_and_rest_end_no_cycle(chunk):
    rng = np.random.default_rng(2)
    cycle = 1.0 - np.cos(2.0 * np.pi * np.arange(200) / 200.0)
    desired = np.concatenate([cycle, cycle, np.zeros(300), cycle])
    noisy = desired + rng.uniform(-0.02, 0.02, len(desired))
    lengths = lengths_of(cycles(blocks_of(noisy, noisy, chunk)))[-3:]
    assert sum(lengths) > 700
    assert len(lengths_of(cycles(blocks_of(desired, desired, chunk)))) == 3


def test_rest_longer_than_the_patience_is_let_go():
    cycle = 1.0 - np.cos(2.0 * np.pi * np.arange(200) / 200.0)
    desired = np.concatenate([cycle, np.zeros(5000), cycle])
    parts = cycles(blocks_of(desired, desired, 64), patience=128)
    assert lengths_of(parts)[-1] <= 200 + 128


def test_spans_of_time():
    time = np.arange(1000) / 100.0 + 50.0
    signal = np.arange(1000.0)
    assert (
        lengths_of(spans(blocks_of(signal, signal, 33, time), 2.5, None)) == [250] * 4
    )
    assert lengths_of(spans(blocks_of(signal, signal, 33), 3.0, 100.0)) == [
        300,
        300,
        300,
        100,
    ]
    assert (
        lengths_of(spans(blocks_of(signal, signal, 250, time), 2.5, None)) == [250] * 4
    )


def test_a_clock_that_restarts_opens_no_segment_twice():
    time = np.concatenate(
        [np.arange(300) / 100.0, np.arange(300) / 100.0, 3.0 + np.arange(100) / 100.0]
    )
    signal = np.arange(700.0)
    assert lengths_of(spans(blocks_of(signal, signal, 33, time), 1.0, None)) == [
        100,
        100,
        400,
        100,
    ]


def test_spans_need_a_time():
    with pytest.raises(
        UsageError, match=r"^`segment` in seconds needs a time column or `sample_rate`$"
    ):
        list(spans(blocks_of(np.arange(5.0), np.arange(5.0)), 1.0, None))
    with pytest.raises(
        UsageError, match=r"^`segment` 0: a segment must last longer than 0 seconds$"
    ):
        list(spans(iter(()), 0.0, None))
