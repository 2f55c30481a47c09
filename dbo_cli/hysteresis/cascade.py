"""The stages of a cascade beside the two operators: scale and delay."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dbo_cli.errors import InputError, ModelError
from dbo_cli.hysteresis.operators import BacklashState, DiscreteBacklashOperator, DiscretePointOperator

Floats = NDArray[np.float64]

_WHOLE = 1e-9  # a delay this close to a whole number of samples is that number


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

    def run(self, x: Floats) -> Floats:
        """Return the output for one block."""
        y: Floats = self.gain * x + self.offset
        return y

    def inverse(self) -> ScaleStage:
        """Return the stage that undoes this one, to rounding."""
        return ScaleStage(1.0 / self.gain, -self.offset / self.gain)


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
        return self._by_time(times - self.seconds, all_times, all_values)

    def _by_count(
        self, step: float, times: Floats, values: Floats, count: int
    ) -> tuple[Floats, DelayHistory]:
        if not step > 0.0:
            raise InputError(f"time step: {step!r} s is not greater than 0")
        samples = self.seconds / step
        whole = math.floor(samples + _WHOLE)
        part = max(samples - whole, 0.0)
        missing = whole + 1 - (values.size - count)
        if missing > 0:
            values = np.concatenate([np.full(missing, values[0]), values])
            times = np.concatenate([times[0] - step * np.arange(missing, 0, -1), times])
        begin = values.size - count - whole
        later, earlier = values[begin : begin + count], values[begin - 1 : begin - 1 + count]
        y = later + part * (earlier - later) if part > _WHOLE else later.copy()
        kept = slice(-(whole + 1), None)
        return y, DelayHistory(tuple(times[kept].tolist()), tuple(values[kept].tolist()))

    def _by_time(self, wanted: Floats, times: Floats, values: Floats) -> tuple[Floats, DelayHistory]:
        before = np.searchsorted(times, wanted, side="right") - 1
        first = np.clip(before, 0, None)
        second = np.clip(before + 1, 0, times.size - 1)
        gap = times[second] - times[first]
        with np.errstate(invalid="ignore", divide="ignore"):
            part = np.where(gap > 0.0, (wanted - times[first]) / gap, 0.0)
        part = np.where(part < _WHOLE, 0.0, np.where(part > 1.0 - _WHOLE, 1.0, part))
        y = values[first] + part * (values[second] - values[first])
        begin = int(first[-1])
        return y, DelayHistory(tuple(times[begin:].tolist()), tuple(values[begin:].tolist()))


Stage = DiscreteBacklashOperator | DiscretePointOperator | ScaleStage | DelayStage
MemoryFree = tuple[DiscretePointOperator | ScaleStage, ...]


def memory_free(stages: Sequence[Stage]) -> MemoryFree:
    """Return the points and scales among stages."""
    return tuple(stage for stage in stages if isinstance(stage, DiscretePointOperator | ScaleStage))


def through(stages: Sequence[DiscretePointOperator | ScaleStage], signal: Floats) -> Floats:
    """Pass a block through memory-free stages."""
    for stage in stages:
        signal = stage.run(signal)
    return signal


def least_slope(stage: DiscretePointOperator | ScaleStage) -> float:
    """Return the least slope of a memory-free stage, without its sign."""
    if isinstance(stage, ScaleStage):
        return abs(stage.gain)
    return float(np.min(stage.dy / stage.dx))


def slow_output_range(stages: Sequence[Stage], v_min: float, v_max: float) -> tuple[float, float]:
    """Return the least and the greatest output of a forward cascade at rest at the ends of its input.

    Slowly: relaxation has come to rest at either end, and a delay does not matter. The voltage goes from
    empty to ``v_max``, then to ``v_min``; a negative gain exchanges the two.
    """
    place, operator = next((k, s) for k, s in enumerate(stages) if isinstance(s, DiscreteBacklashOperator))
    head, tail = memory_free(stages[:place]), memory_free(stages[place:])
    state, ends = operator.empty(), []
    for voltage in (v_max, v_min):
        y, after, _ = operator.run(through(head, np.array([voltage])), state)
        state = BacklashState(after.bits)
        ends.append(float(through(tail, y)[0]))
    return min(ends), max(ends)


def gears_up_to(gears: DiscreteBacklashOperator, top: float) -> DiscreteBacklashOperator:
    """Return an operator without its last gears, those that begin at ``top`` or above."""
    reach = gears.x0 + np.cumsum(gears.dx)
    count = int(np.searchsorted(reach, top - 0.5 * gears.dx[-1])) + 1
    if count >= gears.n:
        return gears
    return DiscreteBacklashOperator(
        gears.dx[:count], gears.dy[:count], gears.x0, gears.y0, gears.relaxation, gears.memory_on
    )


def digest_of(stages: Sequence[Stage]) -> str:
    """Return a name for a forward cascade; a gain inverted twice may differ in its last digits."""
    parts: list[object] = []
    for stage in stages:
        if isinstance(stage, ScaleStage):
            parts.append([f"{stage.gain:.9e}", f"{stage.offset:.9e}"])
        elif isinstance(stage, DelayStage):
            parts.append(stage.seconds)
        else:
            parts.append([stage.dx.tolist(), stage.dy.tolist(), stage.x0, stage.y0])
            if isinstance(stage, DiscreteBacklashOperator) and stage.relaxation:
                parts.append(dataclasses.asdict(stage.relaxation))
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()
