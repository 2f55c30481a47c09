"""The files that generators, wave tables and converters take: volts to bytes, and back.

One function a format writes its bytes, and one reads them back; docs/instruments-out.md
names the description that each was written from. Where a format has codes, their ends
stand for two voltages: by default the least and the greatest of the drive, so that no
code is wasted and every way of reading a file's levels gives the same volts. Before
that, a drive may be brought to another number of points or another rate.
"""

from __future__ import annotations

import io
import math
import wave
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbo_cli import extensions
from dbo_cli.errors import OutputError, UsageError
from dbo_cli.logs.request import import_extra

Floats = NDArray[np.float64]
Codes = NDArray[np.int64]
Values = NDArray[np.float64 | np.int64]
Span = tuple[float, float]
BUNCH = 10  # points a command, as in PI's own example: every controller takes so many
WHOLE_RATE = 1e-6  # of a rate: closer to a whole number, it is that
# of a drive at another rate: 8 GB a signal, more than any generator takes
MOST_POINTS = 10**9
# of a point: stamps of a file are rounded to some microseconds of their step
WHOLE = 1e-6


class Coding(NamedTuple):
    """Whole numbers for voltages: the ends of ``codes`` stand for the ends of ``volts``."""

    codes: tuple[int, int]
    volts: Span

    @property
    def step(self) -> float:
        """Volts a code."""
        return (self.volts[1] - self.volts[0]) / (self.codes[1] - self.codes[0])

    def encode(self, volts: Floats, within: Span) -> Codes:
        """Return the nearest codes; next to a limit the nearest one inside it."""
        codes: Codes = (
            np.rint((volts - self.volts[0]) / self.step).astype(np.int64)
            + self.codes[0]
        )
        codes = np.clip(codes, *self.codes)
        codes = codes - (self.decode(codes) > within[1])
        return codes + (self.decode(codes) < within[0])

    def decode(self, codes: Codes) -> Floats:
        """Return the voltages of codes."""
        part = (codes - self.codes[0]) / (self.codes[1] - self.codes[0])
        return np.clip(
            self.volts[0] + part * (self.volts[1] - self.volts[0]), *self.volts
        )


class Signals(NamedTuple):
    """What is written: volts or codes of shape (channels, points), points a second, and the ends' volts."""

    values: Values
    rate: float
    volts: Span


@dataclass(frozen=True)
class GeneratorFormat:
    """A kind of file.

    Attributes
    ----------
    endings : tuple of str
        What its files are called.
    write, read : callable
        From signals to bytes; from bytes to volts or codes of shape (channels, points).
    codes : (int, int), optional
        The lowest and the highest code; None where volts are written.
    normal : bool
        What is written lies between -1 and 1, without rounding.
    points : (int, int)
        The fewest and the most points.
    channels : bool
        Whether a file holds several signals.
    volts_needed : bool
        Codes of a converter, whose volts nobody can guess.
    """

    endings: tuple[str, ...]
    write: Callable[[Signals], bytes]
    read: Callable[[bytes], Values]
    codes: tuple[int, int] | None = None
    normal: bool = False
    points: tuple[int, float] = (2, math.inf)
    channels: bool = False
    volts_needed: bool = False


def positional(value: float) -> str:
    """Write a number with the fewest digits that read back exactly, without an exponent."""
    return str(np.format_float_positional(value, trim="-"))


# --- arrays and recordings that libraries read ---


def _npy(signals: Signals) -> bytes:
    buffer = io.BytesIO()
    np.save(
        buffer,
        np.squeeze(signals.values, 0) if len(signals.values) == 1 else signals.values,
    )
    return buffer.getvalue()


def _read_npy(data: bytes) -> Floats:
    return np.atleast_2d(np.load(io.BytesIO(data)))


def whole_rate(rate: float) -> int:
    """Return a rate as the whole number that a WAV file has room for (UsageError)."""
    if abs(rate - round(rate)) > WHOLE_RATE * rate or rate < 0.5:
        raise UsageError(
            f"a WAV file has whole points a second, not {rate:.9g} (`rate` {math.ceil(rate)})"
        )
    return round(rate)


def _wav(signals: Signals) -> bytes:
    buffer = io.BytesIO()
    with wave.open(buffer, "wb") as file:
        file.setnchannels(len(signals.values))
        file.setsampwidth(2)
        file.setframerate(whole_rate(signals.rate))
        file.writeframes(signals.values.T.astype("<i2").tobytes())
    return buffer.getvalue()


def _read_wav(data: bytes) -> Codes:
    with wave.open(io.BytesIO(data)) as file:
        frames = np.frombuffer(file.readframes(file.getnframes()), "<i2")
        return frames.reshape(-1, file.getnchannels()).T.astype(np.int64)


