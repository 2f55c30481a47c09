"""A model run over a signal block by block: the state from block to block, and what is counted on the way."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from itertools import chain
from typing import Any, NamedTuple

import numpy as np

from dbo_cli.errors import InputError, Remarks
from dbo_cli.hysteresis import kernel, model_state
from dbo_cli.hysteresis.cascade import PIECE, DelayLeft, DelayStage, read_ahead
from dbo_cli.hysteresis.dynamics import (
    DynamicsInverter,
    DynamicsStage,
    InverseMemory,
    ZeroPhaseLowPass,
    undone,
)
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.hysteresis.model_state import ModelState, Quantity, Simulated, StartName
from dbo_cli.hysteresis.operators import Outside
from dbo_cli.logs.sample_block import (
    GAP_STEPS,
    JITTER,
    FloatArray,
    SampleBlock,
    require_even,
)
from dbo_cli.logs.signal_log import Source, remarks_of

CLOCK_SAMPLES = 101
"""A clock's step is that of so many first samples, however the signal is cut."""

STARTS_MOVING = 1e-3
"""Of the range: how far off the first value a drive may begin without a word."""
PROPOSED_PART = 3.0
"""A resonance over this is proposed as bandwidth: corners rounded by it ask for a few percent more travel."""

DELAY_ROWS = 100_000
"""Rows of which it is known what the interpolation of a delay leaves; chosen: 30 ms of work."""

EVEN_FOR_DYNAMICS = "the inverse of the model's dynamics needs an even clock"
EVEN_FOR_BANDWIDTH = "`bandwidth` needs an even clock"

Taken = tuple[SampleBlock, FloatArray]


