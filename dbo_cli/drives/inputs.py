"""What goes into a model: the signal, and for an inverse what the future has to do with it.

An inverse reads ahead by a delay, and undoes dynamics from what comes later; a trajectory may be rounded by a
low-pass first. All in constant memory, and the same bits however the signal is cut into blocks.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import chain

import numpy as np

from dbo_cli.errors import InputError
from dbo_cli.hysteresis.delay import read_ahead
from dbo_cli.hysteresis.dynamics import (
    DynamicsInverter,
    DynamicsStage,
    InverseMemory,
    ZeroPhaseLowPass,
    undone,
)
from dbo_cli.hysteresis.model_state import ModelState, Quantity
from dbo_cli.logs.clock import JITTER, require_even
from dbo_cli.logs.sample_block import FloatArray, SampleBlock
from dbo_cli.logs.sources import Source
from dbo_cli.remarks import Remarks

CLOCK_SAMPLES = 101
"""A clock's step is that of so many first samples, however the signal is cut."""

PAUSE_STEPS = 1.5  # after a state's last sample, beyond which the first one finds the dynamics at rest
STARTS_MOVING = 1e-3
"""Of the range: how far off the first value a drive may begin without a word."""
PROPOSED_PART = 3.0
"""A resonance over this is proposed as bandwidth: corners rounded by it ask for a few percent more travel."""

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
    delay : float
        Seconds to be read ahead by.
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
    """

    source: Source
    input: Quantity
    delay: float = 0.0
    dynamics: DynamicsStage | None = None
    bandwidth: float | None = None
    last_row: int | None = None
    start: ModelState | None = None
    memory: InverseMemory | None = None
    _read: int = 0
    _smoothed: int = 0
    _squares: float = 0.0
    _largest: float = 0.0
    _corners: int = 0
    _starts_off: float = 0.0
    _ends_off: float = 0.0
    _rest: SampleBlock | None = None

    def blocks(self, read: Iterable[SampleBlock], begun: ModelState | None = None) -> Iterator[Taken]:
        """Return each block with what goes into the model, ``begun`` being the state before the first.

        Raises
        ------
        InputError
            The clock is not even where it must be, or does not resolve the dynamics, or there are fewer
            samples than are read ahead.
        UsageError
            The low-pass cannot be had at this rate.
        """
        role, last, dynamics = self.input.quantity, self.last_row, self.dynamics
        self.start, step = begun or self.start, 0.0
        blocks = read if last is None else _split(read, last)
        if last is None and dynamics is None and self.bandwidth is None and self.delay == 0.0:
            for block in blocks:
                yield block, block.values[role]
            return
        if dynamics is not None or self.bandwidth is not None:
            why = EVEN_FOR_BANDWIDTH if dynamics is None else EVEN_FOR_DYNAMICS
            undoing = None if self.start is None else self.start.undoing
            step, blocks = even_clock(self.source, blocks, why, undoing.time_step if undoing else None)
        taken: Iterable[Taken] = ((block, block.values[role]) for block in blocks)
        if self.bandwidth is not None:
            taken = self._rounded(taken, ZeroPhaseLowPass(self.bandwidth, step), step)
        if self.delay > 0.0:
            timed = ((block, block.time, x) for block, x in taken if block.time is not None)
            taken = read_ahead(timed, self.delay)
        if dynamics is not None:
            taken = self._undone(taken, dynamics.inverter(step))
        for block, x in taken:
            if block is self._rest or (last is not None and block.rows[0] > last):
                return
            yield block, x

    def remarks(self) -> Remarks:
        """Return what is to be said of the transformed signal so far."""
        found, unit, name = Remarks(), self.input.suffix, self.source.name
        if self._smoothed:
            rms = math.sqrt(self._squares / self._smoothed)
            found.notes.append(
                f"{name}: `bandwidth` {self.bandwidth:g} takes off {rms:.3g}{unit} (RMS), "
                f"{self._largest:.3g}{unit} at most"
            )
        if abs(self._starts_off) > STARTS_MOVING * self.input.span:
            found.warn(
                f"{name}: begins on the move, which an actuator at rest cannot: it rings at first, by about "
                f"{abs(self._starts_off):.3g}{unit} (let it begin and end at rest; `lead` auto writes "
                "the drive that it needs before; `periodic` for a loop)"
            )
        stops_dead = self.last_row is None and self.bandwidth is None
        if stops_dead and abs(self._ends_off) > STARTS_MOVING * self.input.span:
            found.warn(
                f"{name}: ends on the move: its last rows brake the actuator, by a drive as for "
                f"{abs(self._ends_off):.3g}{unit} more (let it end at rest; `bandwidth` HZ rounds it)"
            )
        if self._corners and self.dynamics is not None:
            lowest = min((one.frequency for one in self.dynamics.resonances), default=None)
            propose = f" {lowest / PROPOSED_PART:.3g}" if lowest is not None else " HZ"
            found.notes.append(
                f"{name}: in {self._corners:,} samples the corners and the speed of the trajectory, not its "
                f"place, ask for a drive beyond the range (`bandwidth`{propose} rounds it)"
            )
        return found

    def _rounded(self, taken: Iterable[Taken], low_pass: ZeroPhaseLowPass, step: float) -> Iterator[Taken]:
        for block, x in low_pass.blocks(self._with_rest(taken, low_pass.reach, step)):
            if block is not self._rest:
                self.note_rounding(block.values[self.input.quantity], x)
            yield block, x

    def _with_rest(self, taken: Iterable[Taken], count: int, step: float) -> Iterator[Taken]:
        """Add rows that hold the last value: rounded, the move goes on in them, and comes to rest.

        What is read ahead by is then the rounded move, not one that stops dead at its last row.
        """
        block, x = None, np.zeros(0)
        for block, x in taken:
            yield block, x
        if block is not None and x.size:
            rows, times = np.arange(1, count + 1), step * np.arange(1.0, count + 1.0)
            end = None if block.time is None else block.time[-1] + times
            held = np.full(count, x[-1])
            self._rest = SampleBlock(block.rows[-1] + rows, None, end, {self.input.quantity: held})
            yield self._rest, held

    def note_rounding(self, before: FloatArray, after: FloatArray) -> None:
        """Add up what a low-pass took off."""
        away = after - before
        self._squares += float(np.dot(away, away))
        self._largest = max(self._largest, float(np.abs(away).max()))
        self._smoothed += away.size

    def _undone(self, taken: Iterable[Taken], inverter: DynamicsInverter) -> Iterator[Taken]:
        """Undo the dynamics; from a state's memory where the signal goes on from it, else from a rest."""
        low, high = self.input.minimum, self.input.maximum
        rest = iter(taken)
        first = next(rest, None)
        memory = None if first is None else self._memory_at(first[0], inverter)
        begun = memory is not None
        whole = self._counted(chain([first] if first else [], rest))
        for (block, x), u, after in undone(whole, inverter, memory):
            if not begun and self._read < inverter.ahead:
                raise InputError(
                    f"{self.source.name}: {self._read:,} samples are fewer than the {inverter.ahead:,} that "
                    "the inverse of the model's dynamics reads ahead (let it begin and end at rest)"
                )
            if not begun:
                begun, self._starts_off = True, float(u[0] - x[0])
            asked = (u < low) | (u > high)
            if asked.any():
                self._corners += int(np.count_nonzero(asked & (x >= low) & (x <= high)))
            self.memory, self._ends_off = after, float(u[-1] - x[-1])
            yield block, u

    def _counted(self, taken: Iterable[Taken]) -> Iterator[tuple[Taken, FloatArray]]:
        for block, x in taken:
            self._read += x.size
            yield (block, x), x

    def _memory_at(self, block: SampleBlock, inverter: DynamicsInverter) -> InverseMemory | None:
        start = self.start
        if start is None:
            return None
        if start.time is not None and block.time is not None:
            if float(block.time[0]) - start.time > PAUSE_STEPS * inverter.time_step:
                return None
        if start.undoing is not None and start.undoing.time_step == inverter.time_step:
            return start.undoing
        return None if start.dynamics is None else inverter.memory_of(start.dynamics)