def _tdms(signals: Signals) -> bytes:
    nptdms = import_extra("nptdms", "a TDMS file")
    buffer = io.BytesIO()
    properties = {
        "wf_start_offset": 0.0, "wf_increment": 1.0 / signals.rate, "wf_samples": signals.values.shape[1],
        "unit_string": "V",
    }  # fmt: skip
    count = len(signals.values)
    names = [f"voltage_{k}" for k in range(1, count + 1)] if count > 1 else ["voltage"]
    with nptdms.TdmsWriter(buffer) as writer:
        channels = zip(names, signals.values, strict=True)
        writer.write_segment(
            nptdms.ChannelObject("drive", *channel, properties) for channel in channels
        )
    return buffer.getvalue()


def _read_tdms(data: bytes) -> Floats:
    nptdms = import_extra("nptdms", "a TDMS file")
    return np.stack(
        [
            channel[:]
            for channel in nptdms.TdmsFile.read(io.BytesIO(data))["drive"].channels()
        ]
    )


def _binary(form: str) -> Callable[[Signals], bytes]:
    """Return what writes codes as plain numbers, point by point."""
    return lambda signals: signals.values.T.astype(form).tobytes()


def _read_binary(form: str, skipped: int = 0) -> Callable[[bytes], Codes]:
    return lambda data: np.frombuffer(data[skipped:], form).astype(np.int64)[None, :]


# --- wave tables ---


def _pi_gcs(signals: Signals) -> bytes:
    """Return one command for every ten points: WAV table X|& PNT first count values."""
    lines = []
    for table, values in enumerate(signals.values, 1):
        for first in range(0, values.size, BUNCH):
            bunch = values[first : first + BUNCH].tolist()
            append = "&" if first else "X"
            points = " ".join(map(positional, bunch))
            lines.append(
                f"WAV {table} {append} PNT {first + 1} {len(bunch)} {points}\n"
            )
    return "".join(lines).encode()


def _read_pi_gcs(data: bytes) -> Floats:
    tables: dict[str, list[float]] = {}
    for line in data.decode().splitlines():
        _, table, _, _, _, _, *values = line.split()
        tables.setdefault(table, []).extend(map(float, values))
    return np.array(list(tables.values()))


# --- arbitrary waveforms ---


def _keysight(signals: Signals) -> bytes:
    low, high = signals.volts
    head = [
        "File Format:1.10", "Channel Count:1", "Column Char:TAB", f"Sample Rate:{positional(signals.rate)}",
        f"High Level:{positional(high)}", f"Low Level:{positional(low)}", 'Data Type:"Short"', 'Filter:"OFF"',
        f"Data Points:{signals.values.size}", "Data:",
    ]  # fmt: skip
    return "".join(
        f"{line}\r\n" for line in [*head, *map(str, signals.values[0].tolist())]
    ).encode()


def _read_keysight(data: bytes) -> Codes:
    head, _, body = data.decode().partition("Data:\r\n")
    assert "File Format:1.10" in head
    return np.array(body.split(), dtype=np.int64)[None, :]


TFW_HEADER = 512  # bytes


def _tektronix(signals: Signals) -> bytes:
    """Return identifier, version, number of points, no preview, and the codes."""
    numbers = np.array([20050114, signals.values.size, 0], ">u4").tobytes()
    head = (b"TEKAFG3000".ljust(16, b"\0") + numbers).ljust(TFW_HEADER, b"\0")
    return head + _binary(">u2")(signals)


def _picoscope(signals: Signals) -> bytes:
    return "".join(
        f"{positional(value)}\n" for value in signals.values[0].tolist()
    ).encode()


def _read_picoscope(data: bytes) -> Floats:
    return np.array(data.split(), dtype=np.float64)[None, :]


# The last two are the lowest and the highest code: all of a 16-bit word with a sign ...
_INT16 = GeneratorFormat(
    (".bin", ".raw", ".i16"), _binary("<i2"), _read_binary("<i2"), (-32768, 32767)
)
# ... all without one ...
_UINT16 = GeneratorFormat(
    (".bin", ".raw", ".u16"), _binary("<u2"), _read_binary("<u2"), (0, 65535)
)
# ... and those of the source that docs/instruments-out.md names.
_TFW = GeneratorFormat(
    (".tfw",), _tektronix, _read_binary(">u2", TFW_HEADER), (0, 16382)
)
FORMATS = {
    "npy": GeneratorFormat(
        (".npy",), _npy, _read_npy, channels=True
    ),  # and what takes arrays: volts
    "wav": GeneratorFormat(
        (".wav",), _wav, _read_wav, (-32767, 32767), channels=True
    ),  # sound cards, too
    "int16": replace(
        _INT16, volts_needed=True
    ),  # a converter's codes, little end first
    "uint16": replace(_UINT16, volts_needed=True),
    "tdms": GeneratorFormat(
        (".tdms",), _tdms, _read_tdms, channels=True
    ),  # LabVIEW: volts
    "pi-gcs": GeneratorFormat(
        (".txt", ".gcs"), _pi_gcs, _read_pi_gcs, channels=True
    ),  # commands, volts
    "keysight-arb": GeneratorFormat(
        (".arb",), _keysight, _read_keysight, (-32767, 32767)
    ),  # 33500, 33600
    "tektronix-tfw": _TFW,  # AFG1000 to AFG3000
    "rigol-raf": replace(
        _UINT16, endings=(".raf",), codes=(0, 16383)
    ),  # DG1000Z, DG4000, DG5000
    # PicoScope 6's generator: text from -1 to 1
    "picoscope": GeneratorFormat(
        (".txt", ".csv"), _picoscope, _read_picoscope, normal=True, points=(10, 8192)
    ),
}


