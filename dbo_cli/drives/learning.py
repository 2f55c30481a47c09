"""Learning a move that is repeated: the next drive from the recording of the last pass.

r = simulate(model, drive) is what the model believes was asked for; the next request is r + Q(desired -
measured), Q a zero-phase low-pass, and the next drive compensates that. Nothing is kept between passes: the
recording and the model are all. It converges where the model's relative error is below one; Q ends where it
is not, since beyond the update grows from pass to pass.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from dbo_cli.drives.options import DriveOptions
from dbo_cli.errors import InputError
from dbo_cli.hysteresis.initial_states import StartName
from dbo_cli.hysteresis.loops import settled_output
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.hysteresis.model_state import ModelState
from dbo_cli.hysteresis.smoothing import ZeroPhaseLowPass
from dbo_cli.logs.clock import even_step
from dbo_cli.logs.sample_block import FloatArray
from dbo_cli.logs.sources import Source, WholeSource

RESONANCE_PART = 3.0
"""A model is trusted to its lowest resonance over this, where its identification says nothing else.

There an error of 10 % in the frequency leaves a relative error of 3 %; at the resonance one above 1.
"""
TRUSTED_ERROR = 1.0 / 3.0  # of what was asked for, in a third of an octave: a pass takes two thirds off
ENERGY = 1e-3
"""Of the strongest third of an octave (amplitude): with less in it, a band says nothing of the model."""
ANOTHER_MOVE = 0.5
"""Of the move's own RMS: a drive whose believed displacement is further off belongs to another trajectory."""
SAME_RATE = 1e-3  # two clocks may differ by this fraction
SAME_DRIVE = 0.02  # of the drive's range (RMS): recordings further apart are not of one drive
LEARNED_BEFORE = 2e-3
"""Of the move (RMS): a smaller difference of request and trajectory is not what passes learned.

A converter's step of 12 bits is 7e-5 of the range; a first value that the settled actuator steps over left
3e-4. Where less was learned, growth shows a pass later.
"""
GROWTH = 1.2
"""A pass's error over what all passes before took off together, from which on learning is said to diverge.

After the second pass it is the very factor from pass to pass; a converging pass has less than 1, and a first
pass driven by something else than the model's own drive about 1.
"""


@dataclass(frozen=True)
class Tracked:
    """One recording of a drive played: voltage, what was measured, and seconds where they are known."""

    name: str
    voltage: FloatArray
    measured: FloatArray
    time: FloatArray | None = None


class Lesson(NamedTuple):
    """What to ask for next, the cut-off of the low-pass (Hz), and what is to be said."""

    request: FloatArray
    cutoff: float
    notes: list[str]


def lesson(
    model: ActuatorModel,
    desired: FloatArray,
    time: FloatArray,
    step: float,
    recordings: Sequence[Tracked],
    *,
    start: StartName | ModelState = "auto",
    bandwidth: float | None = None,
    loop: bool = False,
) -> Lesson:
    """Return what to ask of the model for the next pass.

    Parameters
    ----------
    model
        The forward model.
    desired, time, step
        The trajectory, its seconds and its even time step (s).
    recordings
        Of the last pass, one or more of the same drive.
    start
        The state in which the drives began.
    bandwidth
        Cut-off of Q in Hz; by default what the model can be trusted to.
    loop
        The trajectory is one period of a loop, the recordings are of whole periods.

    Raises
    ------
    InputError
        A recording is not of this trajectory, in length, rate or values, or the error grew.
    """
    passes = [_one_pass(model, desired, time, step, one, start, loop) for one in recordings]
    _same_drive(model, recordings, [one.voltage for one in passes])
    believed = np.mean([one.believed for one in passes], axis=0)
    error = desired - np.mean([one.measured for one in passes], axis=0)
    name = recordings[0].name
    move = float(np.sqrt(np.mean((desired - desired.mean()) ** 2)))
    unit = f" {model.output.unit}" if model.output.unit else ""
    if _rms(believed - desired) > ANOTHER_MOVE * move:
        raise InputError(
            f"{name}: its drive belongs to another trajectory: by the model it asks for something "
            f"{_rms(believed - desired):.3g}{unit} away from this one (RMS; the move has {move:.3g}{unit})"
        )
    cutoff = _trusted(model, believed, desired - error, step) if bandwidth is None else bandwidth
    low_pass = ZeroPhaseLowPass(cutoff, step)
    smooth = low_pass.loop if loop else low_pass.whole
    update = smooth(error)
    _refuse_growth(
        name, unit, smooth(believed - desired), update, low_pass, desired, believed, smooth(desired), move
    )
    span = float(np.ptp(desired))
    of = f", the mean of {len(recordings)} recordings" if len(recordings) > 1 else ""
    notes = [
        f"{name}: the last pass was {_rms(error):.3g}{unit} off (RMS, {100.0 * _rms(error) / span:.2g} % of "
        f"the move{of}), {_rms(update):.3g}{unit} of it below {cutoff:.4g} Hz, which this pass takes off"
    ]
    if model.dynamics is not None and not loop:
        update = _resting_ends(update, cutoff * step)
    return Lesson(believed + update, cutoff, notes)


