"""A drive: its rows, what they ask of the amplifier, what the limits cost, and what to expect."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from dbo_cli.arrays import Floats
from dbo_cli.drive.gate import Gate
from dbo_cli.drive.limits import Limits
from dbo_cli.drive.outlook import would_fit
from dbo_cli.errors import InputError, LimitError, UsageError
from dbo_cli.model import Cascade, Run, State, Steps

if TYPE_CHECKING:
    from dbo_cli.drive.learning import PassRecord

OnLimit = Literal["auto", "clip", "error"]

ALLOWED_PART = 0.01
"""Of the move: so much of it (RMS) may be cut off unasked; the order of a good model's error; chosen."""
# of the range: a trajectory this little outside is clipped like any other
REACH_SLACK = 0.01
FIRST_ROWS = 131_072  # of a move, that expectations and refusals look at again
NOTHING = np.zeros(0)


@dataclass
class Drive:
    """The drive of a move.

    Attributes
    ----------
    model, limits, on_limit, name
        The forward model, what its drive may do, what happens at a limit, and the
        trajectory's name in messages.
    time : array or None
        Seconds; rows before the move stand before its first stamp. Empty for a stream.
    desired, voltage : array
        Displacement and voltage, row by row; rows that are played as they are (sweep,
        return) have the displacement that the model expects. Empty for a stream.
    move : slice
        The rows of the move itself.
    rows, lead_rows, move_rows : int
        Of the whole drive, before the move, and of the move.
    voltage_range, lead_range : list of float, or None
        Least and greatest voltage, of the whole drive and before the move.
    move_range : list of float, or None
        Least and greatest displacement of the move.
    lead_seconds : float
        How long the rows before the move take.
    clipped, first_clipped : int
        Rows of the move that a limit cut off, and the first of them from 1 (0: none).
    lost_rms, lost_most : float
        What the move misses by that, in the displacement's unit.
    missed, off : float
        How far the first row starts off its displacement, because no settled actuator
        stands there; and by how much dynamics and delay are in motion there.
    expected_error, expected_known : float, optional
        RMS of the error to expect, what is clipped included; and the same if the past
        were known. None where the model does not know.
    starts_at : float, optional
        The first voltage, where nobody said where the amplifier stands.
    past_known : bool
        Whether a sweep or a state makes the past known.
    state : State or None
        After the last row.
    history : tuple of PassRecord
        Of a move that is learned: the passes so far, the last one included.
    notes, warnings : tuple of str
        What a user should know.

    Raises
    ------
    UsageError
        ``on_limit`` is unknown.
    """

    model: Cascade = field(repr=False)
    limits: Limits
    on_limit: OnLimit = "auto"
    name: str = "trajectory"
    time: Floats | None = field(default=None, repr=False)
    desired: Floats = field(default_factory=lambda: NOTHING, repr=False)
    voltage: Floats = field(default_factory=lambda: NOTHING, repr=False)
    move: slice = field(default_factory=lambda: slice(0))
    rows: int = 0
    lead_rows: int = 0
    move_rows: int = 0
    voltage_range: list[float] | None = None
    lead_range: list[float] | None = None
    move_range: list[float] | None = None
    lead_seconds: float = 0.0
    clipped: int = 0
    first_clipped: int = 0
    lost_rms: float = 0.0
    lost_most: float = 0.0
    missed: float = 0.0
    off: float = 0.0
    expected_error: float | None = None
    expected_known: float | None = None
    starts_at: float | None = None
    past_known: bool = False
    state: State | None = field(default=None, repr=False)
    history: tuple[PassRecord, ...] = ()
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    gate: Gate = field(init=False, repr=False)
    # what a refusal and the expected error look at again
    first_rows: list[tuple[Floats, Steps]] = field(default_factory=list, repr=False)
    first_asked: list[tuple[Floats, State, Steps]] = field(
        default_factory=list, repr=False
    )
    _squares: float = field(default=0.0, repr=False)
    _unreachable: int = field(default=0, repr=False)

    def __post_init__(self) -> None:
        """Refuse an inverse model, and an unknown answer to a limit."""
        self.model.require("forward")
        if self.on_limit not in get_args(OnLimit):
            raise UsageError(f"`on_limit` {self.on_limit}: give auto, clip or error")
        self.gate = Gate(self.limits)

    # --- rows, as they are made ---

    def admit(self, voltage: Floats, dt: Steps, part: str) -> None:
        """Let rows of a part (``lead``, ``move``, ``return``) pass the gate, and count them."""
        begins_anywhere = self.gate.last is None
        self.gate.admit(voltage, dt, part)
        if not voltage.size:
            return
        self.rows += voltage.size
        if begins_anywhere:
            self.starts_at = float(voltage[0])
        self.voltage_range = widened(self.voltage_range, voltage)
        if part == "lead":
            self.lead_rows += voltage.size
            self.lead_range = widened(self.lead_range, voltage)
        if part == "move":
            before = self.move_rows - voltage.size
            voltage = voltage[: max(FIRST_ROWS - before, 0)]
        if part != "return" and voltage.size:
            steps = dt[: voltage.size] if isinstance(dt, np.ndarray) else dt
            self.first_rows.append((voltage, steps))

    def clip(
        self, desired: Floats, wanted: Floats, done: Run, before: State, dt: Steps
    ) -> None:
        """Count rows of the move and what the limits cut off them, before they are admitted.

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
        begin = self.move_rows
        self.move_rows += desired.size
        if done.clipped and not self.clipped:
            self.first_clipped = begin + done.first_clipped + 1
        self.clipped += done.clipped
        self.move_range = widened(self.move_range, desired)
        self.first_asked.append((wanted, before, dt))
        if self.limits.slew is None or self.move_rows > FIRST_ROWS:
            self.first_asked = []
        reach = self.model.output
        slack = REACH_SLACK * reach.span
        beyond = (desired < reach.min - slack) | (desired > reach.max + slack)
        self._unreachable += int(np.count_nonzero(beyond))
        if not self.clipped:
            return
        if self.on_limit == "error":
            raise LimitError(
                f"{self.name}: {self.clipping()}{would_fit(self)} (or `on_limit` clip)"
            )
        lost = wanted - self.model.static.run(done.y, before, dt).y
        # a settled start may step over the first value: no limit does that
        lost[: max(self.first_clipped - 1 - begin, 0)] = 0.0
        self._squares += float(np.square(lost).sum())
        self.lost_most = max(self.lost_most, float(np.abs(lost).max()))
        self.lost_rms = math.sqrt(self._squares / self.move_rows)

    def require_reached(self, period: float | None = None) -> None:
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
        if self._unreachable == self.move_rows:
            raise InputError(
                f"{self.name}: every row is outside the model's reach, {reach.min:.6g} to {reach.max:.6g}"
                f"{unit}: check unit, column and zero of the trajectory"
            )
        assert self.move_range is not None
        size, what = self.move_range[1] - self.move_range[0], "the move"
        if not size > 0.0:
            size, what = reach.span, "the model's range"
        if self.on_limit != "auto" or self.lost_rms <= ALLOWED_PART * size:
            return
        raise LimitError(
            f"{self.name}: {self.clipping()}, by {self.lost_rms:.3g}{unit} RMS "
            f"({100.0 * self.lost_rms / size:.2g} % of {what}){would_fit(self, period)} (or `on_limit` clip)"
        )

    # --- what is said and written ---

    def clipping(self) -> str:
        """Return how much of the move the limits forbid, in words."""
        return (
            f"{self.clipped:,} of {self.move_rows:,} rows (first: row {self.first_clipped:,}) exceed "
            f"{self.limits.describe()}"
        )

    def line(self) -> str:
        """Return what came out: ``4,910 rows, 3.1 to 96.2 V, within limits``."""
        unit = self.limits.suffix
        low, high = self.voltage_range or (math.inf, -math.inf)
        state = "within limits" if self.limits.given else "within the identified range"
        if self.clipped:
            state = f"{self.clipped:,} {'row' if self.clipped == 1 else 'rows'} clipped"
        text = f"{self.rows:,} rows, {low:.4g} to {high:.4g}{unit}, {state}"
        if self.lead_range is not None:
            low, high = self.lead_range
            text += f"; {self.lead_seconds:.3g} s before the move, {low:.4g} to {high:.4g}{unit}"
        if self.starts_at is not None:
            text += f"; starts at {self.starts_at:.4g}{unit}: `from` VOLT"
        return text

    def expected_line(self) -> str:
        """Return the error to expect; empty where it is not known."""
        if self.expected_error is None:
            return ""
        error = f"{self.expected_error:.2g}"
        text = f"expected error {error}{self.model.output.suffix} RMS"
        if self.past_known:
            return text
        if self.expected_known is None:
            return f"{text} (past unknown)"
        known = f"{self.expected_known:.2g}"
        if known == error:
            return f"{text}, whatever the past"
        return f"{text} (past unknown; {known} with `condition`)"

    def summary(self) -> dict[str, Any]:
        """Return the drive as plain values, for a summary in JSON."""
        return {
            "format": "dbo-summary",
            "version": 1,
            "model": self.model.digest,
            "unit": self.model.output.unit,
            "rows": self.rows,
            "voltage_range": self.voltage_range,
            "move_range": self.move_range,
            "limits": self.limits.as_dict(),
            "lead": {
                "rows": self.lead_rows,
                "seconds": self.lead_seconds,
                "range": self.lead_range,
            },
            "clipped": self.clipped,
            "lost_rms": self.lost_rms,
            "lost_most": self.lost_most,
            "expected_rmse": self.expected_error,
            "expected_rmse_past_known": self.expected_known,
            "past_known": self.past_known,
            "warnings": list(self.warnings),
        }


def widened(span: list[float] | None, values: Floats) -> list[float]:
    """Return the least and the greatest of a span and of values."""
    low, high = float(values.min()), float(values.max())
    if span is None:
        return [low, high]
    return [min(low, span[0]), max(high, span[1])]
