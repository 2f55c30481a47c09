"""What an identification is given: recordings (their turns, cycles, fast parts), and what a user may fix."""

from __future__ import annotations

import itertools
import math
import numbers
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from dbo_cli.errors import FitError, Remarks, UsageError
from dbo_cli.hysteresis.move_error import SMALLEST_TURN, turning_points

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Booleans = NDArray[np.bool_]

FEWEST_ROWS = 40  # chosen: no log worth a fit has fewer
LARGEST = 1e30  # in any unit: beyond this the squares of the fit would overflow
LEAST_DEVIATION = 1e-30  # standard, in any unit: below this the weights would
# usual steps; where more lie between two stamps, at least one sample is missing
GAP_STEPS = 1.5
# times the largest change between samples: less is hidden between samples anyway;
# chosen
HIDDEN_STEPS = 3.0
# beside a gap tell how fast the drive is there: fewer would take noise for motion;
# chosen
SPEED_ROWS = 4
# of the range: larger ones are loops, no sweep's; divides the swings that are left out
SMALL_SWING = 0.35
KNOWN_PAST = 0.4  # of a log, at most, is left out for its unknown history; chosen
MOST = 0.5
"""More than half of the rows, of an error, of a square is most of it. Measured: docs/choices.md."""
NOTICEABLE = 3e-4
"""Of the range: smaller noise of the voltage, reversals of it and lines of hum are not worth a word.
Measured: docs/choices.md.
"""
# at once: changes no bit; windows that fit the cache are sorted in a third of the time
BLOCK_ROWS = 1 << 12
# of a step: a clock written with few digits still counts as even; with 1e-6 models were
# the same
EVEN = 1e-3
# swings that differ by less count as one amplitude; 5 and 20 %: the same models
AMPLITUDE_SCATTER = 0.1


@dataclass(frozen=True)
class Recording:
    """One log of an actuator: what was applied and what was measured.

    ``voltage`` and ``displacement`` have shape (samples,), in the units named; ``time``
    is in seconds with the same shape, or None where the log has no clock;
    ``sample_period`` in seconds serves in its place. What drives may be another
    quantity than a voltage, and what comes out another than a displacement.
    ``uncertainty`` is the displacement's standard deviation row by row, in its unit;
    None: all rows alike. ``rows`` are the numbers of the samples in the file; None:
    from 1 on, without gaps. ``faulty`` are the rows in which sensor or logger failed,
    shape (samples,); None: not looked for. ``record`` is what a model keeps of where
    the log came from, and ``remarks`` what was said as it was read.
    """

    name: str
    voltage: Floats
    displacement: Floats
    time: Floats | None = None
    sample_period: float | None = None
    voltage_unit: str | None = None
    displacement_unit: str | None = None
    voltage_quantity: str = "voltage"
    displacement_quantity: str = "displacement"
    uncertainty: Floats | None = None
    rows: Integers | None = None
    faulty: Booleans | None = None
    record: Mapping[str, object] = field(default_factory=dict)
    remarks: Remarks = field(default_factory=Remarks)

    def row(self, index: int) -> int:
        """Return the number in the file, from 1, of a sample, from 0."""
        return index + 1 if self.rows is None else int(self.rows[index])

    def seconds(self) -> Floats | None:
        """Time of each sample in seconds from the first, or None where the log has no clock."""
        if self.time is not None:
            elapsed: Floats = self.time - self.time[0]
            return elapsed
        if self.sample_period is not None:
            even: Floats = self.sample_period * np.arange(
                len(self.voltage), dtype=np.float64
            )
            return even
        return None

    def part(self, rows: slice) -> Recording:
        """Return some neighbouring rows as a log."""
        return replace(
            self,
            voltage=self.voltage[rows],
            displacement=self.displacement[rows],
            time=_rows_of(self.time, rows),
            uncertainty=_rows_of(self.uncertainty, rows),
            rows=_rows_of(self.rows, rows),
            faulty=_rows_of(self.faulty, rows),
        )


