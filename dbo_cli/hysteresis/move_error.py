"""What error to expect of a move, from how far other models that explain the logs as well go apart on it.

A log cannot tell everything: other slopes, another bend or another memory may explain
it as well, and predict other things of one move and the same of another. Identification
keeps such models with the one it chose (``fit.alternatives``); they are played over the
very move. What the logs themselves tell, the error on what was left out of the fit, is
in every figure, and the wider the less the move's swings, between its turns, are like
the logs' own.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dbo_cli.errors import ModelError
from dbo_cli.hysteresis.cascade import DelayStage, through
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.hysteresis.model_file import (
    Node,
    read_relaxation,
    read_stages,
    stage_values,
)
from dbo_cli.hysteresis.model_state import StartName
from dbo_cli.hysteresis.operators import Floats, Relaxation, steps_of

Integers = NDArray[np.int64]

# a reversal smaller than this share of the drive's range is noise, not a turn; chosen
SMALLEST_TURN = 0.02
MOST_SWINGS = 256  # are kept with a model: some 4 kB
NEAREST = 0.02  # of the range: swings that lie closer together are kept once; chosen

# of a move are looked at: its first ones, 1 MB of drive and some 30 ms
MOST_ROWS = 131_072
MOST = 8  # other models are played: identification keeps five
# of the other models' numbers: their rounding, 1e-5 of the range, is nothing beside the
# rest
DIGITS = 4
LEFT_OUT = 0.85
"""Of the error on what was left out, the worst of three ways to leave something out, what counts for the
shape. Measured: docs/choices.md.
"""
WIDENING = 4.0
"""How much the error on what was left out grows with how unlike the logs' swings a move's are (a unit of the
range). Measured: docs/choices.md.
"""
APART = 1.0
"""How much the distance of the other models counts. Measured: docs/choices.md."""
GAIN_LATER = 0.75
"""Of the change of the gain along a log, what a later move meets: the model holds the middle of the log, and
half of the change is there at its end. Measured: docs/choices.md.
"""
LINE = 4.0 / 3.0
"""Times the error that a straight line leaves of what was left out: no shape is stated to err by more.
Chosen: docs/choices.md.
"""
# of the range: swings further from the logs' own are said to be unlike them; chosen
UNLIKE = 0.2
# the zero: under this condition it is as stated
ZERO_STAYS = "where it stays as it was in the logs"
SMALL = 0.25  # of the range: swings below it stay inside the loop; chosen
# of a move's rows: from which share of small repeated swings on they are spoken of;
# chosen
MOSTLY = 0.5
# what may have been before the first row
PASTS: tuple[StartName, ...] = ("empty", "full", "settled")
# times the expected error: from which on it is said that the past makes it so much
# larger
PAST_MATTERS = 1.2


def turning_points(signal: Floats, threshold: float) -> Integers:
    """Rows where ``signal`` reverses by more than ``threshold``: alternating maxima and minima.

    The first sample of a plateau counts as the turn. The two ends of the signal are not
    turning points.
    """
    slope = np.sign(np.diff(signal))
    moving = np.flatnonzero(slope)
    if len(moving) == 0:
        return np.empty(0, np.int64)
    changes = np.flatnonzero(np.diff(slope[moving]))
    candidates = np.concatenate(([0], moving[changes] + 1, [len(signal) - 1]))
    values = signal[candidates]
    turns: list[int] = []
    best = 0
    direction = 0.0
    for place in range(1, len(candidates)):
        change = values[place] - values[best]
        if direction == 0.0:
            if abs(change) > threshold:
                direction = np.sign(change)
                best = place
        elif change * direction >= 0.0:
            best = place
        elif abs(change) > threshold:
            turns.append(int(candidates[best]))
            direction = -direction
            best = place
    return np.asarray(turns, dtype=np.int64)


def swings_between_turns(drive: Floats, span: float) -> tuple[Integers, Floats]:
    """Return the rows between which a drive swings, (swings + 1,), and from where to where, (swings, 2)."""
    turns = turning_points(drive, SMALLEST_TURN * span)
    edges = np.concatenate(([0], turns, [len(drive) - 1]))
    return edges, np.column_stack((drive[edges[:-1]], drive[edges[1:]]))


def travelled(drive: Floats, span: float) -> Floats:
    """Return how far a drive has gone since its first sample, in its unit; noise does not count."""
    distance = np.zeros(len(drive))
    edges, _ = swings_between_turns(drive, span)
    for first, last in itertools.pairwise(edges.tolist()):
        gone = np.maximum.accumulate(np.abs(drive[first : last + 1] - drive[first]))
        distance[first : last + 1] = distance[first] + gone
    return distance


def thinned(swings: Floats, span: float) -> Floats:
    """Return at most ``MOST_SWINGS`` of the swings, one of those that lie close together."""
    near = NEAREST * span
    while True:
        cells = np.round(swings / near)
        _, firsts = np.unique(cells, axis=0, return_index=True)
        if len(firsts) <= MOST_SWINGS:
            few: Floats = swings[firsts]
            return few
        near *= 2.0


def unlike(drive: Floats, known: Floats, span: float, begin: int = 0) -> float:
    """Return how far the swings of a drive are from the nearest known ones, in units of the range, RMS.

    A swing is a point: where it comes from and where it goes. Swings count as long as
    they take, from the row ``begin`` on.
    """
    edges, swings = swings_between_turns(drive, span)
    rows = np.maximum(edges[1:] - np.maximum(edges[:-1], begin), 0)
    if not rows.any():
        return 0.0
    squares = ((swings[:, None] - known) ** 2).sum(axis=2).min(axis=1)
    return float(np.sqrt(rows @ squares / rows.sum())) / span


def repeats_small_swings(drive: Floats, span: float, begin: int = 0) -> bool:
    """Whether a drive mostly swings to and fro within a small part of the range, from the row ``begin`` on.

    Where a loop forgets, as those of Duhem and of Bouc and Wen do, such a swing does
    not close, and wanders towards the middle of the large loop as it repeats.
    """
    edges, swings = swings_between_turns(drive[begin:], span)
    if len(swings) < 3:
        return False
    small = np.abs(swings[:, 1] - swings[:, 0]) < SMALL * span
    again = np.abs(swings[2:] - swings[:-2]).max(axis=1) < NEAREST * span
    again &= small[2:]
    # a swing that comes again, and the one that it is again
    repeats = np.zeros(len(swings), dtype=bool)
    repeats[:-2] |= again
    repeats[2:] |= again
    rows = np.diff(edges)[repeats].sum()
    return bool(rows > MOSTLY * (len(drive) - begin))


@dataclass(frozen=True)
class Alternative:
    """A model that explains the logs about as well: what it has changed, and how much it counts (0 to 1).

    ``forgetting`` acts beside its gears as their relaxation does, but by the way gone
    instead of the time: L' = |u'| (u - L) / tau, so its ``tau`` are volts. So do the
    models of Duhem and of Bouc and Wen forget, whose small loops do not close. It only
    says what to expect: beside gears its inverse is not exact.
    """

    kind: str
    weight: float
    model: ActuatorModel
    forgetting: Relaxation | None = None

    def values(self) -> dict[str, Any]:
        """Return it as plain values for the model file."""
        gears = self.model.stages.index(self.model.backlash)
        stages = [stage_values(stage) for stage in self.model.stages]
        # What stands before the gears says where a drive meets their edges, and where
        # it starts.
        stages[gears:] = _rounded(stages[gears:])
        values = {"changed": self.kind, "weight": self.weight, "stages": stages}
        if self.forgetting is not None:
            terms = _rounded(dataclasses.asdict(self.forgetting))
            values["forgetting"] = {"on": "input"} | terms
        return values

    def played(self, drive: Floats, time_step: float | Floats | None) -> Floats:
        """Return the displacement it predicts from its own start."""
        if self.forgetting is None:
            return played(self.model, drive, time_step)
        tail = self.model.tail
        steps = np.diff(travelled(drive, self.model.input.span), prepend=0.0)
        beside = self.forgetting.lags(drive, steps)[0] @ np.array(self.forgetting.gain)
        return through(
            tail, played(self.model.without(*tail), drive, time_step) + beside
        )


@dataclass(frozen=True)
class StatedError:
    """The error to state, in the displacement's unit.

    ``shape`` is the RMS of the error less its mean; ``still_zero`` the size of that
    mean, where the zero stays as it was in the logs; ``moved`` by how much the zero
    moved along them.
    """

    shape: float
    still_zero: float
    moved: float = 0.0

    @property
    def rmse(self) -> float:
        """The RMS of both together, where the zero stays as it was."""
        return math.hypot(self.shape, self.still_zero)

    @property
    def zero(self) -> float:
        """The size of the mean error, where the zero moves as far again as along the logs."""
        return math.hypot(self.still_zero, self.moved)


@dataclass(frozen=True)
class MoveError:
    """What to expect of a move, in the displacement's unit.

    ``rmse`` is the RMS of the error, where the zero stays as it was in the logs and the
    actuator starts as the model takes it to; ``shape`` and ``zero`` are its parts
    (``StatedError``; None where only the whole is known). ``from_any_past`` is the RMS
    where it may have been anywhere before, ``straight_line`` the error of a straight
    line, and ``unlike`` how far the swings are from the logs' own, in units of the
    range. ``repeats_small`` says whether the move goes to and fro within a small part
    of the range.
    """

    rmse: float
    straight_line: float
    shape: float | None
    zero: float | None
    from_any_past: float
    unlike: float = 0.0
    repeats_small: bool = False

    @property
    def form(self) -> float:
        """What to compare with a straight line, whose zero is as unknown: the shape, where it is known."""
        return self.rmse if self.shape is None else self.shape

    @property
    def past_matters(self) -> bool:
        """Whether an unknown past makes the error larger by more than a fifth."""
        return self.from_any_past > PAST_MATTERS * self.rmse


def _rounded(value: Any) -> Any:
    """Round heights and gains; widths stay as they are, since a drive turns on their edges."""
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}")
    if isinstance(value, list | tuple):
        return [_rounded(entry) for entry in value]
    if isinstance(value, dict):
        rounded = dict(value)
        for key, entry in value.items():
            if key not in ("x0", "dx"):
                rounded[key] = _rounded(entry)
        return rounded
    return value


def alternatives_of(model: ActuatorModel) -> list[Alternative]:
    """Return the other models that a forward model was identified with; none where it has none.

    Raises
    ------
    ModelError
        They are malformed.
    """
    known: list[Alternative] | None = vars(model).get(_READ)
    if known is None:
        # kept with it, as its cached properties are
        vars(model)[_READ] = known = _read_alternatives(model)
    return known


_READ = "alternatives that were read"


def _read_alternatives(model: ActuatorModel) -> list[Alternative]:
    """Return the other models out of the values that ``fit`` has of them."""
    entries = model.fit.get("alternatives")
    if not isinstance(entries, list):
        return []
    alternatives = []
    for place, entry in enumerate(entries[:MOST]):
        path = f"fit.alternatives[{place}]"
        try:
            kind = str(entry["changed"])
            weight = float(entry["weight"])
            values = entry["stages"]
        except (TypeError, KeyError, ValueError):
            raise ModelError(
                f"{path}: needs `changed`, `weight` and `stages`"
            ) from None
        stages = read_stages(values, f"{path}.stages")
        beside = None
        if "forgetting" in entry:
            beside, _ = read_relaxation(Node("the model", path, entry), "forgetting")
        alternatives.append(Alternative(kind, weight, _behind(model, stages), beside))
    return alternatives


def _behind(model: ActuatorModel, stages: Sequence[Any]) -> ActuatorModel:
    """Return another model's slow stages with the dynamics of this one, which were found besides."""
    if model.dynamics is not None or model.drive_lag is not None:
        slow = [stage for stage in stages if not isinstance(stage, DelayStage)]
        around = (model.drive_lag, *slow, model.dynamics, model.delay)
        stages = [stage for stage in around if stage is not None]
    return dataclasses.replace(model, stages=tuple(stages), fit={}, provenance={})


