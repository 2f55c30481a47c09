"""A move that is looped: one period in, the settled loop's drive out, perhaps with a run-in before it.

What stands before the period is planned in ``loop_starts``.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from dbo_cli.drives.compensation import Compensation
from dbo_cli.drives.learning import Tracked, learned_source
from dbo_cli.drives.loop_starts import LED_IN, LOOP_ERROR, BeforeLoop
from dbo_cli.drives.model_run import Response
from dbo_cli.drives.options import DriveOptions
from dbo_cli.drives.pieces import NOTHING, require_rows
from dbo_cli.errors import InputError, LimitError, UsageError
from dbo_cli.hysteresis.dynamics import ZeroPhaseLowPass
from dbo_cli.hysteresis.loops import Settled, settled_run, settling, slow_output, undone_loop
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.hysteresis.model_state import ModelState
from dbo_cli.logs.sample_block import FloatArray
from dbo_cli.logs.sources import Source, WholeSource

FEWEST_ROWS = 4  # of a period
SEAM = 3.0
"""Times the largest step inside a period, from which on the step back to its first row does not close it.

A period sampled evenly has steps at the seam like those inside; one that was cut elsewhere has a jump.
"""


@dataclass
class LoopCompensation(BeforeLoop):
    """The drive of a settled loop, with ``options.passes`` passes of run-in before it, in negative time.

    Attributes
    ----------
    whole : WholeSource
        The period as it was read.
    """

    whole: WholeSource = field(init=False)

    remedies = ""  # a loop is run in instead of swept

    def responses(self) -> Iterator[Response]:
        """Return the way there and the run-in, where they are asked for, and one period of the settled drive.

        Raises
        ------
        InputError
            The period is too short or does not close, or its clock is not even.
        LimitError
            A limit of the drive was met, and that is refused; or the loop does not settle within them.
        GateError
            A row breaks a limit: this program's fault.
        """
        self.whole = self.source if isinstance(self.source, WholeSource) else WholeSource(self.source)
        self.step = step = self.whole.even_step("`periodic` needs an even clock")
        block, passes = self.whole.block, self.options.passes
        request = block.values[self.input.quantity]
        asked = self._rounded(request)
        desired = request if self.lesson is None else self.lesson.desired
        _require_closed(self.whole.name, desired)
        self.period = undone_loop(self.model, asked, step)
        if passes:
            require_rows(f"`passes` {passes}: the run-in", passes * asked.size, step)
        led = self.led_to_loop(asked)
        before, run_in, settled, begun = led.before, led.run_in, led.settled, led.begun
        played = before.voltage.size
        count, zero = played + run_in.size, 0.0 if block.time is None else float(block.time[0])
        times = np.asarray(zero - step * np.arange(count, 0, -1.0), dtype=np.float64)
        firsts = before.voltage if played else NOTHING if run_in.size else settled.done.y
        self.gate.require_start(step, float(firsts[0]) if firsts.size else None)
        if played:
            yield self._response(times[:played], before.expected, before.voltage, step)
        if run_in.size:
            yield self._response(times[played:], led.desired, run_in, step)
            self.remarks_before.notes.append(
                f"{self.source.name}: before the first period stand {count:,} rows, {step * count:.3g} s, "
                f"{passes} pass{'es' if passes > 1 else ''} of run-in among them"
            )
        drive = self._closed(settled.done.y)
        self._count(settled)
        if begun is None:
            begun = self.model.start(float(drive[0]), self.start)
        self._require_loop(settled, begun)
        self.move.add(desired)
        end = settled_run(self.model, drive, step, settled.before).state.dynamics
        time = None if block.time is None else float(block.time[-1])
        self.state = dataclasses.replace(settled.done.state, dynamics=end, time=time)
        response = self._response(zero + step * np.arange(float(drive.size)), desired, drive, step)
        yield response._replace(time=block.time)

    def _rounded(self, x: FloatArray) -> FloatArray:
        if self.bandwidth is None:
            return x
        rounded = ZeroPhaseLowPass(self.bandwidth, self.step).loop(x)
        self.inputs.note_rounding(x, rounded)
        return rounded

    def _count(self, settled: Settled) -> None:
        """Count what is unusual in the settled period, and say how it closes."""
        done, block, unit = settled.done, self.whole.block, self.output.suffix
        self.rows += len(block)
        self.beyond.add(done.outside_count, done.first_outside, block)
        self._clip(done, block)
        if done.clipped_count:
            self._miss(self.period - slow_output(self.model, done.y, self.step, settled.before))
        seam, inside = abs(float(done.y[0] - done.y[-1])), float(np.abs(np.diff(done.y)).max())
        self.remarks_before.notes.append(
            f"{self.source.name}: the drive's step at the loop's seam is {seam:.3g}{unit}, the largest "
            f"inside {inside:.3g}{unit}"
        )

    def _require_loop(self, settled: Settled, begun: ModelState) -> None:
        """Say when the model, begun as it is, repeats the loop; refuse or warn where it never does."""
        away, move = self._away(settled, begun), float(np.ptp(self.period))
        if away > LOOP_ERROR * move:
            why = (
                f"however often it is repeated, the model ends {away:.3g}{self.input.suffix} off "
                f"({100.0 * away / move:.2g} % of the move); no start leads to it (`passes` 1 or `state` "
                "empty fixes the start)"
            )
        elif not settled.converged:
            why = "the drive still changes from pass to pass within its limits"
        else:
            self.remarks_before.notes.append(self._settling(settled, begun))
            return
        text = f"{self.source.name}: the loop does not settle: {why}"
        if self.options.on_limit == "error":
            raise LimitError(f"{text} (`on_limit` clip writes it all the same)")
        self.remarks_before.warn(text)

    def _settling(self, settled: Settled, begun: ModelState) -> str:
        """Say how many passes and seconds the mean of a pass takes to come within the expected error."""
        drive, unit, name = settled.done.y, self.input.suffix, self.source.name
        within, what = self._stated()
        what += f", {within:.3g}{unit}"
        first, passes = settling(self.model, drive, self.step, begun, settled.before, within)
        if not passes:
            return f"{name}: by the model the loop is settled from its first pass on: within {what}"
        count = f"{passes:,} pass{'es' if passes > 1 else ''}"
        return (
            f"{name}: by the model the loop settles in {count}, {passes * (self.step * drive.size):.3g} s: "
            f"the mean of the first is {first:.3g}{unit} off, then within {what}"
        )


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


def compensation(
    model: ActuatorModel,
    source: Source,
    options: DriveOptions,
    tracked: Sequence[Tracked] = (),
    last_row: int | None = None,
) -> Compensation:
    """Return the run of a forward model's inverse over a trajectory.

    Parameters
    ----------
    model
        A forward model.
    source
        The trajectory, under the name of the model's output.
    options
        What is asked of the drive.
    tracked
        Recordings of the last pass of this trajectory, to learn from.
    last_row
        The last row that is answered; rows after it are only read ahead.

    Raises
    ------
    UsageError
        The limits are not in order, or options exclude each other.
    ModelError
        The model is an inverse one.
    InputError
        A recording is not of this trajectory, or the error grew.
    """
    model.require("forward")
    if options.history is not None and not tracked:
        raise UsageError("`history` keeps the error of the passes that `tracked` recorded: give both")
    lesson = None
    if tracked:
        source, lesson = learned_source(model, source, tracked, options)
    if options.periodic and options.lead is not None:
        options = dataclasses.replace(options, passes=max(options.passes, LED_IN))
    make = LoopCompensation if options.periodic else Compensation
    return make(model, source, last_row=last_row, options=options, lesson=lesson)
