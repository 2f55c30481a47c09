"""Learning a move that is repeated: the next drive from the recording of the last pass.

r = simulate(model, drive) is what the model believes was asked for. The next request is
d + Q(r - d + e): d the trajectory, e = d - measured, Q a steep zero-phase low-pass. The
next drive compensates that. The recording and the model are all that is needed. With M,
the actuator times the inverse model, what was learned is multiplied by Q(1 - M) a pass.
Q is steep, so that this stays below 1 for a resonance 25 % off, while the part of the
error that stays, (1 - Q)/(1 - Q(1 - M)), is small below the cut-off (docs/theory.md,
section 10).
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from dbo_cli.drives.pieces import soft_rise
from dbo_cli.errors import InputError, Remarks
from dbo_cli.extras.repeat.options import RepeatOptions
from dbo_cli.extras.repeat.settled_loops import settled_run
from dbo_cli.hysteresis.dynamics import Resonance, ZeroPhaseLowPass
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.hysteresis.move_error import rms, trusted_frequency
from dbo_cli.logs.sample_block import SAME_RATE, FloatArray, even_step
from dbo_cli.logs.signal_log import Source
from dbo_cli.logs.sources import WholeSource
from dbo_cli.logs.whole_output import write_whole

FORMAT, VERSION = "dbo-history", 1


class PassRecord(NamedTuple):
    """A pass in a history: the digest of its drive, and the RMS of its error in the output's unit."""

    drive_sha256: str
    rmse: float


def read_history(path: str) -> list[PassRecord]:
    """Return the passes of a history, the oldest first; none where there is no file yet.

    Raises
    ------
    InputError
        The file cannot be read, or is no history.
    """
    if not os.path.exists(path):
        return []
    try:
        with open(path, encoding="utf-8") as file:
            content = json.load(file)
    except (OSError, ValueError, RecursionError) as problem:  # nested too deeply
        raise InputError(f"{path}: cannot be read as a history: {problem}") from None
    if not isinstance(content, dict) or (
        content.get("format"),
        content.get("version"),
    ) != (FORMAT, VERSION):
        raise InputError(
            f'{path}: is no history ("format": "{FORMAT}", "version": {VERSION})'
        )
    passes = content.get("passes")
    if not isinstance(passes, list):
        return []
    return [_record(path, record) for record in passes]


def _record(path: str, values: Any) -> PassRecord:
    rmse = values.get("rmse") if isinstance(values, dict) else None
    if (
        isinstance(rmse, bool)
        or not isinstance(rmse, int | float)
        or not 0.0 <= rmse <= sys.float_info.max
    ):
        raise InputError(f"{path}: a pass has no `rmse`, a number of at least 0")
    return PassRecord(str(values.get("drive_sha256", "")), float(rmse))


def write_history(path: str, passes: Sequence[PassRecord]) -> None:
    """Write a history, whole or not at all."""
    content = {
        "format": FORMAT,
        "version": VERSION,
        "passes": [record._asdict() for record in passes],
    }
    write_whole(path, (json.dumps(content, indent=2) + "\n").encode())


