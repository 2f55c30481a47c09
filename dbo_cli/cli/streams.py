"""A model run over a log block by block: time steps, the state from block to block, and what is counted."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from dbo_cli.cli.bundles import Reading
from dbo_cli.cli.messages import Voice
from dbo_cli.errors import InputError, LimitError

if TYPE_CHECKING:
    from dbo_cli.hysteresis.initial_states import StartName
    from dbo_cli.hysteresis.model import ActuatorModel, Quantity
    from dbo_cli.hysteresis.model_state import DriveLimits, ModelState, Simulated
    from dbo_cli.hysteresis.operators import Outside
    from dbo_cli.logs.sample_block import FloatArray, SampleBlock
    from dbo_cli.logs.signal_log import SignalLog

LONG_WORK = 2_000_000  # rows from which on the Python kernel's slowness is worth a word
STATES = ("auto", "empty", "full", "settled")


class Clock:
    """Tells the time between samples across blocks, for models that remember by time."""

    def __init__(self, log: SignalLog, reading: Reading, why: str | None) -> None:
        self.needed = why is not None
        self.name = log.name
        if why is not None:
            log.require_time(why)
        # One number where samples are evenly spaced by definition: a delay of whole samples is exact then.
        rate = reading.resample or (log.sample_rate if not reading.skip_bad else None)
        self.step: float | None = None if rate is None else 1.0 / rate
        self.last: float | None = None

    def steps(self, block: SampleBlock) -> float | FloatArray | None:
        """Return the seconds since the sample before, one number or one for each sample of the block."""
        if not self.needed or block.time is None:
            return None
        if self.step is not None:
            return self.step
        import numpy as np

        time = block.time
        if self.last is None:
            # Only after a saved state does the very first step count: the log goes on as it begins.
            self.last = float(2.0 * time[0] - time[1]) if len(time) > 1 else float(time[0])
        steps = np.diff(time, prepend=self.last)
        if (steps < 0.0).any():
            raise InputError(self._backward(block, int(np.flatnonzero(steps < 0.0)[0])))
        self.last = float(time[-1])
        return steps

    def _backward(self, block: SampleBlock, index: int) -> str:
        return (
            f"{place_of(self.name, block, index)}: time goes backwards, and this model's lag and creep "
            "depend on the time between samples (cut the log with --rows A:B)"
        )


@dataclass
class Tally:
    """How many samples were unusual, and the data row of the first."""

    count: int = 0
    first_row: int = 0

    def add(self, count: int, index: int, block: SampleBlock) -> None:
        """Count what one block had."""
        if count and not self.count:
            self.first_row = int(block.rows[index])
        self.count += count


@dataclass
class ModelStream:
    """Runs a model over a log; ``start`` is a name, or a state that was saved.

    Without ``limits`` the model is simulated as it stands. With them it must be a forward one, and what
    comes out is the drive that makes its output follow the log (``compensate``).
    """

    model: ActuatorModel
    log: SignalLog
    clock: Clock
    start: StartName | ModelState = "auto"
    outside: Outside = "extend"
    limits: DriveLimits | None = None
    refuse_clipping: bool = False
    state: ModelState | None = None
    rows: int = 0
    beyond: Tally = field(default_factory=Tally)
    clipped: Tally = field(default_factory=Tally)
    missed: float = 0.0

    @property
    def taken(self) -> Quantity:
        """What the stream takes in."""
        return self.model.input if self.limits is None else self.model.output

    def feed(self, block: SampleBlock, x: FloatArray) -> FloatArray:
        """Return the output for one block."""
        steps = self.clock.steps(block)
        if self.state is None:
            self.state = self._begun(float(x[0]))
        done = self._run(block, x, steps, self.state)
        self.state = done.state
        self.rows += len(block)
        self.beyond.add(done.outside_count, done.first_outside, block)
        self.clipped.add(done.clipped_count, done.first_clipped, block)
        self.missed = self.missed or done.first_missed
        if self.refuse_clipping and self.clipped.count:
            raise LimitError(f"{self.clipping()} (--on-limit clip goes on)")
        return done.y

    def tell(self, voice: Voice) -> None:
        """Say what was counted."""
        if self.clipped.count:
            voice.warning(f"{self.clipping()}: clipped (--on-limit error refuses this)")
        elif self.beyond.count:
            fate = "held" if self.outside == "hold" else "extended with the last slope"
            counted = self._counted(self.beyond)
            voice.warning(f"{counted} outside the range of the model ({self._range()}): {fate}")
        if self.missed:
            voice.warning(
                f"{self.log.name}: the drive starts {abs(self.missed):.3g}{self._unit()} off the first "
                "value, which the actuator does not pass when it settles (--state empty or --condition)"
            )
        self._tell_kernel(voice)

    def clipping(self) -> str:
        """Say how much of a trajectory the drive's limits do not allow."""
        assert self.limits is not None
        drive = self.model.input
        unit = f" {drive.unit}" if drive.unit else ""
        limits = f"{drive.quantity} {self.limits.v_min:.6g} to {self.limits.v_max:.6g}{unit}"
        if self.limits.max_slew is not None:
            limits += f", {self.limits.max_slew:.6g}{unit}/s"
        return f"{self._counted(self.clipped)} beyond what the limits of the drive allow ({limits})"

    def _tell_kernel(self, voice: Voice) -> None:
        """Say that the Python kernel does the work, where the work is long."""
        from dbo_cli.hysteresis import kernel

        if kernel.KIND == "python" and self.rows >= LONG_WORK:
            voice.warning("the compiled kernel is not there and Python does the work, a hundred times slower")

    def _counted(self, tally: Tally) -> str:
        first = f"row {tally.first_row:,}" if tally.count == 1 else f"first in row {tally.first_row:,}"
        return f"{self.log.name}: {tally.count:,} of {self.rows:,} samples ({first})"

    def _range(self) -> str:
        return f"{self.taken.quantity} {self.taken.minimum:.6g} to {self.taken.maximum:.6g}{self._unit()}"

    def _unit(self) -> str:
        return f" {self.taken.unit}" if self.taken.unit else ""

    def _begun(self, first: float) -> ModelState:
        if self.limits is None:
            return self.model.start(first, self.start)
        return self.model.start_compensation(first, self.start, self.limits)

    def _run(self, block: SampleBlock, x: FloatArray, steps: Any, state: ModelState) -> Simulated:
        from dbo_cli.hysteresis.model_state import OutsideError

        if self.limits is not None:
            return self.model.compensate(x, state, limits=self.limits, time_step=steps)
        try:
            return self.model.simulate(x, state, time_step=steps, outside=self.outside)
        except OutsideError as problem:
            raise InputError(
                f"{place_of(self.log.name, block, problem.index)}: {x[problem.index]:.6g} is outside the "
                f"range of the model ({self._range()}) (--outside extend or hold)"
            ) from None


LAG_DEPENDS = "this model's lag, creep or delay depends on it"


def ahead(source: SignalLog, role: str, seconds: float) -> Iterator[tuple[SampleBlock, FloatArray]]:
    """Return each block with its signal as it will be ``seconds`` later: how an inverse undoes a delay."""
    if seconds == 0.0:
        return ((block, block.values[role]) for block in source.blocks())
    from dbo_cli.hysteresis.delay import read_ahead

    blocks = ((block, block.time, block.values[role]) for block in source.blocks() if block.time is not None)
    return read_ahead(blocks, seconds)


def place_of(name: str, block: SampleBlock, index: int) -> str:
    """Return where a sample stands, as a message names it: file and line, or row where there are no lines."""
    if block.lines is not None:
        return f"{name}:{int(block.lines[index])}"
    return f"{name}: row {int(block.rows[index])}"
