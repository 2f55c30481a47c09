"""Loop width and lag of held, rounded, noisy and stepped signals, and what noise alone would show."""

from __future__ import annotations

import numpy as np
import pytest
from trials import pairs

from dbo_cli.reports.figures_of_merit import (
    DirectionTracker,
    LoopWidth,
    NoiseLevel,
    PhaseLag,
    TrackingFigures,
    TrackingMetrics,
    hold_length,
    monotone_ends,
)
from dbo_cli.reports.sample_pairs import BATCH

TRUE_LOOP = 0.5


def figures_of(desired, measured, chunk=None) -> TrackingFigures:
    metrics = TrackingMetrics()
    chunk = chunk or len(desired)
    for start in range(0, len(desired), chunk):
        part = slice(start, start + chunk)
        metrics.add(
            pairs(range(1, len(desired) + 1)[part], desired[part], measured[part])
        )
    result = metrics.result()
    assert result is not None
    return result


def play(signal, width=TRUE_LOOP):
    """Return what a mechanism with this backlash makes of a signal."""
    out = np.empty_like(signal)
    at = signal[0] - width / 2
    for place, value in enumerate(signal.tolist()):
        at = min(max(at, value - width / 2), value + width / 2)
        out[place] = at
    return out


def sine(samples=4000, period=1000):
    return 5.0 - 5.0 * np.cos(2.0 * np.pi * np.arange(samples) / period)


def triangle(samples=4000, period=1000):
    return 10.0 * np.abs(2.0 * ((np.arange(samples) / period) % 1.0) - 1.0)


