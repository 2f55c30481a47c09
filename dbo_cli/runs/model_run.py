"""A model run over a signal block by block: the state from block to block, and what is counted on the way."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from dbo_cli.errors import InputError, LimitError
from dbo_cli.hysteresis import kernel
from dbo_cli.hysteresis.initial_states import START_NAMES, StartName
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.hysteresis.model_state import DriveLimits, ModelState, OutsideError, Quantity
from dbo_cli.hysteresis.operators import Outside
from dbo_cli.logs.sample_block import FloatArray, SampleBlock
from dbo_cli.runs.inputs import Inputs, Transforms
from dbo_cli.runs.remarks import Remarks
from dbo_cli.runs.source import Source, remarks_of
from dbo_cli.runs.time_steps import TimeSteps

LONG_WORK = 2_000_000  # rows from which on the Python kernel's slowness is worth a word
ASSUMED_SPREAD = 0.01  # of the range: what the past may matter at the start without a word
REACH_SLACK = 0.01  # of the range: a trajectory this little outside is clipped and counted like any other
FASTER = 2.0
"""Times the fastest drive of the identification's logs: beyond, what the model says of lag is a guess. After
logs of at most 1.3 ranges a second the error at 3 to 6 ranges a second was twice that at the logs' speeds."""

FAST_PART = 0.05  # of the samples: a few faster ones are not worth a word
LAG_DEPENDS = "this model's lag, creep or delay depends on it"


@dataclass
class Tally:
    """How many samples were unusual, and the data row of the first."""

    count: int = 0
    first_row: int = 0

    def add(self, count: int, index: int, block: SampleBlock) -> None:
        """Count what one block had, at least one."""
        if not self.count:
            self.first_row = int(block.rows[index])
        self.count += count


class Response(NamedTuple):
    """One block of a run: seconds (None where they are not known), what went in, and what came out."""

    time: FloatArray | None
    given: FloatArray
    result: FloatArray


