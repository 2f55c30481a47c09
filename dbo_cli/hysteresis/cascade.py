"""The cascade of stages: scale and delay, and what is asked of several stages at once."""

from __future__ import annotations

import dataclasses
import json
import math
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any, Literal, TypeVar

import numpy as np

from dbo_cli.errors import InputError, ModelError
from dbo_cli.hysteresis import kernel, operators
from dbo_cli.hysteresis.dynamics import DynamicsStage
from dbo_cli.hysteresis.kernel import Floats
from dbo_cli.hysteresis.operators import (
    BacklashState,
    DiscreteBacklashOperator,
    DiscretePointOperator,
)
from dbo_cli.interpolation import smooth

Payload = TypeVar("Payload")
Between = Literal["smooth", "linear"]
MOST_DELAYED = 10_000_000  # samples: 80 MB; a delay of 100 s at 100 kHz
# samples: a time this close to a whole number of them is that; rounding leaves less
WHOLE = 1e-9


@dataclass(frozen=True)
class ScaleStage:
    """A gain and an offset: y = gain x + offset, as K and Y_0 in the paper's Section V.

    Raises
    ------
    ModelError
        The gain is 0, or a number is not finite; the message begins with the key.
    """

    gain: float
    offset: float

    def __post_init__(self) -> None:
        """Refuse what cannot be inverted."""
        if (
            not math.isfinite(self.gain)
            or self.gain == 0.0
            or not math.isfinite(1.0 / self.gain)
        ):
            raise ModelError(f"gain: {self.gain!r} is not a finite number other than 0")
        if not math.isfinite(self.offset) or not math.isfinite(self.offset / self.gain):
            raise ModelError(f"offset: {self.offset!r} is not a finite number")

    def run(self, x: Floats, out: Floats | None = None) -> Floats:
        """Return the output for one block, in ``out`` (which may be ``x``) where that is given."""
        y: Floats = np.multiply(self.gain, x, out=out)
        y += self.offset
        return y

    def inverse(self) -> ScaleStage:
        """Return the stage that undoes this one, to rounding."""
        return ScaleStage(1.0 / self.gain, -self.offset / self.gain)


def interpolated(times: Floats, values: Floats, wanted: Floats) -> tuple[Floats, int]:
    """Return a signal at other times, linearly between its samples, and the sample before the last of them.

    Before the first sample the first value holds, after the last one the last. A time
    within 1e-9 of a sample's (in steps) is that sample's, so that shifting there and
    back is exact. Neither times fall.
    """
    values_wanted = np.empty(wanted.size)
    before = kernel.CHOSEN.interpolated(
        np.ascontiguousarray(times),
        np.ascontiguousarray(values),
        np.ascontiguousarray(wanted),
        values_wanted,
        WHOLE,
    )
    return values_wanted, before


def whole_and_part(samples: float) -> tuple[int, float]:
    """Return whole samples and the part beyond; within a billionth of a whole number there is none."""
    whole = math.floor(samples + WHOLE)
    part = samples - whole
    if part <= WHOLE:
        part = 0.0
    return whole, part


def late_by(values: Floats, part: float) -> Floats:
    """Return all values but the first, late by a part of a sample."""
    later = values[1:]
    if part == 0.0:
        return later.copy()
    return later + part * (values[:-1] - later)


@dataclass(frozen=True)
class DelayHistory:
    """What a delay remembers: the samples still needed, each with its time; the last is the newest."""

    times: tuple[float, ...]
    values: tuple[float, ...]


PIECE = 8192
"""Samples that are delayed at once: 64 kB. Four times as many or as few take as long."""

BETWEEN: tuple[Between, ...] = ("smooth", "linear")
"""How a delay takes a value between two samples; model files before version 3 mean ``linear``."""