# of what was asked for, in a third of an octave: a pass takes two thirds off
TRUSTED_ERROR = 1.0 / 3.0
ENERGY = 1e-3
"""Of the strongest third of an octave (amplitude): with less in it, a band says nothing of the model."""
ANOTHER_MOVE = 0.5
"""Of the move's own RMS: a drive whose believed displacement is further off in shape, or in its mean where
that is not learned, belongs to another trajectory. For a very wrong model twice the
move may be asked for.
"""
# of the drive's range (RMS): recordings further apart are not of one drive; chosen
SAME_DRIVE = 0.02
LEARNED_BEFORE = 2e-3
"""Of the move (RMS): a smaller difference of request and trajectory is not what passes learned. Measured:
docs/choices.md.
"""
GROWTH = 1.2
"""The error of a pass over that of the last one, from which on learning is said to diverge. Measured:
docs/choices.md.
"""
BEYOND_NOISE = 2.0
"""Times the noise in that half of the band, as its density above twice the cut-off has it. Measured:
docs/choices.md.
"""
# times the best pass's error: growth by less than GROWTH a pass shows after a few
FROM_BEST = 2.0
ORDER = 4
"""Order of the low-pass Q, which is run both ways. Measured: docs/choices.md."""
# how far off a resonance may be, either way: a payload of half the moving mass does
# that
MISTUNED = 0.25
SHARPER = 0.25  # of the model's damping: that of the mistuned resonance; chosen
# most that |Q(1 - M)| may be at any frequency for such a resonance; chosen, below 1
FACTOR = 0.9
ZERO_JUMP = 10.0
"""Times the usual change of the error from row to row (1.5 of the median), from which one that stays is a
jump of the sensor's zero; Gaussian noise exceeds 7 once in 10^11 rows.
"""
SMALLEST_JUMP = 5e-3  # of the move's span: a smaller one costs less than models do
# rows before and after whose medians differ by at least half of the jump; chosen
JUMP_STAYS = 20


@dataclass(frozen=True)
class Tracked:
    """One recording of a drive played: voltage, what was measured, and seconds where they are known."""

    name: str
    voltage: FloatArray
    measured: FloatArray
    time: FloatArray | None = None


class Lesson(NamedTuple):
    """The trajectory and what to ask for next, the low-pass (Hz), remarks, and the history with this pass."""

    desired: FloatArray
    request: FloatArray
    cutoff: float
    remarks: Remarks
    passes: list[PassRecord]


class _Pass(NamedTuple):
    voltage: FloatArray
    believed: FloatArray
    measured: FloatArray


