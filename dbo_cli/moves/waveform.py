"""A drive as the file that a generator, a wave table or a converter takes.

``npy`` and ``pi-gcs`` hold volts, the others codes, whose ends stand for two voltages.
"""

import io
import math
import wave
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbo_cli.arrays import Floats, Range
from dbo_cli.drive.check import check_drive
from dbo_cli.drive.limits import Limits
from dbo_cli.drive.smooth import MOST_SIGNAL_ROWS
from dbo_cli.errors import LimitError, UsageError, prefixed, require_positive

Codes = NDArray[np.int64]
Values = NDArray[np.float64 | np.int64]
"""Volts or codes; channels stand side by side, shape (points, channels)."""

BUNCH = 10  # points a command, as in PI's own example: every controller takes so many
WHOLE_RATE = 1e-6  # of a rate: closer to a whole number, it is that


class Generator(NamedTuple):
    """A kind of file.

    Attributes
    ----------
    write : callable
        From values, points a second, and the volts of the lowest and highest code to
        bytes.
    codes : (int, int), optional
        The lowest and the highest code; None where volts are written.
    volts_needed : bool
        Codes of a converter, whose volts nobody can guess.
    holds_channels : bool
        Whether one file holds several channels.
    """

    write: Callable[[Values, float, Range], bytes]
    codes: tuple[int, int] | None = None
    volts_needed: bool = False
    holds_channels: bool = False


def _encoded(
    volts: Floats, codes: tuple[int, int], ends: Range, within: Range
) -> tuple[Codes, Floats]:
    """Return whole numbers for voltages, and the voltages that they mean: ``codes`` mean ``ends``.

    They are the nearest codes; next to a limit the nearest one inside it.
    """
    (first, last), (low, high) = codes, ends

    def meant(values: Codes) -> Floats:
        share = (values - first) / (last - first)
        return np.clip(low + share * (high - low), low, high)

    step = (high - low) / (last - first)
    places = np.rint((volts - low) / step).astype(np.int64)
    values: Codes = np.clip(places + first, first, last)
    values = values - (meant(values) > within[1])
    values = values + (meant(values) < within[0])
    return values, meant(values)


def _positional(value: float) -> str:
    """Write a number with the fewest digits that read back exactly, without an exponent."""
    return str(np.format_float_positional(value, trim="-"))


def _npy(values: Values, rate: float, volts: Range) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, values)
    return buffer.getvalue()


def _wav(values: Values, rate: float, volts: Range) -> bytes:
    whole = round(rate)
    if whole < 1 or abs(rate - whole) > WHOLE_RATE * whole:
        raise UsageError(
            f"a WAV file needs a whole rate, not {rate:.9g}: type `rate` {max(whole, 1)}"
        )
    buffer = io.BytesIO()
    with wave.open(buffer, "wb") as file:
        file.setnchannels(1 if values.ndim == 1 else values.shape[1])
        file.setsampwidth(2)
        file.setframerate(whole)
        file.writeframes(values.astype("<i2").tobytes())
    return buffer.getvalue()


def _integers(kind: str, values: Values, rate: float, volts: Range) -> bytes:
    return values.astype(kind).tobytes()


def _pi_gcs(values: Values, rate: float, volts: Range) -> bytes:
    """Return one command for every ten points: WAV 1 X|& PNT first count values."""
    lines = []
    for first in range(0, values.size, BUNCH):
        bunch = values[first : first + BUNCH].tolist()
        append = "&" if first else "X"
        points = " ".join(map(_positional, bunch))
        lines.append(f"WAV 1 {append} PNT {first + 1} {len(bunch)} {points}\n")
    return "".join(lines).encode()


def _keysight(values: Values, rate: float, volts: Range) -> bytes:
    low, high = volts
    lines = [
        "File Format:1.10", "Channel Count:1", "Column Char:TAB", f"Sample Rate:{_positional(rate)}",
        f"High Level:{_positional(high)}", f"Low Level:{_positional(low)}", 'Data Type:"Short"',
        'Filter:"OFF"', f"Data Points:{values.size}", "Data:",
    ]  # fmt: skip
    lines += map(str, values.tolist())
    return "".join(f"{line}\r\n" for line in lines).encode()


