"""A pure delay of the displacement: lagging a signal by it, and reading a trajectory ahead by it."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from dbo_cli.errors import InputError, ModelError
from dbo_cli.hysteresis import kernel

Floats = NDArray[np.float64]
Payload = TypeVar("Payload")

MOST_DELAYED = 10_000_000  # samples: 80 MB; a delay of 100 s at 100 kHz
_WHOLE = 1e-9  # a delay, or a time in samples, this close to a whole number of samples is that number


def interpolated(times: Floats, values: Floats, wanted: Floats) -> tuple[Floats, int]:
    """Return a signal at other times, linearly between its samples, and the sample before the last of them.

    Before the first sample the first value holds, after the last one the last. A time within 1e-9 of a
    sample's (in steps) is that sample's, so that shifting there and back is exact. Neither times fall.
    """
    wanted, found = np.ascontiguousarray(wanted), np.empty(wanted.size)
    signal = np.ascontiguousarray(times), np.ascontiguousarray(values)
    return found, kernel.CHOSEN.interpolated(*signal, wanted, found, _WHOLE)


def whole_and_part(samples: float) -> tuple[int, float]:
    """Return whole samples and the part beyond; within a billionth of a whole number there is none."""
    whole = math.floor(samples + _WHOLE)
    part = max(samples - whole, 0.0)
    return whole, part if part > _WHOLE else 0.0


@dataclass(frozen=True)
class DelayHistory:
    """What a delay remembers: the samples still to come out, each with its time; the last is the newest."""

    times: tuple[float, ...]
    values: tuple[float, ...]

    def to_json_dict(self) -> dict[str, object]:
        """Return the history as plain JSON values."""
        return {"times": list(self.times), "values": list(self.values)}


@dataclass(frozen=True)
class DelayStage:
    """A pure delay of the output, in seconds; negative in an inverse model, which reads ahead by it.

    Raises
    ------
    ModelError
        ``seconds`` is not a finite number.
    """

    seconds: float

    def __post_init__(self) -> None:
        """Refuse what is not a time."""
        if not math.isfinite(self.seconds):
            raise ModelError(f"seconds: {self.seconds!r} is not a finite number")

    def inverse(self) -> DelayStage:
        """Return the stage that undoes this one."""
        return DelayStage(-self.seconds)

    def lag(
        self, x: Floats, time_step: float | Floats, history: DelayHistory | None
    ) -> tuple[Floats, DelayHistory | None]:
        """Return one block delayed, interpolated linearly between samples, and the history after it.

        Before the first sample ever the first value holds. With a single ``time_step`` (s) the delay is
        counted in samples, so that a whole number of them shifts exactly; with one step for each sample
        (that of the very first does not matter) it is looked up by time.

        Raises
        ------
        ModelError
            The delay is negative.
        InputError
            A single time step is not greater than 0.
        """
        if self.seconds < 0.0:
            raise ModelError("a delay below 0 reads ahead and has no place in a forward model")
        if x.size == 0:
            return x, history
        steps = np.broadcast_to(np.asarray(time_step, dtype=np.float64), x.shape).copy()
        clock = history.times[-1] if history else 0.0
        if history is None:
            steps[0] = 0.0
        times = np.cumsum(np.concatenate([[clock], steps]))[1:]  # one after the other: any block size
        past_times = history.times if history else (clock,)
        past_values = history.values if history else (float(x[0]),)
        all_times = np.concatenate([past_times, times])
        all_values = np.concatenate([past_values, x])
        if np.ndim(time_step) == 0:
            return self._by_count(float(np.asarray(time_step)), all_times, all_values, x.size)
        y, begin = interpolated(all_times, all_values, times - self.seconds)
        return y, DelayHistory(tuple(all_times[begin:].tolist()), tuple(all_values[begin:].tolist()))

    def _by_count(
        self, step: float, times: Floats, values: Floats, count: int
    ) -> tuple[Floats, DelayHistory]:
        if not step > 0.0:
            raise InputError(f"time step: {step!r} s is not greater than 0")
        whole, part = whole_and_part(self.seconds / step)
        if whole > MOST_DELAYED:
            raise InputError(
                f"time step: {step:g} s is {whole:,} times in the delay of {self.seconds:g} s, and more than "
                f"{MOST_DELAYED:,} samples are not held back (a lower sample rate, or a shorter delay)"
            )
        missing = whole + 1 - (values.size - count)
        if missing > 0:
            values = np.concatenate([np.full(missing, values[0]), values])
            times = np.concatenate([times[0] - step * np.arange(missing, 0, -1), times])
        begin = values.size - count - whole
        later, earlier = values[begin : begin + count], values[begin - 1 : begin - 1 + count]
        y = later + part * (earlier - later) if part else later.copy()
        kept = slice(-(whole + 1), None)
        return y, DelayHistory(tuple(times[kept].tolist()), tuple(values[kept].tolist()))


def read_ahead(
    blocks: Iterable[tuple[Payload, Floats, Floats]], seconds: float
) -> Iterator[tuple[Payload, Floats]]:
    """Shift a signal to earlier by ``seconds``: the value wanted at t + seconds, for every sample at t.

    Takes (payload, time, values) and yields (payload, values) for the same blocks, each as soon as enough of
    the future is known; interpolates linearly, and the last value holds. The result does not depend on how
    the signal is cut into blocks; empty blocks are dropped.
    """
    waiting: deque[tuple[Payload, Floats, Floats]] = deque()
    for block in blocks:
        if block[1].size == 0:
            continue
        waiting.append(block)
        while waiting and block[1][-1] > waiting[0][1][-1] + seconds:
            yield _shifted(waiting, seconds)
    while waiting:
        yield _shifted(waiting, seconds)


def _shifted(waiting: deque[tuple[Payload, Floats, Floats]], seconds: float) -> tuple[Payload, Floats]:
    """Take the first block off and return it shifted, by the blocks that wait behind it."""
    time = np.concatenate([block[1] for block in waiting])
    values = np.concatenate([block[2] for block in waiting])
    payload, own, _ = waiting.popleft()
    # Mirrored in time, so that the sample after takes the part of the one before: lagging the result by the
    # delay again finds the same pairs of samples.
    ahead, _ = interpolated(-time[::-1], values[::-1], -(own + seconds)[::-1])
    return payload, ahead[::-1]
