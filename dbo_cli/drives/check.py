"""Any program's drive against limits, by the gate that this program's own pass; and what was played."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbo_cli.drives.gate import DriveFigures, DriveGate, Floats
from dbo_cli.errors import InputError
from dbo_cli.hysteresis.cascade import interpolated
from dbo_cli.hysteresis.model_state import DriveLimits
from dbo_cli.logs.sample_block import GAP_STEPS, SAME_RATE, median_step

TOLERANCE = 1e-3  # of the drive's range: a converter of 10 bits rounds to half of it
# standard deviations: white noise reaches 5 once in two million rows
MOST_BY_NOISE = 6.0
# of a variance: what sums and transforms of double precision leave of two equal drives
EXACT = 1e-12
# of the shorter of the two: in a few rows everything is like everything
FEWEST_SHARED = 0.25
# correlation below which a recording is of another drive; chosen, in between
ANOTHER = 0.5
# of what is left at the right speed: less at another one, and it was played at that
OTHER_SPEED = 0.1
# in any unit; sums of squares of what is beyond leave the range of float64
LARGEST = 1e100
# rows from which on a part of a row is looked for: three numbers are fitted to them
FEWEST_FOR_PARTS = 16


Rows = NDArray[np.int64]


@dataclass
class CheckedDrive:
    """What a drive asks of an amplifier, and what is wrong with it.

    Attributes
    ----------
    figures : DriveFigures
        Range, steps and speed of the drive.
    problems : list of str
        Limits that are broken, each with its first place; empty where none is.
    played : dict
        With a recording: rows, lag, gain, offset, largest difference.
    outside : int
        How many rows, the first ones, are outside the limits, on the way inwards from
        ``from_``.
    """

    figures: DriveFigures
    problems: list[str] = field(default_factory=list)
    played: dict[str, Any] = field(default_factory=dict)
    outside: int = 0


def check_drive(
    drive: Floats,
    time: Floats | None,
    limits: DriveLimits,
    *,
    from_: float | None = None,
    loop: bool = False,
    tolerance: float = 0.0,
    place: Callable[[int], str] = lambda row: f"row {row + 1}",
    suffix: str = "",
) -> CheckedDrive:
    """Return what is wrong with a drive.

    Parameters
    ----------
    drive, time
        Voltages, and seconds where they are known.
    limits
        What the drive may do; infinite where nothing is asked.
    from_
        Where the amplifier stands before the first row.
    loop
        The drive is looped: the step from its last row to its first counts, too.
    tolerance
        By how much a row may miss a limit: the noise of what is a recording of the
        drive, not the drive.
    place
        How messages call a row (from 0).
    suffix
        The unit, behind a blank, for messages.

    Raises
    ------
    InputError
        A slew limit is to be checked and no time is known; or a row is no voltage at
        all.
    """
    require_voltages(drive, place, suffix)
    checked = CheckedDrive(DriveFigures())
    steps = None
    if time is not None and time.size > 1:
        steps = _check_clock(checked, time, place)
    if steps is None and limits.max_slew is not None:
        raise InputError(
            "there is no time, and `max_slew` depends on it (`time` COLUMN or `sample_rate` HZ)"
        )
    checked.figures.see(drive, steps)
    allowed = replace(
        limits, v_min=limits.v_min - tolerance, v_max=limits.v_max + tolerance
    )
    waits = steps
    # both rows of a step may miss by the tolerance
    if steps is not None and limits.max_slew:
        waits = steps + 2.0 * tolerance / limits.max_slew
    # On a slow ramp a recorder gives the same value twice; a drive that was computed
    # moves in every row.
    gate = DriveGate(allowed, from_, suffix, may_wait=tolerance > 0.0)
    bad = gate.broken(drive, waits)
    checked.outside = gate.outside
    if gate.outside == drive.size:
        bad[-1] = True  # it never came inside
    if bad.any():
        row = int(np.argmax(bad))
        before = _row_before(drive, row, from_)
        reason = DriveGate(limits, suffix=suffix).reason(float(drive[row]), before)
        if tolerance:
            reason += f" by more than the tolerance, {tolerance:.3g}{suffix}"
        checked.problems.append(_problem(place, bad, reason))
    if loop:
        seam = gate.violation(drive[:1], None if waits is None else waits[:1])
        if seam:
            seam = f"from the last row to the first: {seam}"
        seam = seam or _open_seam(drive, suffix)
        if seam:
            checked.problems.append(seam)
    return checked


def _row_before(drive: Floats, row: int, from_: float | None) -> float:
    """Return the voltage before a row; before the first one that is ``from_``, where it is known."""
    if row == 0 and from_ is not None:
        return from_
    return float(drive[max(row - 1, 0)])


def require_voltages(
    drive: Floats, place: Callable[[int], str], suffix: str = ""
) -> None:
    """Refuse figures that no amplifier has and no sum of squares holds (InputError)."""
    beyond = ~(np.abs(drive) <= LARGEST)
    if beyond.any():
        row = int(np.argmax(beyond))
        raise InputError(
            f"{place(row)}: {drive[row]:g}{suffix} is no voltage: it is beyond {LARGEST:g}"
        )


def _open_seam(drive: Floats, suffix: str) -> str:
    """Return what is said of a loop whose last step is not of its kind; nothing where it closes."""
    seam = abs(drive[0] - drive[-1])
    inside = float(np.abs(np.diff(drive)).max(initial=0.0))
    if seam <= 3.0 * inside:  # as a period that does not close (see ``loops``)
        return ""
    return (
        f"from the last row, {drive[-1]:.6g}{suffix}, to the first, {drive[0]:.6g}{suffix}, is a step of "
        f"{seam:.3g}{suffix} where the largest inside is {inside:.3g}{suffix}: the loop does not close"
    )


def _check_clock(
    checked: CheckedDrive, time: Floats, place: Callable[[int], str]
) -> Floats:
    """Note what is odd about time stamps; return the seconds before each row, none of them below 0."""
    steps = np.diff(time)
    forward = steps[steps > 0.0]
    usual = median_step(forward) if forward.size else 0.0
    # as ``compensate`` counts the row before the first
    first = steps[0] if steps[0] > 0.0 else usual
    steps = np.concatenate([[first], steps])
    for what, odd in (
        ("time goes backwards", steps < 0.0),
        ("the time stamp repeats", steps == 0.0),
        ("a gap in time", steps > GAP_STEPS * usual),
    ):
        if odd.any():
            checked.problems.append(_problem(place, odd, what))
    return np.maximum(steps, 0.0)


def _problem(place: Callable[[int], str], odd: Any, reason: str) -> str:
    count = int(np.count_nonzero(odd))
    more = f" ({count:,} rows in all)" if count > 1 else ""
    return f"{place(int(np.argmax(odd)))}: {reason}{more}"


class Likeness(NamedTuple):
    """How a recording is like a drive.

    Attributes
    ----------
    lag, part
        By how many rows it is later, whole ones and the fraction of a row beside them.
    rows
        How many rows of the two belong together.
    gain, offset, alike
        Recording = gain drive + offset; the correlation of the two, without its sign.
    largest, left
        The largest difference, and what is left of it after gain and offset.
    ends, cut
        The recording's range, and what is left of the difference where the drive is cut
        off there.
    """

    lag: int
    part: float
    rows: int
    gain: float
    offset: float
    alike: float
    largest: float
    left: float
    ends: tuple[float, float]
    cut: float


def noise_of(played: Floats) -> float:
    """Return the standard deviation of a recording's read-back noise; 0 where none is evident."""
    # with all of identification
    from dbo_cli.hysteresis.identification.cleaning import read_back_noise

    return read_back_noise(played)


