"""Two recorders, one log: joined by time, and how far their clocks are apart.

A displacement follows the voltage through a loop: it turns where the voltage turns, but
is no function of it, so a plain correlation takes a loop of 18 % for a delay of 17 ms.
Here the displacement is described by the voltage, its powers and plays of it (a
Prandtl-Ishlinskii sum, linear in its weights), powers of that sum, a straight drift, and
the derivative of all that: the weight of the derivative is the offset. A delay of the
actuator or its sensor looks the same, and is part of what is found.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbo_cli.errors import InputError, UsageError, warn
from dbo_cli.logs.log import Log
from dbo_cli.logs.source import FloatArray, Reading, Table

SENSORS = ("displacement", "measured")  # the rows are those of their file
DRIVES = ("voltage", "desired", "input")
GAP_STEPS = 2.5  # usual steps; in a longer one at least a row is missing
APART = 5.0  # standard deviations from which on two clocks count as apart
# times less unexplained variance, where the drive's clock is moved: an amplifier's lag
# of 3 ms made 2 to 6 of a cycle of a second, 10 ms between clocks 14 to 42
BETTER = 10.0

PLAYS = np.geomspace(0.003, 0.7, 24)  # half widths, in parts of the drive's range
FINE = 20_000  # places at which the drive is followed
MOST_ROWS = 3_000  # of the sensor that are used (means of neighbours)
COARSE = 2_000  # steps of the coarse search over the shorter record
CANDIDATES = 6  # best places of the coarse search that are refined
STEPS = 12  # of Gauss and Newton at most
COVERED = 0.5  # of the shorter record must be covered by both
FEWEST_ROWS = 40  # of the sensor, and a tenth of them, where the drive's past is known
PARTS = (
    8  # of a record, each with an offset of its own: their scatter is the uncertainty
)
EXPLAINED = 0.09  # of the displacement's variance may be left unexplained
ALIKE = (
    1.3  # times the least residual: a second place that explains the records as well
)
PERFECT = 1e-6  # of the variance: below that, no place fits better than another
KNOWN_TO = 0.5  # samples of the slower clock, two standard deviations


@dataclass(frozen=True)
class ClockOffset:
    """What is added to the drive's clock (s), and two standard deviations of it (s).

    ``auto``: it was found from the signals, so a delay of the actuator is part of it.
    """

    seconds: float
    uncertainty: float = 0.0
    auto: bool = False


# --- joining ---


def joined(logs: Sequence[Log], reading: Reading) -> Log:
    """Join logs of one move by time into one.

    The rows are those of the log that holds the displacement (or what was measured),
    else of the first one. The others are interpolated linearly onto them, where all
    have rows.

    Parameters
    ----------
    logs
        One of each file, with its roles; the first gives the name.
    reading
        ``clock_offset``: seconds, or ``auto``, added to the clock of the drive's file.

    Raises
    ------
    InputError
        A log has no clock, they have no time in common, or the offset cannot be found.
    """
    if len(logs) > 2 and reading.clock_offset is not None:
        raise UsageError("`clock_offset` needs two files: join the others first")
    base = logs[0]
    for log in logs:
        if any(role in log.columns for role in SENSORS):
            base = log
            break
    rows = base.read()
    remarks = list(base.remarks)
    columns = dict(base.columns)
    offset: ClockOffset | None = None
    for log in logs:
        if log is base:
            continue
        other = log.read()
        time = _other_time(base, rows, log, other, reading)
        if reading.clock_offset is None:
            _warn_if_apart(base, rows, log, other, time)
        else:
            offset = _offset(base, rows, log, other, time, reading.clock_offset)
            time = time + offset.seconds
            if offset.auto:
                remarks.append(
                    f"{log.name}: its clock is moved by {offset.seconds:.6g} s (within "
                    f"{offset.uncertainty:.2g} s; a delay of the actuator is part of it)"
                )
        rows, left_out = _beside(rows, time, other, f"{base.name} and {log.name}")
        if left_out:
            remarks.append(
                f"{left_out:,} rows of {base.name} are left out: {log.name} has none there"
            )
        remarks += log.remarks
        columns |= log.columns
    assert rows.time is not None
    clock = replace(
        base.clock, first=float(rows.time[0]), last=float(rows.time[-1]), rows=rows.rows
    )
    log = Log.of_table(logs[0].name, columns, rows, clock, remarks)
    log.clock_offset = offset
    return log


def _other_time(
    base: Log, rows: Table, log: Log, other: Table, reading: Reading
) -> FloatArray:
    """Return a log's times on the clock of the base: dates and times of day are brought together."""
    for one, table in ((base, rows), (log, other)):
        if table.time is None:
            raise InputError(
                f"{one.name} has no clock, and files are joined by time: add a time column, or give "
                "`sample_rate` HZ if both were recorded at one rate"
            )
    assert other.time is not None
    stamps = base.clock.first_stamp, log.clock.first_stamp
    if stamps[0] is not None and stamps[1] is not None:
        if (rows.origin is None) == (other.origin is None):
            shifted: FloatArray = other.time + (stamps[1] - stamps[0]) / 1e9
            return shifted
    if stamps == (None, None) or reading.clock_offset is not None:
        return other.time
    raise InputError(
        f"{base.name} and {log.name} count time from different beginnings, one by dates: give `clock_offset` "
        "SECONDS, or auto"
    )