@dataclass(frozen=True)
class RepeatedMove:
    """A trajectory that is played again and again.

    Attributes
    ----------
    model
        The forward model.
    desired, time, step
        The trajectory, its seconds and its even time step (s).
    options
        Of these: ``state``, in which the drives began; ``bandwidth``, the cut-off of Q
        (by default what the model can be trusted to); ``periodic``, where recordings
        are of whole periods; ``absolute``.
    """

    model: ActuatorModel
    desired: FloatArray
    time: FloatArray
    step: float
    options: RepeatOptions

    @property
    def unit(self) -> str:
        """The displacement's unit as messages write it."""
        return self.model.output.suffix

    def lesson(
        self, recordings: Sequence[Tracked], history: Sequence[PassRecord] = ()
    ) -> Lesson:
        """Return what to ask of the model for the next pass.

        Parameters
        ----------
        recordings
            Of the last pass, one or more of the same drive.
        history
            The passes so far, the oldest first; from one with this very drive on they
            are forgotten.

        Raises
        ------
        InputError
            A recording is not of this trajectory, in length, rate or values, or the
            error grew.
        """
        desired, absolute = self.desired, self.options.absolute
        unit, name = self.unit, recordings[0].name
        passes = [self._rows_of(recording) for recording in recordings]
        self._require_same_drive(recordings, passes)
        believed = np.mean([recorded.believed for recorded in passes], axis=0)
        self._require_same_move(name, believed)
        error = desired - np.mean([recorded.measured for recorded in passes], axis=0)
        zero = 0.0 if absolute else float(error.mean())
        remarks = Remarks(warnings=self._jumps(name, error))
        error = error - zero
        digest = hashlib.sha256(
            np.ascontiguousarray(passes[0].voltage).tobytes()
        ).hexdigest()
        passed = PassRecord(digest, rms(error))
        drives = [record.drive_sha256 for record in history]
        # learned from before: what came of it is forgotten
        if passed.drive_sha256 in drives:
            history = history[: drives.index(passed.drive_sha256)]
        cutoff = self.options.bandwidth or self._trusted(
            name, believed, desired - error
        )
        low_pass = ZeroPhaseLowPass(cutoff, self.step, ORDER)
        smooth = low_pass.loop if self.options.periodic else low_pass.whole
        update, before = smooth(error), smooth(believed - desired)
        if history:
            self._refuse_grown(name, passed, history)
        else:
            self._refuse_growth(name, error, before, update, cutoff)
        of = ""
        if len(recordings) > 1:
            of = f", the mean of {len(recordings)} recordings"
        percent = 100.0 * passed.rmse / float(np.ptp(desired))
        remarks.notes.append(
            f"{name}: the last pass was {passed.rmse:.3g}{unit} off (RMS, {percent:.2g} % of the move{of}), "
            f"{rms(update):.3g}{unit} of it below {cutoff:.4g} Hz, which this pass takes off"
        )
        learned = before + update
        if not absolute:
            remarks.notes.append(
                f"{name}: the mean of the error, {zero:.3g}{unit}, is taken for the sensor's zero and not "
                "learned (`absolute` learns it)"
            )
            learned = learned - learned.mean()  # nor was it before
        if self.model.dynamics is not None and not self.options.periodic:
            learned = _resting_ends(learned, cutoff * self.step)
        return Lesson(desired, desired + learned, cutoff, remarks, [*history, passed])

    def _rows_of(self, recording: Tracked) -> _Pass:
        """Return drive, belief and measurement of the rows that belong to the trajectory."""
        model, step, loop, count = (
            self.model,
            self.step,
            self.options.periodic,
            self.desired.size,
        )
        begin = 0
        if recording.time is not None:
            begin = self._first_row(recording.name, recording.time)
        rows = recording.voltage.size - begin
        if rows > count and not loop and recording.time is not None:
            rows = count  # what stands behind is a return
        fits = rows % count == 0 if loop else rows == count
        if rows < count or not fits:
            whole = " or whole periods of it" if loop else ""
            raise InputError(
                f"{recording.name}: {rows:,} rows from the trajectory's first on, the trajectory has "
                f"{count:,}{whole} (give the recording of this trajectory, row by row)"
            )
        if loop:
            # the first of several is not settled yet
            last = begin if rows == count else begin + count
            voltage = recording.voltage[last:].reshape(-1, count).mean(axis=0)
            measured = recording.measured[last:].reshape(-1, count).mean(axis=0)
            begun = model.start(float(voltage[0]), self.options.state)
            return _Pass(voltage, settled_run(model, voltage, step, begun).y, measured)
        start = self.options.state if begin == 0 else "auto"
        begun = model.start(float(recording.voltage[0]), start)
        believed = model.simulate(recording.voltage, begun, time_step=step).y
        own_rows = slice(begin, begin + count)
        return _Pass(
            recording.voltage[own_rows],
            believed[own_rows],
            recording.measured[own_rows],
        )

    def _first_row(self, name: str, time: FloatArray) -> int:
        """Return the recording's row of the trajectory's first; what stands before is a sweep or run-in."""
        step = even_step(time)
        if step is None or abs(step / self.step - 1.0) > SAME_RATE:
            rate = "no even clock"
            if step is not None:
                rate = f"{1.0 / step:.6g} samples a second"
            raise InputError(
                f"{name}: has {rate} where the trajectory has {1.0 / self.step:.6g} (record at the drive's "
                "rate, or resample both)"
            )
        return int(np.searchsorted(time, self.time[0] - 0.5 * self.step))

    def _require_same_drive(
        self, recordings: Sequence[Tracked], passes: Sequence[_Pass]
    ) -> None:
        for recording, recorded in zip(recordings, passes, strict=True):
            if (
                rms(recorded.voltage - passes[0].voltage)
                > SAME_DRIVE * self.model.input.span
            ):
                raise InputError(
                    f"{recording.name}: was driven otherwise than {recordings[0].name}; only recordings of "
                    "one drive can be averaged"
                )

    def _require_same_move(self, name: str, believed: FloatArray) -> None:
        """Refuse a drive that asks for another shape, whatever its size (``absolute``: or another mean)."""
        believed_shape, wanted = (
            believed - believed.mean(),
            self.desired - self.desired.mean(),
        )
        square = float(np.sum(wanted * wanted))
        size = 1.0
        if square:
            size = max(float(np.sum(believed_shape * wanted)) / square, 0.0)
        mean = 0.0
        if not self.options.absolute:
            mean = float(believed.mean() - self.desired.mean())
        away = math.hypot(rms(believed_shape - size * wanted), mean)
        if away > ANOTHER_MOVE * rms(wanted):
            raise InputError(
                f"{name}: its drive belongs to another trajectory: by the model it asks for something "
                f"{away:.3g}{self.unit} away from this one in shape (RMS; the move has "
                f"{rms(wanted):.3g}{self.unit})"
            )

    def _refuse_growth(
        self,
        name: str,
        error: FloatArray,
        learned: FloatArray,
        update: FloatArray,
        cutoff: float,
    ) -> None:
        """Refuse to go on when the error is larger than what was learned, in either half of the band.

        Growth begins near the cut-off, where what was learned is small; all of it would
        hide that. Where the sensor's noise is larger still, nothing can be said without
        a history.
        """
        frequency, rows = np.fft.rfftfreq(update.size, self.step), update.size
        least = LEARNED_BEFORE * rms(self.desired - self.desired.mean())
        beyond = np.abs(np.fft.rfft(error)[frequency > 2.0 * cutoff]) ** 2
        # of Gaussian noise
        density = float(np.median(beyond)) / math.log(2.0) if beyond.size else 0.0
        half = frequency < 0.5 * cutoff
        for part, where in ((half, "below"), (~half, "above")):
            this, before = (
                rms(np.fft.irfft(np.fft.rfft(x) * part, rows))
                for x in (update, learned)
            )
            noise = (
                math.sqrt(
                    2.0 * density * np.count_nonzero(part & (frequency <= cutoff))
                )
                / rows
            )
            if before > least and this > max(GROWTH * before, BEYOND_NOISE * noise):
                raise InputError(
                    f"{name}: the error grew: {where} {0.5 * cutoff:.4g} Hz this pass is {this:.3g}"
                    f"{self.unit} off (RMS), more than the {before:.3g}{self.unit} that was learned there "
                    "(go back to the best pass, with a lower `bandwidth` or a better model)"
                )

    def _refuse_grown(
        self, name: str, passed: PassRecord, history: Sequence[PassRecord]
    ) -> None:
        """Refuse to go on when the error is larger than the last pass's, or much larger than the best's."""
        errors, unit = [record.rmse for record in history], self.unit
        best = min(errors)
        if passed.rmse <= min(GROWTH * errors[-1], FROM_BEST * best):
            return
        number = 1 + errors.index(best)
        raise InputError(
            f"{name}: the error grew: this pass is {passed.rmse:.3g}{unit} off (RMS), the last one was "
            f"{errors[-1]:.3g}{unit} and pass {number} of the history, the best, {best:.3g}{unit} (learn "
            f"from the recording of pass {number} again, with a lower `bandwidth` or a better model)"
        )

    def _jumps(self, name: str, error: FloatArray) -> list[str]:
        """Warn where the sensor's zero jumps within the pass: a change between two rows that stays."""
        steps = np.abs(np.diff(error))
        least = max(
            ZERO_JUMP * (1.5 * float(np.median(steps))),
            SMALLEST_JUMP * float(np.ptp(self.desired)),
        )
        for k in np.flatnonzero(steps > least)[: 10 * JUMP_STAYS].tolist():
            before, after = (
                error[max(k + 1 - JUMP_STAYS, 0) : k + 1],
                error[k + 1 : k + 1 + JUMP_STAYS],
            )
            stays = abs(float(np.median(after) - np.median(before)))
            if min(before.size, after.size) == JUMP_STAYS and stays > 0.5 * steps[k]:
                return [
                    f"{name}: the measured displacement jumps by {stays:.3g}{self.unit} at row {k + 2:,} of "
                    "the pass, which no actuator does: the sensor's zero moved, and the jump is learned "
                    "(record it again)"
                ]
        return []

    def _trusted(self, name: str, believed: FloatArray, measured: FloatArray) -> float:
        """Return the frequency (Hz) up to which a pass takes most of the error off, and nothing grows."""
        known = trusted_frequency(self.model)
        frequency = known
        if frequency is None:
            frequency = _trusted_by_bands(name, believed, measured, self.step)
        return min(frequency, 0.45 / self.step, _safe(self.model))


