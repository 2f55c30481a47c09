"""Faults of sensors and loggers, mended or left out before anything is fitted, and said.

Voltage: noise of its read-back moves the gears, so it is smoothed. Displacement: hum of
the mains is taken off; spikes, and rows in which the sensor stands still while the
drive moves, are left out.

The range of a drive is that of its recordings without the noise with which they were
read back. The least and the greatest of noisy readings lie outside what the amplifier
gave: a model that took them for its range would send a unipolar amplifier below zero.
So the drive is found in each row from parabolas through the rows before it and behind
it, which may meet in a corner. Where readings have no noise, every digit of their least
and greatest is kept.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dbo_cli.errors import UsageError
from dbo_cli.hysteresis.identification.normal_equations import dot, sum_of_squares
from dbo_cli.hysteresis.identification.recordings import (
    BLOCK_ROWS,
    EVEN,
    FEWEST_ROWS,
    HIDDEN_STEPS,
    MOST,
    NOTICEABLE,
    Booleans,
    Floats,
    IdentificationOptions,
    Integers,
    Recording,
    drive_shape,
)
from dbo_cli.hysteresis.move_error import SMALLEST_TURN, turning_points

SPECTRUM_ROWS = 200
"""For a spectrum in which noise and drive can be told apart."""

# standard deviation over the median distance from the middle, of normal noise
OF_NORMAL = 1.4826
FLOOR_FACTOR = 5.0
"""The drive ends where its spectrum, averaged over bands, is down to so many times the noise floor."""

HARMONICS = 12.0
"""In cycles of the drive: a low-pass below its twelfth harmonic rounds the turns (0.3 % of the range), and a
line below may be what the actuator does.
"""

HUM_LINE = 30.0
"""Power of a line over the median around it (white noise reaches 12 in a log of 10,000 rows), and over what
the drive has there, scaled to the displacement: else the drive does hum.
"""

# rows: longer ones have turns of the drive in them; 5 and 11: the same models
SPIKE_WINDOW = 7
# with 4 and 16, errors on new moves of eight invented logs were 0.999 to 1.001
SPIKE_SIGMAS = 8.0
SPIKE_SPREAD = 2.0
"""A spike leaves its neighbours by so many times what they differ among themselves; a turn does not."""

MOST_SPIKES = 0.2  # of the rows: more are not spikes; chosen

STUCK_PATH = 0.08
"""Of the drive's range: how far it may travel while a working sensor, even one of 5 bits, repeats itself."""


def clean(
    recordings: Sequence[Recording], sensor: Sensor, notes: list[str]
) -> tuple[list[Recording], tuple[float, float]]:
    """Return the logs without what sensors and loggers did to them, and both ends of the drive.

    What was done is added to ``notes``.
    """
    recordings = [sensor.taken_off(log) for log in recordings]
    recordings = [without_voltage_glitches(log, notes) for log in recordings]
    ends = drive_range(recordings)
    mended_logs = [mended(log, notes) for log in recordings]
    return within(mended_logs, ends), ends


def without_voltage_glitches(recording: Recording, notes: list[str]) -> Recording:
    """Replace single samples of the voltage that jump away and back by the mean of their neighbours.

    The drive was not there, but one such sample would stretch the gears over a range
    that was never driven. A jump counts where it is three times the most that the
    drive, such samples aside, does between samples.
    """
    v = recording.voltage
    middle = np.median((v[:-2], v[1:-1], v[2:]), axis=0)
    jump = np.abs(v[1:-1] - middle)
    usual = float(np.abs(np.diff(middle)).max())
    least = max(HIDDEN_STEPS * usual, SMALLEST_TURN * float(np.ptp(middle)))
    rows = np.flatnonzero(jump > least) + 1
    if not len(rows) or usual == 0.0:
        return recording
    repaired = v.copy()
    repaired[rows] = (v[rows - 1] + v[rows + 1]) / 2.0
    notes.append(
        f"{recording.name}: {len(rows)} single voltages that jump away and back replaced by the mean of "
        f"their neighbours (first at row {recording.row(rows[0])}: {v[rows[0]]:g})"
    )
    return replace(recording, voltage=repaired)