def _beside(
    rows: Table, time: FloatArray, other: Table, place: str
) -> tuple[Table, int]:
    """Put another log's signals beside rows, where it has some; return how many rows had none.

    Raises
    ------
    InputError
        They have no time in common.
    """
    assert rows.time is not None
    at = rows.time
    if not len(time):
        raise InputError(f"{place}: one of them has no rows")
    behind = np.clip(np.searchsorted(time, at, side="right"), 1, max(len(time) - 1, 1))
    covered = (at >= time[0]) & (at <= time[-1])
    if len(time) > 1:
        steps = np.diff(time)
        in_gap = steps[behind - 1] > GAP_STEPS * np.median(steps)
        is_stamp = (at == time[behind]) | (at == time[behind - 1])
        covered &= ~in_gap | is_stamp
    if not covered.any():
        apart = float(at[0] - time[0])
        raise InputError(
            f"{place} have no time in common: {at[0]:.9g} to {at[-1]:.9g} s and {time[0]:.9g} to "
            f"{time[-1]:.9g} s (`clock_offset` {apart:.9g} lets both begin together, auto finds it)"
        )
    kept = at[covered]
    values = {role: array[covered] for role, array in rows.values.items()}
    for role, array in other.values.items():
        values[role] = np.interp(kept, time, array)
    dt = rows.dt
    places = np.flatnonzero(covered)
    is_whole = places[-1] - places[0] + 1 == len(places)
    if isinstance(dt, np.ndarray) or not is_whole:
        steps = np.diff(kept)
        dt = np.concatenate([steps[:1], steps])
    return Table(kept, values, dt, rows.origin), len(at) - len(kept)


def _signals(rows: Table, other: Table) -> tuple[FloatArray, FloatArray] | None:
    """Return drive and displacement of two logs, if one has each."""
    drives = [other.values[role] for role in DRIVES if role in other.values]
    sensors = [rows.values[role] for role in SENSORS if role in rows.values]
    return (drives[0], sensors[0]) if drives and sensors else None


def _offset(
    base: Log, rows: Table, log: Log, other: Table, time: FloatArray, asked: float | str
) -> ClockOffset:
    """Return the offset that the user gives, or the one that the signals show."""
    if asked != "auto":
        return ClockOffset(float(asked))
    signals = _signals(rows, other)
    place = f"{base.name} and {log.name}"
    if signals is None or rows.time is None:
        raise InputError(
            f"{place}: `clock_offset` auto needs a drive and a displacement"
        )
    return clock_offset(time, signals[0], rows.time, signals[1], place)


def _warn_if_apart(
    base: Log, rows: Table, log: Log, other: Table, time: FloatArray
) -> None:
    """Warn where the drive explains the displacement much better when its clock is moved."""
    signals = _signals(rows, other)
    if signals is None or rows.time is None:
        return
    try:
        pair = _Pair.of(time, signals[0], rows.time, signals[1], "")
    except InputError:
        return
    fits = pair.fits()
    if not fits or fits[0].residual > EXPLAINED:
        return
    best = fits[0]
    now = pair.residual_at(0.0)
    is_better = now is not None and now > BETTER * max(best.residual, PERFECT)
    is_apart = abs(best.offset) > pair.slower + APART * best.deviation
    if is_better and is_apart:
        side = "early" if best.offset > 0.0 else "late"
        warn(
            f"{base.name} and {log.name}: drive and sensor do not line up in time: try `clock_offset` auto "
            f"({log.name} is some {abs(best.offset):.3g} s {side}; a delay of the actuator looks the same)"
        )


