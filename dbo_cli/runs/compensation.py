"""Compensation: the drive that makes an actuator follow a trajectory."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain

import numpy as np

from dbo_cli.errors import InputError, UsageError
from dbo_cli.hysteresis.conditioning import condition as conditioning_drive
from dbo_cli.hysteresis.initial_states import StartName
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.hysteresis.model_state import DriveLimits, ModelState
from dbo_cli.logs.clock import even_step
from dbo_cli.logs.sample_block import FloatArray, SampleBlock
from dbo_cli.runs.model_run import ModelRun, Response
from dbo_cli.runs.source import Source

RATE_SAMPLES = 101
"""The sweep takes its rate from so many first samples, however the trajectory is cut."""


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
        held: list[tuple[SampleBlock, FloatArray]] = []
        while sum(len(block) for block, _ in held) < RATE_SAMPLES:
            more = next(blocks, None)
            if more is None:
                break
            held.append(more)
        yield self._sweep(held)
        for block, x in chain(held, blocks):
            yield Response(block.time, block.values[self.taken.quantity], self.feed(block, x))
        self.check_reach()

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


def _usual_step(name: str, stamps: FloatArray) -> float:
    """Return the median step (s) of a clock that is not even (InputError where it stands still)."""
    steps = np.diff(stamps)
    forward = steps[steps > 0.0]
    if not len(forward):
        raise InputError(f"{name}: the time does not advance, and `condition` takes its rate from it")
    return float(np.median(forward))


def check_range(v_min: float | None, v_max: float | None) -> None:
    """Refuse limits that leave nothing between them (UsageError)."""
    if v_min is not None and v_max is not None and v_min >= v_max:
        raise UsageError(f"`v_min` {v_min:g} must be below `v_max` {v_max:g}")
