"""Two recordings of one drive on one clock: by what both hold.

By the drive, where both recorded it: to a hundredth of a row, whatever the actuator did.
Otherwise by the displacement against what is expected of it: then a delay of actuator
and sensor is part of the shift, and a loop makes it uncertain.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dbo_cli.arrays import Floats
from dbo_cli.signals import Lag, even, lag

LONGEST = 1 << 17
"""Rows of the longer recording in the search; a longer one is looked at in coarser steps."""
SAME_STEP = 1e-6
"""Part of a step by which two clocks of one step may differ."""
RATE_SHOWS = 0.1
"""Rows that two rates must bring apart over a recording before they count as different."""
WHOLE_BY_DRIVE, WHOLE_BY_DISPLACEMENT = 0.02, 0.5
"""Rows off a whole one, up to which one card is taken to have played and recorded, at one step.

A displacement does not tell parts of a row: what is left of creep is a phase, too."""
SAME_DRIVE = 0.05
"""Part of the variance that a recorded drive may differ by, apart from its gain."""


@dataclass(frozen=True)
class Alignment:
    """How the clock of one recording is related to that of another.

    Attributes
    ----------
    late_start, early_start
        First time stamps (s) of the two.
    lag
        By how much the late one's signal comes later, from first row to first row (s).
    step
        Seconds a row of the slower clock.
    """

    late_start: float
    early_start: float
    lag: Lag
    step: float

    @property
    def ahead(self) -> float:
        """Seconds by which the late recording's stamps are ahead of the other's at its beginning."""
        return self.late_start - self.early_start + self.lag.seconds

    @property
    def deviation_rows(self) -> float:
        """One standard deviation of it in rows of the slower clock."""
        return self.lag.deviation / self.step

    def early_time(self, late_time: Floats) -> Floats:
        """Return stamps of the late recording on the clock of the other (s)."""
        return self.early_start + self.lag.early_time(late_time - self.late_start)


def mean_step(time: Floats) -> float:
    """Return the seconds a row of a clock; 0 where it stands still."""
    step = even(time)
    return float(np.median(np.diff(time))) if step is None else step


def align_drives(
    late_time: Floats, late: Floats, early_time: Floats, early: Floats
) -> Alignment | None:
    """Lay two recordings of one drive over each other; None where they are not of one drive.

    Parameters
    ----------
    late_time, late : array of shape (rows,)
        Stamps (s) and drive of the one; gain and offset may differ.
    early_time, early : array of shape (other rows,)
        Those of the other.
    """
    found = aligned(late_time, late, early_time, early, rate=True)
    if found is None:
        return None
    if abs(found.lag.rate) * np.ptp(late_time) < RATE_SHOWS * found.step:
        found = aligned(late_time, late, early_time, early)
    if found is None or found.lag.residual > SAME_DRIVE:
        return None
    return _on_whole_rows(found, late_time, early_time, WHOLE_BY_DRIVE)


def align_displacements(
    late_time: Floats, late: Floats, early_time: Floats, early: Floats
) -> Alignment | None:
    """Lay a measured displacement over an expected one; None where the two do not tell.

    Parameters are those of ``align_drives``; ``early`` may have further columns of what
    the displacement may be made of.
    """
    found = aligned(late_time, late, early_time, early)
    if found is None:
        return None
    return _on_whole_rows(found, late_time, early_time, WHOLE_BY_DISPLACEMENT)


def aligned(
    late_time: Floats,
    late: Floats,
    early_time: Floats,
    early: Floats,
    *,
    rate: bool = False,
    inverted: bool = False,
) -> Alignment | None:
    """Return how two recordings lie over each other, by ``signals.lag``; see there for the options."""
    if min(len(late_time), len(early_time)) < 2:
        return None
    longest = max(float(np.ptp(late_time)), float(np.ptp(early_time)))
    step = max(mean_step(late_time), mean_step(early_time), longest / LONGEST)
    if not step > 0.0:
        return None
    found = lag(
        _sampled(late_time, late, step),
        _sampled(early_time, early, step),
        step,
        rate=rate,
        inverted=inverted,
    )
    if found is None:
        return None
    return Alignment(float(late_time[0]), float(early_time[0]), found, step)


def _sampled(time: Floats, values: Floats, step: float) -> Floats:
    """Return signals on an even grid of a step (s) from their first stamp on."""
    own = even(time)
    if own is not None and abs(own / step - 1.0) < SAME_STEP:
        return values
    grid = np.arange(time[0], time[-1] + 1e-6 * step, step)
    columns = [np.interp(grid, time, column) for column in np.atleast_2d(values.T)]
    return np.column_stack(columns) if values.ndim > 1 else columns[0]


def _on_whole_rows(
    found: Alignment, late_time: Floats, early_time: Floats, slack: float
) -> Alignment:
    """Return the alignment by whole rows where one card may have played and recorded."""
    steps = even(late_time), even(early_time)
    if steps[0] is None or steps[1] is None or found.lag.rate:
        return found
    if abs(steps[0] / steps[1] - 1.0) > SAME_STEP:
        return found
    rows = round(found.lag.seconds / steps[1])
    off = abs(found.lag.seconds / steps[1] - rows)
    if off > max(slack, 3.0 * found.deviation_rows):
        return found
    return replace(found, lag=replace(found.lag, seconds=rows * steps[1]))
