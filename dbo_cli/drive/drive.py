"""A drive: its rows, what they ask of the amplifier, and what to expect of them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dbo_cli.drive.limits import Limits
from dbo_cli.model import State

if TYPE_CHECKING:
    from dbo_cli.drive.learning import PassRecord

Floats = NDArray[np.float64]
NOTHING = np.zeros(0)


@dataclass
class Extent:
    """What consecutive rows span, seen block by block.

    Attributes
    ----------
    rows : int
        How many were seen.
    least, greatest : float
        Infinite where none was.
    """

    rows: int = 0
    least: float = math.inf
    greatest: float = -math.inf

    def see(self, values: Floats) -> None:
        """See consecutive rows."""
        if values.size:
            self.rows += values.size
            self.least = min(self.least, float(values.min()))
            self.greatest = max(self.greatest, float(values.max()))

    @property
    def span(self) -> float:
        """The distance from the least to the greatest."""
        return max(self.greatest - self.least, 0.0)

    @property
    def range(self) -> list[float] | None:
        """The least and the greatest, None without rows."""
        return [self.least, self.greatest] if self.rows else None


@dataclass(frozen=True)
class Drive:
    """The drive of a move.

    Attributes
    ----------
    time : array or None
        Seconds; rows before the move stand before its first stamp. Empty for a stream.
    desired, voltage : array
        Displacement and voltage, row by row; rows that are played as they are (sweep,
        return) have the displacement that the model expects. Empty for a stream.
    move : slice
        The rows of the move itself.
    rows : int
        Of the whole drive.
    least, greatest : float
        Its voltages.
    clipped, first_clipped : int
        Rows of the move that a limit cut off, and the first of them from 1 (0: none).
    lost_rms, lost_most : float
        What the move misses by that, in the displacement's unit.
    expected_error, expected_known : float, optional
        RMS of the error to expect, what is clipped included; and the same if the past
        were known. None where the model does not know.
    past_known : bool
        Whether a sweep or a state makes the past known.
    state : State or None
        After the last row.
    lead : Extent
        Voltages before the move.
    lead_seconds : float
        How long they take.
    limits : Limits
        What the drive may do.
    digest : str
        Name of the model.
    unit : str, optional
        Of the displacement.
    move_range : list of float, optional
        Least and greatest displacement of the move.
    history : tuple of PassRecord
        Of a move that is learned: the passes so far, the last one included.
    notes, warnings : tuple of str
        What a user should know.
    """

    limits: Limits
    digest: str
    unit: str | None
    time: Floats | None = None
    desired: Floats = field(default_factory=lambda: NOTHING, repr=False)
    voltage: Floats = field(default_factory=lambda: NOTHING, repr=False)
    move: slice = field(default_factory=lambda: slice(0))
    rows: int = 0
    least: float = math.inf
    greatest: float = -math.inf
    clipped: int = 0
    first_clipped: int = 0
    lost_rms: float = 0.0
    lost_most: float = 0.0
    expected_error: float | None = None
    expected_known: float | None = None
    past_known: bool = False
    state: State | None = None
    lead: Extent = field(default_factory=Extent)
    lead_seconds: float = 0.0
    move_range: list[float] | None = None
    history: tuple[PassRecord, ...] = ()
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()

    def line(self) -> str:
        """Return what came out: ``4,910 rows, 3.1 to 96.2 V, within limits``."""
        unit, lead = self.limits.suffix, self.lead
        state = "within limits"
        if self.clipped:
            state = f"{self.clipped:,} {'row' if self.clipped == 1 else 'rows'} clipped"
        text = f"{self.rows:,} rows, {self.least:.4g} to {self.greatest:.4g}{unit}, {state}"
        if lead.rows:
            ends = f"{lead.least:.4g} to {lead.greatest:.4g}{unit}"
            text += f"; {self.lead_seconds:.3g} s before the move, {ends}"
        return text

    def expected_line(self) -> str:
        """Return the error to expect; empty where it is not known."""
        if self.expected_error is None:
            return ""
        unit = f" {self.unit}" if self.unit else ""
        error = f"{self.expected_error:.2g}"
        text = f"expected error {error}{unit} RMS"
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
            "model": self.digest,
            "unit": self.unit,
            "rows": self.rows,
            "voltage_range": [self.least, self.greatest] if self.rows else None,
            "move_range": self.move_range,
            "limits": self.limits.as_dict(),
            "lead": {
                "rows": self.lead.rows,
                "seconds": self.lead_seconds,
                "range": self.lead.range,
            },
            "clipped": self.clipped,
            "lost_rms": self.lost_rms,
            "lost_most": self.lost_most,
            "expected_rmse": self.expected_error,
            "expected_rmse_past_known": self.expected_known,
            "past_known": self.past_known,
            "warnings": list(self.warnings),
        }