def mended(recording: Recording, notes: list[str]) -> Recording:
    """Mend what sensor and logger did to one recording, or mark its rows as faulty, and say so."""
    spikes = spiked_rows(recording.displacement)
    if spikes.any():
        notes.append(
            f"{recording.name}: {int(spikes.sum())} outlying rows left out (spikes of the displacement; "
            f"first at row {recording.row(int(np.argmax(spikes)))})"
        )
    stuck = stuck_rows(recording.displacement, recording.voltage)
    if stuck.any():
        notes.append(
            f"{recording.name}: {int(stuck.sum())} rows left out: the displacement stands still while the "
            f"drive moves (first at row {recording.row(int(np.argmax(stuck)))}): check the sensor"
        )
    faulty = spikes | stuck
    step = regular_step(recording)
    if step is not None and len(recording.voltage) >= SPECTRUM_ROWS:
        recording = _without_hum(recording, faulty, step, notes)
        recording = _without_read_back_noise(recording, faulty, step, notes)
    return replace(recording, faulty=faulty)


def regular_step(recording: Recording) -> float | None:
    """Return the usual step (s) where no single step is far from it; None without such a clock."""
    seconds = recording.seconds()
    if seconds is None:
        return None
    steps = np.diff(seconds)
    step = float(np.median(steps))
    if not step > 0.0:
        return None
    farthest = float(np.abs(steps - step).max())
    return step if farthest <= EVEN * step else None