def played_tolerance(drive: Floats, played: Floats, tolerance: float | None) -> float:
    """Return by how much a recording may differ from a drive (its unit).

    Where no ``tolerance`` is given, that is a thousandth of the drive's range, or what
    the noise of the recording makes of it if that is more.
    """
    if tolerance is not None:
        return tolerance
    return max(TOLERANCE * float(np.ptp(drive)), MOST_BY_NOISE * noise_of(played))


def check_played(
    checked: CheckedDrive,
    drive: Floats,
    played: Floats,
    steps: tuple[float | None, float | None],
    tolerance: float | None = None,
    gain: float = 1.0,
    suffix: str = "",
) -> None:
    """Compare a recording of the drive with what was to be played; problems and figures go to ``checked``.

    Parameters
    ----------
    drive, played
        What was computed, and what was recorded.
    steps
        Seconds a row of the two, where they are known: at another rate the drive is
        interpolated.
    tolerance
        Largest difference allowed; see ``played_tolerance``.
    gain
        Of an amplifier behind the place of the recording: it is compared times that.
    suffix
        The unit, behind a blank, for messages.
    """
    most = played_tolerance(drive, played * gain, tolerance)
    step, played_step = steps
    count = drive.size
    ratio = late_seconds = None
    if step is not None and played_step is not None:
        ratio = played_step / step
        if abs(ratio - 1.0) > SAME_RATE:
            count = int((drive.size - 1) / ratio + 1e-9) + 1
        else:
            ratio = None
    likeness, speed = _found(drive, played * gain, most, count, ratio)
    if played_step is not None:
        late_seconds = (likeness.lag + likeness.part) * played_step
    checked.played = {
        "rows": likeness.rows, "lag_rows": likeness.lag, "lag_seconds": late_seconds,
        "resampled": count != drive.size, "gain": likeness.gain, "offset": likeness.offset,
        "largest_difference": likeness.largest, "difference_after_gain_and_offset": likeness.left,
        "tolerance": most, "read_back_noise": noise_of(played * gain), "speed": speed, "amplifier_gain": gain,
    }  # fmt: skip
    if likeness.alike < ANOTHER:
        checked.problems.append(
            "what was played is another drive: the two have nothing in common"
        )
        return
    if speed != 1.0:
        checked.problems.append(
            f"the drive was played {speed:.3g} times as fast as it was to be (the generator's rate or "
            "frequency, or the recording's clock)"
        )
    elif likeness.rows < count:
        checked.problems.append(
            f"{count - likeness.rows:,} of {count:,} rows were not played"
        )
    if likeness.largest > most:
        checked.problems.append(
            f"what was played differs by up to {likeness.largest:.6g}{suffix}, more than {most:.3g}{suffix} "
            f"({_cause(likeness, drive, most, gain, suffix)})"
        )


