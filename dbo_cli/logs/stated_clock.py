"""Sample rates and steps that a file states: which names count, in which units, and what to do in doubt.

A rate is used only where its meaning is plain.  An attribute called ``sample_rate`` of ``10 kHz`` is 10,000
samples a second; one without a unit is taken in the unit that its name implies (hertz for a rate, seconds
for a step), and that is said; a unit that is none of a rate or a step, or two statements that disagree, are
refused as soon as the rate is needed.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from dbo_cli.errors import InputError
from dbo_cli.logs.columns import split_header
from dbo_cli.logs.plain_text import clean_text
from dbo_cli.logs.time_units import time_unit

_RATES = {"samplerate", "samplingrate", "samplingfrequency", "samplefrequency", "samplingfreq", "samplefreq",
          "acquisitionrate", "acquisitionfrequency", "fs", "srate", "sfreq", "scanrate", "abtastrate",
          "abtastfrequenz", "messfrequenz", "messrate"}  # fmt: skip
_STEPS = {"wfincrement", "sampleperiod", "samplingperiod", "sampleinterval", "samplinginterval", "sampletime",
          "timestep", "timeincrement", "dt", "deltat", "ts", "tinterval", "xincrement", "xinc", "tinc",
          "abtastintervall", "abtastzeit", "abtastperiode"}  # fmt: skip
_BARE = {"rate"}  # of what? only a unit of a rate tells
_PER_SECOND = ("Hz", "hz", "HZ", "Hertz", "hertz", "S/s", "Sa/s", "sps", "SPS", "Sps", "samples/s",
               "Samples/s", "sample/s", "samples/sec", "samples/second", "samplespersecond", "scans/s",
               "1/s", "s^-1", "s-1", "/s")  # fmt: skip
_LARGE = {"": 1.0, "k": 1e3, "K": 1e3, "M": 1e6, "G": 1e9}
_HERTZ = {prefix + unit: factor for prefix, factor in _LARGE.items() for unit in _PER_SECOND} | {"mHz": 1e-3}
# Steps a second of each unit, so that dividing keeps 0.1 ms at exactly 10,000 samples a second.
_PER_STEP = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9, "ps": 1e12, "min": 1.0 / 60.0, "h": 1.0 / 3600.0}
_AMOUNT = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(1/s|s\^?-1|[^\d]*?)\s*")
_LONGEST = 80  # characters of a name or of an amount with its unit; the patterns' time grows with the square
_SAME = 1e-6  # rates that differ by less were rounded when the file was written (0.000333333 s, 3000 Hz)


@dataclass(frozen=True)
class Statement:
    """What one place of a file says of the clock: samples a second, or why it cannot be used.

    ``assumed`` is the unit that was taken where none was given.
    """

    said: str
    rate: float | None
    problem: str = ""
    assumed: str = ""


def is_clock_name(name: str) -> bool:
    """Tell whether an attribute, variable or header line of this name states a rate or a step."""
    return len(name) <= _LONGEST and bool(_kind_of(name)[0])


def _kind_of(name: str) -> tuple[str, str, str | None]:
    """Give ``rate``, ``step`` or nothing for a name, its plain spelling, and the unit that it carries."""
    quantity, unit = split_header(name)
    key = re.sub(r"[\s_\-.]+", "", quantity).lower()
    if key.endswith("hz") and key.removesuffix("hz") in _RATES:
        key, unit = key.removesuffix("hz"), unit or "Hz"
    return ("rate" if key in _RATES | _BARE else "step" if key in _STEPS else ""), key, unit


def read_statement(name: str, value: object, unit: object = None, *, sure: bool = False) -> Statement | None:
    """Read an attribute, variable or header line as a statement of rate or step; None where it is none.

    Parameters
    ----------
    name
        How the file calls it (``sample_rate``, ``fs``, ``SampleTime[ms]``, ``dt_us``).
    value
        A number, one in an array, or text such as ``10 kHz``.
    unit
        A unit that the file gives beside it.
    sure
        The format itself defines the unit (seconds or hertz), so that nothing is assumed without one.
    """
    kind, key, own = _kind_of(name)
    if not kind:
        return None
    amount, written = _amount(value)
    stated = clean_text(unit).strip() if unit is not None else ""
    stated = stated or written or own or ""
    if key in _BARE and stated.replace(" ", "") not in _HERTZ:
        return None
    said = f"'{name}' {_plain(value)}" + (f" {stated}" if stated and stated not in _plain(value) else "")
    if amount is None:
        # Text and lists under the name of a step are time stamps (``ts``) more often than steps.
        several = kind == "rate" and not isinstance(value, str | bytes) and np.asarray(value).size > 1
        return Statement(said, None, f"{said} is no single number") if several else None
    if not amount > 0.0 or not math.isfinite(amount):
        return None  # an instrument's way to say that it does not know
    factor = _factor(kind, stated)
    if factor is None:
        proper = "a rate (Hz, kHz, S/s)" if kind == "rate" else "a time step (s, ms, us)"
        return Statement(said, None, f"{said} is not in a unit of {proper}")
    rate = amount * factor if kind == "rate" else factor / amount
    return Statement(said, rate, assumed="" if stated or sure else "Hz" if kind == "rate" else "s")


def agreed_rate(place: str, statements: Iterable[Statement], notes: list[str]) -> float | None:
    """Give the one sample rate (Hz) that all statements tell; None without any.

    Raises
    ------
    InputError
        A statement cannot be read, or two disagree; ``sample_rate`` is the remedy.
    """
    told = list(dict.fromkeys(statements))
    for one in told:
        if one.rate is None:
            raise InputError(f"{place}: {one.problem} (`sample_rate` HZ gives the rate instead)")
    if not told:
        return None
    first = told[0]
    assert first.rate is not None
    for one in told[1:]:
        assert one.rate is not None
        if abs(one.rate - first.rate) > _SAME * first.rate:
            raise InputError(
                f"{place}: two sample rates are stated, {first.said} and {one.said}: which one holds? "
                "(`sample_rate` HZ decides)"
            )
    certain = [one for one in told if not one.assumed]
    chosen = certain[0] if certain else first
    if chosen.assumed:
        notes.append(f"{place}: {chosen.said} has no unit: {chosen.assumed} is assumed")
    return chosen.rate


def _amount(value: object) -> tuple[float | None, str]:
    """Take a value apart into its number (None where it is not exactly one) and the unit behind it."""
    if isinstance(value, str | bytes):
        text = clean_text(value).strip()
        found = _AMOUNT.fullmatch(text) if len(text) <= _LONGEST else None
        return (float(found[1]), found[2]) if found else (None, "")
    try:
        array = np.asarray(value).ravel()
    except (ValueError, TypeError):
        return None, ""
    if array.size and array.dtype.kind in "SUO" and isinstance(array[0], str | bytes):
        return _amount(array[0]) if array.size == 1 else (None, "")
    if not array.size or array.dtype.kind not in "fiub" or np.any(array != array[0]):
        return None, ""
    return float(array[0]), ""


def _factor(kind: str, unit: str) -> float | None:
    """Give samples a second per unit of a rate, or units a second of a step; None for an unknown unit."""
    plain = unit.strip().strip("[]()").strip()
    if not plain:
        return 1.0
    if kind == "rate":
        return _HERTZ.get(plain.replace(" ", ""))
    plain = plain.replace(" ", "").replace("µ", "u").replace("μ", "u")
    for suffix in ("/sample", "/S", "/Sa", "persample"):
        plain = plain.removesuffix(suffix)
    return _PER_STEP.get(time_unit(plain) or "")


def _plain(value: object) -> str:
    """Show a value shortly."""
    if isinstance(value, str | bytes):
        text = clean_text(value).strip()
    else:
        array = np.asarray(value).ravel()
        if array.size != 1:
            return f"({array.size} values)"
        one = array[0]
        text = f"{one:g}" if array.dtype.kind in "fiub" else clean_text(one)
    return text if len(text) <= 40 else text[:37] + "..."
