"""Faults of sensors and loggers, mended or left out before anything is fitted, and said.

Voltage: noise of its read-back moves the gears, so it is smoothed. Displacement: hum of
the mains is taken off; spikes, and rows in which the sensor stands still while the
drive moves, are left out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dbo_cli.errors import UsageError
from dbo_cli.hysteresis.identification.recordings import (
    BLOCK_ROWS,
    EVEN,
    FEWEST_ROWS,
    MOST,
    NOTICEABLE,
    Floats,
    IdentificationOptions,
    Recording,
    drive_shape,
)

Booleans = NDArray[np.bool_]

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


@dataclass(frozen=True)
class Cleaned:
    """A recording with faults mended, the rows to leave out (bool, shape (samples,)), and what to say."""

    recording: Recording
    bad: Booleans
    notes: list[str]


def cleaned(recording: Recording) -> Cleaned:
    """Mend or mark what sensor and logger did to one recording."""
    notes: list[str] = []
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
    bad = spikes | stuck
    step = regular_step(recording)
    if step is not None and len(recording.voltage) >= SPECTRUM_ROWS:
        recording = _without_hum(recording, bad, step, notes)
        recording = _without_read_back_noise(recording, bad, step, notes)
    return Cleaned(recording, bad, notes)


def regular_step(recording: Recording) -> float | None:
    """Return the usual step (s) where no single step is far from it; None without such a clock."""
    seconds = recording.seconds()
    if seconds is None:
        return None
    steps = np.diff(seconds)
    step = float(np.median(steps))
    return (
        step
        if step > 0.0 and float(np.abs(steps - step).max()) <= EVEN * step
        else None
    )


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
    sigma = (
        OF_NORMAL * float(np.median(away[away > 0.0])) if (away > 0.0).any() else 0.0
    )
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
    begins, ends = (
        np.concatenate(([0], edges)),
        np.concatenate((edges, [len(displacement)])),
    )
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
    return lines, power / float(window @ window)


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
    held = float(np.mean(np.diff(recording.displacement) == 0.0))
    if base is None or held > MOST:
        return recording
    displacement = _filled(recording.displacement, bad)
    found = _hum_lines(displacement, recording.voltage, step, base)
    if not found:
        return recording
    from scipy.signal import filtfilt, iirnotch

    clean = displacement
    for frequency in found:
        width = max(1.0 / (step * len(displacement)) * 8.0, frequency / 30.0)
        taps = iirnotch(frequency, frequency / width, 1.0 / step)
        clean = filtfilt(*taps, clean)
    size = np.sqrt(2.0) * float(np.std(displacement - clean))
    shown = ", ".join(f"{frequency:.4g}" for frequency in found)
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
    found: list[float] = []
    for line in candidates[np.argsort(-power[candidates])]:
        near = any(abs(frequency[line] - one) < 6.0 * frequency[1] for one in found)
        foreign = HUM_LINE * float(driven[line]) < float(power[line])
        if (
            not near
            and foreign
            and _stands_out(power, int(line), base / float(frequency[1]))
        ):
            found.append(float(frequency[line]))
    return sorted(found)


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
    places = [round((order + k) * base) for k in (-2, -1, 1, 2)]
    harmonics = [
        float(power[max(at - 2, 0) : at + 3].max())
        for at in places
        if 2 < at < len(power) - 2
    ]
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
            displacement = displacement + self.lag * slope(
                displacement, ordered, self.lag
            )
        if self.delay > 0.0:
            displacement = np.interp(ordered + self.delay, ordered, displacement)
        return replace(
            recording,
            voltage=recording.voltage[:known],
            displacement=displacement[:known],
            time=None if recording.time is None else recording.time[:known],
            uncertainty=None
            if recording.uncertainty is None
            else recording.uncertainty[:known],
            rows=None if recording.rows is None else recording.rows[:known],
        )


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
    found: Floats = savgol_filter(
        values, 2 * half + 1, min(3, 2 * half), deriv=1, delta=step
    )
    return found