@dataclass
class Inputs:
    """The blocks of a source, transformed.

    Attributes
    ----------
    source : Source
        Where the signal comes from.
    input : Quantity
        What the model takes of it; its name is the signal's role in the blocks.
    delay : DelayStage, or None
        What is read ahead for.
    dynamics : DynamicsStage, or None
        Dynamics to be undone.
    bandwidth : float, or None
        Cut-off of a low-pass in Hz.
    last_row : int, or None
        The last row that is answered; rows after it are only read ahead.
    start : ModelState, or None
        Before the first sample, where that is known.
    memory : InverseMemory, or None
        Of the dynamics' inverse, after the block yielded last.
    delay_left : DelayLeft, or None
        What the delay leaves of the signal that was read ahead.
    """

    source: Source
    input: Quantity
    delay: DelayStage | None = None
    dynamics: DynamicsStage | None = None
    bandwidth: float | None = None
    last_row: int | None = None
    start: ModelState | None = None
    memory: InverseMemory | None = None
    delay_left: DelayLeft | None = None
    _read: int = 0
    _smoothed: int = 0
    _squares: float = 0.0
    _largest: float = 0.0
    _corners: int = 0
    _starts_off: float = 0.0
    _ends_off: float = 0.0
    _rest: SampleBlock | None = None

    def blocks(
        self, read: Iterable[SampleBlock], begun: ModelState | None = None
    ) -> Iterator[Taken]:
        """Return each block with what goes into the model, ``begun`` being the state before the first.

        Raises
        ------
        InputError
            The clock is not even where it must be, or does not resolve the dynamics, or
            there are fewer samples than are read ahead.
        UsageError
            The low-pass cannot be had at this rate.
        """
        role = self.input.quantity
        last = self.last_row
        self.start = begun or self.start
        blocks = read if last is None else _split(read, last)
        step = 0.0
        if self.dynamics is not None or self.bandwidth is not None:
            step, blocks = self._on_even_clock(blocks)
        taken: Iterable[Taken] = ((block, block.values[role]) for block in blocks)
        if self.bandwidth is not None:
            taken = self._rounded(taken, ZeroPhaseLowPass(self.bandwidth, step), step)
        if self.delay:
            taken = self._ahead(taken, self.delay)
        if self.dynamics is not None:
            taken = self._undone(taken, self.dynamics.inverter(step))
        for block, x in taken:
            if block is self._rest or (last is not None and block.rows[0] > last):
                return
            yield block, x

    def _on_even_clock(
        self, blocks: Iterable[SampleBlock]
    ) -> tuple[float, Iterator[SampleBlock]]:
        """Return the time step (s), and the blocks, each refused where its clock is not even."""
        why = EVEN_FOR_BANDWIDTH if self.dynamics is None else EVEN_FOR_DYNAMICS
        known = None
        if self.start is not None and self.start.undoing is not None:
            known = self.start.undoing.time_step
        return even_clock(self.source, blocks, why, known)

    def _ahead(self, taken: Iterable[Taken], delay: DelayStage) -> Iterator[Taken]:
        """Read ahead by a delay, and note what it leaves."""
        self.delay_left = DelayLeft(delay, DELAY_ROWS)

        def timed() -> Iterator[tuple[Taken, FloatArray, FloatArray]]:
            for block, x in taken:
                if block.time is not None:
                    yield (block, x), block.time, x

        ahead_of = read_ahead(timed(), abs(delay.seconds), delay.between)
        for (block, x), ahead in ahead_of:
            if block.time is not None and block is not self._rest:
                self.delay_left.add(block.time, x, ahead)
            yield block, ahead

    def remarks(self) -> Remarks:
        """Return what is to be said of the transformed signal so far."""
        remarks = Remarks()
        unit, name = self.input.suffix, self.source.name
        if self._smoothed:
            rms = math.sqrt(self._squares / self._smoothed)
            remarks.notes.append(
                f"{name}: `bandwidth` {self.bandwidth:g} takes off {rms:.3g}{unit} (RMS), "
                f"{self._largest:.3g}{unit} at most"
            )
        if abs(self._starts_off) > STARTS_MOVING * self.input.span:
            remarks.warn(
                f"{name}: begins on the move, which an actuator at rest cannot: it rings at first, by about "
                f"{abs(self._starts_off):.3g}{unit} (let it begin and end at rest; `lead` auto writes "
                "the drive that it needs before; `periodic` for a loop)"
            )
        stops_dead = self.last_row is None and self.bandwidth is None
        if stops_dead and abs(self._ends_off) > STARTS_MOVING * self.input.span:
            remarks.warn(
                f"{name}: ends on the move: its last rows brake the actuator, by a drive as for "
                f"{abs(self._ends_off):.3g}{unit} more (let it end at rest; `bandwidth` HZ rounds it)"
            )
        if self._corners and self.dynamics is not None:
            remarks.notes.append(
                f"{name}: in {self._corners:,} samples the corners and the speed of the trajectory, not its "
                f"place, ask for a drive beyond the range (`bandwidth` {self._proposed()} rounds it)"
            )
        return remarks

    def _proposed(self) -> str:
        """Return the bandwidth (Hz) to propose, from the lowest resonance."""
        frequencies = []
        if self.dynamics is not None:
            for resonance in self.dynamics.resonances:
                frequencies.append(resonance.frequency)
        if not frequencies:
            return "HZ"
        return f"{min(frequencies) / PROPOSED_PART:.3g}"

    def _rounded(
        self, taken: Iterable[Taken], low_pass: ZeroPhaseLowPass, step: float
    ) -> Iterator[Taken]:
        for block, x in low_pass.blocks(self._with_rest(taken, low_pass.reach, step)):
            if block is not self._rest:
                self.note_rounding(block.values[self.input.quantity], x)
            yield block, x

    def _with_rest(
        self, taken: Iterable[Taken], count: int, step: float
    ) -> Iterator[Taken]:
        """Add rows that hold the last value: rounded, the move goes on in them, and comes to rest.

        What is read ahead by is then the rounded move, not one that stops dead at its
        last row.
        """
        block, x = None, np.zeros(0)
        for block, x in taken:
            yield block, x
        if block is None or not x.size:
            return
        rows = block.rows[-1] + np.arange(1, count + 1)
        times = None
        if block.time is not None:
            times = block.time[-1] + step * np.arange(1.0, count + 1.0)
        resting = np.full(count, x[-1])
        self._rest = SampleBlock(rows, None, times, {self.input.quantity: resting})
        yield self._rest, resting

    def note_rounding(self, before: FloatArray, after: FloatArray) -> None:
        """Add up what a low-pass took off."""
        away = after - before
        self._squares += float(np.square(away).sum())
        self._largest = max(self._largest, float(np.abs(away).max()))
        self._smoothed += away.size

    def _undone(
        self, taken: Iterable[Taken], inverter: DynamicsInverter
    ) -> Iterator[Taken]:
        """Undo the dynamics; from a state's memory where the signal goes on from it, else from a rest."""
        low, high = self.input.minimum, self.input.maximum
        following = iter(taken)
        first = next(following, None)
        if first is None:
            return
        memory = self._memory_at(first[0], inverter)
        begun = memory is not None

        def counted() -> Iterator[tuple[Taken, FloatArray]]:
            for block, x in chain([first], following):
                self._read += x.size
                yield (block, x), x

        for (block, x), u, after in undone(counted(), inverter, memory):
            if not begun and self._read < inverter.ahead:
                raise InputError(
                    f"{self.source.name}: {self._read:,} samples are fewer than the {inverter.ahead:,} that "
                    "the inverse of the model's dynamics reads ahead (let it begin and end at rest)"
                )
            if not begun:
                begun = True
                self._starts_off = float(u[0] - x[0])
            beyond = (u < low) | (u > high)
            if beyond.any():
                inside = (x >= low) & (x <= high)
                self._corners += int(np.count_nonzero(beyond & inside))
            self.memory = after
            self._ends_off = float(u[-1] - x[-1])
            yield block, u

    def _memory_at(
        self, first: SampleBlock, inverter: DynamicsInverter
    ) -> InverseMemory | None:
        """Return what the inverse remembers before the first block; None where it begins at rest."""
        start = self.start
        if start is None:
            return None
        if start.time is not None and first.time is not None:
            late = float(first.time[0]) - start.time
            if late > GAP_STEPS * inverter.time_step:
                return None
        return start.memory_for(inverter)


