"""What an export tells about itself: sizes, the most work of one step, bounds, and remarks; as data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class ExportSummary:
    """Figures of one export; the README beside the sources shows the same.

    Attributes
    ----------
    folder, name, direction, arithmetic : str
        Where and what was exported.
    files : tuple of str
        Names in the folder.
    gears, table_rows, run : int
        Gears, rows of the gear table, and how many equal gears a row stands for.
    table_bytes, state_bytes : int
        Constant tables (flash), and the state (RAM) on a 32-bit target.
    worst_runs : int
        The most runs of equal gears one step can cross; its work grows with them, not with the gears.
    bounds : mapping
        Derived bounds on the error against the float64 model, in the output's unit and in % of its range;
        empty for double, which gives the same bits.
    gears_loss : mapping
        Where gears were taken away: the largest and the RMS difference this makes on test moves.
    vectors : int
        Samples in the self-test.
    notes : tuple of str
        What the caller must know or do.
    """

    folder: str
    name: str
    direction: str
    arithmetic: str
    files: tuple[str, ...]
    gears: int
    table_rows: int
    run: int
    table_bytes: int
    state_bytes: int
    worst_runs: int
    vectors: int
    bounds: Mapping[str, float] = field(default_factory=dict)
    gears_loss: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
