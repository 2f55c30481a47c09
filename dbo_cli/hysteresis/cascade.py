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
from typing import Any, NamedTuple, TypeVar

import numpy as np

from dbo_cli.errors import InputError, ModelError
from dbo_cli.hysteresis import kernel, operators
from dbo_cli.hysteresis.dynamics import DynamicsStage
from dbo_cli.hysteresis.kernel import Floats
from dbo_cli.hysteresis.operators import BacklashState, DiscreteBacklashOperator, DiscretePointOperator

Payload = TypeVar("Payload")
MOST_DELAYED = 10_000_000  # samples: 80 MB; a delay of 100 s at 100 kHz
WHOLE = 1e-9  # samples: a time this close to a whole number of them is that; rounding leaves less


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
        if not math.isfinite(self.gain) or self.gain == 0.0 or not math.isfinite(1.0 / self.gain):
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

    Before the first sample the first value holds, after the last one the last. A time within 1e-9 of a
    sample's (in steps) is that sample's, so that shifting there and back is exact. Neither times fall.
    """
    wanted, values_wanted = np.ascontiguousarray(wanted), np.empty(wanted.size)
    signal = np.ascontiguousarray(times), np.ascontiguousarray(values)
    return values_wanted, kernel.CHOSEN.interpolated(*signal, wanted, values_wanted, WHOLE)


def whole_and_part(samples: float) -> tuple[int, float]:
    """Return whole samples and the part beyond; within a billionth of a whole number there is none."""
    whole = math.floor(samples + WHOLE)
    part = max(samples - whole, 0.0)
    return whole, part if part > WHOLE else 0.0


def late_by(values: Floats, part: float) -> Floats:
    """Return all values but the first, late by a part of a sample."""
    later = values[1:]
    return later + part * (values[:-1] - later) if part else later.copy()


@dataclass(frozen=True)
class DelayHistory:
    """What a delay remembers: the samples still to come out, each with its time; the last is the newest."""

    times: tuple[float, ...]
    values: tuple[float, ...]


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
        past_times, past_values = (history.times, history.values) if history else ((0.0,), (float(x[0]),))
        all_times = np.concatenate([past_times, np.broadcast_to(time_step, x.shape)])
        now = len(past_times) - 1
        if history is None:
            all_times[1] = 0.0
        all_times[now:] = np.cumsum(all_times[now:])  # one after the other: any block size
        all_values = np.concatenate([past_values, x])
        if np.ndim(time_step) == 0:
            return self._by_count(float(np.asarray(time_step)), all_times, all_values, x.size)
        y, begin = interpolated(all_times, all_values, all_times[now + 1 :] - self.seconds)
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
        begin = values.size - count - whole - 1
        y = late_by(values[begin : begin + count + 1], part)
        behind = slice(-(whole + 1), None)
        return y, DelayHistory(tuple(times[behind].tolist()), tuple(values[behind].tolist()))


def read_ahead(
    blocks: Iterable[tuple[Payload, Floats, Floats]], seconds: float
) -> Iterator[tuple[Payload, Floats]]:
    """Shift a signal to earlier by ``seconds``: the value wanted at t + seconds, for every sample at t.

    Takes (payload, time, values) and yields (payload, values) for the same blocks, each as soon as enough of
    the future is known; interpolates linearly, and the last value holds. The result does not depend on how
    the signal is cut into blocks; empty blocks are dropped.
    """
    waiting: deque[tuple[Payload, Floats, Floats]] = deque()
    for block in chain(blocks, [None]):
        if block is not None and block[1].size == 0:
            continue
        waiting.extend([block] if block is not None else [])
        while waiting and (block is None or block[1][-1] > waiting[0][1][-1] + seconds):
            time = np.concatenate([block[1] for block in waiting])
            values = np.concatenate([block[2] for block in waiting])
            payload, block_time, _ = waiting.popleft()
            # Mirrored in time, so that the sample after takes the part of the one before: lagging the result
            # by the delay again finds the same pairs of samples.
            ahead, _ = interpolated(-time[::-1], values[::-1], -(block_time + seconds)[::-1])
            yield payload, ahead[::-1]


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
Stage = DiscreteBacklashOperator | MemoryFreeStage | DynamicsStage | DelayStage | OtherHysteresis


def memory_free(stages: Sequence[Stage]) -> MemoryFree:
    """Return the points and scales among stages."""
    return tuple(stage for stage in stages if isinstance(stage, DiscretePointOperator | ScaleStage))


def through(stages: Sequence[MemoryFreeStage], x: Floats, overwrite: bool = False) -> Floats:
    """Pass a block through memory-free stages; ``overwrite``: ``x`` is not needed any more.

    A new array for every stage would cost more than the stages: memory that was given back is empty pages.
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


