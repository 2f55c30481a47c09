"""How far two recorders' clocks are apart, found from what they recorded.

A displacement follows the voltage through a loop: it turns where the voltage turns, but
is no function of it. So the displacement is described by the voltage, its powers and
plays of it (a Prandtl-Ishlinskii sum, linear in its weights), by a straight drift, and
by its own derivative: the weight of that is the offset. A second derivative column that
grows with time gives the drift of one clock against the other.

A delay of the actuator or its sensor looks the same, and is part of what is found.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dbo_cli.errors import InputError
from dbo_cli.interpolation.smooth import interpolated
from dbo_cli.logs.sample_block import FloatArray, median_step

Spectrum = NDArray[np.complex128]

PLAYS = np.geomspace(0.003, 0.7, 24)
"""Half widths of the plays, in parts of the drive's range: ten in a decade; chosen."""

FINE, MOST_SENSOR = 20_000, 3_000
"""Places at which the drive is followed, and rows of the sensor that are used (means of neighbours)."""

COARSE = 2_000  # steps of the coarse search over the shorter record
ENOUGH = 0.5  # of the shorter record must be covered by both
STEPS = 12  # of Gauss and Newton at most
FEWEST = 0.1  # of the sensor's rows must lie where the drive's past is known
AT_END = 0.005  # of the drive's range: so near its end the drive has been there
CANDIDATES = 6  # best places of the coarse search that are refined
# times the least residual: a second place that explains the records as well
ALIKE = 1.15
EXPLAINED = 0.3  # of the displacement's scatter may be left unexplained
# of a sample of the slower clock: what an offset must be known to (two standard
# deviations)
FIFTH = 0.2
DRIFT_FROM = 10.0  # s, from which on a drift is looked for
# standard deviations of a drift from which on it is one; they come from PARTS - 2
# degrees of freedom
SURE = 5.0
PARTS = 8  # of a record, each with an offset of its own


@dataclass(frozen=True)
class ClockOffset:
    """What is to be added to the drive's clock, in seconds, and its standard deviation.

    ``drift`` is how much faster the sensor's clock runs (seconds a second), ``about``
    the time on the drive's clock at which the offset holds.
    """

    seconds: float
    deviation: float
    drift: float = 0.0
    drift_deviation: float = math.inf
    about: float = 0.0

    def moved(self, time: FloatArray) -> FloatArray:
        """Return times of the drive's clock on the sensor's."""
        moved: FloatArray = time + self.seconds + self.drift * (time - self.about)
        return moved


@dataclass(frozen=True)
class _Fit:
    """One fit: offset and drift, their deviations, and what part of the scatter is unexplained."""

    offset: float
    drift: float
    deviation: float
    drift_deviation: float
    about: float
    residual: float


def find_offset(
    drive_time: FloatArray,
    drive: FloatArray,
    sensor_time: FloatArray,
    sensor: FloatArray,
    place: str,
) -> ClockOffset:
    """Return the offset of the drive's clock, and the drift where it is sure and the records last.

    Parameters
    ----------
    drive_time, drive
        What the drive's recorder has; seconds that rise.
    sensor_time, sensor
        What the sensor's has; seconds that do not fall.
    place
        How messages call the two.

    Raises
    ------
    InputError
        The records cannot tell.
    """
    slower = max(median_step(np.diff(drive_time)), _usual_step(sensor_time))
    fine = np.linspace(drive_time[0], drive_time[-1], FINE)
    drive_time, drive = fine, interpolated(drive_time, drive, fine)[0]
    sensor_time, sensor = _thinned(sensor_time, sensor, MOST_SENSOR)
    if float(np.ptp(drive)) == 0.0 or float(np.ptp(sensor)) == 0.0:
        raise InputError(
            f"{place}: `clock_offset` auto finds nothing: one of the two stands still"
        )
    columns = _columns(drive)
    fits: list[_Fit] = []
    for start in _coarse(drive_time, drive, sensor_time, sensor, slower):
        fit = _refined(drive_time, columns, sensor_time, sensor, start)
        if fit is not None:
            fits.append(fit)
    if not fits:
        raise InputError(
            f"{place}: `clock_offset` auto finds nothing that the two have in common"
        )
    fits.sort(key=lambda fit: fit.residual)
    best = fits[0]
    # every second play: does the description matter?
    fewer = np.hstack([columns[:, :3], columns[:, 3::2]])
    again = _refined(drive_time, fewer, sensor_time, sensor, best.offset)
    if again is not None:
        best = replace(
            best, deviation=math.hypot(best.deviation, again.offset - best.offset)
        )
    _require_sure(best, fits[1:], slower, place)
    drift = 0.0
    lasts = min(np.ptp(drive_time), np.ptp(sensor_time)) >= DRIFT_FROM
    if lasts and abs(best.drift) > SURE * best.drift_deviation:
        drift = best.drift
    return ClockOffset(
        best.offset, best.deviation, drift, best.drift_deviation, best.about
    )