GENERATORS = {
    "npy": Generator(_npy, holds_channels=True),
    "wav": Generator(_wav, (-32767, 32767), holds_channels=True),
    "int16": Generator(partial(_integers, "<i2"), (-32768, 32767), True),
    "uint16": Generator(partial(_integers, "<u2"), (0, 65535), True),
    "keysight-arb": Generator(_keysight, (-32767, 32767)),
    "pi-gcs": Generator(_pi_gcs),
}
"""By the name that ``to`` takes; the codes are all of a word, or those of the maker's description."""


# --- a drive as such a file ---


class Waveform(NamedTuple):
    """A generator's file.

    Attributes
    ----------
    data : bytes
        Its content.
    volts : array of shape (points,)
        What it says at the generator's output.
    rate : float
        Points a second.
    line, codes : str
        What has to be set at the generator, and what its codes mean.
    values : array of shape (points,)
        The volts or codes in ``data``.
    """

    data: bytes
    volts: Floats
    rate: float
    line: str
    codes: str = ""
    values: Values = np.zeros(0)


def waveform(
    voltage: Floats,
    drive_rate: float,
    to: str,
    limits: Limits,
    *,
    name: str = "drive",
    gain: float = 1.0,
    loop: bool = False,
    points: int | None = None,
    rate: float | None = None,
    codes: Range | None = None,
    volts: Range | None = None,
    max_rounding: float = 1.0,
    doubts: Sequence[str] = (),
) -> Waveform:
    """Return a drive as a generator's file; what it says passes the gate.

    Parameters
    ----------
    voltage : array of shape (rows,)
        The drive (V).
    drive_rate : float
        Its rows a second.
    to : str
        A key of ``GENERATORS``.
    limits : Limits
        Of the drive; its rating counts.
    name : str
        What messages call it.
    gain : float
        Of the amplifier: the file's volts are the drive's over this.
    loop : bool
        The drive is one period of a loop, which other points or another rate keep.
    points, rate : int, float
        Points, or points a second, of the generator, over the same time; the drive's
        own where neither is given.
    codes : (int, int), optional
        The lowest and the highest code; the format's where not given.
    volts : (float, float), optional
        What they mean at the generator's output; the drive's ends where not given.
    max_rounding : float
        By how much rounding, or another rate, may move the drive, in percent of its
        range.
    doubts : sequence of str
        What a reader dropped, guessed or cut: each is a problem.

    Raises
    ------
    UsageError
        An option is senseless, or says nothing of this format.
    LimitError
        The drive breaks its limits or does not fit the volts, or is moved too far.
    GateError
        What is written breaks a limit: this program's fault.
    """
    form = GENERATORS.get(to)
    if form is None:
        raise UsageError(f"`to` {to}: give one of {', '.join(GENERATORS)}")
    if form.codes is None and (codes or volts):
        raise UsageError(f"{to} files hold volts: leave `codes` and `volts` out")
    require_positive(rate=rate, points=points, gain=abs(gain))
    if points is not None and (rate is not None or points < 2):
        raise UsageError(f"`points` {points}: give 2 or more, and no `rate` beside it")
    time = np.arange(voltage.size) / drive_rate
    checked = check_drive(voltage, time, limits, name=name, loop=loop, doubts=doubts)
    checked.require_passed()
    if voltage.size < 2:
        raise UsageError(f"{name}: one row is not a drive")
    resampled, rate, change = _at_points(voltage, drive_rate, points, rate, loop)
    exact = resampled / gain
    low, high = sorted(end / gain for end in limits.rating)
    slew = None if limits.slew is None else limits.slew / abs(gain)
    values: Values = exact
    heard, meaning, ends, rounding = exact, "", (low, high), 0.0
    if form.codes is not None:
        with prefixed(name):
            (lowest, highest), ends = _codes_of(form, to, codes, volts, exact)
        values, heard = _encoded(exact, (lowest, highest), ends, (low, high))
        rounding = abs(gain) * float(np.abs(heard - exact).max())
        meaning = (
            f"codes {lowest} to {highest} mean {ends[0]:.6g} to {ends[1]:.6g} V; "
            f"rounding changes the drive by {rounding:.3g} V"
        )
        if slew is not None:  # codes stand a step beside
            slew += (ends[1] - ends[0]) / (highest - lowest) * rate
    allowance = 0.01 * max_rounding * float(np.ptp(voltage))
    largest = max(change, rounding)
    if not largest <= allowance and np.ptp(voltage) > 0.0:
        raise LimitError(
            f"{name}: points or codes change the drive by up to {largest:.3g} V, more than {allowance:.3g} V:"
            " raise `points`, `rate` or `max_rounding`, or narrow `volts`"
        )
    allowed = replace(limits, rating=(low, high), slew=slew, extrapolate=True)
    allowed.admit(heard, None, 1.0 / rate, "return")
    line = _line(heard, rate, gain, change)
    return Waveform(form.write(values, rate, ends), heard, rate, line, meaning, values)


