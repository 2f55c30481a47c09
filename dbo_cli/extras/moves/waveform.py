"""Write drives as the file that a generator, a wave table or a converter takes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dbo_cli.drives.check import TOLERANCE, check_drive
from dbo_cli.drives.gate import DriveGate, Floats
from dbo_cli.drives.options import Figure, check_gain, limits_in
from dbo_cli.errors import InputError, LimitError, Remarks, UsageError
from dbo_cli.extras.moves import generators as waveforms
from dbo_cli.extras.moves.generators import Points, Values, format_named
from dbo_cli.hysteresis.model_state import DriveLimits
from dbo_cli.logs.columns import column_wish
from dbo_cli.logs.request import Address, ReadingOptions, check_document
from dbo_cli.logs.sample_block import joined, require_even
from dbo_cli.logs.signal_log import open_log, remarks_of
from dbo_cli.logs.units import in_unit
from dbo_cli.logs.whole_output import all_or_none, check_outputs, write_whole
from dbo_cli.runs.files import (
    Destination,
    read_record,
    summary_of_values,
    write_summary,
)

SAME_RATE = 1e-9  # two drives for one file are of one clock; the stamps' digits aside
_REMEDIES = {
    "a gap in time": " (`rows` A:B plays a part, `resample` HZ goes straight through)",
    "does not close": " (compensate's `periodic` makes one that does; without `loop` it is played once)",
}
PLAYS = "a generator plays even steps"


@dataclass(frozen=True)
class WaveformOptions:
    """What file is asked for, and what the drive may do; limits in volts, or texts with their unit.

    Attributes
    ----------
    to : str
        A key of ``FORMATS``.
    gain : float
        Of the amplifier: the file's volts are the drive's over this.
    points, rate
        Points of the generator, and points a second (Hz); the drive's own where not
        given.
    codes : (int, int), optional
        The lowest and the highest code; the format's where not given.
    volts : (float, float), optional
        What these mean at the generator's output; the drive's ends where not given.
    loop : bool
        The drive repeats.
    tolerance : float, optional
        By how much another rate may move the drive (V); a thousandth of its range where
        not given.
    max_rounding : float
        By how much rounding to codes may move each drive, in per cent of its range.

    Raises
    ------
    UsageError
        A value is senseless, or says nothing of this format.
    """

    to: str
    gain: float = 1.0
    points: int | None = None
    rate: float | None = None
    codes: tuple[float, float] | None = None
    volts: tuple[float, float] | None = None
    loop: bool = False
    v_min: Figure = None
    v_max: Figure = None
    max_slew: Figure = None
    tolerance: Figure = None
    max_rounding: float = 1.0
    voltage: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Refuse what cannot be meant."""
        limits_in("V", self.v_min, self.v_max, self.max_slew)
        form = format_named(self.to)
        check_gain(self.gain)
        if self.volts is not None and math.isinf(self.volts[1] - self.volts[0]):
            low, high = self.volts
            raise UsageError(
                f"`volts` {low:g}:{high:g}: the span is beyond the range of the arithmetic"
            )
        if form.codes is None and (self.codes or (self.volts and not form.normal)):
            raise UsageError(
                f"`{'codes' if self.codes else 'volts'}`: {self.to} files hold volts, no codes"
            )
        if form.volts_needed and self.volts is None:
            raise UsageError(
                f"`volts` LOW:HIGH: say what the lowest and the highest code of {self.to} mean"
            )
        if form.codes is not None and self.codes is not None:
            low, high = self.codes
            least, most = (-32768, 32767) if form.codes[0] < 0 else (0, 65535)
            if (
                low != round(low)
                or high != round(high)
                or not least <= low < high <= most
            ):
                raise UsageError(
                    f"`codes` {low:g}:{high:g}: give whole numbers from {least} to {most}"
                )

    @property
    def limits(self) -> DriveLimits:
        """The drive's limits in volts; infinite where not given."""
        return limits_in("V", self.v_min, self.v_max, self.max_slew)