@dataclass(frozen=True)
class DelayStage:
    """A pure delay of the output, in seconds; negative in an inverse model, which reads ahead by it.

    Parameters
    ----------
    seconds
        How late the output is.
    between
        How a value between two samples is taken. ``smooth``: from six samples
        (``interpolation.smooth``), of those alone that have come; a delay of less than
        two samples has fewer of them behind the time wanted.

    Raises
    ------
    ModelError
        ``seconds`` is not a finite number, or ``between`` is no such word.
    """

    seconds: float
    between: Between = "smooth"

    def __post_init__(self) -> None:
        """Refuse what is not a time."""
        if not math.isfinite(self.seconds):
            raise ModelError(f"seconds: {self.seconds!r} is not a finite number")
        if self.between not in BETWEEN:
            raise ModelError(f"between: {self.between!r} is not smooth or linear")

    def inverse(self) -> DelayStage:
        """Return the stage that undoes this one."""
        return DelayStage(-self.seconds, self.between)

    def rows_ahead(self, step: float) -> int:
        """Return how many rows of an even clock (s) reading ahead by this delay takes at most.

        The first row of a signal already has six samples.
        """
        samples = abs(self.seconds) / step
        late = math.ceil(samples - WHOLE)
        if self.between == "linear" or not whole_and_part(samples)[1]:
            return late
        return max(late + smooth.AFTER - 1, smooth.WINDOW - 1)

    def lag(
        self,
        x: Floats,
        time_step: float | Floats,
        history: DelayHistory | None,
        overwrite: bool = False,
    ) -> tuple[Floats, DelayHistory | None]:
        """Return one block delayed, and the history after it; ``overwrite``: ``x`` is not needed any more.

        A long block is delayed in pieces: what they take of memory stays in the
        processor's caches. Before the first sample ever the first value holds. With a
        single ``time_step`` (s) the delay is counted in samples, so that a whole number
        of them shifts exactly; with one step for each sample (that of the very first
        does not matter) it is looked up by time.

        Raises
        ------
        ModelError
            The delay is negative.
        InputError
            A single time step is not greater than 0.
        """
        if self.seconds < 0.0:
            raise ModelError(
                "a delay below 0 reads ahead and has no place in a forward model"
            )
        if x.size <= PIECE:
            return self._lag_piece(x, time_step, history)
        y = x if overwrite else np.empty_like(x)
        begin = 0
        while begin < x.size:
            waiting = 0 if history is None else len(history.times)
            end = begin + max(PIECE, 2 * waiting)
            steps = operators.steps_of(time_step, slice(begin, end))
            y[begin:end], history = self._lag_piece(x[begin:end], steps, history)
            begin = end
        return y, history

    def _lag_piece(
        self, x: Floats, time_step: float | Floats, history: DelayHistory | None
    ) -> tuple[Floats, DelayHistory | None]:
        """Return what ``lag`` does."""
        if x.size == 0:
            return x, history
        past = history or DelayHistory((0.0,), (float(x[0]),))
        all_times = np.concatenate([past.times, np.broadcast_to(time_step, x.shape)])
        now = len(past.times) - 1
        if history is None:
            all_times[1] = 0.0
        # one after the other: any block size
        all_times[now:] = np.cumsum(all_times[now:])
        all_values = np.concatenate([past.values, x])
        if np.ndim(time_step) == 0:
            return self._by_count(
                float(np.asarray(time_step)), all_times, all_values, x.size
            )
        return self._by_time(all_times, all_values, x.size)

    def _by_time(
        self, times: Floats, values: Floats, count: int
    ) -> tuple[Floats, DelayHistory]:
        """Delay the last ``count`` samples, looked up by time."""
        if self.between == "linear":
            y, begin = interpolated(times, values, times[-count:] - self.seconds)
        else:
            times, values = _with_rest_before(times, values, count)
            newest = values.size - count
            y, before = smooth.interpolated(
                times, values, times[-count:] - self.seconds, newest
            )
            begin = max(before - (smooth.WINDOW - 1), 0)
        return y, DelayHistory(
            tuple(times[begin:].tolist()), tuple(values[begin:].tolist())
        )

    def _by_count(
        self, step: float, times: Floats, values: Floats, count: int
    ) -> tuple[Floats, DelayHistory]:
        """Delay the last ``count`` samples, counted in steps."""
        if not step > 0.0:
            raise InputError(f"time step: {step!r} s is not greater than 0")
        whole, part = whole_and_part(self.seconds / step)
        if whole > MOST_DELAYED:
            raise InputError(
                f"time step: {step:g} s is {whole:,} times in the delay of {self.seconds:g} s, and more than "
                f"{MOST_DELAYED:,} samples are not held back (a lower sample rate, or a shorter delay)"
            )
        place = 0
        if part and self.between == "smooth":
            place = window_place(whole)
        needed = whole + 1 + place  # samples before the one that has just come
        missing = needed - (values.size - count)
        if missing > 0:
            values = np.concatenate([np.full(missing, values[0]), values])
            times = np.concatenate([times[0] - step * np.arange(missing, 0, -1), times])
        begin = values.size - count - needed
        if place:
            y = smooth.shifted_by_part(
                values[begin : begin + count + smooth.WINDOW - 1], place, 1.0 - part
            )
        else:
            y = late_by(values[begin : begin + count + 1], part)
        behind = slice(-needed, None)
        return y, DelayHistory(
            tuple(times[behind].tolist()), tuple(values[behind].tolist())
        )