def format_named(name: str) -> GeneratorFormat:
    """Return a kind of file of this program, or one that an extra brings.

    Raises
    ------
    UsageError
        There is none of this name.
    """
    if name in FORMATS:
        return FORMATS[name]
    brought: GeneratorFormat | None = extensions.find("generator", name)
    if brought is None:
        names = [*FORMATS, *extensions.keys("generator")]
        raise UsageError(f"`to`: '{name}' is none of {', '.join(names)}")
    return brought


def check_name(output: str, form: str) -> None:
    """Refuse a file name that says another format (UsageError)."""
    endings = format_named(form).endings
    if output != "-" and not output.lower().endswith(endings):
        raise UsageError(
            f"{output}: a {form} file is called {' or '.join('*' + ending for ending in endings)}"
        )


def written(form: str, signals: Signals) -> bytes:
    """Return the bytes of a file, read back and found the same.

    Raises
    ------
    OutputError
        They read back as something else: a fault of this program.
    """
    chosen = format_named(form)
    data = chosen.write(signals)
    if not np.array_equal(chosen.read(data), signals.values):
        raise OutputError(
            f"the {form} file would not read back as it was written (please report it)"
        )
    return data


# --- other points and rates ---


class Points(NamedTuple):
    """Signals as they are played.

    Attributes
    ----------
    volts : array of shape (channels, points)
    rate : float
        Points a second.
    moved : float
        The largest difference, at the drive's own rows, from what it was.
    held : int
        Points at the end that only repeat the last value.
    """

    volts: Floats
    rate: float
    moved: float = 0.0
    held: int = 0


def at_points(
    drive: Floats, rate: float, points: int | None, new_rate: float | None, loop: bool
) -> Points:
    """Return signals at so many points, or at another rate, over the same time; linear between rows.

    Parameters
    ----------
    drive
        Signals of shape (channels, rows).
    rate
        Their rows a second.
    points, new_rate
        Points wanted, and points a second; with both, the last value fills what is
        left.
    loop
        The signals repeat: their time is one row longer, and nothing can be filled up.

    Raises
    ------
    UsageError
        The time is no whole number of points, or needs more than there are.
    """
    rows = drive.shape[1]
    seconds = (rows if loop else rows - 1) / rate
    count = points or rows
    what, most = f"`points` {count:,}", float(count)
    if new_rate is not None:
        what, most = f"`rate` {new_rate:g}", max(most, seconds * new_rate)
    if most > MOST_POINTS:
        raise UsageError(
            f"{what}: a drive of {seconds:.6g} s becomes more than {MOST_POINTS:,} points"
        )
    if new_rate is not None:
        exact = seconds * new_rate
        count = math.ceil(exact - WHOLE) + (0 if loop else 1)
        fitting = points or max(round(exact), 2)
        is_whole = abs(exact - round(exact)) <= WHOLE * max(1.0, exact)
        is_full = points is None or count == points
        if loop and not (is_whole and is_full):
            raise UsageError(
                f"`rate` {new_rate:g}: the loop of {seconds:.6g} s is {exact:.6g} points (a `rate` of "
                f"{fitting / seconds:.9g} makes {fitting:,})"
            )
        if points is not None and count > points:
            raise UsageError(
                f"`points` {points:,}: the drive takes {count:,} at {new_rate:g} a second (leave `rate` out, "
                f"or at most {(points - 1) / seconds:.6g})"
            )
    elif count < 2:
        raise UsageError(f"`points` {count}: a drive needs two")
    elif count == rows:
        new_rate = rate
    else:
        new_rate = (count if loop else count - 1) / seconds
    resting = 0 if points is None else points - count
    if count == rows and abs(new_rate / rate - 1.0) < WHOLE / count:
        played, moved = drive, 0.0
    else:
        time, new = np.arange(rows) / rate, np.arange(count) / new_rate
        period = seconds if loop else None
        played = np.stack([np.interp(new, time, axis, period=period) for axis in drive])
        back = np.stack([np.interp(time, new, axis, period=period) for axis in played])
        moved = float(np.abs(back - drive).max())
    return Points(
        np.pad(played, ((0, 0), (0, resting)), mode="edge"), new_rate, moved, resting
    )