@dataclass
class ModelRun:
    """One run of a model over a source.

    Without ``limits`` the model is simulated as it stands. With them it must be a forward one, and what
    comes out is the drive that makes its output follow the source (see ``compensation``).

    Attributes
    ----------
    model, source
        What is run over what; the source has the model's input (or, with ``limits``, output) as a role.
    start : str or ModelState
        ``auto``, ``empty``, ``full``, ``settled``, or a state to go on from.
    outside : {"extend", "hold", "error"}
        Beyond the model's range: go on with the last slope, hold, or refuse.
    limits : DriveLimits, optional
        What the drive may do.
    refuse_clipping : bool
        Raise LimitError where the limits are met.
    last_row : int, optional
        The last row that is answered; rows after it are only read ahead.
    bandwidth : float, optional
        Cut-off (Hz) of the low-pass that rounds a trajectory first.
    state : ModelState, or None
        After the samples run so far.
    """

    model: ActuatorModel
    source: Source
    start: StartName | ModelState = "auto"
    outside: Outside = "extend"
    limits: DriveLimits | None = None
    refuse_clipping: bool = False
    last_row: int | None = None
    why_time: str | None = None
    bandwidth: float | None = None
    state: ModelState | None = None
    found_start: StartName | None = None
    last_drive: float | None = None
    rows: int = 0
    beyond: Tally = field(default_factory=Tally)
    clipped: Tally = field(default_factory=Tally)
    fast: Tally = field(default_factory=Tally)
    missed: float = 0.0
    unreachable: int = 0
    assumed: float = 0.0
    steps: TimeSteps = field(init=False)
    prepared: Inputs = field(init=False)

    def __post_init__(self) -> None:
        """Refuse a source without time where the model needs one."""
        why = self.why_time
        inverting = self.limits is not None or self.model.direction == "inverse"
        if self.model.needs_time or (inverting and reads_ahead(self.model)):
            why = LAG_DEPENDS
        if self.bandwidth is not None and why is None:
            why = "`bandwidth` depends on it"
        begun = self.start if isinstance(self.start, ModelState) else None
        self.steps = TimeSteps(self.source, why, begun.time if begun else None)
        what = Transforms(
            self.taken.quantity,
            self.model.delay_seconds if inverting else 0.0,
            self.model.dynamics if inverting else None,
            self.bandwidth,
            self.last_row,
        )
        self.prepared = Inputs(self.source, what, begun, self.taken)

    @property
    def taken(self) -> Quantity:
        """What the run takes in."""
        return self.model.input if self.limits is None else self.model.output

    @property
    def given(self) -> Quantity:
        """What the run gives."""
        return self.model.output if self.limits is None else self.model.input

    def responses(self) -> Iterator[Response]:
        """Run over the whole source; the blocks may be of any length, their samples always the same.

        Raises
        ------
        InputError
            The source is bad, time goes backwards, or a sample is outside where that is refused.
        LimitError
            A limit of the drive was met, and that is refused.
        """
        role = self.taken.quantity
        for block, x in self.inputs():
            yield Response(block.time, block.values[role], self.feed(block, x))
        self.check_reach()

    def check_reach(self) -> None:
        """Refuse a trajectory that lies outside what the model reaches from its first row to its last."""
        if self.rows and self.unreachable == self.rows:
            raise InputError(
                f"{self.source.name}: every row is outside what the model reaches ({self._range()}): check "
                "unit, column and zero of the trajectory"
            )

    def inputs(self) -> Iterator[tuple[SampleBlock, FloatArray]]:
        """Return each block with what goes into the model (see ``Inputs``)."""
        return self.prepared.blocks()

    def feed(self, block: SampleBlock, x: FloatArray) -> FloatArray:
        """Return the output for one block, and go on from there."""
        steps = self.steps.of(block) if self.steps.needed else None
        if self.state is None:
            self.state = self._begun(float(x[0]))
        try:
            if self.limits is None:
                done = self.model.simulate(x, self.state, time_step=steps, outside=self.outside)
            else:
                done = self.model.compensate(x, self.state, limits=self.limits, time_step=steps)
        except OutsideError as problem:
            raise InputError(
                f"{block.place(self.source.name, problem.index)}: {x[problem.index]:.6g} is outside the "
                f"range of the model ({self._range()}) (`outside` extend or hold)"
            ) from None
        time = None if block.time is None else float(block.time[-1])
        self.state = dataclasses.replace(done.state, time=time, undoing=self.prepared.memory)
        self.rows += len(x)
        if self.limits is not None:
            reach, slack = self.model.output, REACH_SLACK * self.model.output.span
            wanted = x if self.model.dynamics is None else block.values[self.taken.quantity]
            outside = (wanted < reach.minimum - slack) | (wanted > reach.maximum + slack)
            self.unreachable += int(np.count_nonzero(outside))
        if done.outside_count:
            self.beyond.add(done.outside_count, done.first_outside, block)
        if done.clipped_count:
            self.clipped.add(done.clipped_count, done.first_clipped, block)
        self.missed = self.missed or done.first_missed
        if self.refuse_clipping and self.clipped.count:
            raise LimitError(f"{self._clipping()} (`on_limit` clip goes on)")
        if steps is not None and self.model.direction == "forward":
            self._watch_speed(x if self.limits is None else done.y, steps, block)
        return done.y

    @property
    def may_condition(self) -> bool:
        """Whether a sweep before the first sample could bring the actuator into the start."""
        return self.limits is not None

    def _watch_speed(self, drive: FloatArray, steps: float | FloatArray, block: SampleBlock) -> None:
        """Count the samples whose drive is faster than any that the model was identified from."""
        fastest = self.model.fit.get("fastest_drive")
        if not isinstance(fastest, float) or self.model.dynamics is not None:
            return
        before = drive[0] if self.last_drive is None else self.last_drive
        faster = np.abs(np.diff(drive, prepend=before)) > FASTER * fastest * steps
        self.last_drive = float(drive[-1])
        if faster.any():
            self.fast.add(int(np.count_nonzero(faster)), int(np.argmax(faster)), block)

    def remarks(self) -> Remarks:
        """Return what is to be said of the run so far."""
        told = remarks_of(self.source)
        told.add(self.prepared.remarks())
        if self.found_start:
            told.notes.append(f"{self.source.name}: starts {self.found_start}, as the identification found")
        if self.assumed:
            displacement = self.model.output if self.model.direction == "forward" else self.model.input
            told.notes.append(
                f"{self.source.name}: where it starts, the displacement depends on the past by up to "
                f"{self.assumed:.3g}{unit_of(displacement)}; the actuator is taken to have settled there "
                f"({'`condition` sweeps it there, ' if self.may_condition else ''}`state` empty where it "
                "comes from its lower end)"
            )
        if self.clipped.count:
            told.warn(f"{self._clipping()}: clipped (`on_limit` error refuses this)")
        elif self.beyond.count:
            fate = "held" if self.outside == "hold" else "extended with the last slope"
            counted = self._counted(self.beyond)
            told.warn(f"{counted} outside the range of the model ({self._range()}): {fate}")
        if self.fast.count > FAST_PART * self.rows:
            told.warn(
                f"{self._counted(self.fast)} move the drive more than {FASTER:g} times as fast as the logs "
                "of the identification did: how late the actuator is there was not seen; identify at the "
                "speed of use"
            )
        if self.missed:
            told.warn(
                f"{self.source.name}: the drive starts {abs(self.missed):.3g}{unit_of(self.taken)} off the "
                "first value, which the actuator does not pass when it settles (`state` empty or `condition`)"
            )
        if kernel.KIND == "python" and self.rows >= LONG_WORK:
            told.warn("the compiled kernel is not there and Python does the work, a hundred times slower")
        drive = self.model.input
        if self.limits and (self.limits.v_min < drive.minimum or self.limits.v_max > drive.maximum):
            told.warn(
                f"the limits of the drive reach beyond {drive.minimum:.6g} to {drive.maximum:.6g}"
                f"{unit_of(drive)}, where the model was identified; it extrapolates there"
            )
        return told

    def _clipping(self) -> str:
        """Say how much of a trajectory the drive's limits do not allow."""
        assert self.limits is not None
        drive = self.model.input
        limits = f"{drive.quantity} {self.limits.v_min:.6g} to {self.limits.v_max:.6g}{unit_of(drive)}"
        if self.limits.max_slew is not None:
            limits += f", {self.limits.max_slew:.6g}{unit_of(drive)}/s"
        return f"{self._counted(self.clipped)} beyond what the limits of the drive allow ({limits})"

    def _counted(self, tally: Tally) -> str:
        first = f"row {tally.first_row:,}" if tally.count == 1 else f"first in row {tally.first_row:,}"
        return f"{self.source.name}: {tally.count:,} of {self.rows:,} samples ({first})"

    def _range(self) -> str:
        taken = self.taken
        return f"{taken.quantity} {taken.minimum:.6g} to {taken.maximum:.6g}{unit_of(taken)}"

    def _begun(self, first: float) -> ModelState:
        if self.limits is None:
            if self.start == "auto":
                self.found_start = found_start(self.model, self.source.name, first)
            begun = self.model.start(first, self.found_start or self.start)
        else:
            begun = self.model.start_compensation(first, self.start, self.limits)
        if self.start == "auto" and not self.found_start:
            spread = self.model.start_spread(begun, first)
            displacement = self.model.output if self.model.direction == "forward" else self.model.input
            self.assumed = spread if spread > ASSUMED_SPREAD * displacement.span else 0.0
        return begun


def found_start(model: ActuatorModel, name: str, first: float) -> StartName | None:
    """Return the start that the identification found for its log of this name and first voltage."""
    logs = model.fit.get("logs")
    if model.direction != "forward" or not isinstance(logs, list):
        return None
    for log in logs:
        told = log if isinstance(log, dict) else {}
        named = name == told.get("name") or name.endswith(f"/{told.get('name')}")
        for start in START_NAMES:
            if named and told.get("begins_at") == first and told.get("start") == start:
                return start
    return None


def reads_ahead(model: ActuatorModel) -> bool:
    """Tell whether the inverse of a model needs samples that come later."""
    return model.delay_seconds > 0.0 or model.dynamics is not None


def unit_of(quantity: Quantity) -> str:
    """Return a quantity's unit behind a blank, nothing where it has none."""
    return f" {quantity.unit}" if quantity.unit else ""
