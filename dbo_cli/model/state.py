"""Values that go into and come out of a model: quantities, states, blocks of output, and time steps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from dbo_cli.arrays import Floats
from dbo_cli.errors import InputError, ModelError
from dbo_cli.model.fields import Keyed, number, text, unless_null
from dbo_cli.signals import COARSEST_DECIMAL, even

# seconds since the sample before: one number, or one each
Steps = float | Floats | None
# three numbers of each section of the dynamics
SectionStates = tuple[tuple[float, float, float], ...]
# times (s) and values of the samples that a delay still needs; the last is the newest
Held = tuple[tuple[float, ...], tuple[float, ...]]
# what undoing dynamics and delay remembers: the step (s) of its clock, (y, a, b) of each
# section, and the last two values wanted, for the delay
Undoing = tuple[float, SectionStates, tuple[float, ...]]
START_NAMES = ("auto", "empty", "full", "settled")
KEPT_STARTS = ("settled", "empty", "full", "below", "above")  # of ``auto``, in a model


@dataclass(frozen=True)
class Quantity(Keyed):
    """What a signal is: its name, its unit (None: not known), and the range the model covers.

    Raises
    ------
    ModelError
        The ends of the range are not in order; the message begins with the key.
    """

    quantity: str
    unit: str | None
    min: float
    max: float
    KEYS: ClassVar = {
        "quantity": text,
        "unit": unless_null(text),
        "min": number,
        "max": number,
    }

    def __post_init__(self) -> None:
        """Refuse a range whose ends are not in order."""
        if not self.min < self.max:
            raise ModelError(f"max: {self.max!r} is not greater than min, {self.min!r}")

    @property
    def span(self) -> float:
        """The length of the range."""
        return self.max - self.min

    @property
    def suffix(self) -> str:
        """The unit behind a blank, as messages write it; nothing where there is none."""
        if self.unit is None:
            return ""
        return f" {self.unit}"


@dataclass(frozen=True)
class State:
    """Everything that one sample leaves behind for the next; the same whether a model runs or is undone.

    Attributes
    ----------
    bits : int
        B = b_{n-1} ... b_0 of the gears.
    memory : tuple of float, or None
        L_j of the relaxation; None: at rest at the sample to come.
    drive : float, or None
        The last voltage, for the slew limit.
    time : float, or None
        When the last sample was (s); kept for the caller.
    sections : tuple, or None
        (p, q, u) of each section of the dynamics; None: at rest at the sample to come.
    delay : Held, or None
        What a delay still holds back.
    amplifier : float, or None
        The output of the amplifier; None: at rest at the sample to come.
    undoing : Undoing, or None
        What undoing dynamics and delay remembers; put there by its caller.
    first : float, or None
        Of a drive about to start: its first voltage.
    model : str
        Digest of the model that it is of; empty inside a run.
    """

    bits: int = 0
    memory: tuple[float, ...] | None = None
    drive: float | None = None
    time: float | None = None
    sections: SectionStates | None = None
    delay: Held | None = None
    amplifier: float | None = None
    undoing: Undoing | None = None
    first: float | None = None
    model: str = ""

    def behind(
        self, bits: int, memory: tuple[float, ...] | None, drive: float | None
    ) -> State:
        """Return the state with the gears and the voltage of a later sample."""
        return State(
            bits, memory, drive, self.time, self.sections, self.delay,
            self.amplifier, self.undoing, self.first,
        )  # fmt: skip


class Run(NamedTuple):
    """One block of output, or of a drive, and the state after it; places count from 0 in the block.

    Attributes
    ----------
    y : array
        The output: displacement of a forward model, voltage of a drive.
    state : State
        After the block.
    clipped, first_clipped : int
        How many rows of a drive its limits clipped, and the first of them.
    """

    y: Floats
    state: State
    clipped: int = 0
    first_clipped: int = 0


def steps_of(time: ArrayLike) -> float | Floats:
    """Return the step (s) of time stamps that are even to rounding, else one a row (0 first).

    Raises
    ------
    InputError
        Time goes backwards.
    """
    stamps = np.asarray(time, dtype=np.float64).reshape(-1)
    steps = np.diff(stamps, prepend=stamps[:1])
    wrong = np.flatnonzero(~(steps >= 0.0))
    if wrong.size:
        row = int(wrong[0])
        raise InputError(f"row {row + 1}: time goes backwards, to {stamps[row]:.9g} s")
    step = even(stamps)
    return steps if step is None else step


def steps_behind(last_time: float | None, time: Floats | None, dt: Steps) -> Steps:
    """Return the seconds before each row, where a state was left at a time (s) before the first.

    An even clock that goes on stays one number; a clock that begins anew, or no clock,
    leaves ``dt`` as it is.
    """
    if last_time is None or time is None or not time[0] > last_time:
        return dt
    if isinstance(dt, float) and abs(time[0] - last_time - dt) <= COARSEST_DECIMAL * dt:
        return dt
    return np.diff(time, prepend=last_time)