def move_error(
    model: ActuatorModel,
    drive: Floats,
    time_step: float | Floats | None,
    begin: int = 0,
    start: StartName = "auto",
) -> MoveError | None:
    """Return what to expect of a move; None where the model does not know.

    Parameters
    ----------
    model : forward, with its ``fit``
    drive : voltages, shape (rows,); all of them are played
    time_step : seconds since the row before, one number or one for each; None without a
        clock
    begin : the first row that counts
    start : what was before the first row
    """
    expected, known = model.fit.get("expected_rmse"), model.fit.get("left_out_rmse")
    if not isinstance(expected, float) or drive.size <= begin:
        return None
    drive = drive[:MOST_ROWS]
    steps = time_step
    if steps is not None:
        steps = steps_of(steps, slice(0, MOST_ROWS))
    predicted = played(model, drive, steps, start)[begin:]
    straight = rms(predicted - _straight(model, drive[begin:]))
    shape = zero = None
    distance = 0.0
    if isinstance(known, float):
        others = []
        for alternative in alternatives_of(model):
            if steps is not None or not alternative.model.needs_time:
                displacement = alternative.played(drive, steps)[begin:]
                others.append((alternative, displacement))
        apart = spread(predicted, others)
        drifted = changed_gain(predicted, model.fit.get("gain_trend"))
        moving = moving_zero(
            _of_fit(model, "zero_drift"),
            _of_fit(model, "zero_drift_rate"),
            _seconds(steps, drive.size, begin),
        )
        distance = _unlike(model, drive, begin)
        error = stated(known, distance, apart, drifted, moving)
        error = capped(error, model.fit.get("line_left_out_rmse"))
        expected, shape, zero = error.rmse, error.shape, error.zero
    past = _past(model, drive, steps, begin, predicted)
    from_any_past = float(np.hypot(expected, past))
    small = repeats_small_swings(drive, model.input.span, begin)
    return MoveError(expected, straight, shape, zero, from_any_past, distance, small)