def even_clock(
    source: Source, blocks: Iterable[SampleBlock], why: str, known: float | None = None
) -> tuple[float, Iterator[SampleBlock]]:
    """Return the step (s) of an even clock, and the same blocks, each refused where its clock is not even.

    With a ``known`` step, of a run that is gone on with, that one is returned where the
    stamps agree with it.

    Raises
    ------
    InputError
        The clock is not even; the message names the first place and the remedy.
    """
    if source.even_rate is not None:
        return 1.0 / source.even_rate, iter(blocks)
    following = iter(blocks)
    first, stamps = first_blocks(following)
    step = _even_step_of(source, stamps, why, known)
    jitter = float(np.abs(np.diff(stamps) - step).max(initial=0.0))
    slack = JITTER * step + 2.0 * jitter

    def checked() -> Iterator[SampleBlock]:
        last: float | None = None
        for block in chain(first, following):
            if block.time is not None and len(block):
                if last is None:
                    last = block.time[0] - step
                steps = np.diff(block.time, prepend=last)
                odd = np.abs(steps - step) > slack
                if odd.any():
                    index = int(np.argmax(odd))
                    raise InputError(
                        f"{block.place(source.name, index)}: a time step of {steps[index]:.6g} s among steps "
                        f"of {step:.6g} s, and {why} (`resample` HZ interpolates)"
                    )
                last = float(block.time[-1])
            yield block

    return step, checked()


def _even_step_of(
    source: Source, stamps: FloatArray, why: str, known: float | None
) -> float:
    """Return the step (s) of the first time stamps: the ``known`` one, where they agree with it."""
    steps = np.diff(stamps)
    if known is not None:
        agrees = not steps.size or abs(float(np.mean(steps)) - known) <= JITTER * known
        if agrees:
            return known
    if not steps.size:
        raise InputError(
            f"{source.name}: holds a single sample, which is no clock, and {why}"
        )
    return require_even(source.name, stamps, why)


def first_blocks(blocks: Iterator[SampleBlock]) -> tuple[list[SampleBlock], FloatArray]:
    """Take the first blocks, enough to tell the rate from; return them and their first stamps (s)."""
    first: list[SampleBlock] = []
    while sum(map(len, first)) < CLOCK_SAMPLES:
        more = next(blocks, None)
        if more is None:
            break
        first.append(more)
    times = [block.time for block in first if block.time is not None]
    stamps = np.concatenate([np.zeros(0), *times])
    return first, stamps[:CLOCK_SAMPLES]


def _split(blocks: Iterable[SampleBlock], last_row: int) -> Iterator[SampleBlock]:
    """Cut the block that goes on beyond the last row to be answered."""
    for block in blocks:
        if not len(block) or block.rows[-1] <= last_row or block.rows[0] > last_row:
            yield block
            continue
        count = int(np.searchsorted(np.asarray(block.rows), last_row, side="right"))
        yield block.part(0, count)
        yield block.part(count, len(block))