def _cause(
    likeness: Likeness, drive: Floats, most: float, gain: float, suffix: str
) -> str:
    """Return in words what explains a difference: a cut, or a gain and an offset."""
    cause = "neither a gain nor an offset explains it"
    explained = likeness.left <= 0.5 * likeness.largest
    if likeness.cut <= most:
        beyond = (likeness.ends[0] - drive.min(), drive.max() - likeness.ends[1])
        cut = []
        for end, by in zip(likeness.ends, beyond, strict=True):
            if by > most:
                cut.append(f"{end:.6g}")
        cause = f"it is the drive cut off at {' and '.join(cut)}{suffix}: a limit of the amplifier?"
    elif explained:
        cause = f"gain {likeness.gain:.6g} and offset {likeness.offset:.6g}{suffix} explain all but "
        cause += f"{likeness.left:.3g}{suffix}"
    if explained and gain != 1.0:
        cause += (
            f"; before the amplifier an amplitude of {100.0 * abs(likeness.gain):.4g} % and an offset of "
            f"{likeness.offset / gain:.4g}{suffix}"
        )
    return cause


def _found(
    drive: Floats, played: Floats, most: float, count: int, ratio: float | None
) -> tuple[Likeness, float]:
    """Return how a recording is like a drive in ``count`` rows, and how many times as fast it was played."""
    likeness = _likeness(_stretched(drive, count, ratio), played, most)
    speed = 1.0
    # at another speed: row for row, or from end to end?
    if likeness.alike < ANOTHER or likeness.left > most:
        for rows in sorted({drive.size, played.size} - {count}):
            again = _likeness(_stretched(drive, rows), played, most)
            closer = again.left < OTHER_SPEED * likeness.left
            if closer and again.alike > likeness.alike:
                likeness, speed = again, count / rows
    return likeness, speed


def _stretched(drive: Floats, count: int, step: float | None = None) -> Floats:
    """Return a drive in so many rows, ``step`` of its own rows apart (over all of it, where not given)."""
    if count == drive.size:
        return drive
    if step is None:
        step = (drive.size - 1) / max(count - 1, 1)
    rows = np.arange(float(drive.size))
    return interpolated(rows, drive, step * np.arange(float(count)))[0]


def _likeness(drive: Floats, played: Floats, most: float) -> Likeness:
    """Return how a recording is like a drive, later by fractions of a row where whole rows do not do."""
    lag = _lag(drive, played)
    begin, end = max(0, -lag), min(drive.size, played.size - lag)
    likeness = _fitted(drive[begin:end], played[begin + lag : end + lag], lag, 0.0)
    if likeness.left <= most or likeness.alike < ANOTHER:
        return likeness
    if end - begin < FEWEST_FOR_PARTS:
        return likeness
    curve = _Curve(drive)
    part = 0.0
    rows = np.arange(begin + 1.0, end - 1.0)
    b = played[begin + 1 + lag : end - 1 + lag]
    for _ in range(2):
        a, speed = curve.at(rows - part)
        columns = np.column_stack([a - a.mean(), np.ones(a.size), speed])
        gain, _, slope = np.linalg.lstsq(columns, b, rcond=None)[0].tolist()
        if gain:
            part = min(max(part - slope / gain, -1.0), 1.0)
        else:
            part = 0.0
    again = _fitted(curve.at(rows - part)[0], b, lag, part)
    if again.left < likeness.left:
        return again._replace(rows=likeness.rows)
    return likeness