Numbers = TypeVar("Numbers", Floats, Integers, Booleans)


def _rows_of(values: Numbers | None, rows: slice) -> Numbers | None:
    """Return the values of some rows, None where the log has none."""
    return None if values is None else values[rows]


METHODS = ("least-squares", "paper")
SLOPES = ("growing", "falling", "free")
SIGNS = ("rising", "falling")
ZEROS = ("none", "mean", "first")
NOT_FOR_PAPER = ("relaxation", "delay", "slopes", "skip_seconds", "rated", "sensor_delay", "sensor_lag",
                 "dynamics")  # fmt: skip
NOT_WITH_PRIOR = (
    "gears",
    "points",
    "relaxation",
    "delay",
    "slopes",
    "method",
    "zero",
    "dynamics",
)

MOST_GEARS = 10_000  # the normal equations of so many take 800 MB


@dataclass(frozen=True)
class IdentificationOptions:
    """What the user asked for; None stands for 'auto'.

    Parameters
    ----------
    gears, points : int, optional
        Number of gears; number of segments of the asymmetry, 0 for none.
    relaxation : sequence of float, optional
        Time constants in seconds, () for none.
    delay : float, optional
        Of the actuator, in seconds.
    slopes : {"growing", "falling", "free"}, optional
        How the slopes of the gears may change from one to the next.
    skip_seconds : float
        Left out at the beginning of every log.
    method : {"least-squares", "paper"}
        The paper's own takes one log of one cycle, and of the other options gears,
        points and zero alone.
    zero : {"none", "mean", "first"} or float
        Displacement that counts as zero: as logged, the log's mean, its first, or a
        value.
    rated : (float, float), optional
        The drive's full range, for a warning where the logs cover less; texts have a
        unit (``"1.2kV"``).
    force : bool
        Keep a model that would be refused.
    dynamics : int, optional
        Number of resonances: 0, 1 or 2.
    sign : {"rising", "falling"}, optional
        Whether the displacement rises or falls as the voltage rises; logs of the other
        sign are refused.
    sensor_delay, sensor_lag : float
        What the sensor adds, in seconds: taken off the logs, kept in the model's
        ``fit``, not compensated.
    scale_uncertainty : float
        Of the displacement's scale (a wavelength, a calibration), standard, in %:
        common to all rows, so that no log shows it. It is stated with the gain.

    Raises
    ------
    UsageError
        A value is not of its kind, or options contradict each other.
    """

    gears: int | None = None
    points: int | None = None
    relaxation: Sequence[float] | None = None
    delay: float | None = None
    slopes: str | None = None
    skip_seconds: float = 0.0
    method: str = "least-squares"
    zero: str | float = "none"
    rated: tuple[float | str, float | str] | None = None
    force: bool = False
    sensor_delay: float = 0.0
    sensor_lag: float = 0.0
    dynamics: int | None = None
    sign: str | None = None
    scale_uncertainty: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what is not of its kind or contradicts the rest."""
        for name, least in (("gears", 1), ("points", 0), ("dynamics", 0)):
            _check_count(name, getattr(self, name), least)
        if self.gears is not None and self.gears > MOST_GEARS:
            raise UsageError(
                f"`gears` {self.gears}: {MOST_GEARS:,} are more than any log can tell apart"
            )
        if self.dynamics is not None and self.dynamics > 2:
            raise UsageError(
                f"`dynamics` {self.dynamics}: at most two resonances are looked for"
            )
        for name in ("skip_seconds", "sensor_delay", "sensor_lag", "delay"):
            if name != "delay" or self.delay is not None:
                _seconds(name.removesuffix("_seconds"), getattr(self, name))
        share = self.scale_uncertainty
        if not (_is_number(share) and 0.0 <= float(share) < 100.0):
            raise UsageError(
                f"`scale_uncertainty` {share!r}: is a share in %, from 0 to below 100"
            )
        if self.relaxation is not None:
            self._check_relaxation(self.relaxation)
        self._check_choices()
        self._check_rated()
        if self.method == "paper":
            self._check_paper()

    def _check_choices(self) -> None:
        for name, choices in (("slopes", SLOPES), ("sign", SIGNS)):
            if getattr(self, name) is not None:
                _choice(name, getattr(self, name), choices)
        _choice("method", self.method, METHODS)
        _choice("force", self.force, (False, True))
        if not (_is_number(self.zero) and math.isfinite(float(self.zero))):
            _choice("zero", self.zero, ZEROS, " or a displacement")

    def _check_relaxation(self, taus: object) -> None:
        if isinstance(taus, str) or not isinstance(taus, Sequence):
            raise UsageError(
                f"`relaxation` {taus!r}: give a list of time constants in seconds"
            )
        for tau in taus:
            if not (_is_number(tau) and 0.0 < tau < math.inf):
                raise UsageError(
                    f"`relaxation` {tau!r}: time constants are positive numbers of seconds"
                )
        object.__setattr__(self, "relaxation", tuple(float(tau) for tau in taus))

    def _check_rated(self) -> None:
        if self.rated is None:
            return
        if isinstance(self.rated, str) or not (
            isinstance(self.rated, Sequence) and len(self.rated) == 2
        ):
            raise UsageError(
                f"`rated` {self.rated!r}: give both ends of the drive's range"
            )
        low, high = self.rated
        if isinstance(low, str) or isinstance(high, str):
            return  # checked when they are in the logs' unit
        if not (
            _is_number(low) and _is_number(high) and -math.inf < low < high < math.inf
        ):
            raise UsageError(
                f"`rated` {self.rated!r}: the lower end must be a number below the upper one"
            )

    def check_prior(self) -> None:
        """Refuse what a prior already has (UsageError)."""
        usual = {option.name: option.default for option in fields(self)}
        for name in NOT_WITH_PRIOR:
            if getattr(self, name) != usual[name]:
                raise UsageError(
                    f"`{name}` does not go with `prior`, whose shape is kept: leave one of them out"
                )

    def _check_paper(self) -> None:
        """Refuse what the paper's method would have to ignore."""
        usual = {option.name: option.default for option in fields(self)}
        for name in NOT_FOR_PAPER:
            value = getattr(self, name)
            nothing = name in ("relaxation", "delay", "dynamics") and not value
            if value != usual[name] and not nothing:
                shown = name.removesuffix("_seconds")
                raise UsageError(
                    f"`{shown}` does not go with `method` paper: the paper's model is fitted to one cycle "
                    "and has neither lag nor delay (`rows` A:B cuts the cycle out)"
                )


