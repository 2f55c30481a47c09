"""What is asked of the drive of a move that is repeated, besides what any drive is asked."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from dbo_cli.drives.options import DriveOptions
from dbo_cli.errors import UsageError


@dataclass(frozen=True)
class RepeatOptions(DriveOptions):
    """Options of a loop, or of a move that is learned pass by pass.

    Of ``DriveOptions``, ``lead`` of a loop is the rest before its run-in (two passes at
    least), at the voltage that brings the creep where the loop needs it, auto: as few
    seconds as that takes; and ``bandwidth`` with recordings of the last pass is the
    cut-off of what is learned.

    Attributes
    ----------
    absolute : bool
        With recordings of the last pass, learn the mean of the error, too; it is taken
        for the sensor's zero otherwise.
    history : str, optional
        A file that keeps the error of each pass, so that growth is seen.
    periodic : bool
        The trajectory is one period of a loop; the drive is that of the settled loop.
    passes : int
        With ``periodic``, so many passes of run-in before it.
    learns : bool
        There are recordings of the last pass.

    Raises
    ------
    UsageError
        A value is none, or two exclude each other.
    """

    absolute: bool = False
    history: str | None = None
    periodic: bool = False
    passes: int = 0
    learns: bool = False

    def __post_init__(self) -> None:
        """Check what excludes what, before anything is read."""
        super().__post_init__()
        if self.passes and not self.periodic:
            raise UsageError("`passes` is the run-in of a loop (`periodic`)")
        if self.passes < 0:
            raise UsageError(f"`passes` {self.passes}: give a whole number of passes")
        if self.periodic and self.condition:
            raise UsageError(
                "`periodic` and `condition` exclude each other (`passes` N runs a loop in)"
            )
        if self.periodic and self.return_ is not None:
            raise UsageError(
                "`periodic` and `return_` exclude each other: a loop goes on"
            )

    @property
    def why_time(self) -> str | None:
        """Why the time between samples is needed, where it is."""
        if self.learns:
            return "`tracked` depends on it"
        why = super().why_time
        if why is None and self.periodic:
            return "`periodic` depends on it"
        return why

    @property
    def rounding(self) -> float | None:
        """Cut-off (Hz) with which the trajectory's corners are rounded; not where what was learned is."""
        return None if self.learns else self.bandwidth


def repeat_options(options: DriveOptions, brought: Mapping[str, Any]) -> RepeatOptions:
    """Return the options of a drive with those that this extra brings; recordings are none of them.

    Raises
    ------
    UsageError
        A value is none, or two exclude each other.
    """
    fields = {
        field.name: getattr(options, field.name)
        for field in dataclasses.fields(DriveOptions)
    }
    names = ("absolute", "history", "periodic", "passes")
    values = {name: brought[name] for name in names if name in brought}
    learns = bool(brought.get("tracked"))
    if values.get("history") is not None and not learns:
        raise UsageError(
            "`history` keeps the error of the passes that `tracked` recorded: give both"
        )
    return RepeatOptions(**fields, **values, learns=learns)