# --- the offset between two clocks ---


@dataclass(frozen=True)
class _Fit:
    """An offset (s), its standard deviation (s), and the part of the variance left unexplained."""

    offset: float
    deviation: float
    residual: float


def clock_offset(
    drive_time: FloatArray,
    drive: FloatArray,
    time: FloatArray,
    displacement: FloatArray,
    place: str,
) -> ClockOffset:
    """Return what is to be added to the drive's clock, found from the signals.

    Parameters
    ----------
    drive_time, drive
        What the drive's recorder has; its times (s) do not fall.
    time, displacement
        What the sensor's has.
    place
        How messages call the two.

    Raises
    ------
    InputError
        The records do not tell it to half a sample of the slower clock.
    """
    pair = _Pair.of(drive_time, drive, time, displacement, place)
    fits = pair.fits()
    if not fits:
        raise InputError(
            f"{place}: `clock_offset` auto: the two have too little in common, give SECONDS"
        )
    best = fits[0]
    _require_sure(best, fits[1:], pair.slower, place)
    return ClockOffset(best.offset, 2.0 * best.deviation, auto=True)


@dataclass(frozen=True)
class _Pair:
    """A drive on a fine clock with its columns, the sensor's rows, the slower clock's step (s)."""

    drive_time: FloatArray
    drive: FloatArray
    columns: FloatArray
    time: FloatArray
    displacement: FloatArray
    slower: float

    @classmethod
    def of(
        cls,
        drive_time: FloatArray,
        drive: FloatArray,
        time: FloatArray,
        displacement: FloatArray,
        place: str,
    ) -> _Pair:
        """Prepare two records; refuse those that are too short, or stand still (InputError)."""
        if min(len(drive_time), len(time)) < FEWEST_ROWS or np.ptp(drive_time) == 0.0:
            raise InputError(
                f"{place}: `clock_offset` auto needs {FEWEST_ROWS} rows of each, give SECONDS"
            )
        if np.ptp(drive) == 0.0 or np.ptp(displacement) == 0.0:
            raise InputError(
                f"{place}: `clock_offset` auto: one of the two stands still, give SECONDS"
            )
        slower = max(_usual_step(drive_time), _usual_step(time))
        fine = np.linspace(drive_time[0], drive_time[-1], FINE)
        drive = np.interp(fine, drive_time, drive)
        time, displacement = _thinned(time, displacement)
        return cls(fine, drive, _columns(drive), time, displacement, slower)

    def fits(self) -> list[_Fit]:
        """Return the fits near the places that look alike, the best first."""
        fits: list[_Fit] = []
        for start in _coarse(
            self.drive_time, self.drive, self.time, self.displacement, self.slower
        ):
            fit = self._refined(self.columns, start)
            if fit is not None:
                fits.append(fit)
        if not fits:
            return fits
        fits.sort(key=lambda fit: fit.residual)
        best = fits[0]
        # every second play: what the description of the loop does to the offset
        fewer = np.hstack([self.columns[:, :3], self.columns[:, 3::2]])
        again = self._refined(fewer, best.offset)
        if again is not None:
            change = again.offset - best.offset
            fits[0] = replace(best, deviation=math.hypot(best.deviation, change))
        return fits

    def residual_at(self, offset: float) -> float | None:
        """Return what part of the variance an offset leaves; None where too little is in common."""
        rows = _rows_at(self.drive_time, self.columns, self.time, offset)
        if rows is None:
            return None
        y = self.displacement[rows.inside]
        made, _ = _bent(self.drive_time, self.columns, rows, y)
        left = y - made @ np.linalg.lstsq(made, y, rcond=1e-9)[0]
        return float(np.mean(left**2)) / max(float(np.var(y)), 1e-300)

    def _refined(self, columns: FloatArray, start: float) -> _Fit | None:
        return _refined(self.drive_time, columns, self.time, self.displacement, start)


def _require_sure(
    best: _Fit, others: Sequence[_Fit], slower: float, place: str
) -> None:
    """Refuse an offset that is not known well enough (InputError)."""
    if best.residual > EXPLAINED:
        raise InputError(
            f"{place}: `clock_offset` auto: at no offset does the drive explain the displacement (at best "
            f"{100.0 * (1.0 - best.residual):.0f} %): check the columns, or give SECONDS"
        )
    if 2.0 * best.deviation > KNOWN_TO * slower:
        raise InputError(
            f"{place}: `clock_offset` auto: {best.offset:.6g} s, but uncertain by "
            f"{2.0 * best.deviation:.2g} s, more than half a sample ({KNOWN_TO * slower:.2g} s): give SECONDS"
        )
    alike = ALIKE * max(best.residual, PERFECT)
    for fit in others:
        if abs(fit.offset - best.offset) > slower and fit.residual < alike:
            raise InputError(
                f"{place}: `clock_offset` auto: {best.offset:.6g} s and {fit.offset:.6g} s fit alike, "
                "since the drive repeats itself: give SECONDS, or a log that begins or ends at rest"
            )


