"""A drive as the file that a generator, a wave table or a converter takes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbo_cli.drive.check import check_drive
from dbo_cli.drive.gate import Gate
from dbo_cli.drive.limits import Limits
from dbo_cli.errors import LimitError, OutputError, UsageError
from dbo_cli.moves.generators import FORMATS, Coding, Format, Signal, Span, whole_rate

Floats = NDArray[np.float64]

MOST_POINTS = 10**9  # 8 GB, more than any generator takes
WORDS = ((-32768, 32767), (0, 65535))
"""What 16 bits hold, with and without a sign."""


class Waveform(NamedTuple):
    """A generator's file.

    Attributes
    ----------
    data : bytes
        Its content.
    volts : array of shape (points,)
        What it says at the generator's output, read back.
    rate : float
        Points a second.
    line : str
        What has to be set at the generator.
    """

    data: bytes
    volts: Floats
    rate: float
    line: str


class _Played(NamedTuple):
    """A drive at the generator's points: volts, points a second, by how much they move it."""

    volts: Floats
    rate: float
    moved: float


def waveform(
    voltage: Floats,
    drive_rate: float,
    to: str,
    limits: Limits,
    *,
    name: str = "drive",
    gain: float = 1.0,
    points: int | None = None,
    rate: float | None = None,
    codes: Span | None = None,
    volts: Span | None = None,
    max_rounding: float = 1.0,
    doubts: Sequence[str] = (),
) -> Waveform:
    """Return a drive as a generator's file; what is written is read back and passes the gate.

    Parameters
    ----------
    voltage : array of shape (rows,)
        The drive (V).
    drive_rate : float
        Its rows a second.
    to : str
        A key of ``FORMATS``.
    limits : Limits
        Of the drive; its rating counts.
    name : str
        What messages call it.
    gain : float
        Of the amplifier: the file's volts are the drive's over this.
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
        What was written, read back, breaks a limit: this program's fault.
    """
    form = _format_of(to, codes, volts)
    _check_numbers(gain, points, rate, max_rounding)
    time = np.arange(voltage.size) / drive_rate
    check_drive(voltage, time, limits, name=name, doubts=doubts).require_passed()
    if voltage.size < 2:
        raise UsageError(f"{name}: a drive of one row is nothing to play")
    played = _at_points(voltage, drive_rate, points, rate)
    most = 0.01 * max_rounding * float(np.ptp(voltage))
    if played.moved > most:
        raise LimitError(
            f"{name}: {played.volts.size:,} points move the drive by up to {played.moved:.3g} V, more than"
            f" {most:.3g} V (more `points`, a higher `rate`, or `max_rounding` PERCENT)"
        )
    if to == "wav":
        played = played._replace(rate=float(whole_rate(played.rate)))
    return _written(
        form, played, _at_generator(limits, gain), name, gain, codes, volts, most
    )


def _format_of(to: str, codes: Span | None, volts: Span | None) -> Format:
    """Return the format of a name; refuse codes and volts that it does not have."""
    if to not in FORMATS:
        raise UsageError(f"`to` {to}: there are {', '.join(FORMATS)}")
    form = FORMATS[to]
    if form.codes is None and (codes or volts):
        raise UsageError(
            f"`{'codes' if codes else 'volts'}`: {to} files hold volts, no codes"
        )
    if form.volts_needed and volts is None:
        raise UsageError(
            f"`volts` LOW:HIGH: say what the lowest and the highest code of {to} mean"
        )
    if volts is not None and not (
        volts[0] < volts[1] < math.inf and volts[0] > -math.inf
    ):
        raise UsageError(f"`volts` {volts[0]:g}:{volts[1]:g}: give the lower end first")
    if codes is not None and form.codes is not None:
        least, most = WORDS[0] if form.codes[0] < 0 else WORDS[1]
        whole = all(code == round(code) for code in codes)
        if not (whole and least <= codes[0] < codes[1] <= most):
            raise UsageError(
                f"`codes` {codes[0]:g}:{codes[1]:g}: give whole numbers from {least} to {most}, the lower"
                " one first"
            )
    return form


def _check_numbers(
    gain: float, points: int | None, rate: float | None, max_rounding: float
) -> None:
    """Refuse numbers that cannot be meant."""
    if not math.isfinite(gain) or gain == 0.0:
        raise UsageError(f"`gain` {gain:g}: give a number other than 0")
    if points is not None and rate is not None:
        raise UsageError("`points` and `rate` each say how many points: give one")
    if points is not None and not 2 <= points <= MOST_POINTS:
        raise UsageError(f"`points` {points}: give 2 to {MOST_POINTS:,}")
    if rate is not None and not 0.0 < rate < math.inf:
        raise UsageError(f"`rate` {rate:g}: give a number above 0")
    if not 0.0 <= max_rounding < math.inf:
        raise UsageError(f"`max_rounding` {max_rounding:g}: must not be below 0")