def _check_count(name: str, value: object, least: int) -> None:
    if value is None:
        return
    if (
        isinstance(value, bool)
        or not isinstance(value, numbers.Integral)
        or value < least
    ):
        raise UsageError(f"`{name}` {value!r}: is a whole number, at least {least}")


def _is_number(value: object) -> bool:
    return (
        isinstance(value, numbers.Real)
        and not isinstance(value, bool)
        and not math.isnan(float(value))
    )


def _seconds(name: str, value: object) -> None:
    if not (
        isinstance(value, numbers.Real)
        and _is_number(value)
        and 0.0 <= float(value) < math.inf
    ):
        raise UsageError(f"`{name}` {value!r}: is a time in seconds, not negative")


def _choice(
    name: str, value: object, choices: Sequence[object], other: str = ""
) -> None:
    if not any(
        value is choice or (isinstance(value, str) and value == choice)
        for choice in choices
    ):
        raise UsageError(
            f"`{name}` {value!r}: is one of {', '.join(map(str, choices))}{other}"
        )


@dataclass(frozen=True)
class DriveShape:
    """What the drive voltage of one log does: where it turns, how often and how widely.

    ``turns`` are the rows of the turning points; ``cycles`` the rows where whole cycles
    begin (and the last one ends); ``amplitudes`` the peak-to-peak voltage between
    neighbouring turning points.
    """

    turns: Integers
    cycles: Integers
    amplitudes: Floats

    @property
    def cycle_count(self) -> int:
        """Number of whole cycles."""
        return max(len(self.cycles) - 1, 0)