def learned_source(
    model: ActuatorModel,
    source: Source,
    recordings: Sequence[Tracked],
    options: RepeatOptions,
) -> tuple[WholeSource, Lesson]:
    """Return a source of what to ask for next, and the lesson."""
    history = [] if options.history is None else read_history(options.history)
    whole, role = WholeSource(source), model.output.quantity
    desired, time = whole.block.values[role], whole.block.time
    source.require_time("`tracked` needs an even clock")
    assert time is not None
    step = whole.even_step("`tracked` needs an even clock")
    lesson = RepeatedMove(model, desired, time, step, options).lesson(
        recordings, history
    )
    whole.block = dataclasses.replace(whole.block, values={role: lesson.request})
    return whole, lesson


def _resting_ends(learned: FloatArray, per_sample: float) -> FloatArray:
    """Return what was learned with rests at its ends, which it leaves within a period of the cut-off.

    The inverse of dynamics takes the move to begin and end at rest. What does not asks
    for a jump at the first sample, which the next belief contains: measured (800 Hz, 20
    kHz) it grew fourfold a pass.
    """
    rise = np.clip(np.arange(learned.size) * per_sample, 0.0, 1.0)
    weight = soft_rise(rise)
    begun = learned[0] + weight * (learned - learned[0])
    rested: FloatArray = begun[-1] + weight[::-1] * (begun - begun[-1])
    return rested