def _codes_of(
    form: Generator, to: str, codes: Range | None, volts: Range | None, exact: Floats
) -> tuple[tuple[int, int], Range]:
    """Return the lowest and highest code, and their volts, which the drive must not leave."""
    assert form.codes is not None
    first, last = codes or form.codes
    lowest, highest = form.codes
    is_whole = first == round(first) and last == round(last)
    if not (is_whole and lowest <= first < last <= highest):
        raise UsageError(
            f"`codes` {first:g}:{last:g}: give whole numbers from {lowest} to {highest}, the "
            "lower first"
        )
    if form.volts_needed and volts is None:
        raise UsageError(
            f"{to} needs `volts` LOW:HIGH, the voltages of the lowest and highest code"
        )
    least, greatest = float(exact.min()), float(exact.max())
    low, high = volts or (least, greatest)
    if not -math.inf < low < high < math.inf:
        raise UsageError(f"`volts` {low:g}:{high:g}: give LOW:HIGH")
    if least < low or greatest > high:
        raise LimitError(
            f"the drive needs {least:.6g} to {greatest:.6g} V of the generator, `volts` is "
            f"{low:.6g}:{high:.6g}: widen it, or check `gain`"
        )
    return (int(first), int(last)), (low, high)


def side_by_side(channels: Sequence[Waveform], to: str) -> bytes | None:
    """Return the file of several channels; None where the format ``to`` holds one."""
    if not GENERATORS[to].holds_channels:
        return None
    values = np.column_stack([channel.values for channel in channels])
    return GENERATORS[to].write(values, channels[0].rate, (0.0, 0.0))


def _at_points(
    drive: Floats, drive_rate: float, points: int | None, rate: float | None, loop: bool
) -> tuple[Floats, float, float]:
    """Return a drive at so many points, or at another rate, over the same time; linear between rows.

    A loop's time is its period: the step from its last row to its first counts, and
    the points share it evenly. Returns the points, how many a second, and by how much
    they move the drive.
    """
    if rate is None and points is None:
        return drive, drive_rate, 0.0
    steps = drive.size if loop else drive.size - 1
    more = 0 if loop else 1  # a loop's last point is one step before its first
    seconds = steps / drive_rate
    if points is None:
        assert rate is not None
        points = math.ceil(seconds * rate * (1.0 - 1e-9)) + more
    if points > MOST_SIGNAL_ROWS:
        raise UsageError(
            f"{points:,} points, at most {MOST_SIGNAL_ROWS:,}: lower `points` or `rate`"
        )
    if loop or rate is None:
        rate = (points - more) / seconds
    time, new = np.arange(drive.size) / drive_rate, np.arange(points) / rate
    period = seconds if loop else None
    resampled = np.interp(new, time, drive, period=period)
    back = np.interp(time, new, resampled, period=period)
    return resampled, rate, float(np.abs(back - drive).max())


def _line(volts: Floats, rate: float, gain: float, shift: float) -> str:
    """Return what to set at the generator, and what resampling changed, in words."""
    low, high = float(volts.min()), float(volts.max())
    text = (
        f"{volts.size:,} points at {rate:.5g} Hz, {volts.size / rate:.6g} s; {high - low:.6g} Vpp,"
        f" offset {0.5 * (high + low):.6g} V at gain {gain:g}"
    )
    return f"{text}; resampled within {shift:.3g} V" if shift else text