def runs(mask: Booleans) -> list[tuple[int, int]]:
    """Return first row and end of each run of rows that are true."""
    edges = np.flatnonzero(
        np.diff(np.concatenate(([0], mask.astype(np.int8), [0])))
    ).tolist()
    return list(zip(edges[::2], edges[1::2], strict=True))


def drive_shape(voltage: Floats) -> DriveShape:
    """Find turning points, whole cycles and amplitudes of one log's drive."""
    turns = turning_points(voltage, SMALLEST_TURN * float(np.ptp(voltage)))
    heights = voltage[turns]
    amplitudes = np.abs(np.diff(heights))
    if len(turns) >= 2:
        first_is_low = heights[0] < heights[1]
        cycles = turns[0 if first_is_low else 1 :: 2]
    else:
        cycles = turns
    return DriveShape(turns, cycles, amplitudes)


def one_amplitude(shapes: Sequence[DriveShape]) -> bool:
    """Whether all cycles of all logs go over one and the same range."""
    amplitudes = np.concatenate([shape.amplitudes for shape in shapes])
    return len(amplitudes) < 2 or float(
        np.ptp(amplitudes)
    ) <= AMPLITUDE_SCATTER * float(amplitudes.max())


def check_recordings(recordings: Sequence[Recording]) -> None:
    """Refuse logs from which nothing can be identified, naming the log and the remedy.

    Raises
    ------
    FitError
        Too few rows, a time that does not advance, constant voltage or displacement, a
        voltage that never turns, or units that differ.
    """
    if not recordings:
        raise FitError(
            "no log given: identify needs at least one log of voltage and displacement"
        )
    first = recordings[0]
    for log in recordings:
        if len(log.voltage) < FEWEST_ROWS:
            raise FitError(
                f"{log.name}: {len(log.voltage)} rows are too few to identify from: record at least one "
                f"whole cycle with {FEWEST_ROWS} rows or more"
            )
        _check_sizes(log)
        _check_uncertainty(log)
        if log.time is not None and not log.time[-1] > log.time[0]:
            raise FitError(
                f"{log.name}: time does not advance from the first row ({log.time[0]:.6g} s) to the last "
                f"({log.time[-1]:.6g} s): repair the clock, or give `sample_rate` HZ instead"
            )
        if np.ptp(log.voltage) == 0.0:
            raise FitError(
                f"{log.name}: the voltage is constant ({log.voltage[0]:g}): record a drive that moves over "
                "the range ('dbo excite' writes one)"
            )
        if np.ptp(log.displacement) == 0.0:
            raise FitError(
                f"{log.name}: the displacement is constant ({log.displacement[0]:g}): check the sensor and "
                "the column chosen"
            )
        if len(drive_shape(log.voltage).turns) == 0:
            raise FitError(
                f"{log.name}: the voltage never turns back, so the log shows no loop: record at least one "
                "whole cycle up and down ('dbo excite' writes a drive that does)"
            )
        for mine, other, what in (
            (log.voltage_unit, first.voltage_unit, "voltage"),
            (log.displacement_unit, first.displacement_unit, "displacement"),
        ):
            if mine != other:
                raise FitError(
                    f"{log.name}: its {what} is in {mine or 'no unit'}, that of {first.name} in "
                    f"{other or 'no unit'}: bring the logs to one unit"
                )


def widest_first(recordings: Sequence[Recording]) -> list[Recording]:
    """Return the logs in their order, but those over most of the range first: the first one's level is kept.

    Each log has an offset of its own. That of a log of small loops carries what the
    model misses there: with one first, new moves of an asymmetric plant were off by 2.2
    % of the range, 0.4 % with the wide log first.
    """
    widest = max(float(np.ptp(log.voltage)) for log in recordings)
    return sorted(
        recordings,
        key=lambda log: float(np.ptp(log.voltage)) < (1.0 - AMPLITUDE_SCATTER) * widest,
    )