def spiked_rows(displacement: Floats, window: int = SPIKE_WINDOW) -> Booleans:
    """Rows that leave their neighbours and come back, further than these differ among themselves.

    ``window`` is the odd number of rows that are looked at together; up to a third of
    them may be spiked.
    """
    from numpy.lib.stride_tricks import sliding_window_view

    spiked = np.zeros(len(displacement), bool)
    if len(displacement) < 4 * window:
        return spiked
    half = window // 2
    windows = sliding_window_view(np.pad(displacement, half, mode="edge"), window)
    away, spread = np.empty((2, len(displacement)))
    for begin in range(0, len(displacement), BLOCK_ROWS):
        part = slice(begin, begin + BLOCK_ROWS)
        around = np.sort(windows[part], axis=1)
        away[part] = np.abs(displacement[part] - around[:, half])
        spread[part] = around[:, -1 - window // 3] - around[:, window // 3]
    sigma = 0.0
    if (away > 0.0).any():
        sigma = OF_NORMAL * float(np.median(away[away > 0.0]))
    spiked = (away > SPIKE_SIGMAS * sigma) & (away > SPIKE_SPREAD * spread)
    # 0.1 % of the range: chosen.
    spiked &= away > 1e-3 * float(
        np.subtract(*np.percentile(displacement, [99.0, 1.0]))
    )
    return spiked if spiked.mean() <= MOST_SPIKES else np.zeros(len(displacement), bool)


def stuck_rows(displacement: Floats, voltage: Floats) -> Booleans:
    """Rows of runs of one displacement, away from its extremes, over which the drive travels far."""
    stuck = np.zeros(len(displacement), bool)
    edges = np.flatnonzero(np.diff(displacement) != 0.0) + 1
    begins = np.concatenate(([0], edges))
    ends = np.concatenate((edges, [len(displacement)]))
    path = np.concatenate(([0.0], np.cumsum(np.abs(np.diff(voltage)))))
    travelled = path[ends - 1] - path[begins]
    usual = float(np.percentile(travelled, 90.0))
    far = travelled > max(STUCK_PATH * float(np.ptp(voltage)), 4.0 * usual)
    low, high = float(displacement.min()), float(displacement.max())
    for begin, end in zip(begins[far], ends[far], strict=True):
        # at an extreme it is clipped, which is looked at elsewhere
        if low < displacement[begin] < high:
            stuck[begin:end] = True
    return stuck


def _drive_frequency(recording: Recording, step: float) -> float | None:
    """Cycles of the drive per second: turns over twice their time."""
    turns = drive_shape(recording.voltage).turns
    if len(turns) < 2:
        return None
    return (len(turns) - 1) / (2.0 * step * float(turns[-1] - turns[0]))


def _spectrum(values: Floats, step: float) -> tuple[Floats, Floats]:
    """Frequency and power of each line of a signal with its ends brought together, by a Hann window."""
    window = np.hanning(len(values))
    power = np.abs(np.fft.rfft((values - values.mean()) * window)) ** 2
    lines: Floats = np.asarray(np.fft.rfftfreq(len(values), step), dtype=np.float64)
    return lines, power / sum_of_squares(window)


def _filled(values: Floats, bad: Booleans) -> Floats:
    """Bad rows replaced by a straight line between their neighbours."""
    if not bad.any() or bad.all():
        return values
    rows = np.arange(len(values))
    return np.interp(rows, rows[~bad], values[~bad])


def _without_hum(
    recording: Recording, bad: Booleans, step: float, notes: list[str]
) -> Recording:
    """Take lines that the drive does not have off the displacement, each with a slowly changing size."""
    base = _drive_frequency(recording, step)
    repeated = float(np.mean(np.diff(recording.displacement) == 0.0))
    if base is None or repeated > MOST:
        return recording
    displacement = _filled(recording.displacement, bad)
    lines = _hum_lines(displacement, recording.voltage, step, base)
    if not lines:
        return recording
    from scipy.signal import filtfilt, iirnotch

    clean = displacement
    for frequency in lines:
        width = max(1.0 / (step * len(displacement)) * 8.0, frequency / 30.0)
        taps = iirnotch(frequency, frequency / width, 1.0 / step)
        clean = filtfilt(*taps, clean)
    size = np.sqrt(2.0) * float(np.std(displacement - clean))
    shown = ", ".join(f"{frequency:.4g}" for frequency in lines)
    unit = f" {recording.displacement_unit}" if recording.displacement_unit else ""
    notes.append(
        f"{recording.name}: hum of {size:.3g}{unit} at {shown} Hz, which the drive does not have, taken off "
        "the displacement: shield the sensor, or ground it"
    )
    return replace(recording, displacement=np.where(bad, recording.displacement, clean))


def _hum_lines(
    displacement: Floats, voltage: Floats, step: float, base: float
) -> list[float]:
    """Frequencies (Hz) of lines far above the drive that stand out of the displacement alone."""
    frequency, power = _spectrum(displacement, step)
    _, driven = _spectrum(voltage * (np.ptp(displacement) / np.ptp(voltage)), step)
    least = (NOTICEABLE * float(np.ptp(displacement))) ** 2 * len(displacement) / 4.0
    candidates = np.flatnonzero((frequency > HARMONICS * base) & (power > least))
    lines: list[float] = []
    for line in candidates[np.argsort(-power[candidates])]:
        near = any(
            abs(frequency[line] - other_line) < 6.0 * frequency[1]
            for other_line in lines
        )
        foreign = HUM_LINE * float(driven[line]) < float(power[line])
        if (
            not near
            and foreign
            and _stands_out(power, int(line), base / float(frequency[1]))
        ):
            lines.append(float(frequency[line]))
    return sorted(lines)


def _stands_out(power: Floats, line: int, base: float) -> bool:
    """Whether a line is far above what is around it, the drive's own harmonics (every ``base`` lines) too.

    Harmonics fall off evenly; the mains' line is alone.
    """
    reach = max(len(power) // 200, 12)
    around = np.r_[
        max(line - reach, 0) : max(line - 4, 0),
        line + 5 : min(line + reach, len(power)),
    ]
    if len(around) < 8 or power[line] < HUM_LINE * float(np.median(power[around])):
        return False
    order = round(line / base)
    harmonics = []
    for neighbour in (-2, -1, 1, 2):
        place = round((order + neighbour) * base)
        if 2 < place < len(power) - 2:
            harmonics.append(float(power[place - 2 : place + 3].max()))
    return not harmonics or float(power[line]) > HUM_LINE * max(harmonics)


def _without_read_back_noise(
    recording: Recording, bad: Booleans, step: float, notes: list[str]
) -> Recording:
    """Smooth a noisy voltage, and the displacement alike so that they stay together."""
    base = _drive_frequency(recording, step)
    voltage = recording.voltage
    if base is None:
        return recording
    frequency, power = _spectrum(voltage, step)
    floor = float(np.median(power[3 * len(power) // 4 :]))
    # the median of an exponential variable is 0.69 of its mean
    noise = float(np.sqrt(floor / 0.69))
    between_rows = (
        OF_NORMAL * float(np.median(np.abs(np.diff(voltage, 2)))) / np.sqrt(6.0)
    )
    if min(noise, 2.0 * between_rows) < NOTICEABLE * float(np.ptp(voltage)):
        # a few jumps have a broad spectrum, too; noise is in most rows
        return recording
    bands = np.array_split(power[1:], min(100, len(power) // 20))
    above = [band.mean() > FLOOR_FACTOR * floor / 0.69 for band in bands]  # see above
    last = max((k for k, yes in enumerate(above) if yes), default=0)
    cutoff = max(float(frequency[sum(map(len, bands[: last + 1]))]), HARMONICS * base)
    # so near half the rate (chosen) a low-pass takes off little noise
    if cutoff > 0.35 / step:
        return recording
    from scipy.signal import butter, sosfiltfilt

    sections = butter(4, cutoff, fs=1.0 / step, output="sos")
    smooth = sosfiltfilt(sections, voltage)
    displacement = np.where(
        bad,
        recording.displacement,
        sosfiltfilt(sections, _filled(recording.displacement, bad)),
    )
    notes.append(
        f"{recording.name}: the voltage's read-back is noisy ({100.0 * noise / np.ptp(voltage):.2g} % of its "
        f"range): voltage and displacement smoothed above {cutoff:.3g} Hz; log the voltage that was sent"
    )
    return replace(recording, voltage=smooth, displacement=displacement)


LONGEST_DELAY = 0.25
"""Of a cycle: what is later shows nothing of the actuator. Of 194 models none changed with half of it."""


@dataclass(frozen=True)
class Sensor:
    """Delay and first-order lag of the sensor, in seconds."""

    delay: float = 0.0
    lag: float = 0.0

    @staticmethod
    def of(options: IdentificationOptions) -> Sensor:
        """Return the sensor that the user named."""
        return Sensor(options.sensor_delay, options.sensor_lag)

    def __bool__(self) -> bool:
        """Whether there is anything to take off."""
        return self.delay > 0.0 or self.lag > 0.0

    def check(self, cycle: float | None) -> None:
        """Raise UsageError where the figures are not a sensor's; ``cycle`` is the logs' in seconds."""
        if not self:
            return
        if cycle is None:
            raise UsageError(
                "`sensor_delay` and `sensor_lag` need a clock: name the time column (`time`) or give "
                "`sample_rate`"
            )
        for value, name in ((self.delay, "sensor_delay"), (self.lag, "sensor_lag")):
            if value > LONGEST_DELAY * cycle:
                raise UsageError(
                    f"`{name}` {value:g} s is more than a quarter of a cycle of the logs ({cycle:.3g} s): "
                    "give it in seconds, or record more slowly"
                )

    def taken_off(self, recording: Recording) -> Recording:
        """Return the recording as a sensor without delay and lag would have made it.

        The last rows, for which the sensor answers only after the log's end, are cut
        off.
        """
        seconds = recording.seconds()
        if not self or seconds is None:
            return recording
        known = int(np.searchsorted(seconds, seconds[-1] - self.delay, side="right"))
        known = max(known, min(FEWEST_ROWS, len(seconds)))
        ordered = np.maximum.accumulate(seconds)
        displacement = recording.displacement
        if self.lag > 0.0:
            rate = slope(displacement, ordered, self.lag)
            displacement = displacement + self.lag * rate
        if self.delay > 0.0:
            displacement = np.interp(ordered + self.delay, ordered, displacement)
        return replace(recording, displacement=displacement).part(slice(known))


def slope(values: Floats, seconds: Floats, width: float) -> Floats:
    """Rate of change of noisy values, from cubics fitted over ``width`` seconds to either side.

    A difference of neighbours would multiply the noise by the lag over the sample
    period.
    """
    from scipy.signal import savgol_filter

    steps = np.diff(seconds)
    step = float(np.median(steps[steps > 0.0]))
    if float(np.abs(steps - step).max()) > EVEN * step:
        even = np.linspace(
            seconds[0],
            seconds[-1],
            max(round((seconds[-1] - seconds[0]) / step) + 1, 5),
        )
        filled = slope(np.interp(even, seconds, values), even, width)
        spread: Floats = np.interp(seconds, even, filled)
        return spread
    half = min(max(round(width / step), 2), (len(values) - 1) // 2)
    rate: Floats = savgol_filter(
        values, 2 * half + 1, min(3, 2 * half), deriv=1, delta=step
    )
    return rate


# --- the range of a drive ---

# rows: the standard deviation of noise is known to a tenth from so many
FEWEST_READINGS = 200
# of the differences that are compared: a smooth drive is far smaller in the second
ORDERS = (4, 10)
# ratio of white noise by the two orders; a sine of a third of the rate has 0.53
ALIKE = (0.7, 1.4)
MOST_NOISE = 0.05  # of the range: a larger scatter is the drive itself
LEAST_NOISE = 1e-9  # of the range: less is the rounding of a computed drive
# of the rows: so many readings turn where the drive does not; by rounding none does
REVERSALS = 0.01
TURN = 8.0  # standard deviations of the noise: a turn of the drive, not of the noise

# rows of a parabola; longer ones say no more than is asked for
SHORTEST, LONGEST = 4, 1 << 12
# standard errors within which a longer parabola agrees with each shorter one
AGREE = 1.0
SURE = 2.0  # standard errors by which a level is known, where the highest is looked for
SAME = 2.0  # standard errors within which a swing reaches the top as the highest does
# standard deviations of the noise: the largest step of the last digit of an end
LAST_DIGIT = 2.0


def drive_range(recordings: Sequence[Recording]) -> tuple[float, float]:
    """Return the least and the greatest voltage of the drive over all logs, without read-back noise."""
    ends = [_ends(log.voltage) for log in recordings]
    lowest = min(low for low, _ in ends)
    highest = max(high for _, high in ends)
    return lowest, highest


def within(
    recordings: Sequence[Recording], ends: tuple[float, float]
) -> list[Recording]:
    """Return the logs with their voltages inside the drive's range: what lies beyond is noise."""
    return [replace(log, voltage=np.clip(log.voltage, *ends)) for log in recordings]


def read_back_noise(voltage: Floats) -> float:
    """Return the standard deviation of the noise of a recorded drive; 0 where none is evident.

    Noise is white: differences of any order tell the same standard deviation of it. So
    does rounding, but that is smaller than the distance between neighbouring levels,
    and readings do not go back and forth by it where the drive does not turn.
    """
    if len(voltage) < FEWEST_READINGS:
        return 0.0
    noise, again = (_scatter(voltage, order) for order in ORDERS)
    span = float(np.ptp(voltage))
    if not LEAST_NOISE * span < noise <= MOST_NOISE * span:
        return 0.0
    if not ALIKE[0] <= again / noise <= ALIKE[1]:
        return 0.0
    if noise < _distance_of_levels(voltage) and not _goes_back_and_forth(
        voltage, noise
    ):
        return 0.0
    return noise


def _distance_of_levels(voltage: Floats) -> float:
    """Return the usual distance between neighbours among all different readings."""
    return float(np.median(np.diff(np.unique(voltage))))


def _goes_back_and_forth(voltage: Floats, noise: float) -> bool:
    """Whether many readings turn where the drive does not."""
    steps = np.diff(voltage)
    directions = np.sign(steps[steps != 0.0])
    reversals = int(np.count_nonzero(np.diff(directions)))
    turns = len(turning_points(voltage, TURN * noise))
    return reversals - turns > REVERSALS * len(voltage)


def _scatter(voltage: Floats, order: int) -> float:
    """Return the standard deviation of white noise by the median of the differences of an order."""
    differences = np.abs(np.diff(voltage, order))
    return (
        OF_NORMAL
        * float(np.median(differences))
        / math.sqrt(math.comb(2 * order, order))
    )


def _ends(voltage: Floats) -> tuple[float, float]:
    """Return both ends of one log's drive."""
    lowest, highest = float(voltage.min()), float(voltage.max())
    noise = read_back_noise(voltage)
    if noise == 0.0:
        return lowest, highest
    low = max(_rounded(-_top(-voltage, noise), noise), lowest)
    high = min(_rounded(_top(voltage, noise), noise), highest)
    return (low, high) if low < high else (lowest, highest)


def _top(voltage: Floats, noise: float) -> float:
    """Return the greatest voltage of the drive.

    Every second row says where the drive is highest, and the rows in between, whose
    noise is another, say how high that is; then the other way round.
    """
    rows = len(voltage) // 2
    halves = [voltage[0 : 2 * rows : 2], voltage[1 : 2 * rows : 2]]
    known = [_levels(half, noise) for half in halves]
    tops, weights = [], []
    for finding, telling in ((0, 1), (1, 0)):
        at = _highest_rows(halves[finding], noise, *known[finding])
        level, error = known[telling]
        weight = error[at] ** -2.0
        tops.append(dot(level[at], weight) / float(weight.sum()))
        weights.append(float(weight.sum()))
    top = float(np.average(tops, weights=weights))
    # So many readings above it are higher by noise alone: a drive of few rows a turn is
    # seen better so.
    above = max(int(np.count_nonzero(voltage > top)), 1)
    by_noise = noise * math.sqrt(2.0 * math.log(above))
    return max(top, float(voltage.max()) - by_noise)


def _highest_rows(
    voltage: Floats, noise: float, level: Floats, error: Floats
) -> Integers:
    """Return the row in which each swing is highest, for the swings that reach the top."""
    turns = turning_points(voltage, TURN * noise)
    lows = turns[voltage[turns] < voltage.mean()]
    edges = np.unique(np.concatenate(([0], lows, [len(voltage)])))
    sure = level - SURE * error
    swings = itertools.pairwise(edges.tolist())
    rows = np.asarray(
        [begin + int(np.argmax(sure[begin:end])) for begin, end in swings]
    )
    best = rows[np.argmax(sure[rows])]
    below = level[best] - level[rows]
    as_high: Integers = rows[below <= SAME * np.hypot(error[rows], error[best])]
    return as_high


def _levels(voltage: Floats, noise: float) -> tuple[Floats, Floats]:
    """Return the drive in each row without noise, and its standard error; both have shape (samples,)."""
    before, error_before = _one_sided(voltage, noise)
    after, error_after = (values[::-1] for values in _one_sided(voltage[::-1], noise))
    weight_before, weight_after = error_before**-2.0, error_after**-2.0
    weight = weight_before + weight_after
    level: Floats = (weight_before * before + weight_after * after) / weight
    return level, weight**-0.5


def _one_sided(voltage: Floats, noise: float) -> tuple[Floats, Floats]:
    """Return the end of a parabola through the readings up to each row, and its standard error.

    A parabola is as long as its end agrees with those of all shorter ones (Lepski's
    rule).
    """
    from scipy.signal import oaconvolve

    middle = float(voltage.mean())
    readings = voltage - middle
    level, error = readings.copy(), np.full(len(voltage), noise)
    lowest, highest = readings - AGREE * noise, readings + AGREE * noise
    growing = np.ones(len(voltage), bool)
    rows = SHORTEST
    while rows <= min(LONGEST, len(voltage)):
        weights = _weights_of_the_end(rows)
        end = oaconvolve(readings, weights[::-1], mode="full")[: len(voltage)]
        end_error = noise * math.sqrt(sum_of_squares(weights))
        np.maximum(lowest, end - AGREE * end_error, out=lowest)
        np.minimum(highest, end + AGREE * end_error, out=highest)
        growing &= lowest <= highest
        growing[: rows - 1] = False
        level[growing] = end[growing]
        error[growing] = end_error
        rows *= 2
    return level + middle, error


def _weights_of_the_end(rows: int) -> Floats:
    """Return the weights of so many readings in the end of the parabola through them."""
    place = np.linspace(-1.0, 1.0, rows)
    columns = np.column_stack((np.ones(rows), place, place**2))
    weights: Floats = columns @ np.linalg.solve(columns.T @ columns, columns[-1])
    return weights


def _rounded(level: float, noise: float) -> float:
    """Return a level with the digits that noise leaves of it; the last is a multiple of 1, 2 or 5.

    None is left of a level that noise does not tell from 0.
    """
    largest = LAST_DIGIT * noise
    if abs(level) < largest:
        return 0.0
    exponent = math.floor(math.log10(largest))
    unit = 10.0**exponent
    factor = 1
    if 2 * unit <= largest:
        factor = 2
    if 5 * unit <= largest:
        factor = 5
    steps = round(level / (factor * unit))
    return float(f"{steps * factor}e{exponent}")