def _usual_step(time: FloatArray) -> float:
    """Return the usual time between rows (s), several of which may have one stamp."""
    return float(np.ptp(time)) / max(len(time) - 1, 1)


def _thinned(time: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return means of as many neighbours as leave no more than ``MOST_ROWS``."""
    group = -(-len(time) // MOST_ROWS)
    count = len(time) // group
    times = time[: count * group].reshape(count, group).mean(axis=1)
    means = values[: count * group].reshape(count, group).mean(axis=1)
    return times, means


def _columns(drive: FloatArray) -> FloatArray:
    """Return what the displacement may be made of: powers of the drive, and plays of it.

    The plays begin where a drive of this range leaves them: one that starts at the lower
    end has come down to it, and each play lags by its half width.
    """
    u = (drive - drive.min()) / np.ptp(drive)
    plays = np.empty((len(u), len(PLAYS)))
    half = np.minimum(PLAYS, 0.5)
    held = np.clip(u[0], half, 1.0 - half)
    for row, value in enumerate(u.tolist()):
        held = np.minimum(np.maximum(held, value - PLAYS), value + PLAYS)
        plays[row] = held
    return np.column_stack([u, u**2, u**3, plays])


def _coarse(
    drive_time: FloatArray,
    drive: FloatArray,
    time: FloatArray,
    displacement: FloatArray,
    slower: float,
) -> list[float]:
    """Return offsets (s) at which the two look most alike, the best first.

    Both are laid on one grid and shifted against each other; what counts is their
    correlation where both are, whatever its sign.
    """
    shorter = min(float(np.ptp(drive_time)), float(np.ptp(time)))
    step = max(slower, shorter / COARSE)
    v = np.interp(np.arange(drive_time[0], drive_time[-1], step), drive_time, drive)
    y = np.interp(np.arange(time[0], time[-1], step), time, displacement)
    v = v - v.mean()
    y = y - y.mean()
    here, there = np.ones(len(v)), np.ones(len(y))
    count = np.rint(_shifted(here, there))
    is_enough = count >= COVERED * min(len(v), len(y))
    count = np.maximum(count, 1.0)
    mean_v = _shifted(v, there) / count
    mean_y = _shifted(here, y) / count
    scatter_v = _shifted(v * v, there) / count - mean_v**2
    scatter_y = _shifted(here, y * y) / count - mean_y**2
    both = _shifted(v, y) / count - mean_v * mean_y
    floor = 1e-6 * float(np.mean(v * v)) * float(np.mean(y * y))
    alike = both**2 / np.maximum(scatter_v * scatter_y, floor)
    alike[~is_enough] = 0.0
    inner = alike[1:-1]
    peaks = 1 + np.flatnonzero(
        (inner >= alike[:-2]) & (inner >= alike[2:]) & (inner > 0.0)
    )
    best = peaks[np.argsort(-alike[peaks], kind="stable")][:CANDIDATES]
    begin = float(time[0]) - float(drive_time[0])
    return [begin + (int(k) - (len(v) - 1)) * step for k in best]


def _shifted(one: FloatArray, other: FloatArray) -> FloatArray:
    """Return the sums of products at every shift of one array against the other (by FFT)."""
    size = 1 << (len(one) + len(other)).bit_length()
    product = np.conj(np.fft.rfft(one, size)) * np.fft.rfft(other, size)
    sums: FloatArray = np.roll(np.fft.irfft(product, size), len(one) - 1)
    return sums[: len(one) + len(other) - 1]


def _refined(
    drive_time: FloatArray,
    columns: FloatArray,
    time: FloatArray,
    displacement: FloatArray,
    start: float,
) -> _Fit | None:
    """Return the best fit near an offset, by Gauss and Newton; None where too little is in common."""
    span = float(np.ptp(drive_time))
    step = float(drive_time[1] - drive_time[0])
    farthest = 2.0 * step + 0.01 * span  # that one step of the search goes
    offset = start
    fit: _Fit | None = None
    for _ in range(STEPS):
        rows = _rows_at(drive_time, columns, time, offset)
        if rows is None:
            return fit
        y = displacement[rows.inside]
        made, model = _bent(drive_time, columns, rows, y)
        ahead = np.interp(rows.at + 0.5 * step, drive_time, model)
        speed = (ahead - np.interp(rows.at - 0.5 * step, drive_time, model)) / step
        both = np.column_stack([y, speed])
        rest = both - made @ np.linalg.lstsq(made, both, rcond=1e-9)[0]
        unlike = rest[:, 1]  # of the speed: what the columns cannot make
        weight = -float(unlike @ rest[:, 0]) / max(float(unlike @ unlike), 1e-300)
        left = rest[:, 0] + weight * unlike
        change = float(np.clip(weight, -farthest, farthest))
        offset += change
        residual = float(np.mean(left**2)) / max(float(np.var(y)), 1e-300)
        fit = _Fit(offset, _scatter(left, unlike), residual)
        if abs(change) < 0.02 * fit.deviation + 1e-9 * span:
            break
    return fit


def _bent(
    drive_time: FloatArray, columns: FloatArray, rows: _Rows, y: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Describe a displacement by the columns and by square and cube of the loop that they make.

    An actuator bends behind its loop, too. Returned are all columns at the sensor's rows,
    and what they make of the drive on its fine clock.
    """
    weights = np.linalg.lstsq(rows.made, y, rcond=1e-9)[0]
    loop = columns @ weights[: columns.shape[1]]
    part = (loop - loop.min()) / max(float(np.ptp(loop)), 1e-300)
    powers = np.column_stack([part**2, part**3])
    made = np.column_stack([rows.made, _sampled(drive_time, powers, rows.at)])
    weights = np.linalg.lstsq(made, y, rcond=1e-9)[0]
    model = columns @ weights[: columns.shape[1]] + powers @ weights[-2:]
    return made, model


class _Rows(NamedTuple):
    """The sensor's rows that count, their times on the drive's clock (s), and the columns there."""

    inside: NDArray[np.bool_]
    at: FloatArray
    made: FloatArray


def _rows_at(
    drive_time: FloatArray, columns: FloatArray, time: FloatArray, offset: float
) -> _Rows | None:
    """Describe the sensor's rows by the drive, moved by an offset (s); None where too few are left."""
    step = float(drive_time[1] - drive_time[0])
    known = drive_time[_known_from(columns[:, 0])]
    there = time - offset
    inside = (there >= known + step) & (there <= drive_time[-1] - step)
    if np.count_nonzero(inside) < max(0.1 * len(time), FEWEST_ROWS):
        return None
    at = there[inside]
    drift = (at - at[0]) / float(np.ptp(drive_time))
    made = np.column_stack([_sampled(drive_time, columns, at), np.ones(len(at)), drift])
    return _Rows(inside, at, made)


def _sampled(time: FloatArray, columns: FloatArray, at: FloatArray) -> FloatArray:
    """Return the columns at other times, linearly between their rows (which are even)."""
    place = (at - time[0]) / (time[1] - time[0])
    row: NDArray[np.intp] = np.clip(place.astype(np.intp), 0, len(time) - 2)
    part = (place - row)[:, None]
    sampled: FloatArray = columns[row] * (1.0 - part) + columns[row + 1] * part
    return sampled


def _scatter(left: FloatArray, unlike: FloatArray) -> float:
    """Return the standard deviation of an offset by how it scatters between parts of the record.

    ``unlike`` is what the columns cannot make of the speed. What is wrong with the
    description of the loop scatters with it, and so does a clock that runs faster than
    the other.
    """
    pulls = np.zeros(PARTS)
    for part, rows in enumerate(np.array_split(np.arange(len(left)), PARTS)):
        pulls[part] = float(unlike[rows] @ left[rows])
    scatter = math.sqrt(float(pulls @ pulls) * PARTS / (PARTS - 1))
    return scatter / max(float(unlike @ unlike), 1e-300)


def _known_from(part: FloatArray) -> int:
    """Return the first place whose past no longer matters.

    That is where the drive has been at both ends of its range, if more than half of the
    record follows; else where it has been at one, as if it had never gone farther.
    """
    low = int(np.argmax(part <= 0.005))
    high = int(np.argmax(part >= 0.995))
    both = max(low, high)
    return both if both < 0.5 * len(part) else min(low, high)
