"""Any program's drive against limits, by the gate of this program's own; and what was played."""

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from dbo_cli.alignment import RATE_SLACK, Trace, align_drives
from dbo_cli.arrays import Booleans, Floats
from dbo_cli.drive.limits import Limits
from dbo_cli.drive.smooth import open_seam
from dbo_cli.errors import UsageError, prefixed, require_none
from dbo_cli.signals import between, even, noise, step_of

TOLERANCE = 1e-3
"""Of the drive's range, by which a recording may differ: a converter of 10 bits rounds to half of it."""
NOISE = 6.0
"""Standard deviations of a recording's noise: white noise reaches 5 once in two million rows."""
SAME_ROW = 0.02  # rows off an end of the drive, as far as noise moves a lag
HELD = 0.6  # steps of the drive: shorter ones of a recorder show a row that is held
LOST_STEPS = 3.0  # steps, of the drive or the recorder, from which on rows in between are missing
GAP = 1.5  # longest steps around it, from which on a step is a gap
NEIGHBOURS = 16  # steps on either side that say what is usual
EVEN_STEPS = 0.1
"""Of a step: the steps around one differ by less. On an uneven clock nothing says when the next row is due.
Stamps of so even a clock may be rounded, to a twentieth of a step.
"""


@dataclass
class Checked:
    """What a drive asks of an amplifier, and what is wrong with it.

    Attributes
    ----------
    rows, least, greatest, first, last
        Of the drive, in ``unit``.
    largest_step, fastest : float
        From row to row, and per second (None without a clock).
    problems : list of str
        Each with its first row; empty where the drive passes.
    played : dict, optional
        How a recording is like the drive: how many ``rows`` of it the recording holds, by how
        much it is later (``lag_rows``, ``lag_seconds``), recording = ``gain`` * drive +
        ``offset``, and the ``largest_difference`` beside the ``tolerance``, in ``unit``, from
        what lies between two rows where the recorder is clearly faster.
    """

    name: str
    unit: str | None
    rows: int
    least: float
    greatest: float
    first: float
    last: float
    largest_step: float
    fastest: float | None
    problems: list[str] = field(default_factory=list)
    played: dict[str, Any] | None = None

    def json(self) -> str:
        """Return the check as JSON (``dbo-check``)."""
        values = {
            "format": "dbo-check",
            "version": 1,
            "passed": not self.problems,
            **asdict(self),
        }
        return json.dumps(values, indent=2, ensure_ascii=False) + "\n"

    def text(self) -> str:
        """Return the check as lines for a terminal."""
        unit = f" {self.unit}" if self.unit else ""
        verdict = "NOT PASSED" if self.problems else "passed"
        speed = "" if self.fastest is None else f", at most {self.fastest:.6g}{unit}/s"
        lines = [
            f"{self.name}: {verdict}",
            f"  {self.rows:,} rows, {self.least:.6g} to {self.greatest:.6g}{unit}{speed};"
            f" first row {self.first:.6g}{unit}, last row {self.last:.6g}{unit}",
        ]
        if self.played is not None:
            match = self.played
            lag_rows = round(match["lag_rows"], 2) + 0.0
            lines.append(
                f"  played: {match['rows']:,} rows, {lag_rows:g} rows late, gain {match['gain']:.6g}, offset "
                f"{match['offset']:.3g}{unit}, largest difference {match['largest_difference']:.3g}{unit}"
            )
        lines += [f"  {problem}" for problem in self.problems]
        return "\n".join(lines) + "\n"

    def require_passed(self) -> None:
        """Raise LimitError where there is a problem, naming the first."""
        require_none([f"{self.name}: {problem}" for problem in self.problems])


