"""The figures of a drive: its rows, what they ask of the amplifier, what the limits cost, what to expect."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from dbo_cli.arrays import Floats
from dbo_cli.drive.limits import Limits, in_full
from dbo_cli.drive.simulate import Rows
from dbo_cli.model import Cascade, State


class PassRecord(NamedTuple):
    """A pass of a move that is learned: the digest of its drive, and the RMS of its error."""

    drive_sha256: str
    rmse: float


@dataclass(frozen=True)
class Drive:
    """The drive of a move.

    Attributes
    ----------
    model, limits, name
        The forward model, what its drive may do, and the trajectory's name in messages.
    time : array or None
        Seconds; rows before the move stand before its first stamp. Empty for a stream.
    desired, voltage : array
        Displacement and voltage, row by row; rows that are played as they are (sweep,
        return) have the displacement that the model expects. Empty for a stream.
    move : slice
        The rows of the move itself.
    rows : int
        Of the whole drive.
    voltage_range, lead_range : list of float, or None
        Least and greatest voltage, of the whole drive and before the move.
    move_range : list of float, or None
        Least and greatest displacement of the move.
    move_time : list of float, or None
        Stamps (s) of its first and its last row.
    lead_seconds : float
        How long the rows before the move take.
    clipped, first_clipped : int
        Rows of the move that a limit cut off, and the first of them from 1 (0: none).
    lost_rms, lost_most : float
        What the move misses by that, in the displacement's unit.
    expected_error, expected_known, expected_unrested : float, optional
        RMS of the error to expect, what is clipped included; the same if the past were
        known; and, behind a sweep, if the actuator was not at rest before it. None where
        the model does not know.
    mean_left_out : float, optional
        Of a move that is learned but for its mean: the mean error of the last pass, which
        the error to expect leaves out.
    starts_at : float, optional
        The first voltage, where nobody said where the amplifier stands.
    past_known : bool
        Whether a sweep or a typed state makes the past known.
    is_loop : bool
        Whether the move is one period that is repeated.
    state : State or None
        After the last row.
    history : tuple of PassRecord
        Of a move that is learned: the passes so far, the last one included.
    notes, warnings : tuple of str
        What a user should know.
    """

    model: Cascade = field(repr=False)
    limits: Limits
    name: str = "trajectory"
    time: Floats | None = field(default=None, repr=False)
    desired: Floats = field(default_factory=lambda: np.zeros(0), repr=False)
    voltage: Floats = field(default_factory=lambda: np.zeros(0), repr=False)
    move: slice = field(default_factory=lambda: slice(0, 0))
    rows: int = 0
    voltage_range: list[float] | None = None
    lead_range: list[float] | None = None
    move_range: list[float] | None = None
    move_time: list[float] | None = None
    lead_seconds: float = 0.0
    clipped: int = 0
    first_clipped: int = 0
    lost_rms: float = 0.0
    lost_most: float = 0.0
    expected_error: float | None = None
    expected_known: float | None = None
    expected_unrested: float | None = None
    mean_left_out: float | None = None
    starts_at: float | None = None
    past_known: bool = False
    is_loop: bool = False
    state: State | None = field(default=None, repr=False)
    history: tuple[PassRecord, ...] = ()
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()

    @property
    def lead_rows(self) -> int:
        """The number of rows before the move."""
        return int(self.move.start)

    def with_rows(self, rows: Rows) -> Drive:
        """Return the drive with its rows."""
        return replace(self, time=rows.time, desired=rows.x, voltage=rows.y)

    def line(self) -> str:
        """Return what came out: ``4,910 rows, 3.1 to 96.2 V, within limits``."""
        unit = self.limits.suffix
        low, high = self.voltage_range or (math.inf, -math.inf)
        state = "within limits" if self.limits.given else "within the identified range"
        if self.clipped:
            state = f"{self.clipped:,} {'row' if self.clipped == 1 else 'rows'} clipped"
        text = f"{self.rows:,} rows, {in_full(low)} to {in_full(high)}{unit}, {state}"
        if self.lead_range is not None:
            low, high = self.lead_range
            text += f"; {self.lead_seconds:.3g} s before the move, {in_full(low)} to {in_full(high)}{unit}"
        if self.starts_at is not None:
            text += f"; starts at {in_full(self.starts_at)}{unit}: `from_` VOLT"
        return text

    def expected_line(self) -> str:
        """Return the error to expect; empty where it is not known."""
        if self.expected_error is None:
            return ""
        unit = self.model.output.suffix
        text = f"expected error {in_full(self.expected_error, 2)}{unit} RMS"
        if self.mean_left_out is not None:
            return f"{text} without the mean, {in_full(self.mean_left_out, 2)}{unit} (`absolute` learns it)"
        if self.expected_unrested is not None:
            unrested = in_full(self.expected_unrested, 2)
            return f"{text} from rest; {unrested} if the actuator moved just before"
        if self.past_known:
            return text
        if self.expected_known is None:
            return f"{text} (past unknown)"
        way = "from a known `state`" if self.is_loop else "from rest with `condition`"
        return f"{text} (past unknown; {in_full(self.expected_known, 2)} {way})"

    def summary(self) -> dict[str, Any]:
        """Return the drive as plain values, for a summary in JSON."""
        expected = self.expected_error
        if expected is not None:  # with the mean that is left to the sensor's zero
            expected = math.hypot(expected, self.mean_left_out or 0.0)
        return {
            "format": "dbo-summary",
            "version": 1,
            "model": self.model.digest,
            "unit": self.model.output.unit,
            "rows": self.rows,
            "voltage_range": self.voltage_range,
            "move_range": self.move_range,
            "move_time": self.move_time,
            "limits": self.limits.as_dict(),
            "lead": {
                "rows": self.lead_rows,
                "seconds": self.lead_seconds,
                "range": self.lead_range,
            },
            "clipped": self.clipped,
            "lost_rms": self.lost_rms,
            "lost_most": self.lost_most,
            "sensor_delay": self.model.sensor_delay or None,
            "expected_rmse": expected,
            "expected_rmse_past_known": self.expected_known,
            "past_known": self.past_known,
            "warnings": list(self.warnings),
        }
