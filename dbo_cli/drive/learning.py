"""Learning a move that is repeated: the next drive from the recordings of the last pass.

r is what the model believes of the drive that was played: what was asked for. The next
request is r' = d + Q(r - measured): d the trajectory, Q a steep zero-phase low-pass; the
next drive is the inverse of r'. With M, the actuator times the inverse model, what was
learned is multiplied by Q(1 - M) a pass. Q is steep, so that this stays below 1 for a
resonance that is 25 % off, while what is left below the cut-off is small.
"""

import json
import math
from collections.abc import Sequence
from functools import partial
from hashlib import sha256
from itertools import takewhile
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


def learned(
    lead: Lead,
    desired: Floats,
    first: float,
    step: float,
    recordings: Sequence[tuple[str, Rows]],
    history: Sequence[PassRecord] = (),
    *,
    bandwidth: float | None = None,
    periodic: bool = False,
    absolute: bool = False,
) -> tuple[Floats, dict[str, Any]]:
    """Return what the next pass asks of the model, and what its ``Drive`` says of the last one.

    The error to expect is that of the last pass, which the next one should stay below.

    Parameters
    ----------
    lead
        The model, the limits, and what stands before the move.
    desired, first, step
        The trajectory, the stamp of its first row, and seconds a row.
    recordings
        Names, and rows of drive and displacement of the last pass; all of one drive.
    history
        The passes so far, the oldest first; from one with this very drive on they
        are forgotten.
    bandwidth
        Cut-off of Q (Hz); None: as far as the model can be trusted.
    periodic, absolute
        Whether recordings are of whole periods, and whether the mean is learned.

    Raises
    ------
    InputError
        A recording is not of this trajectory, or the error grew.
    """
    name, model = recordings[0][0], lead.model
    if not np.ptp(desired) > 0.0:
        raise InputError(f"{name}: the trajectory holds still: nothing is learned")
    rows_of = rows_of_loop if periodic else rows_of_move
    passes = [
        rows_of(lead, desired, first, step, label, rows) for label, rows in recordings
    ]
    voltage = passes[0][0]
    for (label, _), (other, _, _) in zip(recordings, passes, strict=True):
        if not is_one_drive(model, other, voltage):
            raise _not_this_move(label, f"not the drive of {name}")
    _, modelled, measured = np.mean(passes, axis=0)
    _require_same_move(name, model, desired, modelled, absolute)
    _require_follows(name, modelled, measured)
    error = desired - measured
    zero = 0.0 if absolute else float(error.mean())
    error = error - zero
    digest = sha256(voltage.tobytes()).hexdigest()
    passed = PassRecord(digest, rms(error))
    # what came of learning from this drive before is forgotten
    before = tuple(takewhile(lambda record: record.drive_sha256 != digest, history))
    cutoff = bandwidth
    if cutoff is None:
        cutoff = _trusted_frequency(name, model, desired, measured - modelled, step)
    _require_no_growth(name, [record.rmse for record in before], passed.rmse, cutoff)
    change = low_pass(modelled - desired + error, cutoff, step, periodic, ORDER)
    if not absolute:
        change = change - change.mean()
    if model.dynamics is not None and not periodic:
        change = _resting_ends(change, cutoff * step)
    unit, percent = model.output.suffix, 100.0 * passed.rmse / float(np.ptp(desired))
    note = (
        f"{name}: the last pass was {passed.rmse:.3g}{unit} off (RMS, {percent:.2g} % of the move), "
        f"{noise(measured):.2g}{unit} of it noise; learned below {cutoff:.4g} Hz"
    )
    figures = {
        "expected_error": passed.rmse,
        "expected_known": None,  # the model's own error is what was learned
        "expected_unrested": None,
        "mean_left_out": None if absolute else -zero,
        "history": (*before, passed),
        "notes": (note,),
    }
    return desired + change, figures


# --- the rows of a recording that belong to the trajectory: drive, modelled and measured displacement ---


def rows_of_move(
    lead: Lead, desired: Floats, first: float, step: float, name: str, recording: Rows
) -> Floats:
    """Return the rows of a move, shape (3, rows); what stands before is its lead, what behind a return."""
    voltage, model = recording.x, lead.model
    state = _start(lead, float(voltage[0]), step)
    modelled = model.run(voltage, state, step).y
    rows = np.array([voltage, modelled, _measured(model, recording, step)])
    stamped = _row_by_stamps(name, recording.time, first, step)
    begin = _first_row(lead, desired, step, rows, stamped)
    if voltage.size - begin < desired.size:
        raise _not_this_move(name, f"{voltage.size - begin:,} of {desired.size:,} rows")
    _require_same_past(name, lead, voltage[:begin])
    return rows[:, begin : begin + desired.size]


