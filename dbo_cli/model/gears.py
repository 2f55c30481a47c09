"""The Discrete Backlash Operator: gears, their states, and their inverse.

Gears are a value: they hold no state and are never changed. A state goes in and a new
one comes out, and the output does not depend on how a signal is cut into blocks.

Source: Y. N. Aye and W. T. Ang (2018), "A Discrete Backlash Operator for Identification
and Compensation of Hysteresis and Non-linearity for Piezoelectric Actuator"; equation
numbers are the paper's.
"""

import dataclasses
import functools
import math
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dbo_cli.arrays import Floats, Range
from dbo_cli.errors import ModelError
from dbo_cli.model import kernel
from dbo_cli.model.fields import Keyed
from dbo_cli.model.points import TABLE, axes, read_only
from dbo_cli.model.relaxation import Relaxation
from dbo_cli.model.state import Run, State

Words = NDArray[np.uint64]
Places = NDArray[np.uint32]

NEGLIGIBLE = 1e-9
"""Clipping, and missing a first value, count from this fraction of the range on."""

INWARDS = 1.0 - 2.0**-51
"""Factor on a step: the step in time, the product and this factor are rounded by 2^-53 each."""

CROSSING_TOLERANCE = 1e-9
"""A gear counts as crossed when all but this fraction of it is travelled (more where rounding is coarse)."""

# chosen: more than the additions of a signal's way lose
_ROUNDING_STEPS = 64.0 * np.finfo(np.float64).eps
_LARGEST_TOLERANCE = 1.0 / 16.0  # what 64 steps of rounding are of the narrowest width

LEAST_SLOPE_LEFT = 0.03
"""Of the mean slope: what the negative gains must leave of every slope. At 0.1 % a wish with 1e-4 um of noise
becomes 0.8 V of it; round trips do not show that.
"""

OPEN = (-math.inf, math.inf)
_WORD = 64  # bits of a uint64, in which the kernel keeps the states of gears
_NO_NUMBERS = np.empty(0)


def largest_step(slew: float | None, dt: float | Floats | None) -> Any:
    """Return the largest change of a drive in a time step (s), rounded down; None where any is allowed."""
    if slew is None or slew == math.inf or dt is None:
        return None
    return slew * dt * INWARDS