def slow_output_range(stages: Sequence[Stage], v_min: float, v_max: float) -> tuple[float, float]:
    """Return the least and the greatest output of a forward cascade at rest at the ends of its input.

    Slowly: relaxation has come to rest at either end; dynamics and a delay do not matter. The voltage goes
    from empty to ``v_max``, then to ``v_min``; a negative gain exchanges the two.
    """
    place, operator = next((k, s) for k, s in enumerate(stages) if isinstance(s, DiscreteBacklashOperator))
    head, tail = memory_free(stages[:place]), memory_free(stages[place:])
    state, ends = operator.empty(), []
    for voltage in (v_max, v_min):
        y, after, _ = operator.run(through(head, np.array([voltage])), state)
        state = BacklashState(after.bits)
        ends.append(float(through(tail, y)[0]))
    return min(ends), max(ends)


class CoveredGears(NamedTuple):
    """The gears that a drive inside the covered range moves, and the bits of all others while it does."""

    operator: DiscreteBacklashOperator
    spare_bits: int

    def whole(self, state: BacklashState) -> BacklashState:
        """Return a state of the covered gears as a state of all gears."""
        return BacklashState(state.bits | self.spare_bits, state.memory)


def covered_gears(gears: DiscreteBacklashOperator, low: float, top: float) -> CoveredGears:
    """Return the gears of a forward operator that a drive from ``low`` to ``top`` moves.

    A model may have gears to spare, so that a drive that goes a little further turns there as it does
    inside. They come last in the table, so that the bits of the others keep their places. Where some reach
    below ``low``, the drive finds them engaged after one swing over the covered range, and there they stay.
    """
    core, bits, x0, y0 = gears, 0, gears.x0, gears.y0
    if low > gears.x0 + 0.5 * float(gears.dx[-1]):
        at_once = np.zeros((1, len(gears.relaxation.tau))) if gears.relaxation else None
        _, state, _ = gears.run([top, low], gears.empty(), decay=at_once)  # relaxation plays no part
        count = _gears_within(gears, top - low)
        if state.bits & ((1 << count) - 1) == 0:  # else the gears do not divide the range: nothing to spare
            bits, x0 = state.bits, low
            y0 = gears.coordinates(BacklashState(bits))[1]
    count = _gears_within(gears, top - x0)
    if count < gears.n or bits:
        core = DiscreteBacklashOperator(
            gears.dx[:count], gears.dy[:count], x0, y0, gears.relaxation, gears.memory_on
        )
    return CoveredGears(core, bits)


def _gears_within(gears: DiscreteBacklashOperator, width: float) -> int:
    """Return how many gears, the first ones, are needed to span ``width``."""
    count = int(np.searchsorted(np.cumsum(gears.dx), width - 0.5 * float(gears.dx[-1]))) + 1
    return min(count, gears.n)


def digest_of(stages: Sequence[Stage]) -> str:
    """Return a name for a forward cascade; a gain inverted twice may differ in its last digits."""
    import hashlib  # 2 ms, and most runs ask for no name

    parts: list[object] = []
    for stage in stages:
        if isinstance(stage, ScaleStage):
            parts.append([f"{stage.gain:.9e}", f"{stage.offset:.9e}"])
        elif isinstance(stage, DelayStage):
            parts.append(stage.seconds)
        elif isinstance(stage, DynamicsStage):
            parts.append([dataclasses.asdict(section) for section in stage.sections])
        elif isinstance(stage, OtherHysteresis):
            parts.append(stage.file_values())
        else:
            parts.append([stage.dx.tolist(), stage.dy.tolist(), stage.x0, stage.y0])
            if isinstance(stage, DiscreteBacklashOperator) and stage.relaxation:
                parts.append(dataclasses.asdict(stage.relaxation))
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()
