"""What a user may type as an option's value, and what is said when it is something else."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TypeVar

from dbo_cli.errors import UsageError

Value = TypeVar("Value")


def number(option: str, text: str) -> float:
    """Return a finite number; raise ``UsageError`` for anything else."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise UsageError(f"{option}: not a number: '{text}'")
    return value


def positive(option: str, text: str) -> float:
    """Return a number above zero; raise ``UsageError`` for anything else."""
    value = number(option, text)
    if value <= 0.0:
        raise UsageError(f"{option}: must be above 0, not {text}")
    return value


def not_negative(option: str, text: str) -> float:
    """Return a number of at least zero; raise ``UsageError`` for anything else."""
    value = number(option, text)
    if value < 0.0:
        raise UsageError(f"{option}: must not be below 0, not {text}")
    return value


def whole(option: str, text: str, least: int) -> int:
    """Return a whole number of at least ``least``; raise ``UsageError`` for anything else."""
    try:
        value = int(text)
    except ValueError:
        raise UsageError(f"{option}: not a whole number: '{text}'") from None
    if value < least:
        raise UsageError(f"{option}: must be at least {least}, not {value}")
    return value


def choice(option: str, text: str, choices: Sequence[str]) -> str:
    """Return a text that is one of ``choices``; raise ``UsageError`` for anything else."""
    if text not in choices:
        raise UsageError(f"{option}: '{text}' is none of {', '.join(choices)}")
    return text


def optional(parse: Callable[[str, str], Value], option: str, text: str | None) -> Value | None:
    """Return None for an option that was not given, else what ``parse`` makes of it."""
    return None if text is None else parse(option, text)


def auto_or(parse: Callable[[str, str], Value], option: str, text: str) -> Value | None:
    """Return None for ``auto``, else what ``parse`` makes of the text."""
    return None if text == "auto" else parse(option, text)


def times(option: str, text: str) -> tuple[float, ...]:
    """Return time constants in seconds, given as ``T1,T2,…``; ``0`` means none."""
    values = tuple(not_negative(option, part) for part in text.split(","))
    if values == (0.0,):
        return ()
    if 0.0 in values or len(set(values)) < len(values):
        raise UsageError(f"{option}: time constants must differ and be above 0: '{text}'")
    return tuple(sorted(values))