class _Curve:
    """The cubic spline through rows at 0, 1, 2, ...; its first two and last two pieces are one cubic each.

    The second derivatives m solve m[k-1] + 4 m[k] + m[k+1] = 6 (d[k-1] - 2 d[k] +
    d[k+1]) inside, and m[0] - 2 m[1] + m[2] = 0 at either end. Powers of z = sqrt(3) -
    2 solve the equation without its right side: two-sided ones are its answer to a
    single row, one-sided ones bring the ends about.
    """

    POLE = math.sqrt(3.0) - 2.0
    REACH = 40  # rows; POLE to this power is below 1e-22

    def __init__(self, drive: Floats) -> None:
        self.drive, count = drive, drive.size
        bend = np.zeros(count)
        bend[1:-1] = 6.0 * np.diff(drive, 2)
        powers = self.POLE ** np.arange(count).clip(max=self.REACH)
        powers[self.REACH :] = 0.0
        away = np.abs(np.arange(-self.REACH, self.REACH + 1))
        answer = self.POLE**away / (4.0 + 2.0 * self.POLE)
        inner = np.convolve(bend, answer)[self.REACH : self.REACH + count]
        ends = np.array([1.0, -2.0, 1.0])
        decays = np.stack([powers, powers[::-1]])
        first, last = decays[:, :3] @ ends, decays[:, -3:] @ ends
        missed = np.array([inner[:3] @ ends, inner[-3:] @ ends])
        self.bend: Floats = (
            inner - np.linalg.solve(np.stack([first, last]), missed) @ decays
        )

    def at(self, places: Floats) -> tuple[Floats, Floats]:
        """Return the curve and its slope (per row) between the first row and the last."""
        left = np.clip(np.floor(places).astype(np.int64), 0, self.drive.size - 2)
        after = places - left
        before = 1.0 - after
        left_value, right_value = self.drive[left], self.drive[left + 1]
        bend_here, bend_there = self.bend[left] / 6.0, self.bend[left + 1] / 6.0
        value = left_value * before + right_value * after
        value += (before**3 - before) * bend_here + (after**3 - after) * bend_there
        slope = (
            right_value
            - left_value
            - (3.0 * before**2 - 1.0) * bend_here
            + (3.0 * after**2 - 1.0) * bend_there
        )
        return value, slope


def _fitted(a: Floats, b: Floats, lag: int, part: float) -> Likeness:
    """Return how rows that belong together are alike."""
    columns = np.column_stack([a - a.mean(), np.ones(a.size)])
    gain, middle = np.linalg.lstsq(columns, b, rcond=None)[0].tolist()
    offset = middle - gain * float(a.mean())
    if np.ptp(a) == 0.0:
        alike = 1.0
    elif np.ptp(b) > 0.0:
        alike = abs(float(np.corrcoef(a, b)[0, 1]))
    else:
        alike = 0.0
    largest = float(np.abs(b - a).max())
    left = float(np.abs(b - gain * a - offset).max())
    ends = float(b.min()), float(b.max())
    cut = float(np.abs(b - np.clip(a, *ends)).max())
    return Likeness(lag, part, a.size, gain, offset, alike, largest, left, ends, cut)


def _sums_between(values: Floats, begin: Rows, end: Rows) -> Floats:
    """Return the sum of the values of each stretch of rows."""
    total = np.concatenate([[0.0], np.cumsum(values)])
    sums: Floats = total[end] - total[begin]
    return sums


def _lag(drive: Floats, played: Floats) -> int:
    """Return by how many rows the recording is later: where the rows that belong together tell it best.

    That is the logarithm of the likelihood that one is the other times a gain, n
    log(1/(1 - r^2)) of n rows whose correlation is r: a recording may begin late and
    end early.
    """
    a, b = drive - drive.mean(), played - played.mean()
    lags = np.arange(1 - a.size, b.size)
    begin, end = np.maximum(0, -lags), np.minimum(a.size, b.size - lags)
    count = end - begin
    sum_a = _sums_between(a, begin, end)
    sum_b = _sums_between(b, begin + lags, end + lags)
    squares_a = _sums_between(a * a, begin, end) - sum_a**2 / count
    squares_b = _sums_between(b * b, begin + lags, end + lags) - sum_b**2 / count
    spread = squares_a * squares_b
    shared = _correlated(b, a) - sum_a * sum_b / count
    moving = (spread > EXACT * spread.max()) & (
        count >= FEWEST_SHARED * min(a.size, b.size)
    )
    alike = np.divide(shared**2, spread, out=np.zeros(lags.size), where=moving)
    evidence = -count * np.log(np.maximum(1.0 - alike, EXACT))
    near = lags[evidence >= evidence.max() * (1.0 - 1e-9)]
    return int(near[np.argmin(np.abs(near))])


def _correlated(b: Floats, a: Floats) -> Floats:
    """Return the sums of b[n + lag] a[n] for every lag at which the two overlap."""
    size = 1 << (a.size + b.size - 2).bit_length()
    circular = np.fft.irfft(np.fft.rfft(b, size) * np.fft.rfft(a, size).conj(), size)
    return np.concatenate([circular[size - a.size + 1 :], circular[: b.size]])