def _check_uncertainty(log: Recording) -> None:
    """Refuse standard deviations that are none, naming the first."""
    if log.uncertainty is None:
        return
    valid = (log.uncertainty >= LEAST_DEVIATION) & (log.uncertainty <= LARGEST)
    if not valid.all():
        row = int(np.argmin(valid))
        raise FitError(
            f"{log.name}: the uncertainty in row {log.row(row)} is {log.uncertainty[row]:g}: a standard "
            f"deviation is a number from {LEAST_DEVIATION:g} to {LARGEST:g}"
        )


def _check_sizes(log: Recording) -> None:
    """Refuse numbers that no instrument measured, naming the first."""
    for values, what in ((log.voltage, "voltage"), (log.displacement, "displacement")):
        huge = np.abs(values) > LARGEST
        if huge.any():
            row = int(np.argmax(huge))
            raise FitError(
                f"{log.name}: the {what} in row {log.row(row)} is {values[row]:g}, which no instrument "
                "measured: correct it, or cut the log with `rows`"
            )


def first_wiped_row(voltage: Floats) -> int:
    """First row from which the operator's state no longer depends on the history before the log.

    Once the drive has been at both ends of the range it ever visits, every gear inside
    that range has been set and cleared (wiping-out), so whatever was remembered before
    is gone.
    """
    low, high = float(voltage.min()), float(voltage.max())
    near = SMALLEST_TURN / 4 * (high - low)
    at_low = int(np.argmax(voltage <= low + near))
    at_high = int(np.argmax(voltage >= high - near))
    return max(at_low, at_high)


def pieces_behind_gaps(log: Recording) -> list[tuple[int, int, int]]:
    """Return the pieces of a log behind gaps in which the drive may have turned.

    Each is its first row, the row from which it no longer depends on what was in the
    gap (see ``first_wiped_row``), and its end. A gap hides nothing where the drive
    stood still, or went on as fast as before and after; what a few samples hide anyway
    counts for nothing.
    """
    at, seconds, v = _long_steps(log), log.seconds(), log.voltage
    if seconds is None or not at.size:
        return []
    steps, moves = np.diff(seconds), np.diff(v)
    most = _usual_change(v, at)
    most_measured = _usual_change(log.displacement, at)
    before = np.maximum(at - SPEED_ROWS, 0)
    after = np.minimum(at + 1 + SPEED_ROWS, len(v) - 1)
    # how far the drive would have gone on, by its speed before and after
    ways = np.zeros((2, len(at)))
    for expected, first, last in zip(ways, (before, at + 1), (at, after), strict=True):
        past = seconds[last] - seconds[first]
        np.divide(
            (v[last] - v[first]) * steps[at], past, out=expected, where=past > 0.0
        )
    turned = np.abs(ways - moves[at]).max(axis=0) > HIDDEN_STEPS * most
    still = np.abs(moves[at]) <= most  # if the displacement was, too
    turned[still] = np.abs(np.diff(log.displacement)[at[still]]) > most_measured
    gaps = (at[turned] + 1).tolist()
    ends = [*gaps, len(v)][1:]
    pieces = []
    for begin, end in zip(gaps, ends, strict=True):
        known = begin + first_wiped_row(v[begin:end])
        pieces.append((begin, known, end))
    return pieces


def _long_steps(log: Recording) -> Integers:
    """Return the rows behind which a log's clock makes a step that is longer than usual."""
    if log.time is None or not log.time[-1] > log.time[0]:
        return np.empty(0, np.int64)
    steps = np.diff(log.time)
    # an uneven clock has long steps all along
    usual = float(np.quantile(steps[steps > 0.0], 0.9))
    return np.flatnonzero(steps > GAP_STEPS * usual)


def known_behind_gaps(log: Recording, usable: Booleans) -> Booleans:
    """Return the usable rows without those before whose gap the drive may have turned, if enough are left."""
    known = usable.copy()
    for begin, wiped, _ in pieces_behind_gaps(log):
        known[begin:wiped] = False
    enough = max(MOST * usable.sum(), FEWEST_ROWS)
    return known if known.sum() >= enough else usable


