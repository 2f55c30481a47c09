"""Values that go into and come out of a model: quantities, limits, states and blocks of output.

What the operator has been through before the first sample is one of four: ``empty``
(the actuator has been at or below its lower end), ``full``, ``settled`` (after an
oscillation that decays from the whole range to the first sample) and ``auto``:
``empty`` where the first voltage is at or below the lower end, else ``settled``. Where
the first voltage is not given but asked for, because the first value known is a
displacement, it is the one whose own start leads to that displacement.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

from dbo_cli.errors import InputError, ModelError, suffix_of
from dbo_cli.hysteresis import kernel
from dbo_cli.hysteresis.cascade import DelayHistory
from dbo_cli.hysteresis.dynamics import DynamicsInverter, InverseMemory, SectionStates
from dbo_cli.hysteresis.operators import (
    CROSSING_TOLERANCE,
    BacklashState,
    Counts,
    DiscreteBacklashOperator,
    Floats,
)

StartName = Literal["auto", "empty", "full", "settled"]
START_NAMES: tuple[StartName, ...] = ("auto", "empty", "full", "settled")


class DriveStart(NamedTuple):
    """The first voltage of an inverse, the state before it, and the displacement it reaches.

    Attributes
    ----------
    at_limit : bool
        Whether the voltage stands at a limit, because that is in the way or because it
        leads there.
    """

    voltage: float
    state: BacklashState
    reached: float
    at_limit: bool = False


def start_state(
    operator: DiscreteBacklashOperator, voltage: float, name: StartName
) -> BacklashState:
    """Return the state named ``name`` for a forward operator whose first input is ``voltage``.

    Raises
    ------
    ModelError
        There is no state of that name.
    """
    if name not in START_NAMES:
        raise ModelError(
            f"no initial state is called {name!r}; there are: {', '.join(START_NAMES)}"
        )
    if name == "full":
        return operator.full()
    if name == "empty" or (name == "auto" and voltage <= operator.x0):
        return operator.empty()
    return operator.settled(voltage)


def start_drive(
    operator: DiscreteBacklashOperator,
    displacement: float,
    low: float = -math.inf,
    high: float = math.inf,
) -> DriveStart:
    """Return the voltage in [low, high] whose own start, ``auto``, leads to ``displacement``.

    The output at rest after that start rises with the voltage, but by steps where the
    start changes: where it steps over ``displacement``, the voltage on the nearer side
    of the step is taken. ``operator`` is the forward one. The voltage is found by
    halving the range, and within the reach of one state exactly.
    """
    inverse = operator.inverse()
    lowest, highest = operator.x_range
    from_empty = float(inverse.run([displacement], operator.empty())[0][0])
    if from_empty <= lowest:
        return _within(operator, from_empty, low, high)
    from_full = float(inverse.run([displacement], operator.full())[0][0])
    if from_full >= highest:
        return _within(operator, from_full, low, high)
    below, above = kernel.CHOSEN.backlash_start(
        operator.constants(True),
        inverse.constants(True),
        displacement,
        lowest,
        highest,
    )
    if below == above:
        return _within(operator, below, low, high)
    # A little off the step, so that a voltage that was rounded on its way still starts
    # on the same side.
    off = CROSSING_TOLERANCE * (highest - lowest)
    ends = (
        _within(operator, below - off, low, high),
        _within(operator, above + off, low, high),
    )
    return min(ends, key=lambda end: abs(end.reached - displacement))


def _within(
    operator: DiscreteBacklashOperator, voltage: float, low: float, high: float
) -> DriveStart:
    """Return the start at ``voltage``, or at the limit that is in the way."""
    allowed = min(max(voltage, low), high)
    state = start_state(operator, allowed, "auto")
    reached = float(operator.run([allowed], state)[0][0])
    at_limit = voltage <= low or voltage >= high
    return DriveStart(allowed, state, reached, at_limit)


NEGLIGIBLE = 1e-9
"""Clipping, and missing a first value, count from this fraction of the range on."""


class OutsideError(InputError):
    """A sample lies outside the model's range, and that was to be refused.

    Attributes
    ----------
    index : int
        Position of the first such sample in the block.
    value, low, high : float
        Its value, and the range of the backlash stage it lies outside of, in that
        stage's input.
    """

    def __init__(self, index: int, value: float, low: float, high: float) -> None:
        super().__init__(
            f"sample {index + 1}: {value!r} is outside the range of the model, {low!r} to {high!r}"
            " (`outside` extend or hold)"
        )
        self.index, self.value, self.low, self.high = index, value, low, high


@dataclass(frozen=True)
class Quantity:
    """What a signal is: its name, its unit (None: not known), and the range the model covers.

    Raises
    ------
    ModelError
        The range is not finite, or its ends are not in order; the message begins with
        the key.
    """

    quantity: str
    unit: str | None
    minimum: float
    maximum: float

    def __post_init__(self) -> None:
        """Check the range."""
        for key, value in (("min", self.minimum), ("max", self.maximum)):
            if not math.isfinite(value):
                raise ModelError(f"{key}: {value!r} is not a finite number")
        if not self.minimum < self.maximum:
            raise ModelError(
                f"max: {self.maximum!r} is not greater than min, {self.minimum!r}"
            )

    @property
    def span(self) -> float:
        """The length of the range."""
        return self.maximum - self.minimum

    @property
    def suffix(self) -> str:
        """The unit behind a blank, as messages write it; nothing where there is none."""
        return suffix_of(self.unit)


_INWARDS = 1.0 - 2.0**-51
"""Three roundings (the step in time, the product, this factor) of one part in 2^53 each stay inside it."""


@dataclass(frozen=True)
class DriveLimits:
    """Limits on the drive voltage of a compensation: its range and, per second, its change.

    An infinite slew limit is none.

    Raises
    ------
    ModelError
        The range is empty, a limit is not a number, or the slew is not above 0.
    """

    v_min: float
    v_max: float
    max_slew: float | None = None

    def __post_init__(self) -> None:
        """Refuse an empty range and a slew that forbids every move."""
        if not self.v_min < self.v_max:
            raise ModelError(
                f"the lower voltage limit, {self.v_min!r}, is not below the upper, {self.v_max!r}"
            )
        if self.max_slew is not None and not self.max_slew > 0.0:
            raise ModelError(
                f"the largest slew, {self.max_slew!r}, is not greater than 0"
            )
        if self.max_slew == math.inf:  # times a step of 0 s it would be no number
            object.__setattr__(self, "max_slew", None)

    def largest_step(self, time_step: float | Floats | None) -> float | Floats | None:
        """Return the largest change of the drive in a time step (s), rounded down; None where any is."""
        if self.max_slew is None or time_step is None:
            return None
        return self.max_slew * time_step * _INWARDS

    def largest_change(self, time_step: float | None) -> float | None:
        """Return ``largest_step`` for a single time step."""
        step = self.largest_step(time_step)
        return None if step is None else float(step)

    def beyond(self, drive: Quantity) -> str:
        """Say that the limits reach beyond what a model covers, where they do."""
        if drive.minimum <= self.v_min and self.v_max <= drive.maximum:
            return ""
        return (
            f"the limits of the drive reach beyond {drive.minimum:.6g} to {drive.maximum:.6g}{drive.suffix}, "
            "where the model was identified; it extrapolates there"
        )

    def slack(self, span: float) -> float:
        """Return by how much clipping must move a sample to count, for a drive whose range is ``span``."""
        return NEGLIGIBLE * min(self.v_max - self.v_min, span)


@dataclass(frozen=True)
class ModelState:
    """Everything that one sample leaves behind for the next; the same for a model and its inverse.

    Attributes
    ----------
    backlash : BacklashState
        Bits and relaxation memory; memory None: at rest at the sample to come.
    drive : float, or None
        The last voltage, for the slew limit.
    history : DelayHistory, or None
        What a delay still holds back.
    first : DriveStart, or None
        Of an inverse about to start: its first voltage, and the output of the backlash
        stage it reaches.
    time : float, or None
        When the last sample was (s), where that is known: what comes next may come
        after a pause.
    dynamics : tuple, or None
        (p, q, u) of each section of the dynamics; None: at rest at the sample to come.
    undoing : InverseMemory, or None
        What the inverse of the dynamics remembers, after a compensation.
    drive_lag : tuple, or None
        (p, q, u) of the lag before the gears; None: at rest at the sample to come.
    model : str, or None
        The digest of the model that it is of, where it was handed out.
    """

    backlash: BacklashState
    drive: float | None = None
    history: DelayHistory | None = None
    first: DriveStart | None = None
    time: float | None = None
    dynamics: SectionStates | None = None
    undoing: InverseMemory | None = None
    drive_lag: SectionStates | None = None
    model: str | None = None

    def memory_for(self, inverter: DynamicsInverter) -> InverseMemory | None:
        """Return what the inverse of the dynamics goes on from, on its clock, or None."""
        if self.undoing is not None and self.undoing.time_step == inverter.time_step:
            return self.undoing
        if self.dynamics is None:
            return None
        return inverter.memory_of(self.dynamics)


class Simulated(NamedTuple):
    """One block of output, the state after it, and what was unusual; indices count from 0 in the block.

    Attributes
    ----------
    first_missed : float
        How far the first sample of a compensation is from the first value wanted, in
        the unit wanted, because the settled curve steps over it (0 where it does not).
    """

    y: Floats
    state: ModelState
    outside_count: int = 0
    first_outside: int = 0
    clipped_count: int = 0
    first_clipped: int = 0
    first_missed: float = 0.0

    @property
    def counts(self) -> Counts:
        """The samples that were unusual, as an operator counts them."""
        return Counts(
            self.outside_count,
            self.first_outside,
            self.clipped_count,
            self.first_clipped,
        )
