"""Two recordings of one drive on one clock: by what both hold.

By the drive, where both recorded it: to a hundredth of a row, whatever the actuator did.
Otherwise by the displacement against what is expected of it: then a delay of actuator
and sensor is part of the shift, and a loop makes it uncertain.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from dbo_cli.arrays import Floats
from dbo_cli.signals import TimeLag, even, lag, residual_at, step_of

LONGEST = 1 << 17
"""Rows of the longer recording in the search; a longer one is looked at in coarser steps."""
SAME_STEP = 1e-6
"""Part of a step by which two clocks of one step may differ."""
RATE_SLACK = 1e-3
"""Part by which two clocks may differ; quartz does by some 1e-4."""
RATE_SHOWS = 0.98
"""Part of what one rate leaves that two rates must leave at most before they count as different."""
WHOLE_BY_DRIVE = 0.02
"""Rows off a whole one, up to which one card is taken to have played and recorded, at one step."""
PLAYS = np.geomspace(0.01, 0.7, 24)
"""Half widths, in parts of the range, of the plays that explain a loop beside a lag."""
NEAR_END = 0.005
"""Part of the range: nearer to an end, the past of a loop is gone."""
SMALL_LOOP = 1e-3
"""Part of the measured variance below which no loop is looked for: 3 % of the move."""
LOOP_SHOWS = 0.25
"""Part of the unexplained variance that plays must leave at most for a loop to be there."""
CLEARLY_BETTER = 0.5
"""Part of what the stamps leave, that another alignment must leave at most to be believed."""
APART_SHOWS = 5e-4
"""Part of the variance that stamps leave at least where they are wrong: 2 % of the move.

On 36 logs, right ones leave at most 3.4e-4 beside a loop, and 30 ms off at least 5.4e-4
where no swing repeats.
"""
CLEARLY_APART = 5.0
"""Standard deviations of a lag from which on two clocks count as apart."""
USUAL_LAG = 0.01
"""Seconds that most actuators with amplifier and sensor stay below; what is later is told of."""
ACTUATOR_LAG = 0.05
"""Seconds that an actuator, its amplifier and its sensor may be late; more is a recorder's start."""
DRIVE_RESIDUAL = 0.05
"""Part of the variance that a recorded drive may differ by, apart from its gain."""


class Trace(NamedTuple):
    """A signal of shape (rows,), with the time of each row (s)."""

    time: Floats
    values: Floats


@dataclass(frozen=True)
class Alignment:
    """How the clock of one recording is related to that of another.

    Attributes
    ----------
    start, reference_start
        First time stamps (s) of the two.
    lag
        By how much the signal comes later, from first row to first row (s).
    step
        Seconds a row of the slower clock.
    row_step
        Seconds a row of two even clocks that have one step; None of others.
    """

    start: float
    reference_start: float
    lag: TimeLag
    step: float
    row_step: float | None

    @property
    def ahead(self) -> float:
        """Seconds by which the recording's stamps are ahead of the other's at its beginning."""
        return self.start - self.reference_start + self.lag.seconds

    def recorded_time(self, reference_time: Floats) -> Floats:
        """Return stamps of the other recording on the clock of the recording (s)."""
        times: Floats = reference_time - self.reference_start + self.lag.seconds
        return self.start + times / (1.0 - self.lag.rate)

    def reference_time(self, time: Floats) -> Floats:
        """Return stamps of the recording on the clock of the other (s)."""
        times: Floats = (time - self.start) * (1.0 - self.lag.rate) - self.lag.seconds
        return self.reference_start + times


def align_drives(drive: Trace, reference: Trace) -> Alignment | None:
    """Lay two recordings of one drive over each other; None where they are not of one drive.

    Gain and offset may differ.
    """
    found = aligned(drive, reference, rate=True)
    if found is None or found.lag.residual > DRIVE_RESIDUAL:
        return None
    return on_whole_rows(found, WHOLE_BY_DRIVE)


def align_displacements(
    displacement: Trace,
    reference: Trace,
    *,
    rate: bool = False,
    inverted: bool = False,
) -> Alignment | None:
    """Lay a measured displacement over what it follows; None where the two do not tell.

    A loop is a phase, too, and so is creep: where the displacement is no straight line
    of what it follows, plays of that, its square and a drift stand beside it (a
    Prandtl-Ishlinskii sum, linear in its weights).

    Parameters
    ----------
    displacement, reference
        What was measured; and the expected displacement, or the drive.
    rate, inverted
        As in ``signals.lag``.
    """
    found = aligned(displacement, reference, inverted=inverted)
    if found is None or found.lag.residual < SMALL_LOOP:
        return found
    loop = aligned(displacement, reference, rate=rate, inverted=inverted, loops=True)
    if loop is None or loop.lag.residual > LOOP_SHOWS * found.lag.residual:
        return found
    return loop