def _usual_change(values: Floats, long: Integers) -> float:
    """Return the largest change between samples, ``long`` steps aside, or what is no turn if that is more."""
    changes = np.delete(np.abs(np.diff(values)), long)
    return max(SMALLEST_TURN * float(np.ptp(values)), float(changes.max(initial=0.0)))


def median_cycle_seconds(recordings: Sequence[Recording]) -> float | None:
    """Duration in seconds of the cycle in which the logs' middle second lies.

    None where a log has no clock, or none has a cycle.

    Cycles count by their duration: of a drive with many small quick turns, the full
    sweeps say how late an actuator may be.
    """
    durations: list[Floats] = []
    for log in recordings:
        seconds = log.seconds()
        if seconds is None:
            return None
        turns = drive_shape(log.voltage).turns
        if len(turns) >= 2:
            durations.append(2.0 * np.diff(seconds[turns]))
        elif len(turns) == 1:
            durations.append(np.array([seconds[-1]]))
    if not durations:
        return None
    ordered = np.sort(np.maximum(np.concatenate(durations), 0.0))
    past = np.cumsum(ordered)
    return float(ordered[np.searchsorted(past, past[-1] / 2.0)])


FEWEST_SWINGS = 40  # in a sweep
SWEPT = 5.0  # the highest frequency of a sweep over its lowest, at least
# of neighbouring half periods, the larger over the smaller, as a logarithm: a sweep is
# gradual
SMOOTH = 0.7
# the half periods of a slow log over those of a fast one (medians), at least
FASTER = 10.0
FEWEST_A_PERIOD = 6  # samples, of the highest frequency taken
WIDER = 2.0  # periods of a sweep's lowest frequency that belong to it before and after


@dataclass(frozen=True)
class FastPart:
    """Rows of a log in which the drive is fast, with those before them, which tell the state of the gears.

    Attributes
    ----------
    recording : Recording
        The whole log.
    rows : slice
        The fast ones.
    time_step : float
        Seconds.
    lowest, highest : float
        Frequencies that the drive has there, Hz.
    """

    recording: Recording
    rows: slice
    time_step: float
    lowest: float
    highest: float


def split(recordings: Sequence[Recording]) -> tuple[list[Recording], list[FastPart]]:
    """Return the logs without their fast parts, and these; no fast parts where none are to be told."""
    span = max(float(np.ptp(log.voltage)) for log in recordings)
    sweeps = [_sweep_beside_more(log, span) for log in recordings]
    rests, halves = [], []
    for log, sweep in zip(recordings, sweeps, strict=True):
        # Beside loops, a sweep's many swings do not make a log a fast one.
        rest = log if sweep is None else _without(log, sweep.rows)
        half = _median_half_period(rest, span)
        if half is None:
            half = _median_half_period(log, span)
        rests.append(rest)
        halves.append(half)
    slowest = max((half for half in halves if half is not None), default=0.0)
    slow: list[Recording] = []
    fast: list[FastPart] = []
    for log, sweep, rest, half in zip(recordings, sweeps, rests, halves, strict=True):
        step = grid_step(log)
        if step is not None and half is not None and FASTER * half <= slowest:
            lowest, highest = _band(log, span, step)
            rows = slice(0, log.voltage.size)
            fast.append(FastPart(log, rows, step, lowest, highest))
            continue
        if sweep is not None:
            fast.append(sweep)
        slow.append(rest)
    return slow, fast


def _sweep_beside_more(log: Recording, span: float) -> FastPart | None:
    """Return the longest sweep of a log; None where nothing else is left to tell the gears from."""
    sweep = _longest_sweep(log, span)
    if sweep is None or _without(log, sweep.rows).voltage.size < FEWEST_ROWS:
        return None
    return sweep