def _seconds(steps: float | Floats | None, rows: int, begin: int) -> float:
    """Return how long the rows from ``begin`` on last; 0 without a clock."""
    if steps is None:
        return 0.0
    return float(np.broadcast_to(steps, rows)[begin:].sum())


def _of_fit(model: ActuatorModel, key: str) -> float:
    """Return a number of a model's fit, 0 where there is none."""
    value = model.fit.get(key)
    return value if isinstance(value, float) else 0.0


def _past(
    model: ActuatorModel,
    drive: Floats,
    steps: float | Floats | None,
    begin: int,
    predicted: Floats,
) -> float:
    """Return by how much a move differs, RMS, between the starts that a model knows; the most of them."""
    apart = 0.0
    for start in PASTS:
        apart = max(apart, rms(played(model, drive, steps, start)[begin:] - predicted))
    return apart


def moving_zero(span: float, rate: float, seconds: float) -> StatedError:
    """Return what a zero that moves adds to the error of a move.

    As a whole the move may be off by as much as the zero moved; and while it lasts the
    zero moves on, at most as far, evenly.

    Parameters
    ----------
    span : how far the zero moved along a log, in the displacement's unit
    rate : how fast, a second
    seconds : how long the move lasts
    """
    goes_on = min(rate * seconds, span)
    return StatedError(goes_on / math.sqrt(12.0), 0.0, span)


