"""The rows of the least-squares problem: what each gear, memory and asymmetry contributes to each sample.

For fixed gear widths the operator's output is linear in everything that is unknown (design, section "Lag and
creep beside the gears"): with phi_i the engaged fraction of gear i and L_j the relaxed drive,

    sum_i phi_i dY_i + sum_j c_j L_j - S^-1(y) - drift = 0,

where S^-1 is the inverse of the discrete point operator, written as a piecewise-linear function of the
measured output (Kuhnen's arrangement, reference [6] of the paper). Rows are made in blocks, so that memory
does not grow with the log.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from dbo_cli.hysteresis.model_state import StartName, start_state
from dbo_cli.hysteresis.move_error import travelled
from dbo_cli.hysteresis.operators import (
    BacklashState,
    DiscreteBacklashOperator,
    DiscretePointOperator,
    Relaxation,
)
from dbo_cli.records import dataclass

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

BLOCK_ROWS = 256  # a block without a wanted row is passed over, so blocks are short
JOINED_BLOCKS = 4  # that follow each other: fewer and larger products take half the time
BEND_SEGMENTS = 32  # of the parabola; 16 and 64 changed the errors of one of eight invented logs, by 2 %
EVEN = 1e-6  # of a step
LENGTHS = (0.15, 0.5)  # of memories that fade with the way gone, in units of the range; see ``expectation``


@dataclass(frozen=True)
class Basis:
    """What is fixed before the problem is solved: the gears' edges, the time constants, the delay.

    ``low`` and ``high`` bound the gears on the voltage axis, which ``gears * split`` equal widths divide;
    ``split`` neighbours share one slope, so that ``gears`` heights are unknown. A turn inside a gear
    retraces it: splitting makes that error of the operator small without a single unknown more.
    ``time_constants`` in seconds; ``delay`` in seconds, of the output behind the drive. ``bend`` is the
    asymmetry that acts on the drive before the gears: at a share s of the range it adds bend s (1 - s).
    ``lengths`` are of memories that fade with the way gone, in units of the range; no model has them.
    """

    gears: int
    low: float
    high: float
    split: int = 1
    time_constants: tuple[float, ...] = ()
    delay: float = 0.0
    bend: float = 0.0
    lengths: tuple[float, ...] = ()

    @property
    def span(self) -> float:
        """Width of all gears together, in the unit of the voltage."""
        return self.high - self.low

    def bend_points(self) -> DiscretePointOperator:
        """Return the asymmetry that acts on the drive: a parabola in straight segments, ends held."""
        at = np.arange(BEND_SEGMENTS + 1) / BEND_SEGMENTS
        bent = at + self.bend * at * (1.0 - at)
        return DiscretePointOperator(np.diff(at) * self.span, np.diff(bent) * self.span, self.low, self.low)

    def drive(self, voltage: Floats) -> Floats:
        """Return what reaches the gears, in the unit of the voltage."""
        return self.bend_points().run(voltage) if self.bend else voltage

    def lags(self, voltage: Floats, seconds: Floats | None) -> Floats:
        """Return what each memory holds of the drive, as shares of the range; see ``relaxed_drive``."""
        lags = relaxed_drive((self.drive(voltage) - self.low) / self.span, seconds, self.time_constants)
        if self.lengths:
            way = travelled(voltage, self.span) / self.span
            lags = np.hstack((lags, relaxed_drive((voltage - self.low) / self.span, way, self.lengths)))
        return lags

    def operator(self) -> DiscreteBacklashOperator:
        """Return an operator of these gears with equal heights that sum to one."""
        count = self.gears * self.split
        return DiscreteBacklashOperator(
            np.full(count, self.span / count), np.full(count, 1.0 / count), self.low, 0.0
        )


def relaxed_drive(drive: Floats, seconds: Floats | None, time_constants: tuple[float, ...]) -> Floats:
    """Exponentially forgetting averages of the drive, one column a time constant.

    L_k = a_k L_k-1 + (1 - a_k) u_k with a_k = exp(-dt_k / tau); L_0 = u_0, at rest before the first sample.

    Parameters
    ----------
    drive : shape (samples,), in any unit
    seconds : shape (samples,), time of each sample; may be None where there are no time constants
    time_constants : in seconds

    Returns
    -------
    shape (samples, time constants), in the unit of ``drive``
    """
    if not time_constants or seconds is None:
        return np.empty((len(drive), 0))
    steps = np.maximum(np.diff(seconds, prepend=seconds[0]), 0.0)
    terms = Relaxation(0.0, time_constants, (0.0,) * len(time_constants))
    usual = float(np.median(steps[1:])) if len(steps) > 1 else 0.0
    # A clock that is even but for the digits it was written with need not be looked at step by step.
    even = usual > 0.0 and float(np.abs(steps[1:] - usual).max()) <= EVEN * usual
    return terms.lags(drive, usual if even else steps)[0]


def hat_functions(position: Floats, segments: int) -> Floats:
    """Piecewise-linear hats on the inner knots of ``segments`` equal segments of 0..1; outside, straight on.

    Returns shape (samples, segments - 1). The end segments are extended, as the point operator's are.
    """
    if segments < 2:
        return np.empty((len(position), 0))
    place = np.clip(np.floor(position * segments).astype(np.int64), 0, segments - 1)
    fraction = position * segments - place
    full = np.zeros((len(position), segments + 1))
    rows = np.arange(len(position))
    full[rows, place] = 1.0 - fraction
    full[rows, place + 1] = fraction
    return full[:, 1:-1]


def drift_columns(seconds: Floats, order: int) -> Floats:
    """Legendre polynomials of time from order 0, the sensor's offset; shape (samples, order + 1)."""
    length = float(seconds[-1] - seconds[0]) or 1.0
    centred = 2.0 * (seconds - seconds[0]) / length - 1.0
    return legendre.legvander(centred, order)


