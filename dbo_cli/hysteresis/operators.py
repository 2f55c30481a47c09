"""The Discrete Backlash Operator, the Discrete Point Operator, their states and their inverses.

Operators are values: they hold no state and are never changed. A state goes in and a
new one comes out, and the output does not depend, to the last bit, on how a signal is
cut into blocks. First come the widths of gears and segments (what is refused, and the
grid that makes their sums exact), and relaxation.

Source: Y. N. Aye and W. T. Ang (2018), "A Discrete Backlash Operator for Identification
and Compensation of Hysteresis and Non-linearity for Piezoelectric Actuator"; equation
numbers are the paper's.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dbo_cli.errors import InputError, ModelError
from dbo_cli.hysteresis import kernel

Floats = NDArray[np.float64]
Axis = Literal["input", "output"]
Outside = Literal["extend", "hold", "error"]

CROSSING_TOLERANCE = 1e-9
"""A gear counts as crossed when all but this fraction of it is travelled (more where rounding is coarse)."""

# chosen: more than the additions of a signal's way lose
_ROUNDING_STEPS = 64.0 * np.finfo(np.float64).eps
# of the sum: the grid of 2^-53 then moves no width by more than 2^-12 of itself
_NARROWEST = 2.0**-42
_LARGEST_TOLERANCE = 1.0 / 16.0  # what 64 steps of rounding are of such a width
_FEW, _LOOKED_AT = 16, 256
"""So few different steps among so many first rows are taken for all: looking one up costs 8 to 10 ns a
row, the exponential function with five terms 45 to 95.
"""


def checked_widths(key: str, widths: ArrayLike) -> Floats:
    """Return a read-only copy of ``widths``; raise ModelError naming the key of what is wrong in it."""
    values = np.array(widths, dtype=np.float64).reshape(-1)
    if values.size == 0:
        raise ModelError(f"{key}: is empty; at least one width is needed")
    for i in np.flatnonzero(~(np.isfinite(values) & (values > 0.0)))[:1]:
        raise ModelError(
            f"{key}[{i}]: {float(values[i])!r} is not a finite width greater than 0"
        )
    values.flags.writeable = False
    return values


def checked_pair(
    dx: ArrayLike, dy: ArrayLike, x0: float, y0: float
) -> tuple[Floats, Floats]:
    """Return both axes' widths, checked against each other and the origins."""
    widths, heights = checked_widths("dx", dx), checked_widths("dy", dy)
    if widths.size != heights.size:
        raise ModelError(f"dy: has {heights.size} entries where dx has {widths.size}")
    for key, value in (("x0", x0), ("y0", y0)):
        if not math.isfinite(value):
            raise ModelError(f"{key}: {value!r} is not a finite number")
    return widths, heights


def on_binary_grid(key: str, widths: Floats) -> Floats:
    """Round widths to multiples of the power of two that makes every sum of them exact in float64.

    The grid is 2^-53 of the power of two above their sum, so no width moves by more
    than 2^-53 of the sum. Adding and subtracting them, (6)-(9), then never rounds: X_B
    and Y_B equal (2)-(3) exactly after any number of transitions. Rounding what is
    rounded changes nothing.

    Raises
    ------
    ModelError
        A width is smaller than 2^-42 of the sum, or the sum is beyond what float64
        holds.
    """
    while True:
        total = math.fsum(widths.tolist())
        if not 1e-280 < total < 1e280:
            raise ModelError(
                f"{key}: the widths add up to {total!r}, beyond the range of the arithmetic"
            )
        grid = math.ldexp(1.0, math.frexp(total)[1] - 53)
        rounded: Floats = np.rint(widths / grid) * grid
        for i in np.flatnonzero(rounded < _NARROWEST * total)[:1]:
            raise ModelError(
                f"{key}[{i}]: {float(widths[i])!r} is less than 2^-42 of the sum of all widths, {total!r}"
            )
        if np.array_equal(rounded, widths):
            return rounded
        widths = rounded


