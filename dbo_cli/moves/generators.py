"""The files that generators, wave tables and converters take: numbers to bytes.

``npy`` and ``pi-gcs`` hold volts, the others codes, whose ends stand for two voltages.
"""

from __future__ import annotations

import io
import wave
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbo_cli.arrays import Floats
from dbo_cli.errors import UsageError

Codes = NDArray[np.int64]
Values = NDArray[np.float64 | np.int64]
"""Volts or codes; channels stand side by side, shape (points, channels)."""
Span = tuple[float, float]

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

    write: Callable[[Values, float, Span], bytes]
    codes: tuple[int, int] | None = None
    volts_needed: bool = False
    holds_channels: bool = False


class Coding(NamedTuple):
    """Whole numbers for voltages: the ends of ``codes`` stand for the ends of ``volts``."""

    codes: tuple[int, int]
    volts: Span

    @property
    def step(self) -> float:
        """Volts a code."""
        low, high = self.volts
        return (high - low) / (self.codes[1] - self.codes[0])

    def encode(self, volts: Floats, within: Span) -> Codes:
        """Return the nearest codes; next to a limit the nearest one inside it."""
        places = np.rint((volts - self.volts[0]) / self.step).astype(np.int64)
        codes: Codes = np.clip(places + self.codes[0], *self.codes)
        codes = codes - (self.decode(codes) > within[1])
        return codes + (self.decode(codes) < within[0])

    def decode(self, codes: Codes) -> Floats:
        """Return the voltages of codes."""
        share = (codes - self.codes[0]) / (self.codes[1] - self.codes[0])
        low, high = self.volts
        return np.clip(low + share * (high - low), low, high)


def _positional(value: float) -> str:
    """Write a number with the fewest digits that read back exactly, without an exponent."""
    return str(np.format_float_positional(value, trim="-"))


def _npy(values: Values, rate: float, volts: Span) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, values)
    return buffer.getvalue()


def _wav(values: Values, rate: float, volts: Span) -> bytes:
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


def _integers(kind: str, values: Values, rate: float, volts: Span) -> bytes:
    return values.astype(kind).tobytes()


def _pi_gcs(values: Values, rate: float, volts: Span) -> bytes:
    """Return one command for every ten points: WAV 1 X|& PNT first count values."""
    lines = []
    for first in range(0, values.size, BUNCH):
        bunch = values[first : first + BUNCH].tolist()
        append = "&" if first else "X"
        points = " ".join(map(_positional, bunch))
        lines.append(f"WAV 1 {append} PNT {first + 1} {len(bunch)} {points}\n")
    return "".join(lines).encode()


def _keysight(values: Values, rate: float, volts: Span) -> bytes:
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