def even_clock(
    source: Source, blocks: Iterable[SampleBlock], why: str, known: float | None = None
) -> tuple[float, Iterator[SampleBlock]]:
    """Return the step (s) of an even clock, and the same blocks, each refused where its clock is not even.

    With a ``known`` step, of a run that is gone on with, that one is returned where the stamps agree with it.

    Raises
    ------
    InputError
        The clock is not even; the message names the first place and the remedy.
    """
    if source.even_rate is not None:
        return 1.0 / source.even_rate, iter(blocks)
    rest = iter(blocks)
    held, stamps = first_blocks(rest)
    steps = np.diff(stamps)
    if known is not None and (not steps.size or abs(float(np.mean(steps)) - known) <= JITTER * known):
        step = known
    elif not steps.size:
        raise InputError(f"{source.name}: holds a single sample, which is no clock, and {why}")
    else:
        step = require_even(source.name, stamps, why)
    slack = JITTER * step + 2.0 * float(np.abs(steps - step).max(initial=0.0))
    return step, _even_blocks(source.name, chain(held, rest), step, slack, why)


def first_blocks(blocks: Iterator[SampleBlock]) -> tuple[list[SampleBlock], FloatArray]:
    """Take the first blocks, enough to tell the rate from; return them and their first stamps (s)."""
    held: list[SampleBlock] = []
    while sum(map(len, held)) < CLOCK_SAMPLES:
        more = next(blocks, None)
        if more is None:
            break
        held.append(more)
    times = [block.time for block in held if block.time is not None]
    return held, np.concatenate(times)[:CLOCK_SAMPLES] if times else np.zeros(0)


def _even_blocks(
    name: str, blocks: Iterable[SampleBlock], step: float, slack: float, why: str
) -> Iterator[SampleBlock]:
    last: float | None = None
    for block in blocks:
        if block.time is not None and len(block):
            steps = np.diff(block.time, prepend=block.time[0] - step if last is None else last)
            odd = np.abs(steps - step) > slack
            if odd.any():
                index = int(np.argmax(odd))
                raise InputError(
                    f"{block.place(name, index)}: a time step of {steps[index]:.6g} s among steps of "
                    f"{step:.6g} s, and {why} (`resample` HZ interpolates)"
                )
            last = float(block.time[-1])
        yield block


def _split(blocks: Iterable[SampleBlock], last_row: int) -> Iterator[SampleBlock]:
    """Cut the block that goes on beyond the last row to be answered."""
    for block in blocks:
        if not len(block) or block.rows[-1] <= last_row or block.rows[0] > last_row:
            yield block
            continue
        count = int(np.searchsorted(np.asarray(block.rows), last_row, side="right"))
        yield block.part(0, count)
        yield block.part(count, len(block))
