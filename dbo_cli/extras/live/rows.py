"""What live control of one actuator and of many have in common: a row goes out whole, or not at all.

``plan`` works out a row and everything that comes with it, as one value that is swapped
in at the end; where it raises, nothing is left to commit. ``commit`` checks what it is
told before anything moves.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np

from dbo_cli.errors import InputError, UsageError, shortened

Wanted = TypeVar("Wanted")
Played = TypeVar("Played")

Pending = tuple[Any, Any, Any, Any, Any]
"""What a plan comes to: what was handed out, its volts, whether the limits hold it back, what a converter has
saved up of the slew limit after it (V), and what else goes on with it beside the gears
(None: nothing). A plain tuple, since a row of an actuator takes a microsecond.
"""

WANTED_SPANS = 1e12
"""Of a model's range of displacement: what is wanted from further away is refused. Chosen: what is nearer is
clipped at the drive's limits, and no sum of it overflows.
"""
PLAYED_SPANS = 1000.0
"""Of a model's range of voltage: an applied voltage from further away is refused. Chosen: no amplifier goes
there, but a figure in mV taken for V does.
"""


class Reach(NamedTuple):
    """The numbers that may come in: those between both ends."""

    low: float
    high: float


def reach_of(low: float, high: float, spans: float) -> Reach:
    """Return what is no further from a range than so many times its length."""
    away = spans * (high - low)
    return Reach(low - away, high + away)


class LiveDrive(ABC, Generic[Wanted, Played]):
    """Plans a row, and goes on from it once it is committed."""

    _pending: Pending | None = None

    @abstractmethod
    def _worked_out(self, wanted: Wanted) -> Pending:
        """Return what a plan comes to; nothing that was committed changes."""

    @abstractmethod
    def _followed(self, applied: Any, pending: Pending | None) -> Pending:
        """Return what applied volts, or codes, come to in the place of a plan, after all checks."""

    @abstractmethod
    def _take(self, pending: Pending) -> None:
        """Go on from what was worked out last; this cannot fail."""

    def plan(self, wanted: Wanted) -> Played:
        """Return the voltage (the code, with a converter) for what is wanted next; nothing changes yet.

        A plan that is refused leaves nothing to commit, neither itself nor the one
        before.

        Parameters
        ----------
        wanted : float, or array_like of shape (channels,)
            What is wanted at this sample, in the unit of the model's output (of a bank:
            of each model's); with ``ahead`` what is wanted the model's delay later,
            with ``lookahead`` so much later.

        Raises
        ------
        InputError
            It is not a finite number, or not one for each channel, or beyond all
            reason.
        """
        self._pending = None
        self._pending = pending = self._worked_out(wanted)
        planned: Played = pending[0]
        return planned

    def commit(self, applied: Played | None = None) -> None:
        """Go on from what was planned, or from what was applied instead.

        Where this is refused nothing has moved, and what was planned can still be
        committed.

        Parameters
        ----------
        applied : float or int, or array_like, optional
            Volts, or with a converter a code, where that is not what was planned; of a
            bank of each channel.

        Raises
        ------
        UsageError
            Nothing was planned, and nothing applied is given.
        InputError
            What was applied is no finite number or beyond all reason, or no code of the
            converter.
        """
        pending = self._pending
        if applied is not None:
            pending = self._followed(applied, pending)
        elif pending is None:
            raise UsageError("nothing was planned to be committed: call plan first")
        self._pending = None
        self._take(pending)

    def step(self, wanted: Wanted) -> Played:
        """Plan and commit at once, where the hardware takes what it is given.

        Parameters
        ----------
        wanted : float, or array_like of shape (channels,)
            As in ``plan``.
        """
        planned = self.plan(wanted)
        self.commit()
        return planned

    @property
    def planned(self) -> Any:
        """What was planned and is not committed yet, or None."""
        return None if self._pending is None else self._pending[0]

    def drop(self) -> None:
        """Leave nothing to commit."""
        self._pending = None

    def __getstate__(self) -> dict[str, Any]:
        """Pickle what is committed; what was planned stays behind."""
        return self.__dict__ | {"_pending": None}


def number(what: str, value: object) -> float:
    """Return a single number as a float.

    Raises
    ------
    InputError
        It is a text, a truth value, several numbers or something else.
    """
    good = not isinstance(
        value, bool | str | bytes | bytearray | np.ma.core.MaskedConstant
    )
    if isinstance(value, np.ndarray | np.generic):
        good = good and value.ndim == 0 and value.dtype.kind in "iuf"
    try:
        if good:
            return float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        pass
    shown = shortened(" ".join(repr(value).split()))
    raise InputError(f"{what} is no number: {shown}")


def refused(what: str, value: float, reach: Reach, unit: str) -> InputError:
    """Return why a number was refused: it is none that is finite, or too far away."""
    if not np.isfinite(value):
        return InputError(f"{what} is not a finite number: {value!r}")
    return InputError(
        f"{what}, {value:g}{unit}, is too far away to be meant (it has to lie between {reach.low:g} and"
        f" {reach.high:g}{unit})"
    )