class Gears(Keyed):
    """The Discrete Backlash Operator of n gears, (1)-(12), with relaxation beside the gears.

    Parameters
    ----------
    dx, dy : array_like
        Widths dX_i and dY_i of (10), > 0, gear 0 first.
    x0, y0 : float
        X_0 and Y_0, the coordinates of B = 0.
    relaxation : Relaxation, optional
        Lag and creep; they follow the input, the voltage.

    Attributes
    ----------
    gain, reference : array, float
        Of the relaxation; without one, no gain.
    x_range, y_range : (float, float)
        Input and output at B = 0 and at B = 2^n - 1, after a rest.

    Raises
    ------
    ModelError
        Lengths differ, a width is not > 0, or too narrow beside the rest, or negative
        gains leave too little of a slope; the message begins with the key.

    Notes
    -----
    Outside [X_0, X_0 + sum dX_i] the paper says nothing. ``extend`` goes on with the
    slope of gear n - 1, the last one engaged on the way there; without it Y_B is kept.
    """

    KEYS: ClassVar = {**TABLE, "relaxation": Relaxation.read}
    OPTIONAL: ClassVar = ("relaxation",)

    def __init__(
        self,
        dx: ArrayLike,
        dy: ArrayLike,
        x0: float = 0.0,
        y0: float = 0.0,
        relaxation: Relaxation | None = None,
    ) -> None:
        self.dx, self.dy, widths, heights = axes(dx, dy)
        self.x0, self.y0 = float(x0), float(y0)
        self.relaxation = relaxation
        self.gain, self.reference = np.empty(0), 0.0
        if relaxation is not None:
            self.gain = np.array(relaxation.gain, dtype=np.float64)
            self.reference = relaxation.reference
        self.n = int(self.dx.size)
        self.width = math.fsum(widths.tolist())
        self.height = math.fsum(heights.tolist())
        self.table = self._table(widths, heights)
        low, high = self.x0, self.x0 + self.width
        at_rest = math.fsum(self.gain.tolist())
        bottom = self.y0 + at_rest * (low - self.reference)
        top = self.y0 + self.height + at_rest * (high - self.reference)
        self.x_range, self.y_range = (low, high), (bottom, top)
        for key, (low, high) in (("x0", self.x_range), ("y0", self.y_range)):
            if not low < high:
                raise ModelError(
                    f"{key}: the gears are lost in rounding beside their origin, {low:.6g}"
                )

    def _table(self, widths: Floats, heights: Floats) -> Floats:
        """Return a row (dx, dy, slope, crossing_fraction) for each gear, of widths on the binary grid.

        ``crossing_fraction`` is where a gear counts as crossed: all but 1e-9 of it, since a
        drive that turns on a breakpoint is the usual case and one unit in the last place
        must not decide which gear engages on the way back. Where a gear is so narrow beside
        the numbers that are added and subtracted on an axis that rounding exceeds that, the
        tolerance is 64 rounding steps. Exchanging the axes leaves it as it is, so an operator
        and its inverse decide alike.

        Every slope and the sum of the negative gains, the least that kappa = sum c_j (1 - a_j)
        can be, must be at least 3 % of the mean slope (ModelError): the inverse is then exact
        for every time step, and well conditioned.
        """
        negative = math.fsum(self.gain[self.gain < 0.0].tolist())
        slopes = heights / widths
        smallest = LEAST_SLOPE_LEFT * (self.height / self.width)
        gear = int(np.argmin(slopes))
        slope = float(slopes[gear]) + negative
        if negative < 0.0 and slope < smallest:
            raise ModelError(
                f"relaxation.gain: negative gains leave gear {gear} a slope of {slope:.6g}, less than 3 % "
                f"of the mean, {smallest:.6g}"
            )
        scale_x = max(abs(self.x0), abs(self.x0 + self.width), self.width)
        scale_y = max(abs(self.y0), abs(self.y0 + self.height), self.height)
        gains = math.fsum(np.abs(self.gain).tolist())
        scale_y += gains * (scale_x + abs(self.reference))
        apart_y = heights + negative * widths
        with np.errstate(over="ignore", divide="ignore"):
            rounding = np.maximum(scale_x / widths, scale_y / apart_y)
        tolerance = np.clip(
            _ROUNDING_STEPS * rounding, CROSSING_TOLERANCE, _LARGEST_TOLERANCE
        )
        return read_only(np.column_stack([widths, heights, slopes, 1.0 - tolerance]))

    @property
    def equal_run(self) -> int:
        """How many neighbouring gears are equal, from every multiple of that number on.

        The last run may be shorter. Identification gives many gears one slope, so that
        runs are long; 1 where nothing repeats.
        """
        starts = np.flatnonzero(np.any(self.table[1:] != self.table[:-1], axis=1)) + 1
        run = math.gcd(*starts.tolist()) or self.n
        # the kernel divides by a 32-bit multiplication
        if run * self.n >= 2**32:
            return 1
        return run

    @functools.cached_property
    def exchanged(self) -> Floats:
        """The table of the inverse (17)-(18): dX and dY exchanged in every gear."""
        dx, dy, _, fraction = self.table.T
        return read_only(np.column_stack([dy, dx, dx / dy, fraction]))

    @functools.cached_property
    def _rows(self) -> tuple[tuple[Floats, Places], tuple[Floats, Places]]:
        """The kernel's table and its guide, a row for each gear; and those of the inverse."""
        return kernel_table(self.table), kernel_table(self.exchanged)

    def operator(self, extend: bool, is_inverse: bool = False) -> tuple[Any, ...]:
        """Return the kernel's first arguments, the same for all blocks; memory follows the voltage."""
        rows = self._rows[is_inverse]
        origins = (self.y0, self.x0) if is_inverse else (self.x0, self.y0)
        return *rows, *origins, extend, self.gain, self.reference, is_inverse

    def words(self, bits: int) -> Words:
        """Return the kernel's buffer with the bits of a state in it (ModelError where they are too many)."""
        if bits < 0 or bits >> self.n:
            raise ModelError(f"state: has bits beyond the {self.n} gears of this model")
        size = (self.n + _WORD - 1) // _WORD
        content = bits.to_bytes(8 * size, "little")
        return np.frombuffer(content, dtype="<u8").astype(np.uint64)

    def settled(self, voltage: float, covered: int, spare: int) -> int:
        """Return the bits after an oscillation that decays from the whole range to ``voltage``.

        The range is that of the first ``covered`` gears; others stay as they are in the
        bits ``spare``.

        The oscillation turns at ``voltage + A`` and ``voltage - A``, both cut off at
        the ends of the range; A falls arbitrarily slowly to 0 and the first turn is the
        upper one. The gears stop flipping from the highest to the lowest. With the
        gears up to k spanning [low, high], gear k stops when A no longer reaches high
        (it stays 0) or low (it stays 1), whichever comes first: the end that is farther
        from ``voltage``. A tie, as with even gears halfway, stays 1; a tolerance
        decides that, not rounding.
        """
        words = self.words(spare)
        kernel.extension.backlash_settled(
            self.operator(True, is_inverse=True), words, covered, float(voltage),
        )  # fmt: skip
        return bits_of(words)

    def run(
        self,
        x: ArrayLike,
        state: State,
        dt: float | Floats = math.inf,
        extend: bool = True,
    ) -> Run:
        """Return the output of (1)-(12) for one block, and the state after it.

        Parameters
        ----------
        x : array_like
            One block of the voltage.
        state : State
            Bits and memory before it; without memory the actuator rests at the first
            sample.
        dt : float or array
            Seconds since the sample before, one number or one a sample.
        extend : bool
            Beyond the gears go on with the last slope; else keep Y_B.

        Raises
        ------
        ModelError
            The state is not of these gears.
        """
        return self._block(self.operator(extend), x, state, dt, None, None)

    def undo(
        self,
        y: ArrayLike,
        state: State,
        dt: float | Floats = math.inf,
        window: Range | None = None,
        slew: float | None = None,
    ) -> Run:
        """Return the voltage (17)-(18) of one block of the output, the state after it, and what was clipped.

        Parameters
        ----------
        y, state, dt
            As of ``run``; the state's drive is the voltage before, for the slew. Beyond
            the gears the last slope goes on.
        window : (float, float), optional
            Clip the voltage to this range; the state is then that of ``run`` for the
            clipped voltage.
        slew : float, optional
            With a window: the largest change of the voltage a second.

        Raises
        ------
        ModelError
            The state is not of these gears.
        """
        operator = self.operator(True, is_inverse=True)
        return self._block(operator, y, state, dt, window, slew)

    def _block(
        self,
        operator: tuple[Any, ...],
        signal: ArrayLike,
        state: State,
        dt: float | Floats,
        window: Range | None,
        slew: float | None,
    ) -> Run:
        """Run the kernel over a block; where no memory is known, the first sample is at rest."""
        x = np.ascontiguousarray(signal, dtype=np.float64).reshape(-1)
        steps = decay = _NO_NUMBERS
        if window is not None and slew is not None:
            steps = np.array(largest_step(slew, dt), dtype=np.float64).reshape(-1)
        if self.relaxation is not None:
            decay = self.relaxation.decay(dt)
        memories = np.array(state.memory or np.zeros(self.gain.size))
        y = np.empty_like(x)
        words = self.words(state.bits)
        before = math.nan if state.drive is None else state.drive
        low, high = window or OPEN
        clipped: tuple[int, int] = kernel.extension.backlash_run(
            operator, words, memories, state.memory is None, before, x, y, decay,
            window is not None, low, high, self.slack(low, high), steps,
        )  # fmt: skip
        memory = None if self.relaxation is None else tuple(memories.tolist())
        is_inverse = operator[-1]
        voltage = float(y[-1]) if is_inverse else float(x[-1])
        return Run(y, state.behind(bits_of(words), memory, voltage), *clipped)

    def slack(self, low: float, high: float) -> float:
        """Return by how much clipping to a range has to move a voltage to count."""
        begin, end = self.x_range
        return NEGLIGIBLE * min(high - low, end - begin)

    def stepper(
        self, state: State, dt: float, window: Range, slew: float | None
    ) -> Any:
        """Return the kernel's stepper of ``undo`` at an even rate, for live control.

        Its ``plan(y)`` returns the voltage for an output within ``window`` and
        ``slew``, and ``clipped`` tells whether they held it back; ``follow(voltage)``
        works out the state that a voltage leads to. Nothing changes until ``commit()``.
        The values are those of ``undo``, which checks, allocates and converts for every
        block.
        """
        decay = np.zeros((0, 0))
        if self.relaxation is not None:
            decay = self.relaxation.decay(dt)
        step = largest_step(slew, dt)
        memories = np.array(state.memory or (), dtype=np.float64)
        return kernel.extension.Stepper(
            self.operator(True, is_inverse=True), decay, *window, self.slack(*window),
            math.nan if step is None else step, self.words(state.bits), memories,
            math.nan if state.drive is None else state.drive,
        )  # fmt: skip

    def committed(self, stepper: Any) -> State:
        """Return bits and memory to which a stepper was committed."""
        words, memory = self.words(0), np.zeros(self.gain.size)
        stepper.get(words, memory)
        after = None if self.relaxation is None else tuple(memory.tolist())
        return State(bits_of(words), after)

    def identity(self) -> list[object]:
        """Return what a state of the stage refers to."""
        axes = [self.dx.tolist(), self.dy.tolist(), self.x0, self.y0]
        if self.relaxation is None:
            return [axes]
        return [axes, dataclasses.asdict(self.relaxation)]

    def engagement(self, x: ArrayLike, group_size: int = 1) -> Floats:
        """Return the part of the gears that is in the output of every sample, from B = 0 on.

        The rows phi (len(x) x n) fulfil y - y0 = phi @ dy: 1 for a crossed gear, 0 for
        an open one, a fraction for the engaged one, so that heights are linear unknowns
        of the output. With ``group_size`` > 1 that many neighbours share one column
        (len(x) x ceil(n / group_size)), their mean. Relaxation is not in them (see
        ``Relaxation.lags``).
        """
        x = np.ascontiguousarray(x, dtype=np.float64).reshape(-1)
        crossed = np.zeros(-(-self.n // group_size))
        rows = np.empty((x.size, crossed.size))
        kernel.extension.backlash_engagement(
            self.operator(True), x, rows, crossed, group_size
        )
        return rows


def kernel_table(gears: Floats, run: int = 1) -> tuple[Floats, Places]:
    """Return the kernel's table, a row for each ``run`` of equal gears, and its guide.

    To the row of its gears, each row adds where the first of them begins; one more
    stands behind the last and begins where the last gear ends. The guide cuts the range
    of the input into as many equal parts as there are rows, and says in which row each
    begins.
    """
    ends = np.cumsum(gears[:, :2], axis=0)  # exact: the widths lie on one binary grid
    begins = np.vstack([[0.0, 0.0], ends[run - 1 : -1 : run], ends[-1]])
    rows = np.vstack([gears[::run], gears[-1]])
    table = read_only(np.hstack([rows, begins]))
    parts = np.linspace(0.0, ends[-1, 0], 2 * len(table) - 1)
    guide = np.searchsorted(begins[:-1, 0], parts, side="right") - 1
    return table, guide.astype(np.uint32)


def bits_of(words: Words) -> int:
    """Return B out of the kernel's buffer."""
    return int.from_bytes(words.astype("<u8").tobytes(), "little")