def gear_table(dx: Floats, dy: Floats, scale_x: float, scale_y: float) -> Floats:
    """Return a row (dx, dy, slope, crossing_fraction) for each gear, of widths on the binary grid.

    ``crossing_fraction`` is where a gear counts as crossed: all but 1e-9 of it, since a
    drive that turns on a breakpoint is the usual case and one unit in the last place
    must not decide which gear engages on the way back. Where a gear is so narrow beside
    the numbers that are added and subtracted (``scale_x``, ``scale_y``) that rounding
    exceeds that, the tolerance is 64 rounding steps of the coarser axis. Exchanging the
    axes leaves it as it is, so an operator and its inverse decide alike.

    Raises
    ------
    ModelError
        A slope is beyond what float64 holds.
    """
    with np.errstate(over="ignore", under="ignore"):
        rounding = _ROUNDING_STEPS * np.maximum(scale_x / dx, scale_y / dy)
        fraction = 1.0 - np.clip(rounding, CROSSING_TOLERANCE, _LARGEST_TOLERANCE)
        slope, inverse_slope = dy / dx, dx / dy
    for i in np.flatnonzero(~np.isfinite(slope) | ~np.isfinite(inverse_slope))[:1]:
        raise ModelError(
            f"dy[{i}]: {float(dy[i])!r} over dx[{i}], {float(dx[i])!r}, is beyond the range of the arithmetic"
        )
    gears: Floats = np.ascontiguousarray(np.column_stack([dx, dy, slope, fraction]))
    gears.flags.writeable = False
    return gears


def equal_run(gears: Floats) -> int:
    """Return how many neighbours are equal from every multiple of that number on.

    The last run may be shorter. Identification gives many gears one slope, so that runs
    are long; 1 where nothing repeats.
    """
    starts = np.flatnonzero(np.any(gears[1:] != gears[:-1], axis=1)) + 1
    run = math.gcd(*starts.tolist()) or len(gears)
    # the kernel divides by a 32-bit multiplication
    if run * len(gears) >= 2**32:
        return 1
    return run


def kernel_table(gears: Floats, run: int) -> tuple[Floats, NDArray[np.uint32]]:
    """Return the kernel's table, a row for each ``run`` of equal gears, and its guide.

    To the row of its gears, each row adds where the first of them begins; one more
    stands behind the last and begins where the last gear ends. The guide cuts the range
    of the input into as many equal parts as there are rows, and says in which row each
    begins.
    """
    ends = np.cumsum(gears[:, :2], axis=0)  # exact: the widths lie on one binary grid
    begins = np.vstack([[0.0, 0.0], ends[run - 1 : -1 : run], ends[-1]])
    rows = np.vstack([gears[::run], gears[-1]])
    table: Floats = np.ascontiguousarray(np.hstack([rows, begins]))
    parts = np.linspace(0.0, ends[-1, 0], 2 * len(table) - 1)
    guide = np.searchsorted(begins[:-1, 0], parts, side="right") - 1
    table.flags.writeable = False
    return table, guide.astype(np.uint32)


def checked_steps(time_step: float | ArrayLike) -> Floats:
    """Return time steps (s) as an array; InputError where one is negative or not a number."""
    steps = np.asarray(time_step, dtype=np.float64).reshape(-1)
    for k in np.flatnonzero(~(steps >= 0.0))[:1]:
        raise InputError(
            f"time step {k + 1}: {float(steps[k])!r} s; time must not go backwards"
        )
    return steps


def steps_of(time_step: float | Floats, rows: slice) -> float | Floats:
    """Return the time steps (s) of some rows: a part of theirs, or the one number of all."""
    if isinstance(time_step, np.ndarray):
        return time_step[rows]
    return time_step