def grid_step(log: Recording) -> float | None:
    """Return the step (s) of an even grid of which each sample is nearest to its own place, or None."""
    if log.sample_period is not None and log.time is None:
        return log.sample_period
    if log.time is None or log.time.size < 2:
        return None
    step = float(log.time[-1] - log.time[0]) / (log.time.size - 1)
    if not step > 0.0:
        return None
    away = np.abs(log.time - (log.time[0] + step * np.arange(log.time.size)))
    return step if float(away.max()) <= 0.5 * step else None


def _longest_sweep(log: Recording, span: float) -> FastPart | None:
    """Return the longest sweep of a log, or of its pieces between samples that are lost."""
    edges = [0, log.voltage.size]
    if grid_step(log) is None:
        edges[1:1] = (_long_steps(log) + 1).tolist()
    sweeps = []
    for begin, end in itertools.pairwise(edges):
        if end - begin < FEWEST_SWINGS * FEWEST_A_PERIOD // 2:
            continue
        piece = log.part(slice(begin, end))
        step = grid_step(piece)
        sweep = None if step is None else _sweep(piece, span, step)
        if sweep is not None:
            rows = slice(begin + sweep.rows.start, begin + sweep.rows.stop)
            sweeps.append(replace(sweep, recording=log, rows=rows))
    return max(sweeps, key=lambda part: part.rows.stop - part.rows.start, default=None)


def _swings(voltage: Floats, span: float) -> tuple[Floats, Floats]:
    """Return the rows where the drive turns, the ends included, and the voltage there."""
    turns = turning_points(voltage, NOTICEABLE * span).astype(np.float64)
    rows = np.concatenate([[0.0], turns, [voltage.size - 1.0]])
    return rows, voltage[rows.astype(np.int64)]


def _median_half_period(log: Recording, span: float) -> float | None:
    """Return the median time between turns (s), None where there are too few."""
    seconds = log.seconds()
    rows, _ = _swings(log.voltage, span)
    if seconds is None or rows.size < 6:
        return None
    return float(np.median(np.diff(seconds[rows.astype(np.int64)])))


def _band(log: Recording, span: float, step: float) -> tuple[float, float]:
    """Return the lowest and highest frequency of a fast log's drive (Hz), by its turns."""
    rows, _ = _swings(log.voltage, span)
    halves = np.diff(rows)[1:-1] * step
    halves = halves[halves > 0.0]
    longest = float(np.quantile(halves, 0.98))
    shortest = max(float(np.quantile(halves, 0.02)), step)
    return 0.5 / longest, 0.5 / shortest


def _sweep(log: Recording, span: float, step: float) -> FastPart | None:
    """Return the longest run of small swings whose frequency changes gradually over a wide band."""
    rows, levels = _swings(log.voltage, span)
    halves, heights = np.diff(rows), np.abs(np.diff(levels))
    near = np.abs(np.diff(np.log(np.maximum(halves, 1.0)))) <= SMOOTH
    quick = np.minimum(halves[1:], halves[:-1]) <= FEWEST_A_PERIOD
    small = heights <= SMALL_SWING * span
    good = small[1:] & small[:-1] & (near | quick)
    first, last = max(runs(good), key=lambda run: run[1] - run[0], default=(0, 0))
    if last - first < FEWEST_SWINGS:
        return None
    periods = 2.0 * step * halves[first : last + 1]
    fastest = float(np.quantile(periods, 0.05))
    slowest = float(np.quantile(periods, 0.98))
    if slowest < SWEPT * fastest or fastest < FEWEST_A_PERIOD * step * 0.5:
        return None
    wider = round(WIDER * slowest / step)
    start = max(int(rows[first]) - wider, 0)
    stop = min(int(rows[last + 1]) + wider, log.voltage.size)
    return FastPart(
        log, slice(start, stop), step, 1.0 / slowest, 1.0 / float(periods.min())
    )


def _without(log: Recording, rows: slice) -> Recording:
    """Return a log up to its fast rows, or from behind them where that is the longer part."""
    before = rows.start >= log.voltage.size - rows.stop
    if before:
        return log.part(slice(0, rows.start))
    return log.part(slice(rows.stop, None))
