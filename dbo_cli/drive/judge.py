"""What is judged of a drive: what limits cut off, what to expect, what to warn of, and what would fit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from dbo_cli.arrays import Floats
from dbo_cli.drive.limits import Limits, rounded_up
from dbo_cli.errors import InputError, LimitError
from dbo_cli.model import Cascade, Run, State, Steps

if TYPE_CHECKING:
    from dbo_cli.model.expect import ExpectedError

ALLOWED_PART = 0.01
"""Of the move: so much of it (RMS) may be cut off unasked; the order of a good model's error; chosen."""
# of the range: a trajectory this little outside is clipped like any other
REACH_SLACK = 0.01
FIRST_ROWS = 131_072  # of a move, that expectations and refusals look at again
OFF_AT_FIRST = 1e-3  # of the range: so far off its first value may a drive begin unsaid
JUMP = 0.01  # of the range: a first step that is said
LONG_HOLD = 100.0  # times the longest time constant: what creeps has come to rest


@dataclass(frozen=True)
class Clipping:
    """What limits cut off the rows of a move so far.

    Attributes
    ----------
    rows : int
        Of the move.
    clipped, first : int
        Rows that a limit cut off, and the first of them from 1 (0: none).
    squares, largest : float
        Sum of the squares of what the move misses by that, and the largest of it.
    unreachable : int
        Rows that are beyond the model's reach.
    low, high : float
        Least and greatest displacement of the move.
    """

    rows: int = 0
    clipped: int = 0
    first: int = 0
    squares: float = 0.0
    largest: float = 0.0
    unreachable: int = 0
    low: float = math.inf
    high: float = -math.inf

    @property
    def rms(self) -> float:
        """What the move misses (RMS)."""
        return math.sqrt(self.squares / self.rows) if self.clipped else 0.0

    def said(self, limits: Limits) -> str:
        """Return how much of the move the limits forbid, in words."""
        return (
            f"{self.clipped:,} of {self.rows:,} rows (first: row {self.first:,}) exceed "
            f"{limits.describe()}"
        )


def clip(
    so_far: Clipping,
    model: Cascade,
    desired: Floats,
    target: Floats,
    run: Run,
    state: State,
    dt: Steps,
) -> Clipping:
    """Return what limits cut off a move with the next rows of it.

    Parameters
    ----------
    desired, target
        The rows, and what the static part was to reach for them.
    run, state
        The drive of them, and the state before it.
    """
    first = so_far.first
    if run.clipped and not so_far.clipped:
        first = so_far.rows + run.first_clipped + 1
    slack = REACH_SLACK * model.output.span
    low, high = model.output.min - slack, model.output.max + slack
    result = replace(
        so_far,
        rows=so_far.rows + desired.size,
        clipped=so_far.clipped + run.clipped,
        first=first,
        unreachable=so_far.unreachable
        + int(np.count_nonzero((desired < low) | (desired > high))),
        low=min(so_far.low, float(desired.min())),
        high=max(so_far.high, float(desired.max())),
    )
    if not result.clipped:
        return result
    lost = target - model.static.run(run.y, state, dt).y
    # a settled start may step over the first value: no limit does that
    lost[: max(first - 1 - so_far.rows, 0)] = 0.0
    return replace(
        result,
        squares=so_far.squares + float(np.square(lost).sum()),
        largest=max(so_far.largest, float(np.abs(lost).max())),
    )


@dataclass
class Excerpt:
    """The first rows of a drive, at most ``FIRST_ROWS`` of the move, which judgements play again.

    Attributes
    ----------
    voltage, steps
        Rows before the move and of it, part by part, and their time steps.
    target
        What the static part was to reach for the move, with the time steps; nothing where
        the move is longer, or no slew is limited.
    state
        Before the move.
    """

    voltage: list[Floats] = field(default_factory=list)
    steps: list[Steps] = field(default_factory=list)
    target: list[tuple[Floats, Steps]] = field(default_factory=list)
    state: State | None = None

    def played(self) -> tuple[Floats, Steps]:
        """Return the voltages in one array, and their time steps; one number where all are alike."""
        voltage = np.concatenate(self.voltage)
        steps = []
        for rows, dt in zip(self.voltage, self.steps, strict=True):
            if dt is None:
                return voltage, None
            steps.append(np.broadcast_to(dt, rows.shape))
        dt = np.concatenate(steps)
        return voltage, float(dt[0]) if (dt == dt[0]).all() else dt