@dataclass(frozen=True)
class Relaxation:
    """Lag and creep beside the gears: sum_j gain_j L_j, each L_j a first-order lag of the voltage.

    L_j,k = a_j L_j,k-1 + (1 - a_j)(v_k - reference), a_j = exp(-Δt_k/tau_j). Beyond the
    paper.

    Attributes
    ----------
    reference : float
        Voltage at which nothing is remembered.
    tau : tuple of float
        Time constants in seconds, > 0.
    gain : tuple of float
        Output per volt, >= 0, one for each time constant.
    """

    reference: float
    tau: tuple[float, ...]
    gain: tuple[float, ...]

    def __post_init__(self) -> None:
        """Refuse what no actuator has, naming the key."""
        if not math.isfinite(self.reference):
            raise ModelError(
                f"relaxation.reference: {self.reference!r} is not a finite number"
            )
        if not self.tau:
            raise ModelError("relaxation.tau: is empty; leave relaxation out instead")
        if len(self.tau) != len(self.gain):
            raise ModelError(
                f"relaxation.gain: has {len(self.gain)} entries where relaxation.tau has {len(self.tau)}"
            )
        for j, (tau, gain) in enumerate(zip(self.tau, self.gain, strict=True)):
            if not (math.isfinite(tau) and tau > 0.0):
                raise ModelError(
                    f"relaxation.tau[{j}]: {tau!r} is not a finite time greater than 0"
                )
            if not (math.isfinite(gain) and gain >= 0.0):
                raise ModelError(
                    f"relaxation.gain[{j}]: {gain!r} is not a finite number of at least 0"
                )

    def most(self, drive: float) -> float:
        """Return what the terms add up to at most while the drive is no larger than ``drive``."""
        return math.fsum(self.gain) * (drive + abs(self.reference))

    def decay(self, time_step: float | ArrayLike) -> Floats:
        """Return a_j = exp(-Δt/tau_j) as rows: one for a single time step (s), else one per sample.

        Steps that are all the same come as one row, too. An even clock written in
        decimals has two or three different steps: each is computed once, with the bits
        of the exponential function all the same.

        Raises
        ------
        InputError
            A time step is negative or not a number.
        """
        steps = checked_steps(time_step)
        few = sorted(set(steps[:_LOOKED_AT].tolist()))
        if not len(few) <= _FEW < steps.size:
            return self._factors(steps)
        known = 0
        which = np.zeros(steps.size, dtype=np.int8)
        for place, step in enumerate(few):
            same = steps == step
            known += int(np.count_nonzero(same))
            which += np.int8(place) * same
        if known < steps.size:
            return self._factors(steps)
        factors = self._factors(np.array(few))
        if len(few) == 1:
            return factors
        return factors.take(which, axis=0)

    def _factors(self, steps: Floats) -> Floats:
        """Return the decay factors of time steps, a row for each."""
        factors: Floats = np.exp(-steps[:, np.newaxis] / np.array(self.tau))
        return factors

    def lags(
        self,
        x: ArrayLike,
        time_step: float | ArrayLike,
        memory: Sequence[float] | None = None,
    ) -> tuple[Floats, tuple[float, ...]]:
        """Return L_j after each sample (len(x) × terms) and after the last; at rest first without memory."""
        drive = np.ascontiguousarray(x, dtype=np.float64)
        memories = np.zeros(len(self.tau))
        rows = np.empty((drive.size, len(self.tau)))
        start = 0
        if memory is not None:
            memories[:] = memory
        elif drive.size:
            rows[0] = memories[:] = drive[0] - self.reference
            start = 1
        decay = self.decay(time_step)
        if len(decay) > 1:
            decay = np.ascontiguousarray(decay[start:])
        kernel.CHOSEN.memory_run(
            self.reference, memories, drive[start:], rows[start:], decay
        )
        return rows, tuple(memories.tolist())