def learned_source(
    model: ActuatorModel, source: Source, recordings: Sequence[Tracked], options: DriveOptions
) -> tuple[WholeSource, FloatArray, Lesson]:
    """Return a source of what to ask for next, the trajectory itself, and the lesson."""
    whole = WholeSource(source)
    role = model.output.quantity
    desired, time = whole.block.values[role], whole.block.time
    source.require_time("`tracked` needs an even clock")
    assert time is not None
    step = whole.even_step("`tracked` needs an even clock")
    learned = lesson(
        model, desired, time, step, recordings,
        start=options.state, bandwidth=options.bandwidth, loop=options.periodic,
    )  # fmt: skip
    whole.block = dataclasses.replace(whole.block, values={role: learned.request})
    return whole, desired, learned


class _Pass(NamedTuple):
    voltage: FloatArray
    believed: FloatArray
    measured: FloatArray


def _one_pass(
    model: ActuatorModel,
    desired: FloatArray,
    time: FloatArray,
    step: float,
    one: Tracked,
    start: StartName | ModelState,
    loop: bool,
) -> _Pass:
    """Return drive, belief and measurement of the rows that belong to the trajectory."""
    begin, count = 0, desired.size
    if one.time is not None:
        own = even_step(one.time)
        if own is None or abs(own / step - 1.0) > SAME_RATE:
            told = "no even clock" if own is None else f"{1.0 / own:.6g} samples a second"
            raise InputError(
                f"{one.name}: has {told} where the trajectory has {1.0 / step:.6g} (record at the drive's "
                "rate, or resample both)"
            )
        begin = int(
            np.searchsorted(one.time, time[0] - 0.5 * step)
        )  # what stands before is a sweep or run-in
    rows = one.voltage.size - begin
    if rows > count and not loop and one.time is not None:
        rows = count  # what stands behind is a return
    if rows < count or (rows % count if loop else rows != count):
        whole = " or whole periods of it" if loop else ""
        raise InputError(
            f"{one.name}: {rows:,} rows from the trajectory's first on, the trajectory has {count:,}{whole} "
            "(give the recording of this trajectory, row by row)"
        )
    if loop:
        last = slice(
            begin if rows == count else begin + count, None
        )  # the first of several is not settled yet
        voltage = one.voltage[last].reshape(-1, count).mean(axis=0)
        measured = one.measured[last].reshape(-1, count).mean(axis=0)
        return _Pass(voltage, settled_output(model, voltage, step, start), measured)
    begun = model.start(float(one.voltage[0]), start if begin == 0 else "auto")
    believed = model.simulate(one.voltage, begun, time_step=step).y
    own_rows = slice(begin, begin + count)
    return _Pass(one.voltage[own_rows], believed[own_rows], one.measured[own_rows])