def write_waveform(
    drives: Sequence[Address],
    destination: Destination,
    reading: ReadingOptions,
    options: WaveformOptions,
) -> Remarks:
    """Write a generator's file of one drive, or of several that are played together, and what was done.

    Raises
    ------
    InputError
        A drive has no even clock, or the drives do not belong together.
    LimitError
        A drive breaks its limits, does not fit the volts, does not close, or is moved
        too far by another rate or by rounding.
    GateError
        What was written, read back, breaks a limit: this program's fault; nothing is
        left behind.
    """
    output, summary = destination.output, destination.summary
    waveforms.check_name("-" if output.is_stream else output.path, options.to)
    check_outputs([path for path in (output, summary) if path is not None], drives)
    if summary is not None:
        check_document(summary, "a summary", "json")
    signals = _signals(drives, options.voltage)
    if len(signals) > 1 and not format_named(options.to).channels:
        raise UsageError(
            f"a {options.to} file holds one drive, not {len(signals)} (one file each)"
        )
    names = _names_of(signals, len(drives))
    values, steps, remarks_of, records = zip(
        *[_read(*signal, reading, options) for signal in signals], strict=True
    )
    remarks = Remarks()
    for remarks_of_drive in remarks_of:
        remarks.add(remarks_of_drive)
    for name, volts, step in zip(names, values, steps, strict=True):
        if volts.size != values[0].size or abs(step / steps[0] - 1.0) > SAME_RATE:
            raise InputError(
                f"{name}: has other rows or another rate than {names[0]}: play them apart"
            )
    drive = np.stack(values)
    played = waveforms.at_points(
        drive, 1.0 / steps[0], options.points, options.rate, options.loop
    )
    most = TOLERANCE * float(np.ptp(drive))
    if options.tolerance is not None:
        most = in_unit("tolerance", options.tolerance, "V")
    if played.moved > most:
        raise LimitError(
            f"{names[0]}: {played.volts.shape[1]:,} points move the drive by up to {played.moved:.3g} V, "
            f"more than {most:.3g} V (more `points`, a higher `rate`, or `tolerance` VOLT)"
        )
    data, back, lines = _encoded(played, names, options)
    with all_or_none():
        write_whole(output, data, protect=drives)
        if summary is not None:
            summaries = []
            for read, volts, known, line in zip(
                records, back, remarks_of, lines, strict=True
            ):
                remarks_of_drive = Remarks([*known.notes, line], known.warnings)
                summaries.append(
                    summary_of_values(
                        volts, destination.command, read, remarks_of_drive
                    )
                )
            write_summary(summary, summaries)
    remarks.note(lines)
    return remarks


def _names_of(signals: Sequence[tuple[Address, str | None]], files: int) -> list[str]:
    """Return what messages call each channel: its file, with its column where that has several."""
    if files == len(signals):
        return [drive.name for drive, _ in signals]
    return [f"{drive.name}, {column}" for drive, column in signals]


def _signals(
    drives: Sequence[Address], columns: Sequence[str]
) -> list[tuple[Address, str | None]]:
    """Return which column of which file each channel is: a column a file, or several of one file."""
    if len(columns) < 2:
        return [(drive, *(columns or (None,))) for drive in drives]
    if len(drives) == 1:
        return [(drives[0], column) for column in columns]
    if len(drives) != len(columns):
        raise UsageError(
            f"`voltage`: {len(columns)} columns of {len(drives)} files (one for each, or one for all)"
        )
    return list(zip(drives, columns, strict=True))


def _read(
    address: Address,
    column: str | None,
    reading: ReadingOptions,
    options: WaveformOptions,
) -> tuple[Floats, float, Remarks, dict[str, Any]]:
    """Return a drive in volts, read whole and within its limits, its even step (s), remarks, its record."""
    name = address.name
    with open_log(
        address, {"voltage": column_wish("voltage", column, option="voltage")}, reading
    ) as log:
        log.require_time(PLAYS)
        log.convert("voltage", "V", "a generator's file")
        block = joined(list(log.blocks()))
        remarks, read = remarks_of(log), read_record(name, log.reading_record())
        assert block.time is not None
        rows = block.rows
        drive, stated = block.values["voltage"], log.stated_rate
    if drive.size < 2:
        raise InputError(f"{name}: a drive of one row is nothing to play")
    checked = check_drive(
        drive,
        block.time,
        options.limits,
        loop=options.loop,
        place=lambda row: f"row {rows[row]:,}",
        suffix=" V",
    )
    if checked.problems:
        problem = checked.problems[0]
        for words, remedy in _REMEDIES.items():
            if words in problem:
                raise LimitError(f"{name}: {problem}{remedy}")
        raise LimitError(f"{name}: {problem}")
    return (
        drive,
        1.0 / stated if stated else require_even(name, block.time, PLAYS),
        remarks,
        read,
    )