# rows from which on the Python kernel's slowness is worth a word: it takes seconds
LONG_WORK = 2_000_000
# of the range: what the past may matter at the start without a word; chosen
ASSUMED_SPREAD = 0.01
FASTER = 2.0
"""Times the fastest drive of the identification's logs: beyond, what the model says of lag is a guess.
Measured: docs/choices.md.
"""

FAST_PART = 0.05  # of the samples: a few faster ones are not worth a word; chosen
SAME_STEP = 1e-6
"""A run goes on without a pause where its first sample comes one step after the last one's, to this fraction.

Time stamps are row numbers over a rate, rounded; a rounding error is 1e-9 of a step
after 10^7 rows.
"""

LAG_DEPENDS = "this model's lag, creep or delay depends on it"


@dataclass
class Tally:
    """How many samples were unusual, and the first one's row in the file; 0 where it has none."""

    count: int = 0
    first_row: int = 0

    def add(self, count: int, index: int, block: SampleBlock | None) -> None:
        """Count samples of a block, of which the first is sample ``index`` of it, from 0.

        Without a block they come before the move, where rows have no number.
        """
        if not self.count and block is not None:
            self.first_row = int(block.rows[index])
        self.count += count


class Response(NamedTuple):
    """One block of a run: seconds (None where they are not known), the model's input x, and its output y."""

    time: FloatArray | None
    x: FloatArray
    y: FloatArray