def check_drive(
    voltage: Floats,
    time: Floats | None,
    limits: Limits,
    *,
    name: str = "drive",
    start: float | None = None,
    loop: bool = False,
    tolerance: float = 0.0,
    doubts: Sequence[str] = (),
) -> Checked:
    """Return what is wrong with a drive.

    Parameters
    ----------
    voltage, time : array of shape (rows,)
        Voltages, and seconds where they are known.
    limits : Limits
        Its rating is what the drive may do.
    start : float, optional
        Where the amplifier stands before the first row.
    loop : bool
        The drive is looped: the step from its last row to its first counts, too.
    tolerance : float
        By how much a row may miss a limit, of a recording.
    doubts : sequence of str
        What its reader dropped, guessed or cut: each is a problem.

    Raises
    ------
    InputError
        A slew limit is to be checked and no time is known.
    """
    low, high = limits.rating
    problems, waits, fastest = list(doubts), None, None
    change = np.abs(np.diff(voltage))
    if time is not None and change.size:
        waits, odd = _steps(time)
        if odd.any():
            reason = "time goes back, stands still, or has a gap before it"
            problems.append(_problem(odd, reason))
        if tolerance > 0.0 and limits.slew is not None:
            waits += 2.0 * tolerance / limits.slew  # both rows of a step may miss
        forward = np.diff(time) > 0.0
        if forward.any():
            fastest = float((change[forward] / np.diff(time)[forward]).max())
    if start is not None and not low <= start <= high:
        _, reason = limits.broken(np.array([start]), None, 1.0, "return")
        problems.append(f"the amplifier: {reason}")
    allowed = replace(limits, rating=(low - tolerance, high + tolerance))
    with prefixed(name):
        bad, reason = allowed.broken(voltage, start, waits, "return")
    if reason:
        problems.append(_problem(bad, reason))
    if loop:
        wait = None if waits is None else waits[:1]
        _, reason = allowed.broken(voltage[:1], float(voltage[-1]), wait, "return")
        seam = f"from the last row to the first: {reason}" if reason else ""
        seam = seam or open_seam(voltage)
        if seam:
            problems.append(seam)
    return Checked(
        name=name,
        unit=limits.quantity.unit,
        rows=voltage.size,
        least=float(voltage.min()),
        greatest=float(voltage.max()),
        first=float(voltage[0]),
        last=float(voltage[-1]),
        largest_step=float(change.max(initial=0.0)),
        fastest=fastest,
        problems=problems,
    )


def _steps(time: Floats) -> tuple[Floats, Booleans]:
    """Return the seconds before each row, as long as rounded stamps may hide, and where the clock is odd.

    The first row has the step of the second, as ``compensate`` counts it. A stamp is rounded
    when it is made and when it is read, to its digits or to decimals. In decimals an even
    clock shows steps of two kinds, and the step that is meant lies between them.
    """
    steps = np.diff(time)
    shortest, longest = _around(steps)
    are_even = longest - shortest <= EVEN_STEPS * shortest
    odd = (steps <= 0.0) | (are_even & (steps > GAP * longest))
    steps, longest = np.maximum(steps, 0.0), np.fmax(longest, steps)
    is_even = longest - np.fmin(shortest, steps) <= EVEN_STEPS * steps
    steps = np.where(is_even, longest, steps)
    steps += 2.0 * np.spacing(np.maximum(np.abs(time[1:]), np.abs(time[:-1])))
    return np.concatenate([steps[:1], steps]), np.append(False, odd)


def _around(steps: Floats) -> tuple[Floats, Floats]:
    """Return the shortest and the longest of the 16 steps on either side of each step."""
    shortest = longest = np.pad(steps, NEIGHBOURS, constant_values=np.nan)
    for shift in (1, 2, 4, 8):  # of two, four, eight, sixteen steps
        shortest = np.fmin(shortest[:-shift], shortest[shift:])
        longest = np.fmax(longest[:-shift], longest[shift:])
    before, after = slice(steps.size), slice(NEIGHBOURS + 1, None)
    shortest = np.fmin(shortest[before], shortest[after])
    return shortest, np.fmax(longest[before], longest[after])


def _problem(rows: Booleans, reason: str) -> str:
    """Name the first of some rows, and how many there are."""
    count = int(np.count_nonzero(rows))
    more = f" ({count:,} rows in all)" if count > 1 else ""
    return f"row {int(np.argmax(rows)) + 1:,}: {reason}{more}"


# --- what was played ---


def tolerance_of(drive: Floats, recorded: Floats, tolerance: float | None) -> float:
    """Return by how much a recording may differ: as given, or a thousandth of the range, or its noise.

    Raises
    ------
    UsageError
        It is below 0.
    """
    if tolerance is not None and tolerance < 0.0:
        raise UsageError(f"`tolerance` {tolerance:g}: give 0 or more")
    if tolerance is not None:
        return tolerance
    return max(TOLERANCE * float(np.ptp(drive)), NOISE * noise(recorded))