class DelayLeft:
    """What a delay leaves of a signal that was read ahead by it: the two interpolations, there and back.

    A plant whose delay is its own leaves what reading ahead alone does, which is less.

    Parameters
    ----------
    delay : DelayStage
        The model's.
    most_rows : int
        So many rows are looked at.
    """

    def __init__(self, delay: DelayStage, most_rows: int) -> None:
        self._delay = DelayStage(abs(delay.seconds), delay.between)
        self._history: DelayHistory | None = None
        self._begin = self._last = math.nan
        self._rows_left = most_rows
        self._squares, self._rows = 0.0, 0

    def add(self, time: Floats, wanted: Floats, ahead: Floats) -> None:
        """Add a block: its times (s), what is wanted there, and the same read ahead."""
        if self._rows_left <= 0 or not time.size:
            return
        if math.isnan(self._begin):
            self._begin = self._last = float(time[0])
        steps = np.diff(time, prepend=self._last)
        if (steps < 0.0).any():
            self._rows_left = 0
            return
        late, self._history = self._delay.lag(ahead, steps, self._history)
        # before, what was is not of this signal
        known = time >= self._begin + self._delay.seconds
        left = (late - wanted)[known]
        self._squares += float(np.square(left).sum())
        self._rows += left.size
        self._rows_left -= time.size
        self._last = float(time[-1])

    @property
    def rms(self) -> float:
        """The root of the mean square of what is left, over the rows looked at."""
        return math.sqrt(self._squares / max(self._rows, 1))


def late_loop(x: Floats, samples: float) -> Floats:
    """Return one period of a loop as a smooth delay makes it late by so many samples."""
    whole, part = whole_and_part(samples)
    if not part:
        return np.roll(x, whole)
    return _from_six(x, -whole - 1, window_place(whole), 1.0 - part)


def early_loop(x: Floats, samples: float) -> Floats:
    """Return one period of a loop, read ahead smoothly by so many samples."""
    whole, part = whole_and_part(samples)
    if not part:
        return np.roll(x, -whole)
    return _from_six(x, whole, 2, part)


def _from_six(x: Floats, first: int, place: int, part: float) -> Floats:
    """Return the values of a loop a part behind the samples from ``first`` on, one for each sample."""
    rows = np.arange(first - place, first - place + x.size + smooth.WINDOW - 1)
    return smooth.shifted_by_part(x[rows % x.size], place, part)


def window_place(whole: int) -> int:
    """Return which step of six samples a delay of ``whole`` samples and a part lies in.

    Three of the six come after the time wanted (place 2) where they have come already,
    else two or one.
    """
    return max(2, 4 - whole)


def _with_rest_before(
    times: Floats, values: Floats, count: int
) -> tuple[Floats, Floats]:
    """Put five samples of the first value before a signal that has just begun, at its first step."""
    past = values.size - count
    if past > 1 or values.size < 2:
        return times, values
    moving = times
    if times.size > 2 and times[1] == times[0]:
        moving = times[1:]
    step = float(moving[1] - moving[0])
    rest_times = moving[0] - step * np.arange(smooth.WINDOW - 1.0, 0.0, -1.0)
    rest = np.full(rest_times.size, values[0])
    return np.concatenate([rest_times, times]), np.concatenate([rest, values])


