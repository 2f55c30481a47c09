"""A recording and a trajectory that lie in two files: which rows belong together."""

from dataclasses import replace

import numpy as np

from dbo_cli.alignment import (
    ACTUATOR_LAG,
    CLEARLY_BETTER,
    RATE_SLACK,
    Alignment,
    Trace,
    align_displacements,
    align_drives,
    on_whole_rows,
)
from dbo_cli.errors import InputError
from dbo_cli.reports.pair import Pair, rows_text

WHOLE_BY_DISPLACEMENT = 0.5
"""Rows: a displacement does not tell parts of one, since what is left of creep is a phase, too."""


def match(recording: Pair, trajectory: Pair, by: str = "auto") -> Pair:
    """Give every row of a recording the desired value that belongs to it.

    Parameters
    ----------
    recording
        The measured values, perhaps with a clock and a drive.
    trajectory
        The desired values, perhaps with rows before the move at negative times; its
        drive, by which "auto" lays a recording of it over.
    by : {"auto", "time", "rows"}
        "rows": the first belongs to the first. "time": by two clocks that agree.
        "auto": by time where both have one, else by rows; a recorder that was started
        earlier or later is found, taken off and noted.

    Raises
    ------
    InputError
        The rates differ where rows are matched, a clock is missing, or no row of one
        belongs to a row of the other.
    """
    recording = replace(recording, on_drive_clock=True)
    clockless = [pair.name for pair in (recording, trajectory) if pair.time is None]
    if by == "rows" or (by == "auto" and clockless):
        pair = _by_rows(recording, trajectory)
    elif clockless:
        raise InputError(
            f"{clockless[0]}: has no time: add `sample_rate`, or `match` rows"
        )
    else:
        if by == "auto":
            recording = _on_one_clock(recording, trajectory)
        pair = _by_time(recording, trajectory)
    if not len(pair):
        raise InputError(
            f"{pair.name}: no row lies within the time of {trajectory.name}: try `match` rows"
        )
    outside = len(recording) - len(pair)
    if outside:
        pair = pair.noted(f"{rows_text(outside)} outside {trajectory.name} left out")
    return pair


def _by_rows(recording: Pair, trajectory: Pair) -> Pair:
    """Match row by row; the time is the trajectory's."""
    step, desired_step = recording.step, trajectory.step
    if step is not None and desired_step is not None:
        if abs(step / desired_step - 1.0) > RATE_SLACK:
            raise InputError(
                f"{recording.name}: {1.0 / step:.5g} Hz, {trajectory.name}: {1.0 / desired_step:.5g} Hz:"
                " rows do not correspond; type `match` time"
            )
    count = min(len(recording), len(trajectory))
    pair = recording.taken(np.arange(len(recording)) < count)
    pair = replace(pair, desired=trajectory.desired[:count])
    if trajectory.time is not None:
        pair = replace(pair, time=trajectory.time[:count])
    missing = len(trajectory) - len(recording)
    if missing > 0:
        pair = pair.noted(f"{rows_text(missing)} fewer than in {trajectory.name}")
    return pair


def _by_time(recording: Pair, trajectory: Pair) -> Pair:
    """Match by time: the desired signal is interpolated at the recording's times."""
    clock, slack = trajectory.clock, 1e-6 * (trajectory.step or 0.0)
    time = recording.clock
    pair = recording.taken((time >= clock[0] - slack) & (time <= clock[-1] + slack))
    return replace(pair, desired=np.interp(pair.clock, clock, trajectory.desired))


def _on_one_clock(recording: Pair, trajectory: Pair) -> Pair:
    """Put a recording on the trajectory's clock, by the drive where both hold it.

    By the displacement, where that is sure: as late as an actuator may be, it is an error.
    """
    name = trajectory.name
    if trajectory.voltage is not None and recording.voltage is not None:
        found = align_drives(
            Trace(recording.clock, recording.voltage),
            Trace(trajectory.clock, trajectory.voltage),
        )
        if found is not None:
            return _shifted(recording, found, f"that of {name}, by the drive")
        recording = recording.warned(f"its drive is not that of {name}")
    found = _by_displacement(recording, trajectory)
    least = -0.5 * (recording.step or 0.0)
    if found is None or least <= found.ahead <= ACTUATOR_LAG:
        return recording
    shifted = _shifted(recording, found, f"that of {name}")
    before, after = _scatter(recording, trajectory), _scatter(shifted, trajectory)
    if after >= before:
        return recording
    is_clear = after <= CLEARLY_BETTER * before
    if is_clear and not _rival_holds(found, recording, trajectory):
        return replace(shifted, delay_removed=True)
    return recording.warned(
        f"its clock may be {found.ahead:.4g} s ahead of that of {name}, which is not sure: its stamps are"
        " taken; record the drive, too, or try `match` rows"
    )


def _rival_holds(found: Alignment, recording: Pair, trajectory: Pair) -> bool:
    """Return whether another lag explains the move, and the recording would hold all of it there, too."""
    if found.lag.rival is None:
        return False
    later = found.lag.rival - found.lag.seconds
    first, last = found.recorded_time(trajectory.clock[[0, -1]]) + later
    time, slack = recording.clock, ACTUATOR_LAG
    return bool(first > time[0] - slack and last < time[-1] + slack)


def _shifted(recording: Pair, found: Alignment, other: str) -> Pair:
    """Return a recording with the times of another clock, and a note of it where they differ."""
    time = found.reference_time(recording.clock)
    if np.abs(time - recording.clock).max() <= 0.01 * found.step:
        return recording
    side = "ahead of" if found.ahead > 0.0 else "behind"
    shifted = replace(recording, time=time, clock_offset=found.ahead)
    return shifted.noted(
        f"its clock is {abs(found.ahead):.4g} s {side} {other}; this is taken off"
    )


def _scatter(recording: Pair, trajectory: Pair) -> float:
    """Return the RMS of the error without its mean by the stamps; infinite for fewer than two rows."""
    pair = _by_time(recording, trajectory)
    if len(pair) < 2:
        return np.inf
    return float(np.std(pair.measured - pair.desired))


def _by_displacement(recording: Pair, trajectory: Pair) -> Alignment | None:
    """Return how the measured displacement lies over the move, on whole rows where clocks have one step.

    What stands before the move is left out, where it is not needed: there the displacement
    is less well known. A ramp that is late looks like one that is lower.
    """
    clock, desired = trajectory.clock, trajectory.desired
    measured = Trace(recording.clock, recording.measured)
    move = clock >= 0.0
    if np.unique(desired[move]).size < 2:
        move = np.ones(len(clock), dtype=bool)
    found = align_displacements(measured, Trace(clock[move], desired[move]))
    if found is None or found.lag.rival is not None:
        found = align_displacements(measured, Trace(clock, desired))
    if found is None:
        return None
    return on_whole_rows(found, WHOLE_BY_DISPLACEMENT)