@dataclass
class ModelRun:
    """One run of a model over a source.

    Attributes
    ----------
    model, source
        What is run over what; the source has the model's input as a role.
    start : str or ModelState
        ``auto``, ``empty``, ``full``, ``settled``, or a state to go on from.
    outside : {"extend", "hold", "error"}
        Beyond the model's range: go on with the last slope, hold, or refuse.
    last_row : int, optional
        The last row that is answered; rows after it are only read ahead.
    why_time : str, optional
        Why the time between samples is needed, besides the model's own reasons.
    state : ModelState, or None
        After the samples run so far.
    time_step : float, array or None
        Seconds between the samples of the block run last.
    input, output : Quantity
        What goes into the run and comes out of it: a compensation's are its model's,
        exchanged.
    needs_time : bool
        Whether the time between samples is needed.
    even_step : float, or None
        The time step (s), where samples are evenly spaced by definition.
    last_time : float, or None
        When the sample before the next block was (s), as far as that is known.
    """

    model: ActuatorModel
    source: Source
    start: StartName | ModelState = "auto"
    outside: Outside = "extend"
    last_row: int | None = None
    why_time: str | None = None
    bandwidth: float | None = None
    state: ModelState | None = None
    found_start: StartName | None = None
    last_drive: float | None = None
    rows: int = 0
    rows_before: int = 0
    beyond: Tally = field(default_factory=Tally)
    fast: Tally = field(default_factory=Tally)
    assumed: float = 0.0
    time_step: float | FloatArray | None = None
    input: Quantity = field(init=False)
    output: Quantity = field(init=False)
    displacement: Quantity = field(init=False)
    needs_time: bool = field(init=False)
    even_step: float | None = field(init=False)
    last_time: float | None = field(init=False)
    inputs: Inputs = field(init=False)
    _run: Callable[..., Simulated] = field(init=False)
    _clock_runs: bool = False

    remedies = ""
    """What brings an actuator into the start, in front of other ways."""
    compensates = False
    """Whether a forward model is given a displacement, to be turned into a drive."""

    def __post_init__(self) -> None:
        """Refuse a source without time where the model needs one."""
        model = self.model
        begun = self.start if isinstance(self.start, ModelState) else None
        self.input, self.output = model.input, model.output
        if self.compensates:
            self.input, self.output = model.output, model.input
        inverting = self.compensates or model.direction == "inverse"
        self.displacement = self.input if inverting else self.output
        depends = model.needs_time or (inverting and reads_ahead(model))
        self._prepare_clock(LAG_DEPENDS if depends else self.why_time, begun)
        self._run = functools.partial(model.simulate, outside=self.outside)
        delay = model.delay if inverting and model.delay_seconds > 0.0 else None
        dynamics = model.dynamics if inverting else None
        self.inputs = Inputs(
            self.source,
            self.input,
            delay,
            dynamics,
            self.bandwidth,
            self.last_row,
            begun,
        )

    def _prepare_clock(self, why: str | None, begun: ModelState | None) -> None:
        """Note whether time is needed, and what is known of it; refuse a source that lacks it."""
        self.needs_time = why is not None
        if why is not None:
            self.source.require_time(why)
        self.last_time = None if begun is None else begun.time
        # One number where samples are evenly spaced by definition: a delay of whole
        # samples is exact then.
        rate = self.source.even_rate
        self.even_step = None if rate is None else 1.0 / rate

    @property
    def voltage_scale(self) -> str | None:
        """What the voltages of the model's logs were multiplied by, ``times 20``; None where by nothing."""
        inputs: Any = self.model.provenance.get("inputs") or []
        scales = set()
        for log in inputs:
            columns = log.get("read", {}).get("columns", {})
            scales.add(columns.get("voltage", {}).get("scale"))
        if len(scales) != 1:
            return None
        scale: str | None = scales.pop()
        return scale

    def responses(self) -> Iterator[Response]:
        """Run over the whole source; the blocks may be of any length, their samples always the same.

        Raises
        ------
        InputError
            The source is bad, time goes backwards, or a sample is outside where that is
            refused.
        """
        role = self.input.quantity
        for block, x in self.inputs.blocks(self.source.blocks()):
            yield Response(block.time, block.values[role], self.feed(block, x).y)

    def feed(self, block: SampleBlock, x: FloatArray) -> Simulated:
        """Run one block, and go on from there."""
        steps = self.time_step = self._time_steps(block)
        if self.state is None:
            self.state = self._begun(float(x[0]))
        try:
            done = self._run(x, self.state, time_step=steps)
        except model_state.OutsideError as problem:
            raise InputError(
                f"{block.place(self.source.name, problem.index)}: {x[problem.index]:.6g} is outside the "
                f"range of the model ({self._range()}) (`outside` extend or hold)"
            ) from None
        time = None if block.time is None else float(block.time[-1])
        self.state = dataclasses.replace(
            done.state, time=time, undoing=self.inputs.memory
        )
        self.rows += len(x)
        if block.before_move:  # what is before a move is not what the file asks for
            self.rows_before += len(x)
        elif done.outside_count:
            self.beyond.add(done.outside_count, done.first_outside, block)
        if steps is not None and self.model.direction == "forward":
            self._watch_speed(done.y if self.compensates else x, steps, block)
        return done

    def _time_steps(self, block: SampleBlock) -> float | FloatArray | None:
        """Return the seconds since the sample before: one number, or one for each; None where not needed.

        Raises
        ------
        InputError
            Time goes backwards.
        """
        if not self.needs_time or block.time is None:
            return None
        if not self._clock_runs:
            self._start_clock(block.time)
        if self.even_step is not None:
            return self.even_step
        before = 0.0 if self.last_time is None else self.last_time
        steps: FloatArray = np.diff(block.time, prepend=before)
        if (steps < 0.0).any():
            place = block.place(self.source.name, int(np.argmax(steps < 0.0)))
            raise InputError(
                f"{place}: time goes backwards, and this model's lag and creep depend on the time between "
                "samples (cut the log with `rows` A:B)"
            )
        self.last_time = float(block.time[-1])
        return steps

    def _start_clock(self, time: FloatArray) -> None:
        """Find when the sample before the first one was.

        Only after a saved state does the very first step count. Where the state does
        not know its time, or the clock began anew since, the first sample comes one
        step after it. The stamp of the state's own last sample is a repeated one: no
        time has passed.
        """
        self._clock_runs = True
        first = float(time[0])
        step = self.even_step
        last = self.last_time
        if last is None or last > first or (step is not None and last == first):
            self.last_time = first - _clock_step(time, step)
        elif step is not None and abs(first - last - step) > SAME_STEP * step:
            self.even_step = None  # a pause: from here on the stamps count

    def _watch_speed(
        self, drive: FloatArray, steps: float | FloatArray, block: SampleBlock
    ) -> None:
        """Count the samples whose drive is faster than any that the model was identified from."""
        fastest = self.model.fit.get("fastest_drive")
        if not isinstance(fastest, float) or self.model.dynamics is not None:
            return
        before = drive[0] if self.last_drive is None else self.last_drive
        self.last_drive = float(drive[-1])
        if _largest_change(drive, before) <= FASTER * fastest * float(np.min(steps)):
            return
        faster = np.abs(np.diff(drive, prepend=before)) > FASTER * fastest * steps
        if faster.any() and not block.before_move:
            self.fast.add(int(np.count_nonzero(faster)), int(np.argmax(faster)), block)

    def remarks(self) -> Remarks:
        """Return what is to be said of the run so far."""
        remarks = remarks_of(self.source)
        remarks.add(self.inputs.remarks())
        if self.found_start:
            remarks.notes.append(
                f"{self.source.name}: starts {self.found_start}, as the identification found"
            )
        if self.assumed:
            remarks.notes.append(
                f"{self.source.name}: where it starts, the displacement depends on the past by up to "
                f"{self.assumed:.3g}{self.displacement.suffix}; the actuator is taken to have settled "
                f"there ({self.remedies}`state` empty where it comes from its lower end)"
            )
        self._add_limits(remarks)
        if self.fast.count > FAST_PART * (self.rows - self.rows_before):
            remarks.warn(
                f"{self._counted(self.fast)} move the drive more than {FASTER:g} times as fast as the logs "
                "of the identification did: how late the actuator is there was not seen; identify at the "
                "speed of use"
            )
        if kernel.KIND == "python" and self.rows >= LONG_WORK:
            remarks.warn(
                "the compiled kernel is not there and Python does the work, a hundred times slower"
            )
        return remarks

    def _add_limits(self, remarks: Remarks) -> None:
        """Say what lay outside."""
        if self.beyond.count:
            fate = "held" if self.outside == "hold" else "extended with the last slope"
            remarks.warn(
                f"{self._counted(self.beyond)} outside the range of the model ({self._range()}): {fate}"
            )

    def _counted(self, tally: Tally) -> str:
        place, rows = "the rows before row 1", self.rows
        if tally.first_row > 0:
            place, rows = f"row {tally.first_row:,}", self.rows - self.rows_before
        first = place if tally.count == 1 else f"first in {place}"
        return f"{self.source.name}: {tally.count:,} of {rows:,} samples ({first})"

    def _range(self) -> str:
        low, high = self.input.minimum, self.input.maximum
        return f"{self.input.quantity} {low:.6g} to {high:.6g}{self.input.suffix}"

    def _begun(self, first: float) -> ModelState:
        if self.start == "auto":
            self.found_start = found_start(self.model, self.source.name, first)
        begun = self.model.start(first, self.found_start or self.start)
        self._note_assumed(begun, first)
        return begun

    def _note_assumed(self, begun: ModelState, first: float) -> None:
        """Remember by how much the displacement at the start depends on an unknown past."""
        if self.start != "auto" or self.found_start:
            return
        spread = self.model.start_spread(begun, first)
        if spread > ASSUMED_SPREAD * self.displacement.span:
            self.assumed = spread
        else:
            self.assumed = 0.0