@dataclass(frozen=True)
class BacklashState:
    """The state of a backlash operator: the number B of (1), and what relaxation remembers.

    Attributes
    ----------
    bits : int
        B = b_{n-1} … b_0.
    memory : tuple of float, or None
        L_j, one for each relaxation term; None: at rest at the sample to come.
    """

    bits: int
    memory: tuple[float, ...] | None = None

    def to_json_dict(self) -> dict[str, object]:
        """Return the state as plain JSON values; ``bits`` is hexadecimal."""
        memory = None if self.memory is None else list(self.memory)
        return {"bits": f"{self.bits:x}", "memory": memory}


@dataclass(frozen=True)
class OutputLimits:
    """Limits on the output of an inverse operator, the drive voltage.

    Attributes
    ----------
    low, high : float
        The range of the output; it wins over the slew limit.
    step : float, array, or None
        Largest change of the output since the sample before, one number or one for each
        sample.
    slack : float
        A sample counts as clipped when clipping moved it by more than this.
    """

    low: float = -math.inf
    high: float = math.inf
    step: float | Floats | None = None
    slack: float = 0.0


NO_LIMITS = OutputLimits()
NO_FACTORS = np.empty(0)


class Counts(NamedTuple):
    """How many samples lay outside the range or were clipped, and the index of the first of each."""

    outside: int = 0
    first_outside: int = 0
    clipped: int = 0
    first_clipped: int = 0

    def then(self, later: Counts, samples: int) -> Counts:
        """Return the counts of two blocks, the later of which begins ``samples`` behind the other's begin."""
        first_outside = self.first_outside
        if later.outside and not self.outside:
            first_outside = later.first_outside + samples
        first_clipped = self.first_clipped
        if later.clipped and not self.clipped:
            first_clipped = later.first_clipped + samples
        return Counts(
            self.outside + later.outside,
            first_outside,
            self.clipped + later.clipped,
            first_clipped,
        )