def held(signal, samples):
    return signal[np.arange(len(signal)) // samples * samples]


def rounded(signal, steps):
    return np.round(signal / 10.0 * steps) / steps * 10.0


def noisy(signal, percent, seed=1):
    return signal + np.random.default_rng(seed).normal(0.0, 0.1 * percent, len(signal))


SHAPES = {"sine": sine, "triangle": triangle}
AS_WANTED = {
    "smooth": lambda signal: signal,
    "of 8 bits": lambda signal: rounded(signal, 255),
    "staircase": lambda signal: rounded(signal, 20),
    "held for 10": lambda signal: held(signal, 10),
    "held for 50": lambda signal: held(signal, 50),
    "noise of 0.5 %": lambda signal: noisy(signal, 0.5),
    "noise of 2 %": lambda signal: noisy(signal, 2.0),
    "8 bits of a noisy reading": lambda signal: rounded(noisy(signal, 0.2), 255),
}


@pytest.mark.parametrize("period", [1000, 2000])
@pytest.mark.parametrize("how", AS_WANTED)
def test_a_loop_shows_however_the_desired_signal_is_written(how, period):
    """The mechanism follows the smooth wish; the log holds it held, rounded or read back with noise."""
    wish = sine(8000, period)
    smooth = figures_of(wish, play(wish))
    figures = figures_of(AS_WANTED[how](wish), play(wish))
    assert figures.loop_width == pytest.approx(
        TRUE_LOOP, abs=0.06 if "2 %" in how else 0.04
    )
    assert figures.lag_left == pytest.approx(smooth.lag_left, rel=0.06)
    assert figures.loop_noise is not None
    assert figures.loop_noise < 0.3 * TRUE_LOOP


@pytest.mark.parametrize(
    "how", ["of 8 bits", "staircase", "held for 10", "held for 50"]
)
@pytest.mark.parametrize("shape", SHAPES)
def test_a_loop_shows_where_the_mechanism_follows_the_steps(shape, how):
    steps = AS_WANTED[how](SHAPES[shape]())
    figures = figures_of(steps, play(steps))
    assert figures.loop_width == pytest.approx(TRUE_LOOP, abs=1e-9)
    smooth = figures_of(SHAPES[shape](), play(SHAPES[shape]()))
    assert figures.lag_left == pytest.approx(smooth.lag_left, rel=0.06)


def test_one_pass_over_a_staircase_has_a_loop():
    steps = rounded(sine(1000, 1000), 20)
    assert figures_of(steps, play(steps)).loop_width == pytest.approx(
        TRUE_LOOP, abs=1e-9
    )


def test_compensated_too_much_is_negative_however_it_is_written():
    wish = sine(8000)
    for write in AS_WANTED.values():
        assert figures_of(
            write(wish), 2.0 * wish - play(wish)
        ).loop_width == pytest.approx(-0.5, abs=0.06)


@pytest.mark.parametrize("samples", [4000, 40_000])
@pytest.mark.parametrize("percent", [0.05, 0.5, 2.0])
def test_noise_without_a_loop_reads_about_the_noise_floor(samples, percent):
    wish = sine(samples)
    read = []
    for seed in range(8):
        figures = figures_of(wish, noisy(wish, percent, seed))
        assert figures.loop_width is not None and figures.loop_noise is not None
        read.append(abs(figures.loop_width) / figures.loop_noise)
    assert 0.5 < np.median(read) < 1.3
    assert max(read) < 2.0


def test_a_loop_in_noise_stands_out_of_the_noise_floor():
    wish = sine(4000)
    figures = figures_of(wish, noisy(play(wish), 2.0))
    assert figures.loop_width == pytest.approx(TRUE_LOOP, abs=0.1)
    assert figures.loop_noise is not None
    assert 0.0 < figures.loop_noise < 0.2 * TRUE_LOOP


@pytest.mark.parametrize("how", AS_WANTED)
@pytest.mark.parametrize("chunk", [7, 1000, BATCH - 1, BATCH + 1])
def test_any_block_size_gives_the_same_bits(how, chunk):
    wish = sine(2 * BATCH + 4321, 3217)
    desired, measured = AS_WANTED[how](wish), noisy(play(wish), 0.3, seed=2)
    if chunk == 7:
        desired, measured = desired[:5000], measured[:5000]
    assert figures_of(desired, measured, chunk) == figures_of(desired, measured)


def test_a_long_rest_in_between_costs_no_memory_and_no_loop():
    wish = np.concatenate(
        [sine(2250, 1000), np.full(5 * BATCH, 10.0), sine(4000, 1000)[500:]]
    )
    figures = figures_of(wish, play(wish))
    assert figures.loop_width == pytest.approx(TRUE_LOOP, abs=1e-6)


class TestDirectionTracker:
    def ways(self, values, size=10**9):
        """Return the way of every sample once all is known, from batches of one size."""
        tracker = DirectionTracker()
        out: list[int] = []
        waiting = 0
        for start in range(0, len(values), size):
            told = tracker.add(values[start : start + size])
            if told.earlier is not None:
                out[len(out) - waiting :] = [told.earlier] * waiting
                waiting = 0
            out += told.ways.tolist()
            waiting += len(told.ways) - told.open_from
        return out

    def test_plateaus_keep_their_direction(self):
        assert self.ways(np.array([0.0, 0, 1, 1, 2, 2, 2, 1, 1, 0, 0])) == [
            0,
            0,
            1,
            1,
            1,
            0,
            0,
            -1,
            -1,
            -1,
            0,
        ]

    @pytest.mark.parametrize("size", [97, 1000, 10**9])
    @pytest.mark.parametrize("write", AS_WANTED)
    def test_the_way_is_that_of_the_wish(self, write, size):
        wish = sine(4000)
        ways = np.array(self.ways(AS_WANTED[write](wish), size))
        slope = np.sign(np.gradient(wish))
        assert np.mean(ways == -slope) < (0.05 if "2 %" in write else 0.02)
        assert np.mean(ways == slope) > 0.75

    def test_noise_does_not_turn(self):
        rising = np.linspace(0.0, 10.0, 20_000) + np.random.default_rng(5).normal(
            0.0, 0.05, 20_000
        )
        assert -1 not in self.ways(rising)
        assert self.ways(rising).count(1) > 18_000
        assert self.ways(-rising).count(-1) > 18_000


def test_noise_level_of_white_noise():
    level = NoiseLevel()
    assert level.deviation == 0.0
    level.add(np.random.default_rng(6).normal(3.0, 0.2, 100_000))
    assert level.deviation == pytest.approx(0.2, rel=0.02)


def test_monotone_ends():
    assert monotone_ends(np.array([0.0, 1.0, 2.0, 2.0, 1.0])).tolist() == [0, 2, 3, 4]
    assert monotone_ends(np.array([])).tolist() == []
    assert monotone_ends(np.array([1.0])).tolist() == [0]


def test_hold_length():
    wish = sine(4000)
    assert hold_length(held(wish, 10), wish) == 10.0
    assert hold_length(held(wish, 10), held(wish, 10)) == 1.0, (
        "the mechanism steps, too"
    )
    late = np.convolve(
        held(wish, 50), np.exp(-np.arange(400) / 8.0) * (1.0 - np.exp(-1.0 / 8.0))
    )[:4000]
    assert hold_length(held(wish, 50), late) == 1.0, "the mechanism follows each step"
    assert hold_length(rounded(wish, 255), wish) == 1.0
    assert hold_length(wish, wish) == 1.0
    assert hold_length(np.ones(500), wish[:500]) is None


def test_bins_that_are_doubled_keep_their_places() -> None:
    """A range that grows from a place with an odd number: every sample stays in the bin of its value."""
    width = LoopWidth()
    signal = np.concatenate(
        [np.linspace(first, first + 0.4, 500) for first in (3.3, 3.7, 4.1)]
    )
    signal = np.concatenate([signal, np.linspace(4.6, 70.0, 2000)])
    for batch in np.array_split(signal, 40):
        width.add(batch, np.zeros(len(batch)))
    counted = width._sums[0] + width._sums[2] + width._sums[4]
    places = np.floor(signal / width._bins.width).astype(int) - width._bins.first
    expected = np.bincount(places, minlength=len(counted))
    # the very first sample has no direction yet
    assert np.abs(counted - expected).sum() <= 2
    assert expected.max() > 500


def test_a_value_held_from_one_batch_into_the_next_counts_once():
    hold, count = 7, 3 * BATCH
    assert BATCH % hold != 0
    phase = 2.0 * np.pi * np.arange(count) / 3500.0
    desired = np.sin(phase)[np.arange(count) // hold * hold]
    measured = np.sin(phase - 0.2)
    held, new = TrackingMetrics(), TrackingMetrics()
    held.add(pairs(range(count), desired, measured))
    new.add(pairs(range(len(desired[::hold])), desired[::hold], measured[::hold]))
    first, second = held.result(), new.result()
    assert first is not None and second is not None
    assert first.phase_left == pytest.approx(second.phase_left, rel=1e-9)
    assert first.lag_left == pytest.approx(hold * second.lag_left, rel=1e-9)
    assert first.phase_left == pytest.approx(np.degrees(0.2), rel=1e-4)


def test_what_is_open_at_the_end_of_a_batch_counts_once_its_way_is_known():
    # a step of 1,000 samples lies across the end of the first batch
    stairs = np.arange(2 * BATCH) // 1000.0
    desired = np.concatenate([stairs, stairs[::-1]])
    error = np.zeros(len(desired))
    # of the batch's last step all but its first sample
    error[BATCH // 1000 * 1000 + 1 : BATCH] = 1.0
    width = LoopWidth()
    for part in np.split(np.arange(len(desired)), 4):
        width.add(desired[part], error[part])
    loop = width.loop()
    assert loop is not None
    # a bin holds two steps
    assert loop.width == pytest.approx(-(BATCH % 1000 - 1) / 2000.0, rel=1e-12)


def test_the_lag_loses_no_sample_between_two_batches():
    phase = 2.0 * np.pi * np.arange(400) / 20.0
    measured = np.sin(phase - 0.3) + np.random.default_rng(5).normal(0.0, 0.2, 400)
    whole, cut = PhaseLag(), PhaseLag()
    whole.add(np.sin(phase), measured)
    for part in np.split(np.arange(400), 8):
        cut.add(np.sin(phase[part]), measured[part])
    first, second = whole.lag(), cut.lag()
    assert first is not None and second is not None
    assert second == pytest.approx(first, rel=1e-9)