def _safe(model: ActuatorModel) -> float:
    """Return the highest cut-off (Hz) at which no resonance that is mistuned makes what was learned grow.

    From |Q(1 - M)| <= FACTOR with Q = 1/(1 + (f/f_c)^2n), solved for f_c at every
    frequency.
    """
    highest = math.inf
    resonances = () if model.dynamics is None else model.dynamics.resonances
    for resonance in resonances:
        for part in (1.0 - MISTUNED, 1.0 + MISTUNED):
            frequency = resonance.frequency * np.linspace(0.5, 2.0, 3001)
            actual = Resonance(resonance.frequency * part, SHARPER * resonance.damping)
            plain = Resonance(resonance.frequency, resonance.damping)
            away = np.abs(1.0 - actual.response(frequency) / plain.response(frequency))
            growing = away > FACTOR
            bound = frequency[growing] / (away[growing] / FACTOR - 1.0) ** (0.5 / ORDER)
            highest = min(highest, float(bound.min(initial=math.inf)))
    return highest


def _trusted_by_bands(
    name: str, believed: FloatArray, measured: FloatArray, step: float
) -> float:
    """Return the upper end of the last third of an octave in which the measured follows the believed.

    From the strongest one on: in those below, what a wrong loop makes of it exceeds the
    little asked there.
    """
    window = np.hanning(believed.size)
    spectrum, got = (np.fft.rfft((x - x.mean()) * window) for x in (believed, measured))
    frequency = np.fft.rfftfreq(believed.size, step)
    band = np.floor(
        3.0 * np.log2(np.maximum(frequency[1:] / frequency[1], 1.0))
    ).astype(int)
    energy = np.sqrt(np.bincount(band, np.abs(spectrum[1:]) ** 2))
    off = np.sqrt(np.bincount(band, np.abs(got[1:] - spectrum[1:]) ** 2))
    good, strongest = -1, int(np.argmax(energy))
    for k in strongest + np.flatnonzero(energy[strongest:] > ENERGY * energy.max()):
        if off[k] > TRUSTED_ERROR * energy[k]:
            break
        good = int(k)
    if good < 0:
        raise InputError(
            f"{name}: does not follow the drive's model at any frequency, so that nothing can be learned "
            "(check columns, units and delay, or give `bandwidth` HZ)"
        )
    return float(frequency[1] * 2.0 ** ((good + 1) / 3.0))