# --- refusals ---


def require_reached(
    name: str,
    model: Cascade,
    limits: Limits,
    clipping: Clipping,
    excerpt: Excerpt,
    is_auto: bool,
    period: float | None = None,
) -> None:
    """Refuse a move of which nothing can be reached, or of which the limits cut off too much.

    Parameters
    ----------
    name
        Of the trajectory.
    is_auto
        Whether what costs too much is refused.
    period
        Seconds, where the move is one period of a loop.

    Raises
    ------
    InputError
        No row of the trajectory is within what the model reaches.
    LimitError
        More than a hundredth of the move would be missed.
    """
    reach, unit = model.output, model.output.suffix
    if clipping.unreachable == clipping.rows:
        raise InputError(
            f"{name}: every row is outside the model's reach, {reach.min:.6g} to {reach.max:.6g}"
            f"{unit}: check unit, column and zero of the trajectory"
        )
    size, what = clipping.high - clipping.low, "the move"
    if not size > 0.0:
        size, what = reach.span, "the model's range"
    if not is_auto or clipping.rms <= ALLOWED_PART * size:
        return
    fits = would_fit(model, limits, clipping, excerpt, period)
    raise LimitError(
        f"{name}: {clipping.said(limits)}, by {clipping.rms:.3g}{unit} RMS "
        f"({100.0 * clipping.rms / size:.2g} % of {what}){fits} (or `on_limit` clip)"
    )


def would_fit(
    model: Cascade,
    limits: Limits,
    clipping: Clipping,
    excerpt: Excerpt,
    period: float | None = None,
) -> str:
    """Return what would fit, where that is one number; else an empty text."""
    texts = _reach_texts(model, limits, clipping)
    slower = _times_slower(model, limits, excerpt)
    if not texts and slower > 1.0:
        what = f"it {rounded_up(slower):g} times slower"
        if period is not None:
            what = f"{1.0 / (slower * period):.2g} Hz"
        texts.append(f"{limits.slew:g}{limits.suffix}/s allows {what}")
    return f"; {', '.join(texts)}" if texts else ""


def _reach_texts(model: Cascade, limits: Limits, clipping: Clipping) -> list[str]:
    """Return what the ends of the range reach, where the move goes beyond that."""
    static, ends = model.static, []
    for voltage, start in zip(limits.move, ("full", "empty"), strict=True):
        state = static.start(voltage, start)
        ends.append(float(static.run(np.array([voltage]), state, 1.0).y[0]))
    texts = []
    for voltage, end in zip(limits.move, ends, strict=True):
        above = end == max(ends) and clipping.high > end
        below = end == min(ends) and clipping.low < end
        if above or below:
            texts.append(
                f"{voltage:.6g}{limits.suffix} reaches {end:.4g}{model.output.suffix}"
            )
    return texts


def _times_slower(model: Cascade, limits: Limits, excerpt: Excerpt) -> float:
    """Return how many times the slew limit the move needs; 0 where that is not known."""
    if limits.slew is None or not excerpt.target:
        return 0.0
    fastest, state = 0.0, excerpt.state
    assert state is not None
    for target, dt in excerpt.target:
        run = model.drive(target, state, dt, limits.move)
        state = run.state
        seconds = np.broadcast_to(np.asarray(dt), target.shape)[1:]
        steps = np.abs(np.diff(run.y))[seconds > 0.0]
        rates = steps / seconds[seconds > 0.0]
        fastest = max(fastest, float(rates.max(initial=0.0)))
    return fastest / limits.slew


# --- what to expect ---