def _clock_step(time: FloatArray, even_step: float | None) -> float:
    """Return the step (s) of a clock: the even one, else that of its first two samples; 0 of one sample."""
    if even_step is not None:
        return even_step
    if len(time) < 2:
        return 0.0
    return float(time[1]) - float(time[0])


def _largest_change(values: FloatArray, before: float) -> float:
    """Return the largest change from one value to the next, in pieces that caches hold."""
    largest = abs(float(values[0]) - before)
    for begin in range(0, values.size - 1, PIECE):
        changes = np.diff(values[begin : begin + PIECE + 1])
        largest = max(largest, float(changes.max()), -float(changes.min()))
    return largest


def found_start(model: ActuatorModel, name: str, first: float) -> StartName | None:
    """Return the start that the identification found for its log of this name and first voltage."""
    logs = model.fit.get("logs")
    if model.direction != "forward" or not isinstance(logs, list):
        return None
    for log in logs:
        if not isinstance(log, dict) or log.get("begins_at") != first:
            continue
        log_name = log.get("name")
        if name != log_name and not name.endswith(f"/{log_name}"):
            continue
        for start in model_state.START_NAMES:
            if log.get("start") == start:
                return start
    return None


def reads_ahead(model: ActuatorModel) -> bool:
    """Tell whether the inverse of a model needs samples that come later."""
    return model.delay_seconds > 0.0 or model.dynamics is not None
