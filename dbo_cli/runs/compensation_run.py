"""The run of a compensation: the inverse within the drive's limits, perhaps with a sweep before it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import chain

import numpy as np

from dbo_cli.errors import InputError
from dbo_cli.hysteresis.conditioning import condition as conditioning_drive
from dbo_cli.logs.clock import even_step, median_step
from dbo_cli.logs.sample_block import FloatArray, SampleBlock
from dbo_cli.runs.model_run import ModelRun, Response
from dbo_cli.runs.remarks import Remarks

RATE_SAMPLES = 101
"""The sweep takes its rate from so many first samples, however the trajectory is cut."""


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
        return told

    def _with_desired(self, response: Response, rows: int) -> Response:
        if self.desired is None:
            return response
        return response._replace(given=self.desired[rows - len(response.result) : rows])

    def _sweep(self, held: list[tuple[SampleBlock, FloatArray]]) -> Response:
        """Return the conditioning sweep, and let the run go on from the state it leaves.

        What is wanted during the sweep is what the model does there: every cell must hold a number.
        """
        assert self.limits is not None
        first = float(held[0][1][0])
        times = [block.time for block, _ in held if block.time is not None]
        stamps = np.concatenate(times)[:RATE_SAMPLES]
        step = self.steps.step or even_step(stamps) or _usual_step(self.source.name, stamps)
        sweep = conditioning_drive(self.model, first, self.limits, step)
        start = self.model.start(float(sweep.voltage[0]))
        expected = self.model.simulate(sweep.voltage, start, time_step=step).y
        self.state = sweep.state
        self.steps.follow(float(stamps[0]) - step)
        return Response(sweep.time + float(stamps[0]), expected, sweep.voltage)


def _usual_step(name: str, stamps: FloatArray) -> float:
    """Return the median step (s) of a clock that is not even (InputError where it stands still)."""
    steps = np.diff(stamps)
    forward = steps[steps > 0.0]
    if not len(forward):
        raise InputError(f"{name}: the time does not advance, and `condition` takes its rate from it")
    return median_step(forward)
