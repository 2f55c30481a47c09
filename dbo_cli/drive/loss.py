"""What limits cost a move: the rows that are clipped, what the move misses, and what would fit."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dbo_cli.drive.drive import Extent
from dbo_cli.drive.limits import Limits
from dbo_cli.errors import InputError, LimitError
from dbo_cli.model import Model, State, VoltageWindow

Floats = NDArray[np.float64]
Steps = float | Floats | None

ALLOWED_PART = 0.01
"""Of the move: so much of it (RMS) may be cut off unasked; the order of a good model's error; chosen."""
# of the range: a trajectory this little outside is clipped like any other
# of the range: a trajectory this little outside is clipped like any other
REACH_SLACK = 0.01
KEPT_ROWS = 131_072  # rows that a refusal looks at again; a longer move is not kept


@dataclass
class Loss:
    """Counts what the limits cut off a move, block by block.

    Attributes
    ----------
    model, limits, name
        The forward model, what its drive may do, and the trajectory's name.
    move : Extent
        The displacements of the move.
    clipped, first_clipped : int
        How many rows were clipped, and the first of them from 1.
    most : float
        The most that a row misses, in the displacement's unit.
    """

    model: Model
    limits: Limits
    name: str
    move: Extent = field(default_factory=Extent)
    clipped: int = 0
    first_clipped: int = 0
    most: float = 0.0
    _rows: int = 0
    _unreachable: int = 0
    _squares: float = 0.0
    _sections: Any = None
    _kept: list[tuple[Floats, Steps]] = field(default_factory=list)
    _begun: State | None = None

    def keep(self, wanted: Floats, dt: Steps, before: State) -> None:
        """Keep rows of the static part, so that a refusal can look at them again; not of a long move."""
        self._rows += wanted.size
        if self.limits.slew is None or self._rows > KEPT_ROWS:
            self._kept = []
            return
        self._begun = self._begun or before
        self._kept.append((wanted, dt))

    def see(self, desired: Floats, clipped: int, first: int) -> None:
        """See rows of the move, of which ``clipped`` were clipped, the first at index ``first``."""
        if clipped and not self.clipped:
            self.first_clipped = self.move.rows + first + 1
        self.clipped += clipped
        self.move.see(desired)
        reach = self.model.output
        slack = REACH_SLACK * reach.span
        beyond = (desired < reach.min - slack) | (desired > reach.max + slack)
        self._unreachable += int(np.count_nonzero(beyond))

    def add(self, wanted: Floats, voltage: Floats, before: State, dt: Steps) -> None:
        """Add up what rows miss: what was wanted of the static part, less what the voltage reaches."""
        lost = wanted - self.model.static.run(voltage, before, dt).y
        begin = self.first_clipped - 1 - (self.move.rows - wanted.size)
        lost[: max(begin, 0)] = (
            0.0  # a settled start may step over the first value: no limit does
        )
        dynamics = self.model.dynamics
        if dynamics is not None and dt is not None:
            if self._sections is None:
                self._sections = dynamics.run(np.zeros(1), 1.0)[1]
            lost, self._sections = dynamics.run(lost, dt, self._sections)
        self.add_displacement(lost)

    def add_displacement(self, lost: Floats) -> None:
        """Add rows of which the lost displacement is known."""
        self._squares += float(np.square(lost).sum())
        self.most = max(self.most, float(np.abs(lost).max(initial=0.0)))

    @property
    def rms(self) -> float:
        """What the move misses so far (RMS, in the displacement's unit)."""
        return math.sqrt(self._squares / max(self.move.rows, 1))

    # --- refusals ---

    def require_none(self) -> None:
        """Refuse any clipped row (LimitError)."""
        if self.clipped:
            raise LimitError(
                f"{self.clipping()}{self.would_fit()} (`on_limit` clip goes on)"
            )

    def require_reachable(self) -> None:
        """Refuse a trajectory of which no row can be reached (InputError)."""
        if not self.move.rows or self._unreachable < self.move.rows:
            return
        reach = self.model.output
        raise InputError(
            f"{self.name}: every row is outside what the model reaches, {reach.min:.6g} to {reach.max:.6g}"
            f"{reach.suffix}: check unit, column and zero of the trajectory"
        )

    def require_little(self, period: float | None = None) -> None:
        """Refuse to cut off more than a hundredth of the move (LimitError); ``period``: see ``would_fit``."""
        size, what = self.move.span, "the move"
        if not size > 0.0:
            size, what = self.model.output.span, "the model's range"
        if self.rms <= ALLOWED_PART * size:
            return
        unit = self.model.output.suffix
        raise LimitError(
            f"{self.clipping()}: it would miss {self.rms:.3g}{unit} RMS, {100.0 * self.rms / size:.2g} % of "
            f"{what}{self.would_fit(period)} (`on_limit` clip writes it)"
        )

    def clipping(self) -> str:
        """Say how much of the move its limits do not allow."""
        return (
            f"{self.name}: {self.clipped:,} of {self.move.rows:,} rows (first in row {self.first_clipped:,}) "
            f"are beyond what the limits allow, {self.limits.describe()}"
        )

    def would_fit(self, period: float | None = None) -> str:
        """Say what would fit, where that is one number; empty where it is not.

        Parameters
        ----------
        period
            Seconds, where the move is one period of a loop.
        """
        texts = self._reach_texts()
        slower = self._times_slower()
        if not texts and slower > 1.0:
            what = f"it {_rounded_up(slower):g} times slower"
            if period is not None:
                what = f"{1.0 / (slower * period):.2g} Hz"
            texts.append(f"{self.limits.slew:g}{self.limits.suffix}/s allows {what}")
        return f"; {', '.join(texts)}" if texts else ""

    def _reach_texts(self) -> list[str]:
        """Say what the ends of the move's range reach, where the move goes beyond that."""
        model, unit = self.model, self.model.output.suffix
        ends = []
        for voltage, state in zip(self.limits.move, ("full", "empty"), strict=True):
            begun = model.static.start(voltage, state)
            ends.append(float(model.static.run(np.array([voltage]), begun, 1.0).y[0]))
        texts = []
        for voltage, end in zip(self.limits.move, ends, strict=True):
            above = end == max(ends) and self.move.greatest > end
            below = end == min(ends) and self.move.least < end
            if above or below:
                texts.append(
                    f"{voltage:.6g}{self.limits.suffix} reaches {end:.4g}{unit}"
                )
        return texts

    def _times_slower(self) -> float:
        """Return how many times the slew limit the move needs; 0 where that is not known."""
        state = self._begun
        if self.limits.slew is None or state is None:
            return 0.0
        window = VoltageWindow(*self.limits.move)
        fastest = 0.0
        for wanted, dt in self._kept:
            done = self.model.drive(wanted, state, dt, window)
            state = done.state
            steps = np.abs(np.diff(done.voltage))
            seconds = np.broadcast_to(np.asarray(dt, dtype=np.float64), wanted.shape)[
                1:
            ]
            rates = steps[seconds > 0.0] / seconds[seconds > 0.0]
            fastest = max(fastest, float(rates.max(initial=0.0)))
        return fastest / self.limits.slew


def _rounded_up(value: float) -> float:
    """Return a bound to two digits, no smaller than it is."""
    unit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return math.ceil(value / unit) * unit