class DriveRows:
    """Gear engagement and relaxed drive of one log, delayed, made block by block.

    Parameters
    ----------
    basis : the gears and time constants
    voltage : shape (samples,)
    seconds : shape (samples,), or None where the log has no clock (then neither delay nor relaxation)
    start : 'empty', 'full' or 'settled': the state before the first sample
    wanted : shape (samples,), bool: blocks without a wanted row are passed over (their states are not)
    lags : what ``basis.lags`` gives for this log, where it is known
    """

    def __init__(
        self,
        basis: Basis,
        voltage: Floats,
        seconds: Floats | None,
        start: StartName,
        wanted: NDArray[np.bool_] | None = None,
        lags: Floats | None = None,
    ) -> None:
        self._basis = basis
        self._voltage = basis.drive(voltage)
        self._start = start
        self._wanted = np.ones(len(voltage), bool) if wanted is None else wanted
        self._memory = basis.lags(voltage, seconds) if lags is None else lags
        made = np.zeros(len(voltage), bool)
        for first, last in self._wanted_rows():
            made[first : last + 1] = True
        self._before, self._share = _delayed_rows(seconds, made, basis.delay)

    def blocks(self) -> Iterator[tuple[int, int, Floats]]:
        """Yield (first row, row after the last, columns of shape (rows, gears + time constants))."""
        operator = self._basis.operator()
        state = start_state(operator, float(self._voltage[0]), self._start)
        samples = len(self._voltage)
        made = 0  # rows that the operator has seen so far
        for first, last in self._wanted_rows():
            begin = int(self._before[first])
            if begin > made:
                _, state, _ = operator.run(self._voltage[made:begin], state)
                made = begin
            # Rows before `made` are made again from the state kept at the block's own beginning.
            end = min(int(self._before[last - 1]) + 2, samples)
            next_begin = int(self._before[min(last, samples - 1)])
            columns, state, made = self._columns(operator, state, made, end, next_begin)
            before = self._before[first:last] - begin
            share = self._share[first:last, None]
            if share.any():
                after = np.minimum(before + 1, len(columns) - 1)
                yield first, last, (1.0 - share) * columns[before] + share * columns[after]
            else:
                yield first, last, columns[before]

    def _wanted_rows(self) -> Iterator[tuple[int, int]]:
        """Yield (first row, row after the last) of blocks with a wanted row, a few neighbours at a time."""
        edges = np.arange(0, len(self._wanted), BLOCK_ROWS)
        wanted = [*np.logical_or.reduceat(self._wanted, edges).tolist(), False]
        begin: int | None = None
        for block, here in enumerate(wanted):
            if begin is not None and (not here or block - begin == JOINED_BLOCKS):
                yield begin * BLOCK_ROWS, min(block * BLOCK_ROWS, len(self._wanted))
                begin = None
            if here and begin is None:
                begin = block

    def _columns(
        self, operator: DiscreteBacklashOperator, state: BacklashState, begin: int, end: int, keep: int
    ) -> tuple[Floats, BacklashState, int]:
        """Columns of rows begin..end, and the state at row ``keep``, where the next block begins."""
        keep = min(max(keep, begin), end)
        split = self._basis.split
        early, state = operator.engagement(self._voltage[begin:keep], state, group_size=split)
        late, _ = operator.engagement(self._voltage[keep:end], state, group_size=split)
        engaged = np.vstack((early, late))
        if self._memory.shape[1]:
            engaged = np.hstack((engaged, self._memory[begin:end]))
        return engaged, state, keep


def _delayed_rows(seconds: Floats | None, made: NDArray[np.bool_], delay: float) -> tuple[Integers, Floats]:
    """For each row made, the row at or before the moment ``delay`` ago, and the share of the row after it."""
    samples = len(made)
    if delay <= 0.0 or seconds is None:
        return np.arange(samples), np.zeros(samples)
    if (np.diff(seconds) < 0.0).any():
        made = np.ones(samples, bool)  # a search among times that fall depends on what was searched before
    rows, both = np.flatnonzero(made), (np.zeros(samples, np.int64), np.zeros(samples))
    ago = np.maximum(seconds[rows] - delay, seconds[0])
    before = np.clip(np.searchsorted(seconds, ago, side="right") - 1, 0, samples - 2)
    gap = seconds[before + 1] - seconds[before]
    share = np.divide(ago - seconds[before], gap, out=np.zeros(len(rows)), where=gap > 0.0)
    both[0][rows] = np.maximum.accumulate(before)
    both[1][rows] = np.clip(share, 0.0, 1.0)
    return both
