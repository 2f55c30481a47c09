"""The run of a compensation: the inverse within the drive's limits, perhaps with a sweep before it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import chain

import numpy as np

from dbo_cli.errors import InputError, UsageError
from dbo_cli.hysteresis.conditioning import condition as conditioning_drive
from dbo_cli.logs.clock import even_step, median_step
from dbo_cli.logs.sample_block import FloatArray, SampleBlock
from dbo_cli.runs.model_run import ModelRun, Response, unit_of
from dbo_cli.runs.remarks import Remarks

RATE_SAMPLES = 101
"""The sweep takes its rate from so many first samples, however the trajectory is cut."""

SLACK = 1e-9  # of the range: what rounding may add to a drive that ends at its limit


@dataclass
class Extent:
    """The least and the greatest of all values seen."""

    low: float = math.inf
    high: float = -math.inf

    def add(self, values: FloatArray) -> None:
        """See some values more."""
        self.low = min(self.low, float(values.min(initial=math.inf)))
        self.high = max(self.high, float(values.max(initial=-math.inf)))


@dataclass
class Compensation(ModelRun):
    """A run of the inverse within the drive's limits, perhaps with a sweep before it.

    Attributes
    ----------
    desired : array, optional
        The trajectory, where the source holds what is asked of the model instead (see ``learning``).
    remarks_before : Remarks
        What was said before the run.
    """

    condition: bool = False
    desired: FloatArray | None = None
    remarks_before: Remarks = field(default_factory=Remarks)
    move: Extent = field(default_factory=lambda: Extent())
    drive: Extent = field(default_factory=lambda: Extent())

    def responses(self) -> Iterator[Response]:
        """Return the drive; with ``condition`` first the sweep, in negative time (see ``ModelRun``)."""
        if not self.condition:
            for response in super().responses():
                yield self._with_desired(response, self.rows)
            return
        blocks = self.inputs()
        held: list[tuple[SampleBlock, FloatArray]] = []
        while sum(len(block) for block, _ in held) < RATE_SAMPLES:
            more = next(blocks, None)
            if more is None:
                break
            held.append(more)
        yield self._sweep(held)
        for block, x in chain(held, blocks):
            given = block.values[self.taken.quantity]
            yield self._with_desired(Response(block.time, given, self.feed(block, x)), self.rows)
        self.check_reach()

    def remarks(self) -> Remarks:
        """Return what is to be said of the run so far, and what was said before."""
        told = Remarks()
        told.add(self.remarks_before)
        told.add(super().remarks())
        expected = self._expected_error()
        if expected:
            told.notes.append(expected)
        return told

    def followed(self, desired: FloatArray, drive: FloatArray) -> None:
        """Remember how far the move and its drive reach."""
        self.move.add(desired)
        self.drive.add(drive)

    def _expected_error(self) -> str:
        """Say what error to expect of the move, unless a pass was learned or the model does not know."""
        rmse, name = self.model.fit.get("expected_rmse", ""), self.source.name
        if self.desired is not None or not self.rows:
            return ""
        if rmse is None:
            return f"{name}: what error to expect cannot be told: {self.model.fit.get('expected_from')}"
        if not isinstance(rmse, float):
            return ""
        covered = self.model.input
        slack = SLACK * covered.span
        if self.drive.low < covered.minimum - slack or self.drive.high > covered.maximum + slack:
            return (
                f"{name}: what error to expect cannot be told: the drive goes from {self.drive.low:.6g} to "
                f"{self.drive.high:.6g}{unit_of(covered)}, beyond what the model was identified on"
            )
        span = self.move.high - self.move.low
        part = f" ({100.0 * rmse / span:.2g} % of the move)" if span > 0.0 else ""
        held = ", clipped samples aside" if self.clipped.count else ""
        held += ", besides what `bandwidth` takes off" if self.bandwidth is not None else ""
        return f"{name}: expected error of the move {rmse:.3g}{unit_of(self.model.output)} RMS{part}{held}"

    def _with_desired(self, response: Response, rows: int) -> Response:
        if self.desired is not None:
            response = response._replace(given=self.desired[rows - len(response.result) : rows])
        self.followed(response.given, response.result)
        return response

    def _sweep(self, held: list[tuple[SampleBlock, FloatArray]]) -> Response:
        """Return the conditioning sweep, and let the run go on from the state it leaves.

        What is wanted during the sweep is what the model does there: every cell must hold a number.
        """
        assert self.limits is not None
        first = float(held[0][1][0])
        times = [block.time for block, _ in held if block.time is not None]
        stamps = np.concatenate(times)[:RATE_SAMPLES]
        step = self.steps.step or even_step(stamps) or _usual_step(self.source.name, stamps)
        self._require_bounded(step)
        sweep = conditioning_drive(self.model, first, self.limits, step)
        start = self.model.start(float(sweep.voltage[0]))
        expected = self.model.simulate(sweep.voltage, start, time_step=step).y
        self.state = sweep.state
        self.steps.follow(float(stamps[0]) - step)
        return Response(sweep.time + float(stamps[0]), expected, sweep.voltage)

    def _require_bounded(self, step: float) -> None:
        """Refuse a sweep over the whole range that no memory could hold (UsageError)."""
        from dbo_cli.hysteresis.excitation import MOST_SAMPLES

        assert self.limits is not None
        slew = self.limits.max_slew
        slowest = 0.0 if slew is None else 0.5 * np.pi * (self.limits.v_max - self.limits.v_min) / slew
        rows = 2.0 * max(slowest, 1.0) / step
        if rows > MOST_SAMPLES:
            at, remedy = (f" at `max_slew` {slew:g}", "`max_slew`") if slowest > 1.0 else ("", "rate")
            raise UsageError(
                f"`condition`: the sweep{at} takes {rows * step:.4g} s, {rows:.4g} rows, more than the "
                f"{MOST_SAMPLES:,} that are written at most (another {remedy})"
            )


def _usual_step(name: str, stamps: FloatArray) -> float:
    """Return the median step (s) of a clock that is not even (InputError where it stands still)."""
    steps = np.diff(stamps)
    forward = steps[steps > 0.0]
    if not len(forward):
        raise InputError(f"{name}: the time does not advance, and `condition` takes its rate from it")
    return median_step(forward)
