"""A pure delay of the output, and reading ahead by it.

A value between two samples is taken from six of them: a cubic whose slope at a sample
is that of the polynomial through five samples, limited as in H. T. Huynh, "Accurate
Monotone Cubic Interpolation", SIAM J. Numer. Anal. 30 (1993), scheme M3-A. Where the
samples rise, what is between them rises, so a step or a corner is not overshot, and a
smooth peak keeps its height (``dbo_interpolation.h``). Half a step between the samples
of a sine, the error (RMS, in percent of peak to peak) is 1.3 with 5 samples a period,
0.05 with 10 and 0.002 with 20; linearly it is 6.8, 1.7 and 0.44.
"""

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from dbo_cli.arrays import Floats
from dbo_cli.errors import InputError, ModelError
from dbo_cli.model import kernel
from dbo_cli.model.fields import Keyed, number
from dbo_cli.model.state import Held, Run, State

WINDOW = 6
"""Samples that a value between two samples is made of."""
AFTER = 3
"""Samples of the window that come after the time wanted, where they are known."""
BEFORE = WINDOW - 1 - AFTER
"""Samples of the window before the one that comes just before the time wanted."""
WHOLE_STEP = 1e-9
"""Steps: a time this close to a sample's is that sample's; rounding leaves less."""
MOST_DELAYED = 10_000_000  # samples: 80 MB; a delay of 100 s at 100 kHz


def whole_and_part(samples: float) -> tuple[int, float]:
    """Return whole samples and the part beyond; within a billionth of a whole number there is none."""
    count_before = math.floor(samples + WHOLE_STEP)
    fraction = samples - count_before
    if fraction <= WHOLE_STEP:
        fraction = 0.0
    return count_before, fraction


def between_even(values: Floats, position: int, fraction: float) -> Floats:
    """Return values between even samples: the ``fraction`` of a step behind sample ``position`` of each six.

    ``values`` has five more than come out. ``position`` is 0 to 4: 2 has as many samples of
    the six before the step as behind it, 4 none behind it.
    """
    out = np.empty(values.size - (WINDOW - 1))
    kernel.extension.between_even(np.ascontiguousarray(values), out, position, fraction)
    return out