def stated(
    known: float,
    distance: float,
    apart: StatedError,
    drifted: StatedError,
    zero: StatedError,
) -> StatedError:
    """Return the error to state.

    Parameters
    ----------
    known : on what was left out of the fit, RMS
    distance : how unlike the logs' swings the move's are, in units of the range
    apart : how far other models go apart on it
    drifted : what a gain that changes adds
    zero : what a zero that moves adds
    """
    widened = known * (1.0 + WIDENING * distance)
    shapes = (LEFT_OUT * widened, APART * apart.shape, drifted.shape, zero.shape)
    zeros = (widened, APART * apart.still_zero, drifted.still_zero)
    return StatedError(math.hypot(*shapes), math.hypot(*zeros), zero.moved)


def capped(error: StatedError, line: object) -> StatedError:
    """Return an error whose shape is no larger than what a straight line leaves of what was left out."""
    if not isinstance(line, float):
        return error
    return dataclasses.replace(error, shape=min(error.shape, LINE * line))


def _unlike(model: ActuatorModel, drive: Floats, begin: int) -> float:
    """Return how unlike the logs' swings a drive's are; 0 where the model does not know them."""
    swings = model.fit.get("swings")
    if not swings:
        return 0.0
    try:
        known = np.asarray(swings, dtype=float).reshape(-1, 2)
    except (TypeError, ValueError):
        raise ModelError("fit.swings: needs pairs of voltages") from None
    return unlike(drive, known, model.input.span, begin)


