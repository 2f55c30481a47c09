"""Any program's drive against limits, by the gate that this program's own pass; and what was played."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dbo_cli.drives.compensation import DriveFigures
from dbo_cli.drives.gate import DriveGate, Floats
from dbo_cli.errors import InputError
from dbo_cli.hysteresis.delay import interpolated
from dbo_cli.hysteresis.model_state import DriveLimits
from dbo_cli.logs.clock import GAP_STEPS, median_step

TOLERANCE = 1e-3  # of the drive's range: a converter of 10 bits rounds to half of it
ANOTHER = 0.5  # correlation below which a recording is of another drive
SAME_RATE = 1e-3  # two clocks may differ by this fraction


@dataclass
class CheckedDrive:
    """What a drive asks of an amplifier, and what is wrong with it.

    Attributes
    ----------
    figures : DriveFigures
        Range, steps and speed of the drive.
    problems : list of str
        Limits that are broken, each with its first place; empty where none is.
    played : dict
        With a recording: rows, lag, gain, offset, largest difference.
    """

    figures: DriveFigures
    problems: list[str] = field(default_factory=list)
    played: dict[str, Any] = field(default_factory=dict)


def check_drive(
    drive: Floats,
    time: Floats | None,
    limits: DriveLimits,
    *,
    from_: float | None = None,
    loop: bool = False,
    place: Callable[[int], str] = lambda row: f"row {row + 1}",
) -> CheckedDrive:
    """Return what is wrong with a drive.

    Parameters
    ----------
    drive, time
        Voltages, and seconds where they are known.
    limits
        What the drive may do; infinite where nothing is asked.
    from_
        Where the amplifier stands before the first row.
    loop
        The drive is looped: the step from its last row to its first counts, too.
    place
        How messages call a row (from 0).

    Raises
    ------
    InputError
        A slew limit is to be checked and no time is known.
    """
    steps: Floats | None = None
    checked = CheckedDrive(DriveFigures())
    if time is not None and time.size > 1:
        steps = np.diff(time)
        forward = steps[steps > 0.0]
        usual = median_step(forward) if forward.size else 0.0
        steps = np.concatenate([[usual], steps])
        for what, odd in (
            ("time goes backwards", steps < 0.0),
            ("the time stamp repeats", steps == 0.0),
            ("a gap in time", steps > GAP_STEPS * usual),
        ):
            if odd.any():
                checked.problems.append(_problem(place, odd, what))
        steps = np.maximum(steps, 0.0)
    elif limits.max_slew is not None:
        raise InputError("there is no time, and `max_slew` depends on it (`time` COLUMN or `sample_rate` HZ)")
    checked.figures.see(drive, steps)
    gate = DriveGate(limits, from_)
    before = np.concatenate([[drive[0] if from_ is None else from_], drive[:-1]])
    bad = gate.broken(drive, steps)
    if bad.any():
        row = int(np.argmax(bad))
        reason = gate.reason(float(drive[row]), float(before[row]))
        checked.problems.append(_problem(place, bad, reason))
    if loop:
        seam = gate.violation(drive[:1], None if steps is None else steps[:1])
        inside = float(np.abs(np.diff(drive)).max(initial=0.0))
        if seam is not None:
            checked.problems.append(f"from the last row to the first: {seam.reason}")
        elif abs(drive[0] - drive[-1]) > 3.0 * inside:  # as a period that does not close (see ``loops``)
            checked.problems.append(
                f"from the last row, {drive[-1]:.6g}, to the first, {drive[0]:.6g}, is a step of "
                f"{abs(drive[0] - drive[-1]):.3g} where the largest inside is {inside:.3g}: the loop does "
                "not close"
            )
    return checked


def _problem(place: Callable[[int], str], odd: Any, reason: str) -> str:
    count = int(np.count_nonzero(odd))
    more = f" ({count:,} rows in all)" if count > 1 else ""
    return f"{place(int(np.argmax(odd)))}: {reason}{more}"


def check_played(
    checked: CheckedDrive,
    drive: Floats,
    played: Floats,
    steps: tuple[float | None, float | None],
    tolerance: float | None = None,
) -> None:
    """Compare a recording of the drive with what was to be played; problems and figures go to ``checked``.

    Parameters
    ----------
    drive, played
        What was computed, and what was recorded.
    steps
        Seconds a row of the two, where they are known: at another rate the drive is interpolated.
    tolerance
        Largest difference allowed; a thousandth of the drive's range where not given.
    """
    span = float(np.ptp(drive))
    most = TOLERANCE * span if tolerance is None else tolerance
    own, other = steps
    resampled = own is not None and other is not None and abs(other / own - 1.0) > SAME_RATE
    if resampled and own is not None and other is not None:
        count = int((drive.size - 1) * own / other + 1e-9) + 1
        drive = interpolated(own * np.arange(float(drive.size)), drive, other * np.arange(float(count)))[0]
    lag = _lag(drive, played)
    begin, end = max(0, -lag), min(drive.size, played.size - lag)
    a, b = drive[begin:end], played[begin + lag : end + lag]
    columns = np.column_stack([a - a.mean(), np.ones(a.size)])
    gain, middle = np.linalg.lstsq(columns, b, rcond=None)[0].tolist()
    offset = middle - gain * float(a.mean())
    alike = 1.0 if span == 0.0 else abs(float(np.corrcoef(a, b)[0, 1])) if np.ptp(b) > 0.0 else 0.0
    largest = float(np.abs(b - a).max())
    left = float(np.abs(b - gain * a - offset).max())
    checked.played = {
        "rows": int(a.size), "lag_rows": lag, "lag_seconds": None if other is None else lag * other,
        "resampled": resampled, "gain": gain, "offset": offset, "largest_difference": largest,
        "difference_after_gain_and_offset": left, "tolerance": most,
    }  # fmt: skip
    if alike < ANOTHER:
        checked.problems.append("what was played is another drive: the two have nothing in common")
        return
    if a.size < drive.size:
        checked.problems.append(f"{drive.size - a.size:,} of {drive.size:,} rows were not played")
    if largest > most:
        cause = (
            f"gain {gain:.6g} and offset {offset:.6g} explain all but {left:.3g}"
            if left <= 0.5 * largest
            else "neither a gain nor an offset explains it"
        )
        checked.problems.append(
            f"what was played differs by up to {largest:.6g}, more than {most:.3g} ({cause})"
        )


def _lag(drive: Floats, played: Floats) -> int:
    """Return by how many rows the recording is later: where the two are most alike."""
    from scipy.signal import correlate

    likeness = np.abs(correlate(played - played.mean(), drive - drive.mean(), method="fft"))
    near = np.flatnonzero(likeness >= likeness.max() * (1.0 - 1e-9))
    lags = near - (drive.size - 1)
    return int(lags[np.argmin(np.abs(lags))])