def _at_points(
    drive: Floats, drive_rate: float, points: int | None, rate: float | None
) -> _Played:
    """Return a drive at so many points, or at another rate, over the same time; linear between rows."""
    seconds = (drive.size - 1) / drive_rate
    if rate is not None:
        points = math.ceil(seconds * rate * (1.0 - 1e-9)) + 1
        if points > MOST_POINTS:
            raise UsageError(
                f"`rate` {rate:g}: a drive of {seconds:.6g} s becomes more than {MOST_POINTS:,} points"
            )
    elif points is not None:
        rate = (points - 1) / seconds
    else:
        points, rate = drive.size, drive_rate
    if points == drive.size and abs(rate / drive_rate - 1.0) < 1e-6 / points:
        return _Played(drive, rate, 0.0)
    time, new = np.arange(drive.size) / drive_rate, np.arange(points) / rate
    played = np.interp(new, time, drive)
    back = np.interp(time, new, played)
    return _Played(played, rate, float(np.abs(back - drive).max()))


def _at_generator(limits: Limits, gain: float) -> Limits:
    """Return the limits in front of an amplifier."""
    low, high = sorted(end / gain for end in limits.rating)
    slew = limits.slew
    if slew is not None:
        slew /= abs(gain)
    return Limits((low, high), (low, high), (low, high), slew, "V")


def _written(
    form: Format,
    played: _Played,
    limits: Limits,
    name: str,
    gain: float,
    codes: Span | None,
    volts: Span | None,
    most: float,
) -> Waveform:
    """Return the file of a drive; ``most`` is by how much rounding may move the drive (V)."""
    exact = played.volts / gain
    if not np.isfinite(exact).all():
        raise UsageError(
            f"`gain` {gain:g}: the drive over it is beyond what numbers hold"
        )
    ends = volts or (float(exact.min()), float(exact.max()))
    if exact.min() < ends[0] or exact.max() > ends[1]:
        raise LimitError(
            f"{name}: the drive takes {exact.min():.6g} to {exact.max():.6g} V of the generator, and"
            f" `volts` gives {ends[0]:.6g} to {ends[1]:.6g} (wider `volts`, or another `gain` than {gain:g})"
        )
    coding = None
    content: NDArray[np.float64 | np.int64] = exact
    if form.codes is not None:
        coding = _coding(codes or form.codes, ends)
        content = coding.encode(exact, limits.rating)
    data = form.write(Signal(content, played.rate, ends))
    back = form.read(data)
    if not np.array_equal(back, content):
        raise OutputError(
            "the file does not read back as it was written (please report it)"
        )
    heard = np.asarray(back, dtype=np.float64)
    if coding is not None:
        heard = coding.decode(back)
    _require_fine(name, heard, exact, abs(gain), most)
    if coding is not None and limits.slew is not None:  # codes stand a step beside
        limits = replace(limits, slew=limits.slew + coding.step * played.rate)
    Gate(limits).admit(heard, 1.0 / played.rate, "return")
    return Waveform(data, heard, played.rate, _line(heard, exact, played, gain, coding))


def _coding(codes: Span, ends: Span) -> Coding:
    """Return what codes mean; UsageError where a constant drive does not tell."""
    if not ends[0] < ends[1]:
        raise UsageError(
            "`volts` LOW:HIGH: the drive is constant, so say what the codes mean"
        )
    return Coding((int(codes[0]), int(codes[1])), ends)


def _require_fine(
    name: str, heard: Floats, exact: Floats, gain: float, most: float
) -> None:
    """Refuse codes that leave too little of a move (LimitError); a constant drive has none."""
    rounding = gain * float(np.abs(heard - exact).max())
    if rounding <= most or np.ptp(exact) == 0.0:
        return
    move = gain * float(np.ptp(exact))
    raise LimitError(
        f"{name}: rounding moves the drive by up to {rounding:.3g} V, {100.0 * rounding / move:.3g} % of its"
        f" {move:.3g} V and more than {most:.3g} V (narrower `volts`, a wider span of `codes`, or"
        " `max_rounding` PERCENT)"
    )


def _line(
    heard: Floats, exact: Floats, played: _Played, gain: float, coding: Coding | None
) -> str:
    """Say what has to be set at the generator, and what rounding did."""
    low, high = float(heard.min()), float(heard.max())
    text = (
        f"{heard.size:,} points at {played.rate:.9g} a second, {heard.size / played.rate:.6g} s; amplitude"
        f" {high - low:.6g} Vpp, offset {0.5 * (high + low):.6g} V"
    )
    if gain != 1.0:
        text += f" before a gain of {gain:g}"
    if coding is not None:
        rounding = abs(gain) * float(np.abs(heard - exact).max())
        text += (
            f"; codes {coding.codes[0]} to {coding.codes[1]} mean {coding.volts[0]:.6g} to"
            f" {coding.volts[1]:.6g} V; rounding moves the drive by {rounding:.3g} V"
        )
    if played.moved:
        text += f"; another rate by {played.moved:.3g} V"
    return text