def rows_of_loop(
    lead: Lead, desired: Floats, first: float, step: float, name: str, recording: Rows
) -> Floats:
    """Return the mean of the periods at the end that are alike, shape (3, rows)."""
    voltage, model, count = recording.x, lead.model, desired.size
    stamped = _row_by_stamps(name, recording.time, first, step)
    row_count = voltage.size - (stamped or 0)
    if row_count < count:
        raise _not_this_move(name, f"{row_count:,} of {count:,} rows")
    rows = np.array([voltage, _measured(model, recording, step)])
    periods = rows[:, voltage.size % count :].reshape(2, -1, count)
    begin = last = periods.shape[1] - 1
    while begin and is_one_drive(model, periods[0, begin - 1], periods[0, last]):
        begin -= 1  # before that one, something else leads to the loop
    if begin < last:
        begin += 1  # not settled yet
    rows = periods[:, begin:].mean(axis=1)

    def repeated(period: Floats) -> Floats:
        start = _start(lead, float(voltage[0] if stamped else period[0]), step)
        return settled_run(model, period, step, start)

    # a recorder may begin anywhere in a loop: the period is laid where what the model
    # makes of it is closest to the trajectory
    spectrum = np.fft.rfft(repeated(rows[0])) * np.fft.rfft(desired).conj()
    phase = int(np.argmax(np.fft.irfft(spectrum, count)))
    by_stamps = stamped is not None and row_count % count == 0
    if by_stamps and min(phase, count - phase) * step <= ACTUATOR_LAG:
        phase = 0  # what was learned may be as early
    drive, measured = np.roll(rows, -phase, axis=1)
    return np.array([drive, repeated(drive), measured])


def is_one_drive(model: Cascade, voltage: Floats, other: Floats) -> bool:
    """Return whether two recordings are of one drive, but for what a monitor adds."""
    return rms(voltage - other) <= ONE_DRIVE * model.input.span


def _measured(model: Cascade, recording: Rows, step: float) -> Floats:
    """Return the measured displacement without the sensor's delay."""
    time = step * np.arange(float(recording.y.size))
    return without_delay(time, recording.y, model.sensor_delay)[0]


def _start(lead: Lead, voltage: float, step: float) -> State:
    """Return the state before the first voltage of a drive that was made for it."""
    standing, past = lead.standing, lead.state
    if standing is not None and not isinstance(past, State):
        rest = lead.model.start(standing, past)
        past = lead.model.run(np.array([standing]), rest, step).state
    return lead.model.start(voltage, past)


def _first_row(
    lead: Lead, desired: Floats, step: float, rows: Floats, stamped: int | None
) -> int:
    """Return the row of a recording, as of ``rows_of_move``, that is the trajectory's first.

    Behind what led to it, or where what the model makes of the recorded drive is closest
    to it. A recorder may count from elsewhere than the stamps say: they count where they
    agree with that, or where it shows too little.
    """
    misfit = sliding_misfit(rows[1], desired)
    row = int(np.argmin(misfit))
    led = _row_behind_lead(lead, desired.size, step, rows, row)
    best = row if led is None else led
    if stamped is None or stamped >= misfit.size:
        return best
    # what was learned may be as early
    if abs(best - stamped) * step <= ACTUATOR_LAG:
        return stamped
    square = DRIVE_RESIDUAL * desired.size * float(np.var(desired))
    enough = min(MUCH_CLOSER * float(misfit[stamped]), square)
    return best if led is not None or misfit[row] <= enough else stamped


def _row_behind_lead(
    lead: Lead, count: int, step: float, rows: Floats, row: int
) -> int | None:
    """Return the row behind what led to a move of so many rows; None: not recorded.

    What was learned has changed the shape of the move, and moved it by some rows from
    ``row``, where it begins by its shape.
    """
    voltage, modelled, _ = rows
    close = ONE_DRIVE * lead.model.input.span
    for _ in range(LEAD_TRIES):  # what leads to it depends on its first value
        _, led, still = lead.planned(float(modelled[row]), step, None)
        if not 0 < led.size <= voltage.size or np.ptp(led) <= close:
            return None
        misfit = sliding_misfit(voltage, led)
        begin = int(np.argmin(misfit))
        tried, row = row, begin + led.size + still
        if row + count > voltage.size:
            return None
        if row == tried:
            return row if misfit[begin] <= led.size * close**2 else None
    return None


def _row_by_stamps(
    name: str, time: Floats | None, first: float, step: float
) -> int | None:
    """Return the row at the time of the trajectory's first; None where no stamp is of that time.

    Raises
    ------
    InputError
        The clock has another rate, or a gap.
    """
    if time is None or time.size < 2:
        return None
    longest = float(np.diff(time).max())
    is_other = abs(step_of(time) / step - 1.0) > RATE_SLACK
    if is_other or longest > LONG_STEP * step:
        raise _not_this_move(
            name, f"steps of {step_of(time):.6g} to {longest:.6g} s, not {step:.6g}"
        )
    begin = first - 0.5 * step
    if not time[0] - step <= begin <= time[-1]:
        return None
    return int(np.searchsorted(time, begin))


