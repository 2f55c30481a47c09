"""What limits cost a move: the rows that are clipped, what the move misses, and what would fit."""

from __future__ import annotations

import math
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from dbo_cli.drive.drive import Extent
from dbo_cli.drive.limits import Limits
from dbo_cli.errors import InputError, LimitError, UsageError
from dbo_cli.model import Model, Run, State, Window

Floats = NDArray[np.float64]
Steps = float | Floats | None
OnLimit = Literal["auto", "clip", "error"]

ALLOWED_PART = 0.01
"""Of the move: so much of it (RMS) may be cut off unasked; the order of a good model's error; chosen."""
# of the range: a trajectory this little outside is clipped like any other
REACH_SLACK = 0.01
KEPT_ROWS = 131_072  # rows that a refusal looks at again; a longer move is not kept


class Loss:
    """Counts what the limits cut off a move, block by block, and refuses too much of it.

    Attributes
    ----------
    model, limits, on_limit, name
        The forward model, what its drive may do, what happens at a limit, and the
        trajectory's name.
    move : Extent
        The displacements of the move.
    clipped, first_clipped : int
        How many rows were clipped, and the first of them from 1.
    most : float
        The most that a row misses, in the displacement's unit.

    Raises
    ------
    UsageError
        ``on_limit`` is unknown.
    """

    def __init__(
        self, model: Model, limits: Limits, on_limit: OnLimit, name: str
    ) -> None:
        if on_limit not in get_args(OnLimit):
            raise UsageError(f"`on_limit` {on_limit}: give auto, clip or error")
        self.model, self.limits = model, limits
        self.on_limit, self.name = on_limit, name
        self.move = Extent()
        self.clipped = self.first_clipped = 0
        self.most = 0.0
        self._squares = 0.0
        self._unreachable = 0
        self._kept: list[tuple[Floats, State, Steps]] = []

    @property
    def rms(self) -> float:
        """What the move misses so far (RMS, in the displacement's unit)."""
        return math.sqrt(self._squares / max(self.move.rows, 1))

    def see(
        self, desired: Floats, wanted: Floats, done: Run, before: State, dt: Steps
    ) -> None:
        """See rows of the move.

        Parameters
        ----------
        desired, wanted
            The rows, and what was asked of the static part for them.
        done
            The drive of them, made from the state ``before``.

        Raises
        ------
        LimitError
            A row was clipped, and ``on_limit`` is ``error``.
        """
        begin = self.move.rows
        if done.clipped and not self.clipped:
            self.first_clipped = begin + done.first_clipped + 1
        self.clipped += done.clipped
        self.move.see(desired)
        self._kept.append((wanted, before, dt))
        if self.limits.slew is None or self.move.rows > KEPT_ROWS:
            self._kept = []
        reach = self.model.output
        slack = REACH_SLACK * reach.span
        beyond = (desired < reach.min - slack) | (desired > reach.max + slack)
        self._unreachable += int(np.count_nonzero(beyond))
        if not self.clipped:
            return
        if self.on_limit == "error":
            raise LimitError(
                f"{self.clipping()}{self.would_fit()} (or `on_limit` clip)"
            )
        lost = wanted - self.model.static.run(done.y, before, dt).y
        # a settled start may step over the first value: no limit does that
        lost[: max(self.first_clipped - 1 - begin, 0)] = 0.0
        self._squares += float(np.square(lost).sum())
        self.most = max(self.most, float(np.abs(lost).max()))

    def require_little(self, period: float | None = None) -> None:
        """Refuse a move of which nothing can be reached, or of which the limits cut off too much.

        Parameters
        ----------
        period
            Seconds, where the move is one period of a loop.

        Raises
        ------
        InputError
            No row of the trajectory is within what the model reaches.
        LimitError
            More than a hundredth of the move would be missed, and ``on_limit`` is
            ``auto``.
        """
        reach, unit = self.model.output, self.model.output.suffix
        if self._unreachable == self.move.rows:
            raise InputError(
                f"{self.name}: every row is outside the model's reach, {reach.min:.6g} to {reach.max:.6g}"
                f"{unit}: check unit, column and zero of the trajectory"
            )
        size, what = self.move.span, "the move"
        if not size > 0.0:
            size, what = reach.span, "the model's range"
        if self.on_limit != "auto" or self.rms <= ALLOWED_PART * size:
            return
        raise LimitError(
            f"{self.clipping()}, by {self.rms:.3g}{unit} RMS ({100.0 * self.rms / size:.2g} % of "
            f"{what}){self.would_fit(period)} (or `on_limit` clip)"
        )

    def clipping(self) -> str:
        """Return how much of the move the limits forbid, in words."""
        return (
            f"{self.name}: {self.clipped:,} of {self.move.rows:,} rows (first: row "
            f"{self.first_clipped:,}) exceed {self.limits.describe()}"
        )

    def would_fit(self, period: float | None = None) -> str:
        """Return what would fit, where that is one number; else an empty text."""
        texts = self._reach_texts()
        slower = self._times_slower()
        if not texts and slower > 1.0:
            what = f"it {_rounded_up(slower):g} times slower"
            if period is not None:
                what = f"{1.0 / (slower * period):.2g} Hz"
            texts.append(f"{self.limits.slew:g}{self.limits.suffix}/s allows {what}")
        return f"; {', '.join(texts)}" if texts else ""

    def _reach_texts(self) -> list[str]:
        """Return what the ends of the range reach, where the move goes beyond that."""
        static = self.model.static
        ends = []
        for voltage, state in zip(self.limits.move, ("full", "empty"), strict=True):
            begun = static.start(voltage, state)
            ends.append(float(static.run(np.array([voltage]), begun, 1.0).y[0]))
        texts = []
        for voltage, end in zip(self.limits.move, ends, strict=True):
            above = end == max(ends) and self.move.greatest > end
            below = end == min(ends) and self.move.least < end
            if above or below:
                texts.append(
                    f"{voltage:.6g}{self.limits.suffix} reaches {end:.4g}{self.model.output.suffix}"
                )
        return texts

    def _times_slower(self) -> float:
        """Return how many times the slew limit the move needs; 0 where that is not known."""
        if self.limits.slew is None or not self._kept:
            return 0.0
        window = Window(*self.limits.move)
        fastest, state = 0.0, self._kept[0][1]
        for wanted, _, dt in self._kept:
            done = self.model.drive(wanted, state, dt, window)
            state = done.state
            seconds = np.broadcast_to(np.asarray(dt), wanted.shape)[1:]
            steps = np.abs(np.diff(done.y))[seconds > 0.0]
            rates = steps / seconds[seconds > 0.0]
            fastest = max(fastest, float(rates.max(initial=0.0)))
        return fastest / self.limits.slew


def _rounded_up(value: float) -> float:
    """Return a bound to two digits, no smaller than it is."""
    unit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return math.ceil(value / unit) * unit