def read_ahead(
    blocks: Iterable[tuple[Payload, Floats, Floats]],
    seconds: float,
    between: Between = "smooth",
) -> Iterator[tuple[Payload, Floats]]:
    """Shift a signal to earlier by ``seconds``: the value wanted at t + seconds, for every sample at t.

    Takes (payload, time, values) and yields (payload, values) for the same blocks, each
    as soon as enough of the future is known; the last value holds. The result does not
    depend on how the signal is cut into blocks; empty blocks are dropped.
    """
    ahead = _smooth_ahead
    # samples needed behind the last time wanted
    after = smooth.AFTER
    # the first samples are made of the first six, too
    fewest = smooth.WINDOW
    if between == "linear":
        ahead, after, fewest = _linear_ahead, 1, 2
    waiting: deque[tuple[Payload, Floats, Floats]] = deque()
    past_times = np.zeros(0)
    past_values = np.zeros(0)
    for block in chain(blocks, [None]):
        at_end = block is None
        if block is not None:
            if block[1].size == 0:
                continue
            waiting.append(block)
        while waiting:
            if not at_end:
                known = past_times.size + sum(time.size for _, time, _ in waiting)
                last_wanted = float(waiting[0][1][-1]) + seconds
                if known < fewest or not _reaches(waiting, last_wanted, after):
                    break
            time = np.concatenate([past_times, *(entry[1] for entry in waiting)])
            values = np.concatenate([past_values, *(entry[2] for entry in waiting)])
            payload, block_time, _ = waiting.popleft()
            yield payload, ahead(time, values, block_time + seconds)
            gone = slice(past_times.size + block_time.size)
            past_times = time[gone][-smooth.WINDOW :]
            past_values = values[gone][-smooth.WINDOW :]


def _reaches(
    waiting: Iterable[tuple[Any, Floats, Floats]], wanted: float, after: int
) -> bool:
    """Tell whether so many samples are known behind a time."""
    beyond = 0
    for _, time, _ in reversed(list(waiting)):
        beyond += int(np.count_nonzero(time > wanted))
        if beyond >= after or time[0] <= wanted:
            break
    return beyond >= after


def _linear_ahead(time: Floats, values: Floats, wanted: Floats) -> Floats:
    """Return a signal at later times, linearly.

    Mirrored in time, so that the sample after takes the part of the one before: lagging
    the result by the delay again finds the same pairs of samples.
    """
    mirrored, _ = interpolated(-time[::-1], values[::-1], -wanted[::-1])
    return mirrored[::-1]


def _smooth_ahead(time: Floats, values: Floats, wanted: Floats) -> Floats:
    """Return a signal at later times, smoothly."""
    return smooth.interpolated(time, values, wanted)[0]


class OtherHysteresis(ABC):
    """A stage with another hysteresis than that of gears; its room runs the models it stands in."""

    inverted: bool
    relaxation: operators.Relaxation | None

    @abstractmethod
    def inverse(self) -> OtherHysteresis:
        """Return the stage that undoes this one."""

    @abstractmethod
    def file_values(self) -> dict[str, Any]:
        """Return the stage as plain values for the model file, its ``type`` first."""


MemoryFreeStage = DiscretePointOperator | ScaleStage
MemoryFree = tuple[MemoryFreeStage, ...]
Stage = (
    DiscreteBacklashOperator
    | MemoryFreeStage
    | DynamicsStage
    | DelayStage
    | OtherHysteresis
)


def memory_free(stages: Sequence[Stage]) -> MemoryFree:
    """Return the points and scales among stages."""
    kinds = DiscretePointOperator | ScaleStage
    return tuple(stage for stage in stages if isinstance(stage, kinds))


def through(
    stages: Sequence[MemoryFreeStage], x: Floats, overwrite: bool = False
) -> Floats:
    """Pass a block through memory-free stages; ``overwrite``: ``x`` is not needed any more.

    A new array for every stage would cost more than the stages: memory that was given
    back is empty pages.
    """
    for stage in stages:
        x = stage.run(x, x if overwrite else None)
        overwrite = True
    return x


def least_slope(stage: MemoryFreeStage) -> float:
    """Return the least slope of a memory-free stage, without its sign."""
    if isinstance(stage, ScaleStage):
        return abs(stage.gain)
    return float(np.min(stage.dy / stage.dx))