def _require_sure(best: _Fit, others: list[_Fit], slower: float, place: str) -> None:
    """Refuse an offset that is not known well enough (InputError)."""
    remedy = "give `clock_offset` SECONDS"
    if best.residual > EXPLAINED**2:
        raise InputError(
            f"{place}: `clock_offset` auto finds no offset at which the voltage explains the displacement "
            f"(at best {100.0 * (1.0 - best.residual):.0f} % of its scatter; check the columns, or {remedy})"
        )
    if 2.0 * best.deviation > FIFTH * slower:
        raise InputError(
            f"{place}: `clock_offset` auto cannot tell: {best.offset:.6g} s, but uncertain by "
            f"{2.0 * best.deviation:.2g} s, more than {FIFTH * slower:.2g} s, a fifth of a sample ({remedy})"
        )
    for fit in others:
        apart = abs(fit.offset - best.offset)
        if apart > slower and fit.residual < ALIKE**2 * best.residual:
            raise InputError(
                f"{place}: `clock_offset` auto cannot tell {best.offset:.6g} s from "
                f"{fit.offset:.6g} s: the drive "
                f"repeats itself ({remedy}, or a log that begins or ends at rest)"
            )


def _usual_step(time: FloatArray) -> float:
    """Return the usual time between rows, several of which may have one stamp."""
    distinct = np.unique(time)
    return (
        float(np.ptp(time)) / max(len(time) - 1, 1)
        if len(distinct) < len(time)
        else median_step(np.diff(time))
    )


