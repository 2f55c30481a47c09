"""The figures of merit against plain numpy over whole arrays, and independence of the chunk size."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from trials import pairs

from dbo_cli.reports.accumulators import CompensatedSum, ErrorDistribution
from dbo_cli.reports.figures_of_merit import (
    LoopWidth,
    PhaseLag,
    TrackingFigures,
    TrackingMetrics,
)
from dbo_cli.reports.sample_pairs import BATCH, Batches


def figures_of(desired, measured, chunk=None, **options) -> TrackingFigures:
    metrics = TrackingMetrics(**options)
    chunk = chunk or max(len(desired), 1)
    for start in range(0, len(desired), chunk):
        part = slice(start, start + chunk)
        metrics.add(
            pairs(range(1, len(desired) + 1)[part], desired[part], measured[part])
        )
    result = metrics.result()
    assert result is not None
    return result


def sine(samples, period, phase=0.0, amplitude=20.0):
    return amplitude * np.sin(2.0 * np.pi * np.arange(samples) / period - phase)


def test_by_hand():
    desired = np.array([0.0, 1.0, 2.0, 3.0, 4.0])
    measured = np.array([0.0, 1.5, 2.0, 1.0, 4.5])
    figures = figures_of(desired, measured)
    assert figures.samples == 5
    assert figures.rmse == pytest.approx(math.sqrt((0.25 + 4.0 + 0.25) / 5), abs=1e-15)
    assert figures.nrmse_percent == pytest.approx(100.0 * figures.rmse / 4.0, abs=1e-13)
    assert figures.mean == pytest.approx(-0.2, abs=1e-15)
    assert (figures.max_abs, figures.max_abs_row) == (2.0, 4)
    assert figures.p95_abs == 2.0
    assert (figures.desired_min, figures.desired_max) == (0.0, 4.0)


def test_offset_removed():
    desired = sine(1000, 200)
    figures = figures_of(
        desired, desired - 96.25 + 0.5 * np.sign(desired), remove_offset=True
    )
    assert figures.mean == 0.0
    assert figures.offset == pytest.approx(
        np.mean(0.5 * np.sign(desired)) - 96.25, abs=1e-12
    )
    assert figures.rmse == pytest.approx(np.std(0.5 * np.sign(desired)), abs=1e-12)


def test_the_largest_error_is_that_once_the_offset_is_off():
    desired = np.arange(9.0)
    error = np.array([10.0, 10.0, 12.0, 10.0, 10.0, 4.0, 10.0, 10.0, 10.0])
    figures = figures_of(desired, desired + error, remove_offset=True)
    assert figures.offset == pytest.approx(86.0 / 9.0)
    assert (figures.max_abs, figures.max_abs_row) == (
        pytest.approx(86.0 / 9.0 - 4.0),
        6,
    )
    kept = figures_of(desired, desired + error)
    assert (kept.max_abs, kept.max_abs_row) == (12.0, 3)


def test_perfect_tracking_is_exactly_zero():
    desired = sine(5000, 300) + 1e6
    figures = figures_of(desired, desired)
    assert (figures.rmse, figures.max_abs, figures.mean, figures.p95_abs) == (
        0.0,
        0.0,
        0.0,
        0.0,
    )
    assert figures.loop_width == 0.0


def test_constant_desired_leaves_figures_undefined():
    figures = figures_of(np.full(100, 3.0), np.linspace(2.9, 3.1, 100))
    assert figures.nrmse_percent is None
    assert figures.loop_width is None
    assert figures.loop_width_percent is None
    assert figures.lag_left is None
    assert figures.rmse == pytest.approx(np.std(np.linspace(-0.1, 0.1, 100)), abs=1e-12)


def test_samples_that_are_not_numbers_are_left_out_and_counted():
    desired, measured = sine(100, 20), sine(100, 20) + 1.0
    measured[[3, 50]] = np.nan
    desired[7] = np.inf
    figures = figures_of(desired, measured)
    assert (figures.samples, figures.not_finite, figures.rmse) == (
        97,
        3,
        pytest.approx(1.0, abs=1e-12),
    )


@pytest.mark.parametrize("scale", [5e-324, 1e-300, 1e-150, 1e-9, 1e69])
def test_no_scale_breaks_it(scale):
    desired = sine(500, 100, amplitude=1.0) * scale
    figures = figures_of(
        desired, desired + np.where(np.arange(500) % 2, scale, -scale) * 0.25
    )
    assert all(
        value is None or math.isfinite(value) for value in vars(figures).values()
    )
    if scale >= 1e-150:
        assert figures.rmse == pytest.approx(0.25 * scale, rel=1e-12)


@pytest.mark.parametrize("scale", [1e71, 1e308, np.inf])
def test_beyond_what_can_be_squared_counts_as_no_number(scale):
    metrics = TrackingMetrics()
    metrics.add(
        pairs(range(1, 4), np.array([1.0, scale, 2.0]), np.array([1.0, 1.0, -scale]))
    )
    figures = metrics.result()
    assert figures is not None
    assert (figures.samples, figures.not_finite, metrics.missing) == (1, 2, [1, 1])


def test_no_number_at_all():
    metrics = TrackingMetrics()
    metrics.add(pairs(range(1, 6), np.arange(5.0), np.full(5, np.nan)))
    assert metrics.result() is None
    assert metrics.missing == [0, 5]
    assert TrackingMetrics().result() is None


def test_one_sample():
    figures = figures_of(np.array([1.0]), np.array([1.5]))
    assert (figures.samples, figures.rmse, figures.lag_left, figures.sample_period) == (
        1,
        0.5,
        None,
        None,
    )


def test_time_of_the_largest_error_and_sample_period():
    metrics = TrackingMetrics()
    time = np.arange(50) * 0.005
    error = np.where(np.arange(50) == 31, -7.0, 0.1)
    metrics.add(pairs(range(100, 150), np.arange(50.0), np.arange(50.0) + error, time))
    figures = metrics.result()
    assert figures is not None
    assert (figures.max_abs_row, figures.max_abs_time) == (131, 31 * 0.005)
    assert figures.sample_period == pytest.approx(0.005, rel=1e-12)


@pytest.mark.parametrize("chunk", [1, 97, 1000, BATCH - 1, BATCH, BATCH + 1])
def test_chunk_size_does_not_matter_to_the_last_bit(chunk):
    samples = 40 if chunk == 1 else 2 * BATCH + 12345
    rng = np.random.default_rng(5)
    desired = sine(samples, 777.7)
    measured = 0.9 * sine(samples, 777.7, 0.1) + rng.normal(0.0, 0.3, samples) - 96.0
    whole = figures_of(desired, measured, remove_offset=True)
    assert figures_of(desired, measured, chunk, remove_offset=True) == whole


def test_many_samples_agree_with_numpy():
    rng = np.random.default_rng(6)
    samples = 3 * BATCH + 17
    desired = sine(samples, 5000.0)
    measured = desired + rng.standard_t(3, samples) * 0.2 + 5.0
    figures = figures_of(desired, measured, remove_offset=True)
    error = measured - desired
    assert figures.offset == pytest.approx(error.mean(), rel=1e-13)
    assert figures.rmse == pytest.approx(error.std(), rel=1e-13)
    assert figures.max_abs == pytest.approx(
        np.abs(error - error.mean()).max(), rel=1e-13
    )
    assert figures.p95_abs == pytest.approx(
        np.quantile(np.abs(error - error.mean()), 0.95), rel=2e-3
    )


class TestErrorDistribution:
    def test_exact_for_one_batch(self):
        distribution = ErrorDistribution()
        distribution.add(np.arange(100.0) - 50.0)
        assert distribution.quantile_abs(0.95) == 47.0
        assert distribution.quantile_abs(0.5) == 25.0
        assert distribution.quantile_abs(1.0, offset=-50.0) == 99.0

    @given(st.floats(1e-15, 1e15), st.floats(-3.0, 3.0))
    @settings(max_examples=30, derandomize=True, deadline=None)
    def test_resolution_does_not_depend_on_the_scale(self, scale, centre):
        rng = np.random.default_rng(0)
        error = (rng.normal(centre, 1.0, 3 * 4096)) * scale
        distribution = ErrorDistribution()
        for part in np.split(error, 3):
            distribution.add(part)
        exact = np.sort(np.abs(error))[math.ceil(0.95 * len(error)) - 1]
        assert distribution.quantile_abs(0.95) == pytest.approx(
            exact, abs=2e-3 * (abs(exact) + scale)
        )
        values, counts = distribution.values()
        assert counts.sum() == len(error)
        assert np.all(np.diff(values) > 0.0)

    def test_one_spike_costs_no_resolution(self):
        distribution = ErrorDistribution()
        error = np.linspace(-1.0, 1.0, 4096)
        spiked = error.copy()
        spiked[100] = 1e12
        distribution.add(error)
        distribution.add(spiked)
        assert distribution.quantile_abs(0.5) == pytest.approx(0.5, rel=2e-3)


class TestLoopWidth:
    def loop(self, desired, measured, chunk=10**6):
        width = LoopWidth()
        for start in range(0, len(desired), chunk):
            part = slice(start, start + chunk)
            width.add(desired[part], (measured - desired)[part])
        loop = width.loop()
        return None if loop is None else loop.width

    def test_of_a_play_is_its_width(self):
        # up: the output is 1.5 too low, down: 1.5 too high; it lags behind, so the
        # width is positive
        desired = sine(20000, 400)
        measured = desired - 1.5 * np.sign(np.gradient(desired))
        assert self.loop(desired, measured) == pytest.approx(3.0, abs=1e-12)
        assert self.loop(desired, desired + (desired - measured)) == pytest.approx(
            -3.0, abs=1e-12
        )

    def test_none_where_only_one_direction_was_seen(self):
        desired = np.linspace(0.0, 1.0, 1000)
        assert self.loop(desired, desired) is None

    @pytest.mark.parametrize("growth", [1e-6, 1.0, 1e6])
    def test_range_need_not_be_known(self, growth):
        desired = sine(4000, 200) * np.geomspace(1.0, growth, 4000) + 100.0
        measured = desired - 0.25 * np.sign(np.gradient(desired))
        assert self.loop(desired, measured, 50) == pytest.approx(
            0.5, abs=1e-6 * max(growth, 1.0)
        )

    def test_rest_counts_for_neither_direction(self):
        desired = np.concatenate([np.zeros(500), sine(4000, 200), np.zeros(500)])
        error = np.concatenate([np.full(500, 9.0), np.zeros(4000), np.full(500, 9.0)])
        assert abs(self.loop(desired, desired + error)) < 1.0


class TestPhaseLag:
    def lag(self, desired, measured):
        lag = PhaseLag()
        lag.add(desired, measured)
        return lag.lag()

    @pytest.mark.parametrize("phase", [-1.3, -0.01, 0.0, 0.2, 1.5])
    @pytest.mark.parametrize("samples", [130, 200, 730])
    def test_exact_for_a_sine_of_any_amplitude_and_length(self, phase, samples):
        period = 200.0
        lag, degrees = self.lag(
            sine(samples, period), 0.7 * sine(samples, period, phase) + 3.0
        )
        assert lag == pytest.approx(phase / (2.0 * np.pi) * period, abs=1e-9)
        assert degrees == pytest.approx(math.degrees(phase), abs=1e-9)

    def test_small_lag_of_a_broad_band_signal(self):
        rng = np.random.default_rng(3)
        spectrum = np.zeros(4097, dtype=complex)
        spectrum[5:60] = rng.normal(size=55) + 1j * rng.normal(size=55)
        shift = np.exp(-2j * np.pi * np.arange(4097) / 8192 * 1.25)
        desired, measured = np.fft.irfft(spectrum), np.fft.irfft(spectrum * shift)
        assert self.lag(desired, measured)[0] == pytest.approx(1.25, abs=0.01)

    def test_none_where_nothing_moves(self):
        assert self.lag(np.full(50, 2.0), np.arange(50.0)) is None
        assert self.lag(np.arange(50.0), np.arange(50.0)) is None
        assert PhaseLag().lag() is None


@given(st.lists(st.integers(0, 40), max_size=20), st.integers(1, 16))
@settings(max_examples=60, derandomize=True, deadline=None)
def test_batches_keep_every_sample_in_order(lengths, size):
    stream = np.arange(float(sum(lengths)))
    batches = Batches(size)
    seen, start = [], 0
    for length in lengths:
        part = stream[start : start + length]
        rows = range(start + 1, start + length + 1)
        seen += list(batches.add(pairs(rows, part, -part)))
        start += length
    assert all(len(one) == size for one in seen)
    rest = list(batches.rest())
    assert len(rest) <= 1 and all(0 < len(one) < size for one in rest)
    assert list(batches.rest()) == []
    empty = np.empty(0)
    for role, values in (("desired", stream), ("measured", -stream)):
        assert np.array_equal(
            np.concatenate([empty, *(x.values[role] for x in [*seen, *rest])]), values
        )
    assert np.array_equal(
        np.concatenate([empty, *(x.rows for x in [*seen, *rest])]), stream + 1.0
    )


def test_compensated_sum_keeps_what_rounding_takes():
    total = CompensatedSum()
    for value in (1.0, 1e100, 1.0, -1e100):
        total.add(value)
    assert total.value == 2.0


def test_the_range_is_that_of_all_batches():
    desired = np.zeros(3 * BATCH)
    desired[[5, 7]] = -4.0, 6.0
    metrics = TrackingMetrics()
    metrics.add(pairs(range(1, len(desired) + 1), desired, desired + 1.0))
    figures = metrics.result()
    assert figures is not None
    assert (figures.desired_min, figures.desired_max, figures.nrmse_percent) == (
        -4.0,
        6.0,
        10.0,
    )