def slow_output_range(
    stages: Sequence[Stage], v_min: float, v_max: float
) -> tuple[float, float]:
    """Return the least and the greatest output of a forward cascade at rest at the ends of its input.

    Slowly: relaxation has come to rest at either end; dynamics and a delay do not
    matter. The voltage goes from empty to ``v_max``, then to ``v_min``; a negative gain
    exchanges the two.
    """
    place, operator = next(
        (place, stage)
        for place, stage in enumerate(stages)
        if isinstance(stage, DiscreteBacklashOperator)
    )
    head = memory_free(stages[:place])
    tail = memory_free(stages[place:])
    state = operator.empty()
    ends = []
    for voltage in (v_max, v_min):
        y, after, _ = operator.run(through(head, np.array([voltage])), state)
        state = BacklashState(after.bits)
        ends.append(float(through(tail, y)[0]))
    return min(ends), max(ends)


ROUNDED = 1e-6
"""Of a gear: the ends of the covered range may be so far off its edges, which are sums of rounded widths."""


def covered_gears(
    gears: DiscreteBacklashOperator, low: float, top: float
) -> DiscreteBacklashOperator:
    """Return the gears of a forward operator that a drive from ``low`` to ``top`` moves.

    A model may have gears to spare, so that a drive that goes a little further turns
    there as it does inside. They come last in the table, so that the bits of the others
    keep their places; ``spare_bits`` are theirs.
    """
    x0, y0 = gears.x0, gears.y0
    spare = _engaged_below(gears, low, top)
    if spare is not None:
        x0 = low
        y0 = gears.coordinates(BacklashState(spare))[1]
    count = _gears_within(gears, top - x0)
    if count == gears.n and not spare:
        return gears
    return DiscreteBacklashOperator(
        gears.dx[:count],
        gears.dy[:count],
        x0,
        y0,
        gears.relaxation,
        gears.memory_on,
    )


def spare_bits(gears: DiscreteBacklashOperator, low: float, top: float) -> int:
    """Return the bits of the gears to spare while a drive stays between ``low`` and ``top``.

    Where some reach below ``low``, the drive finds them engaged after one swing over
    the covered range, and there they stay.
    """
    return _engaged_below(gears, low, top) or 0


def _engaged_below(
    gears: DiscreteBacklashOperator, low: float, top: float
) -> int | None:
    """Return the bits of the gears that reach below ``low``; None where there are none to spare."""
    if low <= gears.x0 + 0.5 * float(gears.dx[-1]):
        return None
    at_once = None
    if gears.relaxation:  # plays no part
        at_once = np.zeros((1, len(gears.relaxation.tau)))
    beyond = ROUNDED * float(gears.dx.min())
    ends = [top + beyond, low - beyond]
    _, state, _ = gears.run(ends, gears.empty(), decay=at_once)
    covered = (1 << _gears_within(gears, top - low)) - 1
    if state.bits & covered:
        return None  # the gears do not divide the range
    return state.bits


def _gears_within(gears: DiscreteBacklashOperator, width: float) -> int:
    """Return how many gears, the first ones, are needed to span ``width``."""
    ends = np.cumsum(gears.dx)
    last = int(np.searchsorted(ends, width - 0.5 * float(gears.dx[-1])))
    return min(last + 1, gears.n)


def digest_of(stages: Sequence[Stage]) -> str:
    """Return a name for a forward cascade; a gain inverted twice may differ in its last digits."""
    import hashlib  # 2 ms, and most runs ask for no name

    parts: list[object] = []
    for stage in stages:
        if isinstance(stage, ScaleStage):
            parts.append([f"{stage.gain:.9e}", f"{stage.offset:.9e}"])
        elif isinstance(stage, DelayStage) and stage.between == "linear":
            parts.append(stage.seconds)
        elif isinstance(stage, DelayStage):
            parts.append([stage.seconds, stage.between])
        elif isinstance(stage, DynamicsStage):
            parts.append([dataclasses.asdict(section) for section in stage.sections])
        elif isinstance(stage, OtherHysteresis):
            parts.append(stage.file_values())
        else:
            parts.append([stage.dx.tolist(), stage.dy.tolist(), stage.x0, stage.y0])
            if isinstance(stage, DiscreteBacklashOperator) and stage.relaxation:
                parts.append(dataclasses.asdict(stage.relaxation))
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()