class DiscreteBacklashOperator:
    """The Discrete Backlash Operator of n gears, (1)-(12), with relaxation beside the gears.

    Parameters
    ----------
    dx, dy : array_like
        Widths ΔX_i and ΔY_i of (10), > 0, gear 0 first.
    x0, y0 : float
        X_0 and Y_0, the coordinates of B = 0.
    relaxation : Relaxation, optional
        Lag and creep; they follow the voltage.
    memory_on : {"input", "output"}
        Which of the two signals is the voltage: the input of a forward operator, the
        output of an inverse.

    Raises
    ------
    ModelError
        Lengths differ, a width is not > 0, or too narrow beside the others; the message
        begins with the key.

    Notes
    -----
    Outside [X_0, X_0 + Σ ΔX_i] the paper says nothing. ``extend`` goes on with the
    slope of gear n - 1, the last one engaged on the way there; ``hold`` keeps Y_B.

    A gear counts as crossed when all but 1e-9 of it is travelled (see ``gear_table``).
    """

    def __init__(
        self,
        dx: ArrayLike,
        dy: ArrayLike,
        x0: float = 0.0,
        y0: float = 0.0,
        relaxation: Relaxation | None = None,
        memory_on: Axis = "input",
    ) -> None:
        self.dx, self.dy = checked_pair(dx, dy, x0, y0)
        self.x0 = float(x0)
        self.y0 = float(y0)
        self.relaxation = relaxation
        self.memory_on = memory_on
        self.n = self.dx.size
        widths = on_binary_grid("dx", self.dx)
        heights = on_binary_grid("dy", self.dy)
        self._width = math.fsum(widths.tolist())
        self._height = math.fsum(heights.tolist())
        scale_x = max(abs(self.x0), abs(self.x0 + self._width), self._width)
        scale_y = max(abs(self.y0), abs(self.y0 + self._height), self._height)
        if relaxation is not None and memory_on == "input":
            scale_y += relaxation.most(scale_x)
        elif relaxation is not None:
            scale_x += relaxation.most(scale_y)
        self.gears = gear_table(widths, heights, scale_x, scale_y)
        self.equal_run = equal_run(self.gears)
        self._gain = np.array(relaxation.gain if relaxation else (), dtype=np.float64)
        for key, (low, high) in (("x0", self.x_range), ("y0", self.y_range)):
            if not low < high:
                raise ModelError(
                    f"{key}: rounding leaves nothing of the gears beside {low:.6g}, where they begin"
                )

    def __repr__(self) -> str:
        """Return a short description for debugging."""
        return f"{type(self).__name__}(n={self.n}, x_range={self.x_range}, y_range={self.y_range})"

    def _at_rest(self, voltage: float) -> float:
        """Return what the relaxation terms add up to after a long rest at ``voltage``."""
        if self.relaxation is None:
            return 0.0
        return math.fsum(self.relaxation.gain) * (voltage - self.relaxation.reference)

    @property
    def x_range(self) -> tuple[float, float]:
        """The input at B = 0 and at B = 2^n - 1, after a rest."""
        low, high = self.x0, self.x0 + self._width
        if self.memory_on == "input":
            return low, high
        return low + self._at_rest(self.y0), high + self._at_rest(
            self.y0 + self._height
        )

    @property
    def y_range(self) -> tuple[float, float]:
        """The output at B = 0 and at B = 2^n - 1, after a rest."""
        low, high = self.y0, self.y0 + self._height
        if self.memory_on == "output":
            return low, high
        return low + self._at_rest(self.x0), high + self._at_rest(self.x0 + self._width)

    def inverse(self) -> DiscreteBacklashOperator:
        """Return the inverse (17)-(18): ΔX and ΔY exchanged in every gear, and the origins."""
        return self._inverse

    @functools.cached_property
    def _inverse(self) -> DiscreteBacklashOperator:
        axis: Axis = "output" if self.memory_on == "input" else "input"
        return DiscreteBacklashOperator(
            self.dy, self.dx, self.y0, self.x0, self.relaxation, axis
        )

    def empty(self) -> BacklashState:
        """Return B = 0: the actuator has been at or below its lower end."""
        return BacklashState(0)

    def full(self) -> BacklashState:
        """Return B = 2^n - 1: the actuator has been at or above its upper end."""
        return BacklashState((1 << self.n) - 1)

    def settled(self, voltage: float) -> BacklashState:
        """Return the state after an oscillation that decays from the whole range to ``voltage``.

        The oscillation turns at ``voltage + A`` and ``voltage - A``, both cut off at
        the ends of the range; A falls arbitrarily slowly to 0 and the first turn is the
        upper one. The gears stop flipping from the highest to the lowest. With the
        gears up to k spanning [low, high], gear k stops when A no longer reaches high
        (it stays 0) or low (it stays 1), whichever comes first: the end that is farther
        from ``voltage``. A tie, as with even gears halfway, stays 1; a tolerance
        decides that, not rounding. Close to an end the state passes over into ``empty``
        or ``full``.
        """
        origin, span = self.x0, self._width
        if self.memory_on == "output":
            origin, span = self.y0, self._height
        target = float(voltage) - origin
        if target <= 0.0:
            return self.empty()
        if target >= span:
            return self.full()
        words = np.zeros(kernel.state_words(self.n), dtype=np.uint64)
        kernel.CHOSEN.backlash_decay(*self.constants(True), words, float(voltage))
        return BacklashState(self._bits(words))

    def coordinates(self, state: BacklashState) -> tuple[float, float]:
        """Return X_B and Y_B, (2)-(3)."""
        size = max(self.n, state.bits.bit_length()) // 8 + 1
        stored = state.bits.to_bytes(size, "little")
        bits = np.unpackbits(np.frombuffer(stored, dtype=np.uint8), bitorder="little")
        chosen = np.flatnonzero(bits[: self.n])
        return (
            self.x0 + math.fsum(self.gears[chosen, 0].tolist()),
            self.y0 + math.fsum(self.gears[chosen, 1].tolist()),
        )

    def _words(self, state: BacklashState) -> NDArray[np.uint64]:
        """Return the kernel's buffer with the state's bits in it."""
        if state.bits < 0 or state.bits >> self.n:
            raise ModelError(
                f"state: has bits beyond the {self.n} gears of this operator"
            )
        content = state.bits.to_bytes(8 * kernel.state_words(self.n), "little")
        return np.frombuffer(content, dtype="<u8").astype(np.uint64)

    def _bits(self, words: NDArray[np.uint64]) -> int:
        """Return B out of the kernel's buffer."""
        return int.from_bytes(words.astype("<u8").tobytes(), "little")

    def run(
        self,
        x: ArrayLike,
        state: BacklashState,
        *,
        decay: Floats | None = None,
        outside: Outside = "extend",
        limits: OutputLimits | None = None,
        last: float | None = None,
        out: Floats | None = None,
    ) -> tuple[Floats, BacklashState, Counts]:
        """Return the output of (1)-(12), the state after it, and what was unusual.

        Parameters
        ----------
        x : array_like
            One block of the input.
        state : BacklashState
            The state before it.
        decay : array, optional
            ``Relaxation.decay`` of the time steps: one row, or one for each sample.
            Needed with relaxation.
        outside : {"extend", "hold", "error"}
            ``error`` computes what ``extend`` does; the caller refuses by the counts.
        limits : OutputLimits, optional
            Clip the output; the state is then that of the inverse of this operator
            driven by the clipped output. Not for an operator whose memory follows its
            input.
        last : float, optional
            The output before this block, for the slew limit.
        out : array, optional
            Where the output goes; it may be ``x`` itself.

        Raises
        ------
        ModelError
            The state is not of this operator, or ``decay`` is missing.
        """
        x = np.ascontiguousarray(x, dtype=np.float64).reshape(-1)
        y = np.empty_like(x) if out is None else out
        words = self._words(state)
        terms = self._gain.size
        memory_on_input = self.relaxation is not None and self.memory_on == "input"
        if limits is not None and memory_on_input:
            raise ModelError(
                "limits on the output of an operator whose memory follows its input"
            )
        bound = limits or NO_LIMITS
        memory = np.array(state.memory or [0.0] * terms, dtype=np.float64)
        if memory.size != terms:
            raise ModelError(
                f"state: remembers {memory.size} relaxation terms, this model has {terms}"
            )
        counts = Counts()
        before = math.nan if last is None else last
        for begin, end, factors, steps in self._spans(x.size, state, decay, bound.step):
            counted = kernel.CHOSEN.backlash_run(
                *self.constants(outside != "hold"), words, memory, before, x[begin:end], y[begin:end],
                factors, limits is not None, bound.low, bound.high, bound.slack, steps,
            )  # fmt: skip
            counts = counts.then(Counts(*counted), begin)
            before = float(y[end - 1])
        if x.size == 0:
            return y, state, counts
        memories = tuple(memory.tolist()) if terms else state.memory
        return y, BacklashState(self._bits(words), memories), counts

    @functools.cached_property
    def table(self) -> tuple[Floats, NDArray[np.uint32]]:
        """The kernel's table and its guide."""
        return kernel_table(self.gears, 1)

    def constants(self, extend: bool) -> tuple[Any, ...]:
        """Return the kernel's first arguments, the same for all blocks."""
        reference = self.relaxation.reference if self.relaxation else 0.0
        table = *self.table, self.n, 1, self.x0, self.y0
        return *table, extend, self._gain, reference, self.memory_on == "output"

    def _spans(
        self,
        count: int,
        state: BacklashState,
        decay: Floats | None,
        step: float | Floats | None,
    ) -> list[tuple[int, int, Floats, Floats]]:
        """Return (begin, end, decay, step) of the kernel's calls: a sample at rest is one of its own."""
        if not count:
            return []
        steps = NO_FACTORS
        if step is not None:
            steps = np.array(step, dtype=np.float64).reshape(-1)
        if self.relaxation is None:
            return [(0, count, NO_FACTORS, steps)]
        at_rest = state.memory is None
        edges = [0, count]
        if at_rest and count > 1:
            edges = [0, 1, count]
        spans = []
        for begin, end in pairwise(edges):
            factors = decay
            if at_rest and begin == 0:
                factors = np.zeros((1, self._gain.size))
            elif factors is None:
                raise ModelError(
                    "relaxation needs the time between samples (`sample_rate`)"
                )
            if len(factors) not in (1, end - begin):
                factors = factors[begin:end]
            factors = np.ascontiguousarray(factors)
            span_steps = steps
            if steps.size > 1:
                span_steps = np.ascontiguousarray(steps[begin:end])
            spans.append((begin, end, factors, span_steps))
        return spans

    def engagement(
        self,
        x: ArrayLike,
        state: BacklashState,
        *,
        group_size: int = 1,
        outside: Outside = "extend",
    ) -> tuple[Floats, BacklashState]:
        """Return the part of the gears that is in the output of every sample, and the state after.

        The rows phi (len(x) × n) fulfil y - y0 = phi @ dy: 1 for a crossed gear, 0 for
        an open one, a fraction for the engaged one, so that heights are linear unknowns
        of the output. With ``group_size`` > 1 that many neighbours share one column
        (len(x) × ceil(n / group_size)), their mean: the unknowns are then the heights
        of the groups, equal within each. Relaxation is not in them (see
        ``Relaxation.lags``).
        """
        x = np.ascontiguousarray(x, dtype=np.float64).reshape(-1)
        words = self._words(state)
        crossed = np.empty(-(-self.n // group_size))
        rows = np.empty((x.size, crossed.size))
        table = *self.table, self.n, 1, self.x0, outside != "hold"
        kernel.CHOSEN.backlash_engagement(*table, words, x, rows, crossed, group_size)
        return rows, BacklashState(self._bits(words), state.memory)


class DiscretePointOperator:
    """The Discrete Point Operator of m segments, (13)-(16): memory-free, increasing, piecewise linear.

    Parameters
    ----------
    dx, dy : array_like
        ΔX_i and ΔY_i of (15), > 0, lowest segment first.
    x0, y0 : float
        X_0 and Y_0, where the first segment begins. The end segments extend beyond the
        range.

    Raises
    ------
    ModelError
        Lengths differ or a width is not > 0; the message begins with the key.
    """

    def __init__(
        self, dx: ArrayLike, dy: ArrayLike, x0: float = 0.0, y0: float = 0.0
    ) -> None:
        self.dx, self.dy = checked_pair(dx, dy, x0, y0)
        self.x0, self.y0 = float(x0), float(y0)
        self.m = self.dx.size
        widths = on_binary_grid("dx", self.dx)
        heights = on_binary_grid("dy", self.dy)
        x = np.concatenate([[0.0], np.cumsum(widths)])
        y = np.concatenate([[0.0], np.cumsum(heights)])
        self.x_range = (self.x0, self.x0 + float(x[-1]))
        self.y_range = (self.y0, self.y0 + float(y[-1]))
        self.segments: Floats = np.ascontiguousarray(
            np.column_stack([x[:-1], y[:-1], heights / widths])
        )
        self.segments.flags.writeable = False

    def __repr__(self) -> str:
        """Return a short description for debugging."""
        return f"{type(self).__name__}(m={self.m}, x_range={self.x_range}, y_range={self.y_range})"

    def inverse(self) -> DiscretePointOperator:
        """Return the inverse (17)-(18): ΔX and ΔY exchanged in every segment, and the origins."""
        return DiscretePointOperator(self.dy, self.dx, self.y0, self.x0)

    def run(self, x: ArrayLike, out: Floats | None = None) -> Floats:
        """Return the output of (13)-(16) for one block, in ``out`` (may be ``x``) where that is given."""
        x = np.ascontiguousarray(x, dtype=np.float64).reshape(-1)
        y = np.empty_like(x) if out is None else out
        kernel.CHOSEN.point_run(self.segments, self.x0, self.y0, x, y)
        return y
