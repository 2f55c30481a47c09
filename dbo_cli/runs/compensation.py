"""Compensation: the drive that makes an actuator follow a trajectory."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain

from dbo_cli.errors import UsageError
from dbo_cli.hysteresis.excitation import condition as conditioning_drive
from dbo_cli.hysteresis.initial_states import StartName
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.hysteresis.model_state import DriveLimits, ModelState
from dbo_cli.logs.clock import require_even
from dbo_cli.logs.sample_block import FloatArray, SampleBlock
from dbo_cli.runs.model_run import ModelRun, Response
from dbo_cli.runs.source import Source


@dataclass
class Compensation(ModelRun):
    """A run of the inverse within the drive's limits, perhaps with a sweep before it."""

    condition: bool = False

    def responses(self) -> Iterator[Response]:
        """Return the drive; with ``condition`` first the sweep, in negative time (see ``ModelRun``)."""
        if not self.condition:
            yield from super().responses()
            return
        blocks = self.inputs()
        first = next(blocks)
        yield self._sweep(*first)
        for block, x in chain([first], blocks):
            yield Response(block.time, block.values[self.taken.quantity], self.feed(block, x))

    def _sweep(self, block: SampleBlock, x: FloatArray) -> Response:
        """Return the conditioning sweep, and let the run go on from the state it leaves.

        What is wanted during the sweep is what the model does there: every cell must hold a number.
        """
        assert block.time is not None and self.limits is not None
        step = self.steps.step
        if step is None:
            step = require_even(self.source.name, block.time, "`condition` takes its rate from them")
        sweep = conditioning_drive(self.model, float(x[0]), self.limits, step)
        start = self.model.start(float(sweep.voltage[0]))
        expected = self.model.simulate(sweep.voltage, start, time_step=step).y
        self.state = sweep.state
        return Response(sweep.time + float(block.time[0]), expected, sweep.voltage)


def compensation(
    model: ActuatorModel,
    source: Source,
    *,
    v_min: float | None = None,
    v_max: float | None = None,
    max_slew: float | None = None,
    refuse_clipping: bool = False,
    start: StartName | ModelState = "auto",
    condition: bool = False,
    last_row: int | None = None,
) -> Compensation:
    """Return the run of a forward model's inverse over a trajectory.

    Parameters
    ----------
    model
        A forward model.
    source
        The trajectory, under the name of the model's output.
    v_min, v_max, max_slew
        What the drive may do, in the unit of the model's input (and per second); the model's range where
        not given.
    refuse_clipping, start, last_row
        See ``ModelRun``.
    condition
        Sweep the actuator into a known state first.

    Raises
    ------
    UsageError
        The limits are not in order, or a start is asked for beside the sweep.
    ModelError
        The model is an inverse one.
    """
    model.require("forward")
    if condition and start != "auto":
        named = start if isinstance(start, str) else "a state"
        raise UsageError(f"`condition` and `state` {named} exclude each other: the sweep makes its own state")
    drive = model.input
    low = drive.minimum if v_min is None else v_min
    high = drive.maximum if v_max is None else v_max
    check_range(low, high)
    why = "`max_slew` depends on it" if max_slew is not None else None
    if condition and why is None:
        why = "`condition` depends on it"
    return Compensation(
        model,
        source,
        start=start,
        limits=DriveLimits(low, high, max_slew),
        refuse_clipping=refuse_clipping,
        last_row=last_row,
        why_time=why,
        condition=condition,
    )


def check_range(v_min: float | None, v_max: float | None) -> None:
    """Refuse limits that leave nothing between them (UsageError)."""
    if v_min is not None and v_max is not None and v_min >= v_max:
        raise UsageError(f"`v_min` {v_min:g} must be below `v_max` {v_max:g}")
