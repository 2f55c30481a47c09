"""A move that is looped: one period in, the settled loop's drive out, and what stands before it.

That is nothing, a ramp, a run-in, or a rest and a run-in. The settled drive comes
first. The run-in follows the trajectory, fades over into that drive, and ends on it, so
that the first settled period follows the run-in as every later one follows the one
before.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from dbo_cli.drives.compensation import ALLOWED_PART, SAME_DRIVE
from dbo_cli.drives.model_run import Response, Tally
from dbo_cli.drives.pieces import (
    NOTHING,
    SHORTEST_WAY,
    Before,
    Chosen,
    longest_chosen,
    ramp,
    require_rows,
    require_short,
    rest_samples,
    soft_rise,
)
from dbo_cli.errors import InputError, LimitError
from dbo_cli.extras.repeat import settled_loops as loops
from dbo_cli.extras.repeat.learned_drive import LearnedCompensation
from dbo_cli.extras.repeat.settled_loops import Settled
from dbo_cli.hysteresis.dynamics import ZeroPhaseLowPass, undone
from dbo_cli.hysteresis.kernel import towards
from dbo_cli.hysteresis.model_state import ModelState
from dbo_cli.hysteresis.move_error import rms
from dbo_cli.interpolation.smooth import AFTER
from dbo_cli.logs.sample_block import FloatArray
from dbo_cli.logs.sources import WholeSource

FEWEST_ROWS = 4  # of a period: fewer have no shape
SEAM = 3.0
"""Times the largest step inside a period, from which on the step back to its first row does not close it.