def _encoded(
    played: Points, names: Sequence[str], options: WaveformOptions
) -> tuple[bytes, Floats, list[str]]:
    """Return the bytes, the volts that passed the gate when read back, and a line on each drive."""
    form, rate = format_named(options.to), played.rate
    with np.errstate(over="ignore"):
        volts = played.volts / options.gain
    if not np.isfinite(volts).all():
        raise UsageError(
            f"`gain` {options.gain:g}: the drive over it is beyond the range of the arithmetic"
        )
    count = volts.shape[1]
    if not form.points[0] <= count <= form.points[1]:
        raise UsageError(
            f"a {options.to} file takes {form.points[0]:g} to {form.points[1]:,g} points, not {count:,} "
            f"(`points` {min(max(count, form.points[0]), form.points[1]):g})"
        )
    if options.to == "wav":
        rate = waveforms.whole_rate(rate)
    ends = options.volts or (float(volts.min()), float(volts.max()))
    if volts.min() < ends[0] or volts.max() > ends[1]:
        raise LimitError(
            f"{names[0]}: the drive takes {volts.min():.6g} to {volts.max():.6g} V of the generator, and "
            f"`volts` gives {ends[0]:.6g} to {ends[1]:.6g} (wider `volts`, or the amplifier's `gain`, "
            f"which is {options.gain:g})"
        )
    limits = _limits_at_generator(options)
    within = limits.v_min, limits.v_max
    content, back, coarse = _rounded(volts, ends, within, options)
    for name, exact, rounded in zip(names, volts, back, strict=True):
        _refuse_coarse(name, exact, rounded, options)
    data = waveforms.written(options.to, waveforms.Signals(content, rate, ends))
    if limits.max_slew is not None:
        slew = limits.max_slew + coarse * rate  # codes stand a step beside the drive
        limits = replace(limits, max_slew=slew)
    for rows in back:
        closed = np.append(rows, rows[0]) if options.loop else rows
        DriveGate(limits).admit(closed, 1.0 / rate)
    rounding = float(np.abs(back - volts).max())
    mean = _meaning_of_codes(options, ends)
    lines = []
    for name, rows in zip(names, back, strict=True):
        lines.append(_line(name, rows, played, rounding, options) + mean)
    return data, back, lines


def _limits_at_generator(options: WaveformOptions) -> DriveLimits:
    """Return the limits of the drive in volts of the generator, in front of the amplifier's gain."""
    limits, gain = options.limits, options.gain
    slew = None
    if limits.max_slew is not None:
        slew = limits.max_slew / abs(gain)
    low, high = limits.v_min / gain, limits.v_max / gain
    if gain < 0.0:
        low, high = high, low
    return DriveLimits(low, high, slew)


def _meaning_of_codes(options: WaveformOptions, ends: tuple[float, float]) -> str:
    """Say which codes, or which ends of the form's own scale, mean which volts."""
    form = format_named(options.to)
    codes = options.codes or form.codes
    if codes is None and form.normal:
        codes = (-1, 1)
    if codes is None:
        return ""
    return f"; {codes[0]:g} to {codes[1]:g} mean {ends[0]:.6g} to {ends[1]:.6g} V"


def _rounded(
    volts: Floats,
    ends: tuple[float, float],
    within: tuple[float, float],
    options: WaveformOptions,
) -> tuple[Values, Floats, float]:
    """Return what is written for volts, the volts that it means, and how coarse it is (V)."""
    form = format_named(options.to)
    if form.codes is None and not form.normal:
        return volts, volts, 0.0
    if ends[0] == ends[1]:
        raise UsageError(
            "`volts` LOW:HIGH: the drive is constant, so say what the codes mean"
        )
    if form.codes is None:
        half = 0.5 * (ends[1] - ends[0])
        part = np.clip((volts - ends[0]) / half - 1.0, -1.0, 1.0)
        return part, np.clip(ends[0] + (part + 1.0) * half, *ends), 0.0
    codes = options.codes or form.codes
    coding = waveforms.Coding((int(codes[0]), int(codes[1])), ends)
    content = coding.encode(volts, within)
    return content, coding.decode(content), coding.step


def _refuse_coarse(
    name: str, volts: Floats, rounded: Floats, options: WaveformOptions
) -> None:
    """Refuse codes that leave too little of a move (LimitError); a constant drive has none."""
    move, rounding = float(np.ptp(volts)), float(np.abs(rounded - volts).max())
    if rounding <= 0.01 * options.max_rounding * move or move == 0.0:
        return
    raise LimitError(
        f"{name}: rounding moves it by up to {rounding:.3g} V, {100.0 * rounding / move:.3g} % of its "
        f"{move:.3g} V and more than {options.max_rounding:g} % (narrower `volts`, a wider span of `codes`, "
        "or `max_rounding` PERCENT)"
    )


def _line(
    name: str, volts: Floats, played: Points, rounding: float, options: WaveformOptions
) -> str:
    """Say what has to be set at the generator, and what rounding did."""
    low, high = float(volts.min()), float(volts.max())
    seconds = volts.size / played.rate
    line = f"{name}: {volts.size:,} points at {played.rate:.9g} a second, {seconds:.6g} s, "
    if options.loop:
        line += f"repeated at {1.0 / seconds:.9g} Hz"
    else:
        line += "played once"
    if played.held:
        line += f"; the last {played.held:,} hold the last value"
    line += f"; amplitude {high - low:.6g} Vpp, offset {0.5 * (high + low):.6g} V"
    if options.gain != 1.0:
        line += f" before a gain of {options.gain:g}"
    line += f"; rounding moves it by at most {rounding:.3g} V"
    if played.moved:
        line += f", another rate {played.moved:.3g} V of the drive"
    return line