def _straight(model: ActuatorModel, drive: Floats) -> Floats:
    """Return what the best straight line through the model's slow loop over its range makes of a drive."""
    still = model.without_lag
    upwards = np.linspace(model.input.minimum, model.input.maximum, 101)
    loop = np.concatenate((upwards, upwards[::-1]))
    gain, offset = np.polyfit(loop, played(still, loop, 1e9), 1)
    line: Floats = gain * drive + offset
    return line


def played(
    model: ActuatorModel,
    drive: Floats,
    time_step: float | Floats | None,
    start: StartName = "auto",
) -> Floats:
    """Return the displacement that a model predicts from a start, its own one by default."""
    return model.simulate(
        drive, model.start(float(drive[0]), start), time_step=time_step
    ).y


def spread(chosen: Floats, others: Sequence[tuple[Alternative, Floats]]) -> StatedError:
    """Return how far other models' predictions are from the chosen one's, in shape and in zero.

    Of each kind of change the one that goes farthest counts, weighted by how well it
    explains the logs; their squares add up.
    """
    shapes: dict[str, float] = {}
    zeros: dict[str, float] = {}
    for alternative, predicted in others:
        left = predicted - chosen
        kind = alternative.kind
        shape = alternative.weight * float(left.std())
        zero = alternative.weight * abs(float(left.mean()))
        shapes[kind] = max(shapes.get(kind, 0.0), shape)
        zeros[kind] = max(zeros.get(kind, 0.0), zero)
    shape_squared = sum(shape**2 for shape in shapes.values())
    zero_squared = sum(zero**2 for zero in zeros.values())
    return StatedError(float(np.sqrt(shape_squared)), float(np.sqrt(zero_squared)))


def changed_gain(predicted: Floats, trend: object) -> StatedError:
    """Return what a gain that changed by ``trend`` along the logs (None: not) adds to a later move."""
    if not isinstance(trend, float):
        return StatedError(0.0, 0.0)
    later = GAIN_LATER * abs(trend)
    return StatedError(
        later * float(predicted.std()),
        later * float(predicted.mean() - predicted.min()),
    )


def rms(values: Floats) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(values**2)))


RESONANCE_PART = 3.0
"""A model is trusted to its lowest resonance over this, where its identification says nothing else.
Measured: docs/choices.md.
"""


def trusted_frequency(model: ActuatorModel) -> float | None:
    """Return the frequency (Hz) to which a model can be trusted, or None where it does not know."""
    known = model.fit.get("trusted_hz")
    if isinstance(known, int | float) and not isinstance(known, bool) and known > 0.0:
        return float(known)
    if model.dynamics is not None and model.dynamics.resonances:
        return model.dynamics.resonances[0].frequency / RESONANCE_PART
    return None