A period sampled evenly has steps at the seam like those inside; one that was cut
elsewhere has a jump.
"""
# of the move: the mean of a pass within it counts as settled, where no error is stated
SETTLED_PART = 1e-3
# tries for a loop that its own start leads to; halving brings a range to 1e-18 of it
MOST_STARTS = 60
# tries for a run-in or a ramp that leads to the loop it ends on; two or three are usual
MOST_RUN_INS = 10
# the way to a rest and the loop's own start depend on its level, each time by a few
# percent
REST_PLANS = 4
# passes after a rest, at least: one to fade over, one of the loop for its gears and its
# ringing
LED_IN = 2
REACHED = 0.999  # of the longest rest: it was cut there
# of the move: a loop that the model repeats further off than this is none
LOOP_ERROR = 1e-6
FADES = ((0.5, 0.1), (0.7, 0.4), (0.8, 0.2), (0.9, 0.6))
"""Where a run-in fades over to the settled drive, in parts of it before its end (begin, end), the gentlest
first. Measured: docs/choices.md.
"""


Led = tuple[Before, FloatArray, FloatArray, Settled, ModelState | None]
"""What is played before a loop, what the run-in follows and is, the loop, and the state before it."""


@dataclass
class LoopCompensation(LearnedCompensation):
    """The drive of a settled loop, with ``options.passes`` passes of run-in before it, in negative time.

    Attributes
    ----------
    whole : WholeSource
        The period as it was read.
    step : float
        Its even time step (s).
    period : array
        What the gears are to follow: dynamics and delay are undone.
    """

    whole: WholeSource = field(init=False)
    step: float = field(init=False)
    period: FloatArray = field(init=False)

    repeats = True
    first_what = "period"
    remedies = ""  # a loop is run in instead of swept
    or_after_a_sweep = ""
    before_its_first_sweep = ""

    def responses(self) -> Iterator[Response]:
        """Return the way there and the run-in, where they are asked for, and one period of the settled drive.

        Raises
        ------
        InputError
            The period is too short or does not close, or its clock is not even.
        LimitError
            A limit of the drive was met, and that is refused; or the loop does not
            settle within them.
        GateError
            A row breaks a limit: this program's fault.
        """
        self.streamed = False  # a period is known whole before its first row leaves
        if isinstance(self.source, WholeSource):
            self.whole = self.source
        else:
            self.whole = WholeSource(self.source)
        self.step = step = self.whole.even_step("`periodic` needs an even clock")
        block, passes = self.whole.block, self.options.passes
        request = block.values[self.input.quantity]
        loop = request
        if self.bandwidth is not None:
            loop = ZeroPhaseLowPass(self.bandwidth, step).loop(request)
            self.inputs.note_rounding(request, loop)
        desired = request if self.lesson is None else self.lesson.desired
        _require_closed(self.whole.name, desired)
        self.period = loops.undone_loop(self.model, loop, step)
        if passes:
            require_rows(f"`passes` {passes}: the run-in", passes * loop.size, step)
        before, followed, run_in, settled, begun = self._led_to_loop(loop)
        played = before.voltage.size
        count = played + run_in.size
        zero = 0.0 if block.time is None else float(block.time[0])
        times = np.asarray(zero - step * np.arange(count, 0, -1.0), dtype=np.float64)
        first = None  # of a run-in: any row inside the range will do
        if played:
            first = float(before.voltage[0])
        elif not run_in.size:
            first = float(settled.done.y[0])
        self.gate.require_start(step, first)
        self.lead_in_seconds = step * count
        self.lead_in_figures.see(np.concatenate([before.voltage, run_in]), None)
        if run_in.size:
            self.among_them = f", {passes} {_passes(passes)} of run-in among them"
        require_short(self.source.name, before.chosen, step, step * loop.size)
        drive = self._closed(settled.done.y)
        self._count(settled)
        if begun is None:
            begun = self.model.start(float(drive[0]), self.start)
        self._require_loop(settled, begun, np.concatenate([before.voltage, run_in]))
        self.move_figures.see(desired, None)
        self._require_reached()
        if played:
            yield self._response(times[:played], before.expected, before.voltage, step)
        if run_in.size:
            yield self._response(times[played:], followed, run_in, step)
        end = loops.settled_run(self.model, drive, step, settled.before).state.dynamics
        time = None if block.time is None else float(block.time[-1])
        self.state = dataclasses.replace(settled.done.state, dynamics=end, time=time)
        response = self._response(
            zero + step * np.arange(float(drive.size)), desired, drive, step
        )
        yield response._replace(time=block.time)

    def _count(self, settled: Settled) -> None:
        """Count what is unusual in the settled period, and say how it closes."""
        done, block, unit = settled.done, self.whole.block, self.output.suffix
        self.rows += len(block)
        self.beyond.add(done.outside_count, done.first_outside, block)
        self._count_clipped(done, block)
        if done.clipped_count:
            lost = self.period - loops.slow_output(
                self.model, done.y, self.step, settled.before
            )
            if self.model.dynamics is not None:
                lost = self.model.dynamics.loop(lost, self.step)[0]
            self.loss.add_displacement(lost)
        seam = abs(float(done.y[0] - done.y[-1]))
        inside = float(np.abs(np.diff(done.y)).max())
        self.remarks_before.notes.append(
            f"{self.source.name}: the drive's step at the loop's seam is {seam:.3g}{unit}, the largest "
            f"inside {inside:.3g}{unit}"
        )

    def _require_loop(
        self, settled: Settled, begun: ModelState, led_in: FloatArray
    ) -> None:
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
            self._note_settling(settled, begun, led_in)
            return
        text = f"{self.source.name}: the loop does not settle: {why}"
        much = away > ALLOWED_PART * move
        refused = self.options.on_limit == "error"
        if refused or (self.options.on_limit == "auto" and much):
            raise LimitError(f"{text} (`on_limit` clip writes it all the same)")
        self.remarks_before.warn(text)

    def _note_settling(
        self, settled: Settled, begun: ModelState, led_in: FloatArray
    ) -> None:
        """Say how many passes and seconds the mean of a pass takes to come within the expected error.

        That holds from the start which is assumed; of other pasts it is said what they
        cost the first pass.
        """
        drive, unit = settled.done.y, self.input.suffix
        within, what = self._stated()
        first, passes = loops.settling(
            self.model, drive, self.step, begun, settled.before, within
        )
        how = "is settled from its first pass on: within"
        if passes:
            seconds = passes * (self.step * drive.size)
            how = (
                f"settles in {passes:,} {_passes(passes)}, {seconds:.3g} s: the mean of the first is "
                f"{first:.3g}{unit} off, then within"
            )
        lower, upper = self._from_either_end(settled, led_in)
        known = self.start != "auto" or max(lower, upper) <= within
        start = "" if known else ", from the start assumed,"
        self.remarks_before.notes.append(
            f"{self.source.name}: by the model{start} the loop {how} {what}, {within:.3g}{unit}"
        )
        if not known:
            self.remarks_before.notes.append(
                f"{self.source.name}: from its lower end the actuator's first pass is {lower:.3g}{unit} off "
                f"(RMS), from its upper end {upper:.3g}{unit}: what was before is not known (`state` says "
                "it, more `passes` bring it nearer)"
            )

    def _from_either_end(
        self, settled: Settled, led_in: FloatArray
    ) -> tuple[float, float]:
        """Return how far off the first pass is, RMS, where the actuator came from its lower or upper end."""
        model, step, drive = self.model, self.step, settled.done.y
        aim = loops.settled_run(model, drive, step, settled.before).y
        played = np.concatenate([led_in, drive])
        errors = []
        for end in ("empty", "full"):
            y = model.simulate(
                played, model.start(float(played[0]), end), time_step=step
            ).y
            errors.append(rms(y[-drive.size :] - aim))
        return errors[0], errors[1]

    # --- what stands before the period ---

    def _led_to_loop(self, loop: FloatArray) -> Led:
        """Return the settled loop of a period, and what is asked to stand before it."""
        passes = self.options.passes
        if self.options.lead is not None:
            return self._run_in_from_rest(loop)
        if passes:
            before = self.before_move(float(loop[0]), self.step)
        else:
            before = self._ramp_before()
        settled = self._settled(before.state or self._begun(float(self.period[0])))
        if passes:
            desired = np.concatenate(
                [before.desired, self._approached(loop, float(loop[0]))]
            )
            return before, desired, *self._run_in(desired, loop, before.state, settled)
        if before.state is None:
            before, settled = self._of_its_own_start(settled)
        return before, NOTHING, NOTHING, settled, before.state

    def _run_in_from_rest(self, loop: FloatArray) -> Led:
        """Return the loop, and before it the rest and the run-in.

        What the plan of the rest leaves out, gears that the run-in reaches, is measured
        and taken off.
        """
        bias, within, start = 0.0, self._stated()[0], self.came_from
        longest = longest_chosen(self.step * self.period.size)
        automatic = self.options.lead == "auto"
        seconds = 0.0, longest
        if not automatic:
            typed = float(self.options.lead or 0.0)
            seconds = typed, typed
        for _ in range(REST_PLANS):
            # of the last try alone
            self.rows, self.rows_before, self.clipped = 0, 0, Tally()
            before = self._rest_before(start, seconds, bias)
            desired = self._approached(loop, float(before.expected[-1]))
            assert before.state is not None
            run_in, settled, begun = self._run_in(
                desired, loop, before.state, self._settled(before.state)
            )
            off, _ = loops.settling(
                self.model, settled.done.y, self.step, begun, settled.before, within
            )
            if abs(off) <= 0.5 * within:
                break
            # what an unknown start leaves crossed jumps with it: the next rests start
            # here
            if start is None:
                start = float(before.voltage[0])
                rested = self.step * (before.voltage.size - 1)
                seconds = rested, rested
            else:
                bias += off
        rows = int(np.count_nonzero(before.voltage == before.voltage[-1]))
        self.remarks_before.notes.append(
            f"{self.source.name}: for the creep the drive rests {self.step * rows:.3g} s at "
            f"{before.voltage[-1]:.6g}{self.output.suffix} before the run-in"
        )
        if automatic and self.step * rows >= REACHED * longest and abs(off) > within:
            self.remarks_before.warn(
                f"{self.source.name}: `lead` auto rests {longest:.4g} s at most, after which the creep "
                f"still moves the mean of the first period by {abs(off):.3g}{self.input.suffix} (`lead` "
                "SECONDS rests as long as it says)"
            )
        return before, desired, run_in, settled, begun

    def _approached(self, loop: FloatArray, first: float) -> FloatArray:
        """Return the passes of a run-in, which fade in from a rest."""
        passes = self.options.passes
        return first + _rise(loop.size, passes) * (np.tile(loop, passes) - first)

    def _rest_before(
        self, last: float | None, between: tuple[float, float], bias: float
    ) -> Before:
        """Return the rest that brings the creep where the loop needs it, and the ramp there from ``last``."""
        model, step, come = self.model, self.step, self.came_from is not None
        known = self.start if isinstance(self.start, ModelState) else None
        settled, memory = (
            self._settled(known or self._begun(float(self.period[0]))),
            None,
        )
        within, swing = self._stated()[0], self.options.approach
        if come and between[1] > between[0]:  # what the ramp made ring dies away
            between = step * rest_samples(model, step), between[1]
        if swing is None:
            swing = "auto" if come or self.limits.max_slew is not None else SHORTEST_WAY
        passes, count = self.options.passes, self.period.size
        fade = _fade(passes * count, passes * count, (1.0, 1.0 / passes))
        rise = 1.0 - (1.0 - _rise(count, passes)) * (1.0 - fade)
        for _ in range(REST_PLANS):
            level, seconds = loops.creep_rest(
                model, settled, step, memory, rise, within, between, bias
            )
            voltage, begun = np.array([level]), known
            if last is not None:
                voltage = ramp("approach", last, level, step, swing, self.limits)
                if known is None:
                    voltage, begun = (
                        np.concatenate([[last], voltage]),
                        model.start(last, self.start),
                    )
            done = model.simulate(
                voltage, begun or model.start(level, self.start), time_step=step
            )
            settled = self._settled(done.state)
            memory = None if last is None else done.state.backlash.memory
        rest = np.full(require_rows("`lead`", math.ceil(seconds / step), step), level)
        rested = model.simulate(rest, done.state, time_step=step)
        expected = np.concatenate([done.y, rested.y])
        chosen = self._chosen_ramp(voltage)
        return Before(
            np.concatenate([voltage, rest]), expected, NOTHING, rested.state, chosen
        )

    def _chosen_ramp(self, voltage: FloatArray) -> tuple[Chosen, ...]:
        """Return the ramp to a loop as a piece that was chosen, where nobody typed its seconds."""
        if isinstance(self.options.approach, float | int):
            return ()
        return (
            Chosen(
                "the ramp", voltage.size, "`approach` SECONDS or a larger `max_slew`"
            ),
        )

    def _ramp_before(self) -> Before:
        """Return the ramp to a loop without a run-in; it ends on the first row of the settled drive."""
        approach, last = self.options.approach, self.came_from
        known = self.start if isinstance(self.start, ModelState) else None
        if approach is None or last is None:
            if approach is not None:
                # says what is missing
                self.before_move(float(self.period[0]), self.step)
            return Before(NOTHING, NOTHING, NOTHING, known)

        def to(target: float) -> FloatArray:
            voltage = ramp("approach", last, target, self.step, approach, self.limits)
            return voltage if known is not None else np.concatenate([[last], voltage])

        before = self._leading(known or self.model.start(last, self.start), to)
        if before is None:
            raise LimitError(
                f"{self.source.name}: no ramp was found that ends where the loop begins (`passes` runs it in)"
            )
        return before._replace(chosen=self._chosen_ramp(before.voltage))

    def _leading(
        self, begun: ModelState, to: Callable[[float], FloatArray]
    ) -> Before | None:
        """Return the rows ``to`` the first row of the loop that they lead to, or None."""
        target = float(self._settled(begun).done.y[0])
        for _ in range(MOST_RUN_INS):
            voltage = to(target)
            done = self.model.simulate(voltage, begun, time_step=self.step)
            ends, target = target, float(self._settled(done.state).done.y[0])
            if abs(target - ends) <= SAME_DRIVE * self.output.span:
                return Before(voltage, done.y, NOTHING, done.state)
        return None

    def _settled(self, state: ModelState) -> Settled:
        """Return the loop that settles from a state: gears that it does not reach stay as they were."""
        return loops.settled_drive(
            self.model, self.period, self.step, state, self.limits
        )

    def _of_its_own_start(self, settled: Settled) -> tuple[Before, Settled]:
        """Return the loop whose first row's own start (``auto``, ``settled``) leads to it, and rows before.

        Which gears a start leaves crossed changes by jumps with the voltage, so that
        the first row that the loop needs may jump over the one it began with. A row or
        few from there on then stand before the loop.
        """
        model, first, best = self.model, float(settled.done.y[0]), settled
        below, above, least = -math.inf, math.inf, math.inf
        for _ in range(MOST_STARTS):
            settled = self._settled(model.start(first, self.start))
            leads_to = float(settled.done.y[0])
            away = self._away(settled, model.start(leads_to, self.start))
            if away < least:
                best, least = settled, away
            if least <= LOOP_ERROR * float(np.ptp(self.period)) or below >= above:
                break
            if self.start in ("empty", "full"):  # whatever the first row
                break
            # A later start only lowers the first row that the loop needs: the two meet
            # between these.
            if leads_to > first:
                below = max(below, first)
            else:
                above = min(above, first)
            middle = 0.5 * (below + above)
            first = middle
            if below < leads_to < above or not math.isfinite(middle):
                first = leads_to
        if least > LOOP_ERROR * float(np.ptp(self.period)):
            lag = best.before.drive_lag
            # the second: the lag is on its way
            for start in (first,) if lag is None else (first, lag[0][0]):
                if led := self._rows_before(start, best):
                    return led
        return Before(NOTHING, NOTHING, NOTHING, None), best

    def _rows_before(
        self, first: float, loop: Settled
    ) -> tuple[Before, Settled] | None:
        """Return rows from a voltage to the loop that they lead to, where the model then repeats it."""
        # none where the limits leave one voltage of it
        most = float(np.abs(np.diff(loop.done.y)).max())
        most = most or self.limits.largest_change(self.step) or math.inf

        def to(target: float) -> FloatArray:
            return np.linspace(
                first,
                target,
                max(math.ceil(abs(target - first) / most), 1),
                endpoint=False,
            )

        before = self._leading(self.model.start(first, self.start), to)
        if before is None or before.state is None:
            return None
        settled = self._settled(before.state)
        if self._away(settled, before.state) > LOOP_ERROR * float(np.ptp(self.period)):
            return None
        count, taken, end, unit = before.voltage.size, "", "", self.output.suffix
        if self.start not in ("empty", "full"):
            taken, end = (
                ", where the actuator is taken to have settled,",
                " (`state` empty needs none)",
            )
        self.remarks_before.warn(
            f"{self.source.name}: no start leads to the loop: {count:,} row{'s' if count > 1 else ''} from "
            f"{first:.6g}{unit} on{taken} stand{'' if count > 1 else 's'} before the period{end}"
        )
        return before, settled

    def _away(self, settled: Settled, begun: ModelState) -> float:
        """Return how far off the model repeats a settled drive that is begun in a state."""
        model, drive, step = self.model, settled.done.y, self.step
        ends = loops.slow_output(
            model, drive, step, loops.looped_state(model, drive, step, begun)
        )
        clipped = settled.done.clipped_count
        aim = self.period
        if clipped:
            aim = loops.slow_output(model, drive, step, settled.before)
        return float(np.abs(ends - aim).max())

    def _run_in(
        self,
        desired: FloatArray,
        loop: FloatArray,
        begun: ModelState | None,
        settled: Settled,
    ) -> tuple[FloatArray, Settled, ModelState]:
        """Return the drive up to the settled period, the period settled from the state it leaves, and that.

        During the second half of the last pass it fades over from what follows the
        trajectory to the settled drive, within the slew limit.
        """
        model, limits = self.model, self.limits
        signal = self._undone_before(desired, loop, begun)
        start = begun or model.start_compensation(float(signal[0]), self.start, limits)
        followed = model.compensate(
            signal[: desired.size], start, limits=limits, time_step=self.step
        )
        self.rows += followed.y.size
        self.rows_before += followed.y.size
        self._count_clipped(followed, None)
        forward = start
        if begun is None:
            forward = model.start(float(followed.y[0]), self.start)
        led, off = None, math.inf
        fades: tuple[tuple[float, float], ...] = FADES
        if self.options.lead is not None:
            fades = ((1.0, 1.0 / self.options.passes), *FADES)
        for fade in fades:
            aim = settled
            for _ in range(MOST_RUN_INS):
                target, closed = aim, self._closed(aim.done.y)
                drive = self._faded_over(followed.y, closed, fade)
                if drive[-1] != closed[-1]:
                    off = min(off, abs(float(drive[-1] - closed[-1])))
                    break
                state = model.simulate(drive, forward, time_step=self.step).state
                aim = loops.settled_drive(model, self.period, self.step, state, limits)
                led = drive, target, state
                if (
                    np.abs(aim.done.y - target.done.y).max()
                    <= SAME_DRIVE * model.input.span
                ):
                    return led
        if led is None:
            raise LimitError(
                f"{self.source.name}: the run-in ends {off:.3g}{self.output.suffix} off the settled loop "
                "(more `passes`, or a larger `max_slew`)"
            )
        return led

    def _undone_before(
        self, desired: FloatArray, loop: FloatArray, begun: ModelState | None
    ) -> FloatArray:
        """Return what the gears are to follow before the period, delay and dynamics undone."""
        model, step = self.model, self.step
        inverter = None if model.dynamics is None else model.dynamics.inverter(step)
        ahead = int(np.ceil(model.delay_seconds / step)) + AFTER
        if inverter is not None:
            ahead += inverter.ahead
        signal = loops.read_ahead(
            model, np.concatenate([desired, np.resize(loop, ahead)]), step
        )
        if inverter is not None:
            memory = None
            if begun is not None and begun.dynamics is not None:
                memory = inverter.memory_of(begun.dynamics)
            ((_, signal, _),) = undone([(None, signal)], inverter, memory)
        return signal

    def _faded_over(
        self, followed: FloatArray, settled: FloatArray, fade: tuple[float, float]
    ) -> FloatArray:
        """Return a run-in that ends on the settled drive, within the slew limit.

        ``followed`` and the settled drive both keep the limits, and so does what lies
        between; only the change from the one to the other may be too fast, and then it
        takes longer. ``fade`` is where the change begins and ends, in parts of the
        run-in before its end.
        """
        rows = followed.size
        tail = np.resize(settled, rows + (-rows) % settled.size)[-rows:]
        rise = _fade(rows, settled.size * self.options.passes, fade)
        drive: FloatArray = np.where(
            rise < 1.0, followed + rise * (tail - followed), tail
        )
        drive = np.clip(drive, self.limits.v_min, self.limits.v_max)
        return self._within_slew(drive, float(drive[0]))

    def _stated(self) -> tuple[float, str]:
        """Return what the mean of a pass may be off, and what that is."""
        expected = self.model.fit.get("expected_rmse")
        if isinstance(expected, float) and expected > 0.0:
            return expected, "the expected error"
        return SETTLED_PART * float(np.ptp(self.period)), "0.1 % of the move"

    def _closed(self, drive: FloatArray) -> FloatArray:
        """Return a settled drive whose seam keeps the slew limit to the last digit; refuse one that jumps.

        A drive that has settled differs from the pass before in its last digits, and
        the first row was held within the limit behind the last row of that pass.
        """
        closed = self._within_slew(drive, float(drive[-1]))
        away = float(np.abs(closed - drive).max())
        most = self.limits.largest_change(self.step)
        seam = abs(float(closed[0]) - float(closed[-1]))
        if away > SAME_DRIVE * self.output.span or (most is not None and seam > most):
            raise LimitError(
                f"{self.source.name}: the loop does not close within the limits: from its last row, "
                f"{drive[-1]:.6g}, to its first, {drive[0]:.6g}, is a step that `max_slew` forbids"
            )
        return closed

    def _within_slew(self, drive: FloatArray, last: float) -> FloatArray:
        """Return a drive whose rows follow ``last`` and one another within the slew limit."""
        most = self.limits.largest_change(self.step)
        if most is None or (np.abs(np.diff(drive, prepend=last)) <= most).all():
            return drive
        values = drive.tolist()
        for k, value in enumerate(values):
            last = values[k] = min(
                max(value, towards(last, -most)), towards(last, most)
            )
        return np.array(values)


def _rise(count: int, passes: int) -> FloatArray:
    """Return how much of a run-in's rows is the period: it fades in, during the first pass, from a rest."""
    return np.concatenate(
        [soft_rise(np.arange(count) / count), np.ones(count * (passes - 1))]
    )


def _fade(rows: int, run_in: int, fade: tuple[float, float]) -> FloatArray:
    """Return a rise over the last rows, from one part of the run-in before its end to another."""
    left = (rows - np.arange(rows)) / run_in
    return soft_rise(np.clip((fade[0] - left) / (fade[0] - fade[1]), 0.0, 1.0))


def _passes(count: int) -> str:
    """Return the word for one pass or several."""
    return "pass" if count == 1 else "passes"


def _require_closed(name: str, period: FloatArray) -> None:
    """Refuse a period that is too short or jumps from its last row to its first (InputError)."""
    if period.size < FEWEST_ROWS:
        raise InputError(
            f"{name}: {period.size} rows are no period of a loop (at least {FEWEST_ROWS})"
        )
    seam, inside = (
        abs(float(period[0] - period[-1])),
        float(np.abs(np.diff(period)).max()),
    )
    if seam > SEAM * inside:
        raise InputError(
            f"{name}: the period does not close: from the last row, {period[-1]:.6g}, to the first, "
            f"{period[0]:.6g}, is a step of {seam:.3g} where the largest inside is {inside:.3g} (give one "
            "whole period, without its first row again at the end)"
        )