def sliding_misfit(values: Floats, template: Floats) -> Floats:
    """Return the sum of squared differences from a template at each place where it fits in; one at least."""
    values, template = values - template.mean(), template - template.mean()
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


# --- refusals ---


def _not_this_move(name: str, reason: str) -> InputError:
    """Return the refusal of a recording that is not of this move."""
    return InputError(
        f"{name}: {reason}: record each row of a pass of this drive (other rates: `resample` HZ)"
    )


def _require_same_past(name: str, lead: Lead, before: Floats) -> None:
    """Refuse a pass with a sweep before it for a drive without, or the other way round (InputError)."""
    if before.size < 2 or isinstance(lead.state, State):
        return
    low, high = lead.limits.sweep
    extremes = before[turns(before, 0.1 * (high - low))]
    travel = float(np.abs(np.diff(extremes)).sum())
    if (travel > SWEEP_TRAVEL * (high - low)) != lead.condition:
        how = "without" if lead.condition else "with"
        raise _not_this_move(name, f"another past, {how} a sweep (`condition`)")


def _require_same_move(
    name: str, model: Cascade, desired: Floats, modelled: Floats, absolute: bool
) -> None:
    """Refuse a drive that asks for another shape, whatever its size, or for another mean (InputError)."""
    move, shape = desired - desired.mean(), modelled - modelled.mean()
    size = max(float(np.sum(shape * move) / np.sum(move * move)), 0.0)
    mean = 0.0 if absolute else float(modelled.mean() - desired.mean())
    difference = math.hypot(rms(shape - size * move), mean)
    if difference > ANOTHER_MOVE * rms(move):
        raise _not_this_move(
            name,
            f"its drive belongs to another trajectory, {difference:.3g} from this one (RMS; the move has "
            f"{rms(move):.3g}{model.output.suffix})",
        )


def _require_follows(name: str, modelled: Floats, measured: Floats) -> None:
    """Refuse what follows the drive by chance, or in another scale than the model's logs (InputError)."""
    move, response = modelled - modelled.mean(), measured - measured.mean()
    square, product = float(move @ move), float(move @ measured)
    gain = product / max(square, 1e-300)
    likeness = product / max(math.sqrt(square * float(response @ response)), 1e-300)
    in_scale = 1.0 / OTHER_SCALE <= gain <= OTHER_SCALE
    if not in_scale or likeness < LEAST_CORRELATION:
        raise InputError(
            f"{name}: the displacement does not follow the drive as the model expects, {gain:.3g} times at a "
            f"correlation of {likeness:.2g}: check columns, units and sensor; of another scale, type "
            f"`scale` measured={1.0 / (gain or math.inf):.3g}, or identify with `prior`"
        )


def _require_no_growth(
    name: str, errors: Sequence[float], rmse: float, cutoff: float
) -> None:
    """Refuse to go on when the error grew from those of the passes before (InputError)."""
    best = min(errors, default=math.inf)
    if not errors or rmse <= min(GROWTH * errors[-1], FROM_BEST * best):
        return
    raise InputError(
        f"{name}: the error grew from {errors[-1]:.3g} to {rmse:.3g} RMS: check the sensor's scale, or learn "
        f"from pass {1 + errors.index(best)} ({best:.3g}) with `bandwidth` {0.5 * cutoff:.3g} (it was "
        f"{cutoff:.3g} Hz)"
    )


def _trusted_frequency(
    name: str, model: Cascade, desired: Floats, residual: Floats, step: float
) -> float:
    """Return the frequency (Hz) to which a model is trusted in learning.

    It is a third of its lowest resonance: nothing grows where the model has that 25 % off.
    Without one it is the upper end of the last third of an octave in which the residual is small,
    from the strongest one on: in those below, what a wrong loop makes of it exceeds the
    little that was asked there. Between harmonics, where the trajectory asks for nothing,
    there is only what was learned against such a loop.
    """
    highest = 0.45 / step
    if model.trusted_frequency is not None:
        return min(model.trusted_frequency, highest)
    window = np.hanning(desired.size)
    move = np.fft.rfft((desired - desired.mean()) * window)[1:]
    error = np.fft.rfft((residual - residual.mean()) * window)[1:]
    frequency = np.fft.rfftfreq(desired.size, step)[1:]
    band = np.floor(3.0 * np.log2(frequency / frequency[0])).astype(int)
    energy = np.sqrt(np.bincount(band, np.abs(move) ** 2))
    error_energy = np.sqrt(np.bincount(band, np.abs(error) ** 2))
    counts = energy > BAND_ENERGY * energy.max()
    counts[: np.argmax(energy)] = False
    wrong = counts & (error_energy > TRUSTED_ERROR * energy)
    good = np.flatnonzero(counts & (np.cumsum(wrong) == 0))
    if not good.size:
        raise InputError(
            f"{name}: does not follow the model at any frequency: check columns, units and delay, or "
            "give `bandwidth` HZ"
        )
    return min(float(frequency[0] * 2.0 ** ((good[-1] + 1) / 3.0)), highest)


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