def expected(model: Cascade, excerpt: Excerpt, lead_rows: int) -> ExpectedError | None:
    """Return the error to expect of the move (RMS); None where it is not known."""
    from dbo_cli.model.expect import expected_error

    voltage, dt = excerpt.played()
    return expected_error(model, voltage, dt, lead_rows)


# --- warnings, without the name of the trajectory ---


def jump_warning(limits: Limits, standing: float | None, first: float) -> list[str]:
    """Return a warning where the first row is far from where the amplifier stands."""
    low, high = limits.identified
    if standing is None or abs(first - standing) <= JUMP * (high - low):
        return []
    unit = limits.suffix
    return [
        f"jumps from {standing:.4g} to {first:.4g}{unit} at row 1, and the error there is not in the "
        "expected one: add `approach` auto"
    ]


def start_warnings(
    model: Cascade, limits: Limits, clipping: Clipping, missed: float, off: float
) -> list[str]:
    """Return what was clipped, and how the drive begins.

    ``missed`` and ``off`` are how far the first row starts off its displacement, and by
    how much dynamics and delay are in motion there.
    """
    unit, span = model.output.suffix, model.output.span
    texts = []
    if clipping.clipped:
        texts.append(
            f"{clipping.said(limits)}: clipped; the move misses {clipping.rms:.3g}{unit} RMS, at most "
            f"{clipping.largest:.3g}{unit}"
        )
    if abs(missed) > OFF_AT_FIRST * span:
        texts.append(
            f"row 1 starts {abs(missed):.3g}{unit} off, where no settled actuator is: try "
            "`condition` or `state` empty"
        )
    if abs(off) > OFF_AT_FIRST * span:
        texts.append("the move starts in motion and rings at first: add `lead` auto")
    return texts


def beyond_identified(limits: Limits, low: float, high: float) -> list[str]:
    """Return a warning where the drive, ``low`` to ``high``, leaves the identified range."""
    least, greatest = limits.identified
    if not limits.extrapolate or least <= low <= high <= greatest:
        return []
    unit = limits.suffix
    return [
        f"the drive goes from {low:.6g} to {high:.6g}{unit}, beyond the identified range, "
        f"{least:.6g} to {greatest:.6g}{unit}"
    ]


def move_warnings(
    model: Cascade, excerpt: Excerpt, error: float | None, lost_rms: float
) -> list[str]:
    """Return what of the move the logs do not show; ``error`` is the one to expect."""
    from dbo_cli.model import expect

    texts = expect.move_warnings(model, *excerpt.played())
    line = model.fit.get("line_rmse")
    if error is None or not isinstance(line, float):
        return texts
    if error >= max(line, lost_rms):
        unit = model.output.suffix
        texts.append(
            f"expected error {error:.3g}{unit}, a straight line's is {line:.3g}: identify with a log "
            "of such moves"
        )
    return texts


def creeping_hold(model: Cascade, limits: Limits, state: State | None) -> list[str]:
    """Return a warning where holding the last position drives the voltage out of the limits."""
    relaxation = model.gears.relaxation
    if relaxation is None or state is None or state.drive is None:
        return []
    if min(relaxation.gain) >= 0.0:
        return []
    still = replace(state, sections=None, delay=None, undoing=None)
    position = model.static.run(np.array([state.drive]), still, 0.0).y
    seconds = LONG_HOLD * max(relaxation.tau)
    voltage = float(model.static.drive(position, still, seconds).y[0])
    low, high = limits.move
    if low <= voltage <= high:
        return []
    unit = limits.suffix
    return [
        f"holding the last position takes the drive to {voltage:.6g}{unit} in the long run, outside "
        f"{low:.6g} to {high:.6g}{unit}"
    ]


def widened(span: Sequence[float] | None, values: Floats) -> list[float]:
    """Return the least and the greatest of a span and of values."""
    low, high = float(values.min()), float(values.max())
    if span is None:
        return [low, high]
    return [min(low, span[0]), max(high, span[1])]