def _thinned(
    time: FloatArray, values: FloatArray, most: int
) -> tuple[FloatArray, FloatArray]:
    """Return means of as many neighbours as leave no more than ``most``."""
    group = -(-len(time) // most)
    if group <= 1:
        return time, values
    count = len(time) // group
    cut = slice(count * group)
    return time[cut].reshape(count, group).mean(axis=1), values[cut].reshape(
        count, group
    ).mean(axis=1)


def _columns(drive: FloatArray) -> FloatArray:
    """Return what the displacement may be made of: powers of the drive, and plays of it."""
    low, span = float(drive.min()), float(np.ptp(drive))
    u = (drive - low) / span
    plays = np.empty((len(u), len(PLAYS)))
    held = np.full(len(PLAYS), u[0])
    for row, value in enumerate(u.tolist()):
        held = np.minimum(np.maximum(held, value - PLAYS), value + PLAYS)
        plays[row] = held
    return np.column_stack([u, u**2, u**3, plays])


def _coarse(
    drive_time: FloatArray,
    drive: FloatArray,
    sensor_time: FloatArray,
    sensor: FloatArray,
    slower: float,
) -> list[float]:
    """Return offsets (s) at which the two look most alike, the best first.

    The two are laid on one grid and shifted against each other; what counts is their
    correlation where both are, whatever its sign.
    """
    shorter = min(float(np.ptp(drive_time)), float(np.ptp(sensor_time)))
    step = max(slower, shorter / COARSE)
    v = np.interp(np.arange(drive_time[0], drive_time[-1], step), drive_time, drive)
    y = np.interp(np.arange(sensor_time[0], sensor_time[-1], step), sensor_time, sensor)
    v, y = v - v.mean(), y - y.mean()
    size = 1 << (len(v) + len(y)).bit_length()
    ones = np.fft.rfft(np.ones(len(v)), size), np.fft.rfft(np.ones(len(y)), size)
    seen = [np.fft.rfft(one, size) for one in (v, v * v, y, y * y)]

    def shifted(of_drive: Spectrum, of_sensor: Spectrum) -> FloatArray:
        """Sum products at every shift of the sensor's grid against the drive's."""
        return np.roll(np.fft.irfft(np.conj(of_drive) * of_sensor, size), len(v) - 1)[
            : len(v) + len(y) - 1
        ]

    count = np.rint(shifted(ones[0], ones[1]))
    enough = count >= ENOUGH * min(len(v), len(y))
    count = np.maximum(count, 1.0)
    mean_v, mean_y = (
        shifted(seen[0], ones[1]) / count,
        shifted(ones[0], seen[2]) / count,
    )
    scatter_v = shifted(seen[1], ones[1]) / count - mean_v**2
    scatter_y = shifted(ones[0], seen[3]) / count - mean_y**2
    both = shifted(seen[0], seen[2]) / count - mean_v * mean_y
    floor = 1e-6 * float(np.mean(v * v)) * float(np.mean(y * y))
    alike = np.where(enough, both**2 / np.maximum(scatter_v * scatter_y, floor), 0.0)
    peaks = [
        k
        for k in range(1, len(alike) - 1)
        if alike[k - 1] <= alike[k] >= alike[k + 1] and alike[k] > 0.0
    ]
    peaks.sort(key=lambda k: -alike[k])
    begin = float(sensor_time[0]) - float(drive_time[0])
    return [begin + (k - (len(v) - 1)) * step for k in peaks[:CANDIDATES]]


def _refined(
    drive_time: FloatArray,
    columns: FloatArray,
    sensor_time: FloatArray,
    sensor: FloatArray,
    start: float,
) -> _Fit | None:
    """Return the best fit near an offset, by Gauss and Newton; None where too little is in common."""
    offset, known = start, drive_time[_known_from(columns[:, 0])]
    span, step = float(np.ptp(drive_time)), float(drive_time[1] - drive_time[0])
    farthest = 2.0 * step + 0.01 * span  # that one step of the search goes
    fit: _Fit | None = None
    for _ in range(STEPS):
        there = sensor_time - offset  # on the drive's clock
        inside = (there >= known + step) & (there <= drive_time[-1] - step)
        if np.count_nonzero(inside) < max(FEWEST * len(sensor), 40):
            return fit
        at, y = there[inside], sensor[inside]
        made = np.column_stack([np.interp(at, drive_time, one) for one in columns.T])
        slow = np.column_stack([made, np.ones(len(at)), (at - at[0]) / span])
        model = columns @ np.linalg.lstsq(slow, y, rcond=1e-9)[0][: columns.shape[1]]
        ahead = np.interp(at + 0.5 * step, drive_time, model)
        speed = (ahead - np.interp(at - 0.5 * step, drive_time, model)) / step
        whole = np.column_stack([slow, -speed])
        scale = np.sqrt(np.mean(whole**2, axis=0))
        scale[scale == 0.0] = 1.0
        weights = np.linalg.lstsq(whole / scale, y, rcond=1e-9)[0]
        left = y - (whole / scale) @ weights
        change = float(np.clip(weights[-1] / scale[-1], -farthest, farthest))
        offset += change
        unexplained = (
            float(np.mean(left**2) / np.var(y)) if float(np.var(y)) > 0.0 else 1.0
        )
        fit = _with_drift(offset, at, left, speed, unexplained)
        if abs(change) < 0.02 * fit.deviation + 1e-9 * span:
            break
    return fit


def _with_drift(
    offset: float,
    at: FloatArray,
    left: FloatArray,
    speed: FloatArray,
    unexplained: float,
) -> _Fit:
    """Return offset and drift with their deviations, by how the offset scatters in the record.

    What is wrong with the description of the loop scatters with it, so the deviations
    count that, too.
    """
    parts = np.array_split(np.arange(len(at)), PARTS)
    times, apart, weights = np.zeros(PARTS), np.zeros(PARTS), np.zeros(PARTS)
    for k, rows in enumerate(parts):
        moving = speed[rows] - speed[rows].mean()
        weights[k] = float(np.sum(moving * moving))
        apart[k] = -float(np.sum(moving * left[rows])) / max(weights[k], 1e-300)
        times[k] = at[rows].mean()
    weights /= max(float(weights.sum()), 1e-300)
    middle = float(np.dot(weights, times))
    mean = float(np.dot(weights, apart))
    spread = float(np.dot(weights, (times - middle) ** 2))
    drift = float(np.dot(weights, (times - middle) * (apart - mean))) / max(
        spread, 1e-300
    )
    rest = apart - mean - drift * (times - middle)
    variance = float(np.dot(weights, rest**2)) / (PARTS - 2)
    return _Fit(
        offset,
        drift,
        math.sqrt(variance),
        math.sqrt(variance / max(spread, 1e-300)),
        middle,
        unexplained,
    )


def _known_from(part: FloatArray) -> int:
    """Return the first place whose past no longer matters: the drive was at an end of its range."""
    return int(np.argmax((part <= AT_END) | (part >= 1.0 - AT_END)))
