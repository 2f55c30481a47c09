"""Learning a move that is repeated: the next drive from the recordings of the last pass.

r is what the model believes of the drive that was played: what was asked for. The next
request is r' = d + Q(r - measured): d the trajectory, Q a steep zero-phase low-pass; the
next drive is the inverse of r'. With M, the actuator times the inverse model, what was
learned is multiplied by Q(1 - M) a pass. Q is steep, so that this stays below 1 for a
resonance that is 25 % off, while what is left below the cut-off is small.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from hashlib import sha256
from typing import Any

import numpy as np

from dbo_cli.alignment import ACTUATOR_LAG, DRIVE_RESIDUAL, RATE_SLACK
from dbo_cli.arrays import Floats
from dbo_cli.drive.drive import PassRecord
from dbo_cli.drive.lead import Lead
from dbo_cli.drive.loops import settled_run
from dbo_cli.drive.simulate import Rows
from dbo_cli.drive.smooth import low_pass, soft_rise
from dbo_cli.errors import InputError, ModelError
from dbo_cli.model import Cascade, State, fields
from dbo_cli.signals import noise, step_of, turns, without_delay

FORMAT = "dbo-history"

# of Q, run both ways; at 4 what is learned neither grows nor is lost (measured in benchmarks)
ORDER = 4
GROWTH = 1.2  # times the error of the last pass: beyond, learning diverges; chosen
FROM_BEST = 2.0  # times the best pass's error: growth by less a pass shows after a few
# of the drive's range (RMS): recordings further apart are not of one drive
ONE_DRIVE = 0.02
LONG_STEP = 1.5  # steps: a longer one lacks rows
# times what the model expects of the drive, by which a sensor's scale is told to be another
OTHER_SCALE = 1.25
# of a recording to what the model makes of its drive: with less it is of another thing
LEAST_CORRELATION = 0.5
STANDS_STILL = 1e-9  # of the move: what rounding leaves of a constant
# of the move (RMS): a drive that asks for something further away is of another
ANOTHER_MOVE = 0.5
# of the squares that stamps leave: with more left elsewhere, they are believed
MUCH_CLOSER = 0.25
LEAD_TRIES = 6  # to lay a recording by what led to the move
SWEEP_TRAVEL = 1.7  # ranges that the drive travels in a sweep there and back
# of what was asked, in a third of an octave: a pass takes two thirds off
TRUSTED_ERROR = 1.0 / 3.0
# of the strongest third of an octave (amplitude): with less a band says nothing
BAND_ENERGY = 1e-3


@dataclass(frozen=True)
class RepeatedMove:
    """A trajectory that is played again and again.

    Attributes
    ----------
    lead
        The model, the limits, and what stands before the move.
    desired, time, step
        The trajectory, the time of each row and its even step (s).
    periodic, absolute
        Whether recordings are of whole periods, and whether the mean is learned.
    """

    lead: Lead
    desired: Floats
    time: Floats
    step: float
    periodic: bool
    absolute: bool

    @property
    def model(self) -> Cascade:
        """The forward model."""
        return self.lead.model

    def learned(
        self,
        recordings: Sequence[tuple[str, Rows]],
        history: Sequence[PassRecord],
        bandwidth: float | None,
    ) -> tuple[Floats, dict[str, Any]]:
        """Return what the next pass asks of the model, and what its ``Drive`` says of the last one.

        The error to expect is that of the last pass, which the next one should stay below.

        Parameters
        ----------
        recordings
            Names, and rows of drive and displacement of the last pass; all of one drive.
        history
            The passes so far, the oldest first; from one with this very drive on they
            are forgotten.
        bandwidth
            Cut-off of Q (Hz); None: as far as the model can be trusted.

        Raises
        ------
        InputError
            A recording is not of this trajectory, or the error grew.
        """
        name, unit = recordings[0][0], self.model.output.suffix
        if not np.ptp(self.desired) > 0.0:
            raise InputError(f"{name}: the trajectory holds still: nothing is learned")
        voltage, modelled, measured = self._mean_of(recordings)
        self._require_same_move(name, modelled)
        _require_same_scale(name, modelled, measured)
        error = self.desired - measured
        zero = 0.0 if self.absolute else float(error.mean())
        error = error - zero
        passed = PassRecord(sha256(voltage.tobytes()).hexdigest(), rms(error))
        drives = [record.drive_sha256 for record in history]
        before = tuple(history)
        if passed.drive_sha256 in drives:  # what came of learning from it is forgotten
            before = before[: drives.index(passed.drive_sha256)]
        cutoff = bandwidth
        if cutoff is None:
            cutoff = self._trusted_cutoff(name, measured - modelled)
        errors = [record.rmse for record in before]
        self._require_no_growth(name, errors, passed.rmse, cutoff)
        change = modelled - self.desired + error
        learned = low_pass(change, cutoff, self.step, self.periodic, ORDER)
        if not self.absolute:
            learned = learned - learned.mean()
        if self.model.dynamics is not None and not self.periodic:
            learned = _resting_ends(learned, cutoff * self.step)
        percent = 100.0 * passed.rmse / float(np.ptp(self.desired))
        reached = noise(measured)
        note = (
            f"{name}: the last pass was {passed.rmse:.3g}{unit} off (RMS, {percent:.2g} % of the move), "
            f"{reached:.2g}{unit} of it noise; learned below {cutoff:.4g} Hz"
        )
        figures = {
            "expected_error": passed.rmse,
            "expected_known": None,  # the model's own error is what was learned
            "expected_unrested": None,
            "mean_left_out": None if self.absolute else -zero,
            "history": (*before, passed),
            "notes": (note,),
        }
        return self.desired + learned, figures

    def _trusted_cutoff(self, name: str, residual: Floats) -> float:
        """Return the cut-off (Hz) up to which the model can be trusted."""
        # a third of the lowest resonance: nothing grows where the model has it 25 % off
        cutoff = self.model.trusted_frequency
        if cutoff is None:
            cutoff = _trusted_by_bands(name, self.desired, residual, self.step)
        return min(cutoff, 0.45 / self.step)

    # --- the rows of a recording ---

    def _mean_of(
        self, recordings: Sequence[tuple[str, Rows]]
    ) -> tuple[Floats, Floats, Floats]:
        """Return the drive of the first recording, what the model makes of them, and the mean measured.

        Raises
        ------
        InputError
            A recording is of another drive than the first.
        """
        passes = [self._pass_of(name, block) for name, block in recordings]
        first, voltage = recordings[0][0], passes[0][0]
        for (name, _), (other, _, _) in zip(recordings, passes, strict=True):
            if not self._is_same_drive(other, voltage):
                raise InputError(
                    f"{name}: not the drive of {first}: average recordings of one drive only"
                )
        modelled = np.mean([rows[1] for rows in passes], axis=0)
        return voltage, modelled, np.mean([rows[2] for rows in passes], axis=0)

    def _is_same_drive(self, voltage: Floats, other: Floats) -> bool:
        """Return whether two recordings are of one drive, but for what a monitor adds."""
        return rms(voltage - other) <= ONE_DRIVE * self.model.input.span

    def _pass_of(self, name: str, recording: Rows) -> tuple[Floats, Floats, Floats]:
        """Return drive, modelled and measured displacement of the rows that belong to the trajectory."""
        voltage, step, count = recording.x, self.step, self.desired.size
        modelled = self.model.run(voltage, self._start(voltage), step).y
        stamped = self._row_by_stamps(name, recording.time)
        begin = stamped or 0
        if not self.periodic:
            begin = self._first_row(voltage, modelled, stamped)
        rows = voltage.size - begin
        if rows < count:
            raise InputError(
                f"{name}: {rows:,} rows from the start of the move, the trajectory has "
                f"{count:,}: record each row of it"
            )
        time = step * np.arange(float(voltage.size))
        delay = self.model.sensor_delay
        measured, _ = without_delay(time, recording.y, delay)
        if self.periodic:
            drive, measured = self._mean_period(voltage, measured)
            led = voltage[:1] if stamped else voltage[:0]
            phase = self._phase(self._repeated(drive, led))
            by_stamps = stamped is not None and rows % count == 0
            if by_stamps and min(phase, count - phase) * step <= ACTUATOR_LAG:
                phase = 0  # what was learned may be as early
            drive, measured = np.roll(drive, -phase), np.roll(measured, -phase)
            return drive, self._repeated(drive, led), measured
        self._require_same_past(name, voltage[:begin])
        move = slice(begin, begin + count)  # what stands behind is a return
        return voltage[move], modelled[move], measured[move]

    def _mean_period(self, voltage: Floats, measured: Floats) -> tuple[Floats, Floats]:
        """Return the mean drive and displacement of the periods at the end that are alike."""
        count = self.desired.size
        rows = voltage.size // count * count
        periods = voltage[-rows:].reshape(-1, count)
        first = len(periods) - 1
        while first and self._is_same_drive(periods[first - 1], periods[-1]):
            first -= 1  # before that one, something else leads to the loop
        if first < len(periods) - 1:
            first += 1  # not settled yet
        displacement = measured[-rows:].reshape(-1, count)[first:].mean(axis=0)
        return periods[first:].mean(axis=0), displacement

    def _start(self, voltage: Floats) -> State:
        """Return the state before the first voltage of a drive that was made for it."""
        standing, past = self.lead.standing, self.lead.state
        if standing is not None and not isinstance(past, State):
            rest = self.model.start(standing, past)
            past = self.model.run(np.array([standing]), rest, self.step).state
        return self.model.start(float(voltage[0]), past)

    def _repeated(self, drive: Floats, led: Floats) -> Floats:
        """Return what the model makes of one period that was repeated for ever, behind what led to it."""
        start = self._start(np.concatenate([led, drive]))
        return settled_run(self.model, drive, self.step, start)

    def _phase(self, modelled: Floats) -> int:
        """Return the row of a recorded period on which the trajectory's first one falls.

        A recorder may begin anywhere in a loop: the period is laid where what the model
        makes of it is closest to the trajectory.
        """
        spectrum = np.fft.rfft(modelled) * np.fft.rfft(self.desired).conj()
        return int(np.argmax(np.fft.irfft(spectrum, modelled.size)))

    def _first_row(self, voltage: Floats, modelled: Floats, stamped: int | None) -> int:
        """Return the recording's row of the trajectory's first; what stands before is its lead.

        A recorder may count from elsewhere than the stamps say: the trajectory is laid
        where what the model makes of the recorded drive is closest to it, or behind what
        led to it.
        """
        desired, mean = self.desired - self.desired.mean(), self.desired.mean()
        misfit = sliding_misfit(modelled - mean, desired)
        row = int(np.argmin(misfit))
        led = self._row_behind_lead(voltage, modelled, row)
        best = row if led is None else led
        if stamped is None or stamped >= misfit.size:
            return best
        # what was learned may be as early
        if abs(best - stamped) * self.step <= ACTUATOR_LAG:
            return stamped
        if led is not None and misfit[led] < misfit[stamped]:
            return led
        square = float(np.sum(desired**2))
        enough = min(MUCH_CLOSER * float(misfit[stamped]), DRIVE_RESIDUAL * square)
        return stamped if enough <= float(misfit[row]) else row

    def _row_behind_lead(
        self, voltage: Floats, modelled: Floats, row: int
    ) -> int | None:
        """Return the row behind what led to the move, which begins at about ``row``; None: not recorded.

        What was learned has changed the shape of the move, and moved it by some rows.
        """
        close = ONE_DRIVE * self.model.input.span
        for _ in range(LEAD_TRIES):  # what leads to it depends on its first value
            _, led, still = self.lead.planned(float(modelled[row]), self.step, None)
            if not 0 < led.size <= voltage.size or np.ptp(led) <= close:
                return None
            misfit = sliding_misfit(voltage - led.mean(), led - led.mean())
            begin = int(np.argmin(misfit))
            tried, row = row, begin + led.size + still
            if row + self.desired.size > voltage.size:
                return None
            if row == tried:
                return row if misfit[begin] <= led.size * close**2 else None
        return None

    def _row_by_stamps(self, name: str, time: Floats | None) -> int | None:
        """Return the row at the time of the trajectory's first; None where no stamp is of that time.

        Raises
        ------
        InputError
            The clock has another rate, or a gap.
        """
        if time is None or time.size < 2:
            return None
        step, longest = step_of(time), float(np.diff(time).max())
        other_rate = abs(step / self.step - 1.0) > RATE_SLACK
        if other_rate or longest > LONG_STEP * step:
            raise InputError(
                f"{name}: {1.0 / max(step, 1e-300):.6g} Hz, longest step {longest:.4g} s, the "
                f"trajectory {1.0 / self.step:.6g} Hz: record each row at its rate, or `resample` HZ"
            )
        begin = self.time[0] - 0.5 * self.step
        if not time[0] - self.step <= begin <= time[-1]:
            return None
        return int(np.searchsorted(time, begin))

    def _require_same_past(self, name: str, lead: Floats) -> None:
        """Refuse a pass with a sweep before it for a drive without, or the other way round (InputError)."""
        if lead.size < 2 or isinstance(self.lead.state, State):
            return
        low, high = self.lead.limits.sweep
        span = high - low
        extremes = lead[turns(lead, 0.1 * span)]
        was_swept = float(np.abs(np.diff(extremes)).sum()) > SWEEP_TRAVEL * span
        if was_swept == self.lead.condition:
            return
        how = "with" if was_swept else "without"
        raise InputError(
            f"{name}: recorded {how} a sweep before the move, which makes another past: record a pass of "
            "this drive, or change `condition`"
        )

    # --- refusals ---

    def _require_same_move(self, name: str, modelled: Floats) -> None:
        """Refuse a drive that asks for another shape, whatever its size, or for another mean (InputError)."""
        shape = modelled - modelled.mean()
        move = self.desired - self.desired.mean()
        size = max(float(np.sum(shape * move) / np.sum(move * move)), 0.0)
        mean = 0.0
        if not self.absolute:
            mean = float(modelled.mean() - self.desired.mean())
        difference = math.hypot(rms(shape - size * move), mean)
        if difference > ANOTHER_MOVE * rms(move):
            unit = self.model.output.suffix
            raise InputError(
                f"{name}: its drive belongs to another trajectory, {difference:.3g}{unit} from this one "
                f"(RMS; the move has {rms(move):.3g}{unit})"
            )

    def _require_no_growth(
        self, name: str, errors: Sequence[float], rmse: float, cutoff: float
    ) -> None:
        """Refuse to go on when the error grew from those of the passes before (InputError)."""
        if not errors:
            return
        best = min(errors)
        allowed = min(GROWTH * errors[-1], FROM_BEST * best)
        if rmse <= allowed:
            return
        number, unit = 1 + errors.index(best), self.model.output.suffix
        raise InputError(
            f"{name}: the error grew from {errors[-1]:.3g} to {rmse:.3g}{unit} RMS: check the "
            f"sensor's scale, or learn from pass {number} ({best:.3g}) with `bandwidth` "
            f"{0.5 * cutoff:.3g} (it was {cutoff:.3g} Hz)"
        )


def sliding_misfit(values: Floats, template: Floats) -> Floats:
    """Return the sum of squared differences from a template at each place where it fits in; one at least."""
    places = max(values.size - template.size + 1, 1)
    size = values.size + template.size
    spectrum = np.fft.rfft(values, size) * np.fft.rfft(template, size).conj()
    products = np.fft.irfft(spectrum, size)[:places]
    squares = np.cumsum(np.append(0.0, values**2))
    squares = squares[-places:] - squares[:places]
    misfit: Floats = squares - 2.0 * products + float(np.sum(template**2))
    return misfit


def rms(values: Floats) -> float:
    """Return the root of the mean square."""
    return float(np.sqrt(np.mean(values**2)))


def _resting_ends(learned: Floats, per_sample: float) -> Floats:
    """Return what was learned with rests at its ends, which it leaves within a period of the cut-off.

    The inverse of dynamics takes the move to begin and end at rest. What does not asks
    for a jump at the first row, which the next belief contains: it grew fourfold a pass
    (800 Hz, 20 kHz).
    """
    weight = soft_rise(np.clip(np.arange(learned.size) * per_sample, 0.0, 1.0))
    risen = learned[0] + weight * (learned - learned[0])
    resting: Floats = risen[-1] + weight[::-1] * (risen - risen[-1])
    return resting


def _require_same_scale(name: str, modelled: Floats, measured: Floats) -> None:
    """Refuse what was measured in another scale than the logs that the model comes from (InputError)."""
    move = modelled - modelled.mean()
    gain = float(move @ measured) / max(float(move @ move), 1e-300)
    if 1.0 / OTHER_SCALE <= gain <= OTHER_SCALE:
        return
    spread = LEAST_CORRELATION * float(np.std(measured))
    if abs(gain) * rms(move) <= spread + STANDS_STILL * rms(move):
        raise InputError(
            f"{name}: the displacement does not follow the drive: check columns, units and sensor"
        )
    raise InputError(
        f"{name}: the displacement is {gain:.3g} times what the model expects of this drive: if the sensor's "
        f"scale is another, type `scale` measured={1.0 / gain:.3g}, else identify with `prior`"
    )


def _trusted_by_bands(
    name: str, desired: Floats, residual: Floats, step: float
) -> float:
    """Return the upper end (Hz) of the last third of an octave in which the residual is small.

    From the strongest one on: in those below, what a wrong loop makes of it exceeds the
    little that was asked there. Between harmonics, where the trajectory asks for nothing,
    there is only what was learned against such a loop.
    """
    window = np.hanning(desired.size)
    move = np.fft.rfft((desired - desired.mean()) * window)[1:]
    error = np.fft.rfft((residual - residual.mean()) * window)[1:]
    frequency = np.fft.rfftfreq(desired.size, step)[1:]
    band = np.floor(3.0 * np.log2(frequency / frequency[0])).astype(int)
    energy = np.sqrt(np.bincount(band, np.abs(move) ** 2))
    error_energy = np.sqrt(np.bincount(band, np.abs(error) ** 2))
    strongest = int(np.argmax(energy))
    good = -1
    for k in range(strongest, energy.size):
        if energy[k] <= BAND_ENERGY * energy[strongest]:
            continue
        if error_energy[k] > TRUSTED_ERROR * energy[k]:
            break
        good = k
    if good < 0:
        raise InputError(
            f"{name}: does not follow the model at any frequency: check columns, units and delay, or "
            "give `bandwidth` HZ"
        )
    return float(frequency[0] * 2.0 ** ((good + 1) / 3.0))


# --- the history ---


def parse_history(values: object, name: str = "the history") -> tuple[PassRecord, ...]:
    """Return the passes that JSON values describe, the oldest first (ModelError: they do not)."""
    try:
        content = fields.contents(values, "", FORMAT, "a history")
        record = partial(
            fields.build, PassRecord, drive_sha256=fields.text, rmse=fields.magnitude
        )
        passes: tuple[PassRecord, ...] = fields.build(
            dict, content, "", passes=partial(fields.listed, read=record)
        )["passes"]
    except ModelError as problem:
        raise ModelError(f"{name}: {problem}: give a new file") from None
    return passes


def dumps_history(passes: Sequence[PassRecord]) -> str:
    """Return a history as the text of its file."""
    content = {
        "format": FORMAT,
        "version": fields.VERSION,
        "passes": [record._asdict() for record in passes],
    }
    return json.dumps(content, indent=2) + "\n"