def check_played(
    checked: Checked,
    drive: Floats,
    recorded: Floats,
    times: tuple[Floats | None, Floats | None],
    tolerance: float,
) -> None:
    """Compare a recording with the drive that was to be played; problems and figures go to ``checked``.

    Parameters
    ----------
    drive, recorded : array
        What was computed, and what was recorded (behind the amplifier's gain).
    times : (array or None, array or None)
        Seconds of each row of the two. At other times the drive is interpolated; where the
        recorder is clearly faster, what lies between two rows of the drive is as good.
        Without a clock one has the rate of the other.
    tolerance : float
        The largest difference allowed.
    """
    usual = 0.0 if times[1] is None else step_of(times[1])
    planned = _on_its_clock(drive, times[0], usual or 1.0)
    step = step_of(planned.time) or usual or 1.0
    trace = _on_its_clock(recorded, times[1], step)
    recorded_step = step_of(trace.time) or step
    found = align_drives(trace, planned)
    lag, time = 0.0, trace.time
    if found is not None:
        lag, time = found.lag.seconds, found.reference_time(time)
    slack = SAME_ROW * step
    inside = (time >= -slack) & (time <= planned.time[-1] + slack)
    row = np.interp(time[inside], planned.time, np.arange(float(drive.size)))
    row, played = np.round(row, 6), recorded[inside]
    meant = between(drive, row)
    gain, offset = 1.0, float(np.mean(played - meant))
    if np.ptp(meant) > 0.0:
        gain, offset = np.polyfit(meant, played, 1).tolist()
    largest = _largest_difference(drive, row, played, recorded_step < HELD * step)
    shared = _rows_held(row, LOST_STEPS * max(1.0, recorded_step / step))
    checked.played = {
        "rows": shared,
        "lag_rows": lag / recorded_step,
        "lag_seconds": None if times[1] is None else lag,
        "gain": gain,
        "offset": 0.0 if abs(offset) < 1e-9 * tolerance else offset,
        "largest_difference": largest,
        "tolerance": tolerance,
    }
    if found is None and np.ptp(drive) > 0.0:
        checked.problems.append("another drive was played: the two do not correlate")
        return
    lost, unit = drive.size - shared, f" {checked.unit}" if checked.unit else ""
    if lost * step >= (1.0 - RATE_SLACK) * recorded_step:
        problem = f"{lost:,} of {drive.size:,} rows are not in the recording"
        checked.problems.append(problem)
    if largest > tolerance:
        uneven = times[1] is not None and even(times[1]) is None
        hint = " by its uneven stamps (`sample_rate` HZ goes by rows)" if uneven else ""
        checked.problems.append(
            f"the recording differs by up to {largest:.4g}{unit}, more than {tolerance:.3g}{unit}{hint}"
        )


def _largest_difference(
    drive: Floats, row: Floats, recorded: Floats, is_held: bool
) -> float:
    """Return by how much a recording is off the drive at places between its rows, at most.

    Where a converter that holds each row until the next one would show, what lies between
    two rows is as good.
    """
    around = [between(drive, row)]
    if is_held:
        around += [drive[np.floor(row).astype(int)], drive[np.ceil(row).astype(int)]]
    low, high = np.min(around, axis=0), np.max(around, axis=0)
    return max(float(np.maximum(recorded - high, low - recorded).max()), 0.0)


def _rows_held(row: Floats, longest: float) -> int:
    """Return how many rows of the drive lie between those of a recording; none within longer steps."""
    steps = np.diff(row)
    lost = round(float(steps[steps > longest].sum()))
    first, last = float(row[0]), float(row[-1])
    return math.ceil(last) - math.floor(first) + 1 - lost


def _on_its_clock(values: Floats, time: Floats | None, step: float) -> Trace:
    """Return a signal with its seconds from the first row on; without a clock a row takes ``step`` (s)."""
    if time is not None:
        even_step = even(time)
        if even_step is None:
            return Trace(time - time[0], values)
        step = even_step
    return Trace(step * np.arange(float(values.size)), values)
