"""A move that is looped: one period in, the settled loop's drive out, perhaps with a run-in before it."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from dbo_cli.errors import InputError, LimitError, UsageError
from dbo_cli.hysteresis.dynamics import undone
from dbo_cli.hysteresis.excitation import MOST_SAMPLES
from dbo_cli.hysteresis.loops import Settled, settled_drive, settled_run, shifted, undone_loop
from dbo_cli.hysteresis.model_state import ModelState
from dbo_cli.hysteresis.smoothing import ZeroPhaseLowPass
from dbo_cli.logs.sample_block import FloatArray
from dbo_cli.runs.compensation_run import Compensation
from dbo_cli.runs.model_run import Response
from dbo_cli.runs.remarks import Remarks
from dbo_cli.runs.source import WholeSource

FEWEST_ROWS = 4  # of a period
SAME_DRIVE = 1e-9  # of the range: a drive that another try changes by no more is found
MOST_STARTS = 10  # tries to find a loop that begins where its own start leads to; two or three are usual
SEAM = 3.0
"""Times the largest step inside a period, from which on the step back to its first row does not close it.

A period sampled evenly has steps at the seam like those inside; one that was cut elsewhere has a jump.
"""


@dataclass
class LoopCompensation(Compensation):
    """The drive of a settled loop.

    Attributes
    ----------
    passes : int
        Passes of run-in before it, in negative time; the first fades in from a rest.
    """

    passes: int = 0

    @property
    def may_condition(self) -> bool:
        """A loop is run in instead."""
        return False

    def responses(self) -> Iterator[Response]:
        """Return the run-in, where it is asked for, and one period of the settled drive.

        Raises
        ------
        InputError
            The period is too short or does not close, or its clock is not even.
        LimitError
            A limit of the drive was met, and that is refused.
        """
        assert self.limits is not None
        whole = self.source if isinstance(self.source, WholeSource) else WholeSource(self.source)
        block, why = whole.block, "`periodic` needs an even clock"
        step = whole.even_step(why)
        asked = self._rounded(block.values[self.taken.quantity], step)
        desired = block.values[self.taken.quantity] if self.desired is None else self.desired
        _require_closed(whole.name, desired)
        undone_period = undone_loop(self.model, asked, step)
        state: ModelState = self._begun(float(undone_period[0]))
        if self.passes:
            drive, state = self._run_in(asked, step)
            before = block.time[0] - step * np.arange(drive.size, 0, -1) if block.time is not None else None
            yield Response(before, _faded(desired, self.passes), drive)
        settled = self._settled(undone_period, step, state)
        drive = settled.done.y
        self._count(settled, whole)
        self.followed(desired, drive)
        end = settled_run(self.model, drive, step, settled.before)
        time = None if block.time is None else float(block.time[-1])
        self.state = dataclasses.replace(settled.done.state, dynamics=end.state.dynamics, time=time)
        yield Response(block.time, desired, drive)

    def _settled(self, undone_period: FloatArray, step: float, state: ModelState) -> Settled:
        """Return the settled loop; without a run-in, of the state in which a simulation of it starts.

        Gears that the loop does not reach stay as they were when it began, and where it begins follows from
        the settled drive.
        """
        assert self.limits is not None
        settled = settled_drive(self.model, undone_period, step, state, self.limits)
        if self.passes or isinstance(self.start, ModelState):
            return settled
        for _ in range(MOST_STARTS):
            drive, memory = settled.done.y, settled.before.backlash.memory
            begun = self.model.start(float(drive[0]), self.start)
            # With the memory of the settled loop: the passes before it reach further, and gears keep that.
            backlash = dataclasses.replace(begun.backlash, memory=memory)
            state = dataclasses.replace(settled.before, backlash=backlash)
            settled = settled_drive(self.model, undone_period, step, state, self.limits)
            if np.abs(settled.done.y - drive).max() <= SAME_DRIVE * self.model.input.span:
                break
        return settled

    def _rounded(self, x: FloatArray, step: float) -> FloatArray:
        if self.bandwidth is None:
            return x
        rounded = ZeroPhaseLowPass(self.bandwidth, step).loop(x)
        self.prepared.note_rounding(x, rounded)
        return rounded

    def _run_in(self, asked: FloatArray, step: float) -> tuple[FloatArray, ModelState]:
        """Return the drive of the passes before the settled one, and the state after them."""
        model, limits = self.model, self.limits
        assert limits is not None
        count = self.passes * asked.size
        if count > MOST_SAMPLES:
            raise UsageError(
                f"`passes` {self.passes}: {count:,} rows are more than the {MOST_SAMPLES:,} that are written "
                "at most"
            )
        ahead = int(np.ceil(model.delay_seconds / step)) + 1
        inverter = None if model.dynamics is None else model.dynamics.inverter(step)
        ahead += 0 if inverter is None else inverter.ahead
        wanted = np.concatenate([_faded(asked, self.passes), np.resize(asked, ahead)])
        signal = shifted(wanted, model.delay_seconds / step)
        if inverter is not None:
            ((_, signal, _),) = undone([(None, signal)], inverter)
        state = model.start_compensation(float(signal[0]), self.start, limits)
        time_step = step if model.needs_time or limits.max_slew is not None else None
        done = model.compensate(signal[:count], state, limits=limits, time_step=time_step)
        self._run_in_clipped = done.clipped_count
        return done.y, done.state

    def _count(self, settled: Settled, whole: WholeSource) -> None:
        """Count what is unusual in the settled period, and say how it closes."""
        done, block, name = settled.done, whole.block, whole.name
        self.rows += len(block)
        self.beyond.add(done.outside_count, done.first_outside, block)
        self.clipped.add(done.clipped_count, done.first_clipped, block)
        if self.refuse_clipping and self.clipped.count:
            raise LimitError(f"{self._clipping()} (`on_limit` clip goes on)")
        told = Remarks()
        drive = done.y
        unit = f" {self.model.input.unit}" if self.model.input.unit else ""
        seam, inside = abs(float(drive[0] - drive[-1])), float(np.abs(np.diff(drive)).max())
        told.notes.append(
            f"{name}: the loop settles in {settled.passes} passes; the drive's step at the seam is "
            f"{seam:.3g}{unit}, the largest inside {inside:.3g}{unit}"
        )
        if not settled.converged:
            told.warn(f"{name}: the drive of the loop still changed after {settled.passes} passes")
        self.remarks_before.add(told)


def _faded(x: FloatArray, passes: int) -> FloatArray:
    """Return passes of a period that fade in, during the first, from a rest at its first value."""
    t = np.arange(x.size) / x.size
    weight = t**3 * (10.0 - 15.0 * t + 6.0 * t * t)  # speed and acceleration are zero at either end
    first = x[0] + weight * (x - x[0])
    return np.concatenate([first, np.tile(x, passes - 1)])


def _require_closed(name: str, period: FloatArray) -> None:
    """Refuse a period that is too short or jumps from its last row to its first (InputError)."""
    if period.size < FEWEST_ROWS:
        raise InputError(f"{name}: {period.size} rows are no period of a loop (at least {FEWEST_ROWS})")
    seam, inside = abs(float(period[0] - period[-1])), float(np.abs(np.diff(period)).max())
    if seam > SEAM * inside:
        raise InputError(
            f"{name}: the period does not close: from the last row, {period[-1]:.6g}, to the first, "
            f"{period[0]:.6g}, is a step of {seam:.3g} where the largest inside is {inside:.3g} (give one "
            "whole period, without its first row again at the end)"
        )