def aligned(
    trace: Trace,
    reference: Trace,
    *,
    rate: bool = False,
    inverted: bool = False,
    loops: bool = False,
) -> Alignment | None:
    """Return how two recordings lie over each other, by ``signals.lag``; see there for the options.

    ``loops``: the signal may be made of plays of the reference, too. A rate counts
    where it shows, and where two clocks may differ by it.
    """
    times = trace.time, reference.time
    if min(map(len, times)) < 2 or np.ptp(reference.values) == 0.0:
        return None
    longest = max(float(np.ptp(time)) for time in times)
    step = max(*map(step_of, times), longest / LONGEST)
    if not step > 0.0:
        return None
    signal, columns = _sampled(trace, step), _sampled(reference, step)
    row_step, even_step = even(reference.time), even(trace.time)
    if row_step is None or even_step is None or not _alike(even_step, row_step):
        row_step = None
    begin = 0
    if loops:
        begin, columns = loop_columns(columns)
    found = lag(signal, columns, step, inverted=inverted)
    if found is None:
        return None
    if rate:
        running = lag(signal, columns, step, rate=True, inverted=inverted)
        if running is not None and running.residual < RATE_SHOWS * found.residual:
            found = running if abs(running.rate) <= RATE_SLACK else found
    start = float(reference.time[0]) + begin * step
    return Alignment(float(trace.time[0]), start, found, step, row_step)


def are_apart(found: Alignment, displacement: Trace, reference: Trace) -> bool:
    """Return whether an alignment explains a displacement clearly better than the stamps do.

    A usual lag of the actuator is allowed for, and a loop: of a single swing that repeats, the
    two do not tell.
    """
    clearly = found.step + CLEARLY_APART * found.lag.deviation
    if -clearly <= found.ahead <= clearly + USUAL_LAG:
        return False
    begin, columns = loop_columns(_sampled(reference, found.step))
    signal = _sampled(displacement, found.step)
    shift = begin - (found.start - float(reference.time[0])) / found.step
    residual = residual_at(signal, columns, shift)
    return residual > max(APART_SHOWS, found.lag.residual / CLEARLY_BETTER)


def loop_columns(signal: Floats) -> tuple[int, Floats]:
    """Return what follows a signal with loops (itself, its square, a drift, plays), and their first row.

    There the signal has been at both ends of its range, if more than half of it follows,
    else at one: the plays no longer depend on what was before.
    """
    level = (signal - signal.min()) / np.ptp(signal)
    ends = int(np.argmax(level <= NEAR_END)), int(np.argmax(level >= 1.0 - NEAR_END))
    begin = max(ends) if max(ends) < 0.5 * len(level) else min(ends)
    level = level[begin:]
    drift = np.linspace(0.0, 1.0, len(level))
    return begin, np.column_stack([level, level**2, drift, _plays(level)])


def _plays(level: Floats) -> Floats:
    """Return plays of a signal of 0 to 1 in every row, shape (rows, plays)."""
    plays = np.empty((len(level), len(PLAYS)))
    half = np.minimum(PLAYS, 0.5)
    state = np.clip(level[0], half, 1.0 - half)
    for row, value in enumerate(level):
        state = np.minimum(np.maximum(state, value - PLAYS), value + PLAYS)
        plays[row] = state
    return plays


def _sampled(trace: Trace, step: float) -> Floats:
    """Return a signal on an even grid of a step (s) from its first stamp on."""
    time, values = trace
    even_step = even(time)
    if even_step is not None and _alike(even_step, step):
        return values
    grid = np.arange(time[0], time[-1] + 1e-6 * step, step)
    return np.interp(grid, time, values)


def _alike(step: float, other: float) -> bool:
    """Return whether two steps (s) are those of one clock."""
    return abs(step / other - 1.0) <= SAME_STEP


def on_whole_rows(found: Alignment, slack: float) -> Alignment:
    """Return the alignment by whole rows where one card may have played and recorded."""
    lag, step = found.lag, found.row_step
    if lag.rate or step is None:
        return found
    rows = round(lag.seconds / step)
    if abs(lag.seconds / step - rows) > max(slack, 3.0 * lag.deviation / found.step):
        return found
    return replace(found, lag=replace(lag, seconds=rows * step))