@dataclass(frozen=True)
class Delay(Keyed):
    """A pure delay of the output, in seconds.

    A value between two samples is made of those alone that have come: a delay of less
    than two samples has fewer of them behind the time wanted.

    Raises
    ------
    ModelError
        ``seconds`` is not a finite number of at least 0.
    """

    seconds: float
    KEYS: ClassVar = {"seconds": number}

    def __post_init__(self) -> None:
        """Refuse what is not a time."""
        if not (math.isfinite(self.seconds) and self.seconds >= 0.0):
            raise ModelError(
                f"seconds: {self.seconds!r} is not a finite time of at least 0"
            )

    def run(self, x: Floats, state: State, dt: float | Floats) -> Run:
        """Return one block delayed, and the state with what is held back after it.

        Before the first sample ever the first value holds. With a single ``dt`` (s) the
        delay is counted in samples, so that a whole number of them shifts exactly; with
        one step a sample (that of the very first does not matter) it is looked up by
        time.

        Raises
        ------
        InputError
            The clock stands still, or the delay is more samples than can be held back.
        """
        if self.seconds == 0.0:
            return Run(x, state)
        past_times, past_values = state.delay or ((), ())
        steps = np.array(np.broadcast_to(dt, x.shape))
        if state.delay is None:
            steps[0] = 0.0
        else:
            steps[0] += past_times[-1]
        times = np.concatenate([past_times, np.cumsum(steps)])
        values = np.concatenate([past_values, x])
        if isinstance(dt, np.ndarray):
            y, held = self._by_time(times, values, x.size)
        else:
            y, held = self._by_count(dt, times, values, x.size)
        return Run(y, replace(state, delay=held))

    def _by_time(
        self, times: Floats, values: Floats, count: int
    ) -> tuple[Floats, Held]:
        """Delay the last ``count`` samples, looked up by time."""
        newest = values.size - count
        if newest < 2 and values.size > 1:  # a signal that has just begun
            step = float(times[1] - times[0])
            times, values = _with_rest_before(times, values, step, WINDOW - 1)
            newest += WINDOW - 1
        sought = np.ascontiguousarray(times[-count:] - self.seconds)
        y = np.empty(count)
        before = kernel.extension.between(times, values, sought, y, newest, WHOLE_STEP)
        begin = max(before - (WINDOW - 1), 0)
        return y, (tuple(times[begin:].tolist()), tuple(values[begin:].tolist()))

    def _by_count(
        self, step: float, times: Floats, values: Floats, count: int
    ) -> tuple[Floats, Held]:
        """Delay the last ``count`` samples, counted in steps."""
        if not step > 0.0:
            raise InputError(f"time step: {step!r} s is not greater than 0")
        count_before, fraction = self._samples(step)
        # which step of six samples the time wanted lies in: three of them come after it
        # (position 2) where they have come already, else two or one
        position = max(BEFORE, WINDOW - 2 - count_before)
        needed = count_before  # samples before the one that has just come
        if fraction:
            needed = count_before + 1 + position
        missing = needed - (values.size - count)
        if missing > 0:
            times, values = _with_rest_before(times, values, step, missing)
        begin = values.size - count - needed
        if fraction:
            six = values[begin : begin + count + WINDOW - 1]
            y = between_even(six, position, 1.0 - fraction)
        else:
            y = values[begin : begin + count].copy()
        kept = max(needed, 1)
        return y, (tuple(times[-kept:].tolist()), tuple(values[-kept:].tolist()))

    def _samples(self, dt: float) -> tuple[int, float]:
        """Return how many samples of a clock of ``dt`` (s) the delay takes, and the part beyond."""
        samples = self.seconds / dt
        if samples > MOST_DELAYED:
            raise InputError(
                f"time step: {dt:g} s: a delay of {self.seconds:g} s has more than {MOST_DELAYED:,} "
                "samples: lower the sample rate"
            )
        return whole_and_part(samples)

    def ahead(self, dt: float) -> int:
        """Return how many rows of an even clock ``undo`` reads ahead."""
        count_before, fraction = self._samples(dt)
        if not fraction:
            return count_before
        return max(count_before + AFTER, WINDOW - 1)

    def undo(
        self, y: Floats, past: tuple[float, ...], dt: float, ahead: int
    ) -> tuple[Floats, tuple[float, ...]]:
        """Return an even signal earlier by the delay, shorter by what that reads ahead, and the past after.

        Parameters
        ----------
        y : array
            A block of the output and ``ahead`` rows of what follows it.
        past : tuple of float
            The last two values before the block; without them the signal begins, and its
            first rows are made of its first six samples.
        """
        end = y.size - ahead
        after = (*past, *y[max(end - BEFORE, 0) : end].tolist())[-BEFORE:]
        count = y.size - self.ahead(dt)
        count_before, fraction = self._samples(dt)
        if not fraction:
            return y[count_before : count_before + count], after
        signal = np.concatenate([past, y])
        first = len(past) + count_before - BEFORE  # begin of the first row's six
        first_rows = min(max(-first, 0), count)
        blocks = [
            between_even(signal[:WINDOW], BEFORE + first + row, fraction)
            for row in range(first_rows)
        ]
        begin = first + first_rows
        if first_rows < count:
            six = signal[begin : begin + count - first_rows + WINDOW - 1]
            blocks.append(between_even(six, BEFORE, fraction))
        return np.concatenate(blocks), after

    def loop(self, x: Floats, dt: float) -> Floats:
        """Return one period of a signal that repeats, late by the delay."""
        periods = 2 + math.ceil(self._samples(dt)[0] / x.size)
        signal = np.tile(x, periods + WINDOW // x.size)
        return self.run(signal, State(), dt).y[-x.size :]

    def identity(self) -> list[object]:
        """Return what a state of the stage refers to."""
        return [self.seconds]


def _with_rest_before(
    times: Floats, values: Floats, step: float, count: int
) -> tuple[Floats, Floats]:
    """Put ``count`` samples of the first value before a signal, ``step`` (s) apart."""
    rest_times = times[0] - step * np.arange(float(count), 0.0, -1.0)
    rest = np.full(count, values[0])
    return np.concatenate([rest_times, times]), np.concatenate([rest, values])