def _same_drive(model: ActuatorModel, recordings: Sequence[Tracked], drives: Sequence[FloatArray]) -> None:
    for one, drive in zip(recordings[1:], drives[1:], strict=True):
        if _rms(drive - drives[0]) > SAME_DRIVE * model.input.span:
            raise InputError(
                f"{one.name}: was driven otherwise than {recordings[0].name}; only recordings of one drive "
                "can be averaged"
            )


def _resting_ends(update: FloatArray, per_sample: float) -> FloatArray:
    """Return an update that rests at its ends, and leaves them within a period of the cut-off.

    The inverse of dynamics takes the move to begin and end at rest. An update that does not asks for a jump
    at the first sample, which the next belief contains: measured (800 Hz, 20 kHz) it grew fourfold a pass.
    """
    rise = np.clip(np.arange(update.size) * per_sample, 0.0, 1.0)
    weight = rise**3 * (10.0 - 15.0 * rise + 6.0 * rise * rise)
    begun = update[0] + weight * (update - update[0])
    rested: FloatArray = begun[-1] + weight[::-1] * (begun - begun[-1])
    return rested


def _refuse_growth(
    name: str,
    unit: str,
    learned: FloatArray,
    update: FloatArray,
    low_pass: ZeroPhaseLowPass,
    desired: FloatArray,
    believed: FloatArray,
    rounded: FloatArray,
    move: float,
) -> None:
    """Refuse to go on when the error is larger than all that was learned before."""
    nothing = LEARNED_BEFORE * move
    first = _rms(learned) <= nothing or _rms(believed - rounded) <= nothing
    if first or _rms(update) <= GROWTH * _rms(learned):
        return
    raise InputError(
        f"{name}: the error grew: this pass is {_rms(update):.3g}{unit} off below {low_pass.cutoff:.4g} Hz "
        f"(RMS), more than the {_rms(learned):.3g}{unit} that the passes before took off (go back to the "
        "best pass, with a lower `bandwidth` or a better model)"
    )


def _trusted(model: ActuatorModel, believed: FloatArray, measured: FloatArray, step: float) -> float:
    """Return the frequency (Hz) up to which a pass takes most of the error off."""
    told = model.fit.get("trusted_hz")
    highest = 0.45 / step
    if isinstance(told, int | float) and not isinstance(told, bool) and told > 0.0:
        return min(float(told), highest)
    if model.dynamics is not None and model.dynamics.resonances:
        return min(model.dynamics.resonances[0].frequency / RESONANCE_PART, highest)
    return min(_trusted_by_bands(believed, measured, step), highest)


def _trusted_by_bands(believed: FloatArray, measured: FloatArray, step: float) -> float:
    """Return the upper end of the last third of an octave in which the measured follows the believed."""
    window = np.hanning(believed.size)
    asked, got = (np.fft.rfft((x - x.mean()) * window) for x in (believed, measured))
    frequency = np.fft.rfftfreq(believed.size, step)
    band = np.floor(3.0 * np.log2(np.maximum(frequency[1:] / frequency[1], 1.0))).astype(int)
    energy = np.sqrt(np.bincount(band, np.abs(asked[1:]) ** 2))
    off = np.sqrt(np.bincount(band, np.abs(got[1:] - asked[1:]) ** 2))
    good = -1
    for k in np.flatnonzero(energy > ENERGY * energy.max()):
        if off[k] > TRUSTED_ERROR * energy[k]:
            break
        good = int(k)
    if good < 0:
        raise InputError(
            "the recording does not follow the drive's model at any frequency, so that nothing can be "
            "learned (check columns, units and delay, or give `bandwidth` HZ)"
        )
    return float(frequency[1] * 2.0 ** ((good + 1) / 3.0))


def _rms(x: FloatArray) -> float:
    return math.sqrt(float(np.mean(x * x)))
