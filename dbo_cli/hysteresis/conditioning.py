"""The drive that puts an actuator into a known state before a trajectory."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.hysteresis.model_state import DriveLimits, ModelState
from dbo_cli.hysteresis.swings import Floats, swing_samples, swings

JOINING_TURNS = 30
JOINED = 1e-9  # of the drive's range: the sweep ends where the trajectory begins


class Conditioned(NamedTuple):
    """A conditioning drive: its times (s, below 0), its voltages, and the state it leaves behind."""

    time: Floats
    voltage: Floats
    state: ModelState


def condition(
    model: ActuatorModel,
    first_desired: float,
    limits: DriveLimits,
    time_step: float,
    sweep_seconds: float = 1.0,
) -> Conditioned:
    """Return the drive that puts an actuator into a known state before a trajectory, and that state.

    It goes from the lower limit over the whole range and back, which wipes out whatever was before (a drive
    at or below X_0 clears every bit), and then up the loading branch to the voltage of ``first_desired``.
    ``compensate`` goes on from the state; the last time is one ``time_step`` before 0.
    """
    model.require("forward")
    loading = model.inverse().start(first_desired, "empty")
    wanted = model.inverse().simulate([first_desired], loading, time_step=time_step).y[0]
    target = float(min(max(wanted, limits.v_min), limits.v_max))
    low = limits.v_min
    high = min(max(model.drive_end, target), limits.v_max)
    # What lags remembers the sweep, so the voltage that the trajectory begins with depends on the sweep, and
    # the sweep shall end at that voltage: a fixed point, found in a few turns since the memory is weak.
    for _ in range(JOINING_TURNS):
        turns = [low, high, low, target]
        counts = [
            swing_samples(
                end - begin, time_step, sweep_seconds * abs(end - begin) / (high - low), limits.max_slew
            )
            for begin, end in pairwise(turns)
        ]
        voltage = swings(turns, counts)
        done = model.simulate(voltage, model.start(low), time_step=time_step)
        follows = model.compensate([first_desired], done.state, limits=limits, time_step=time_step)
        begins = float(follows.y[0])
        if abs(begins - target) <= JOINED * (high - low):
            break
        target = begins
    time: Floats = -time_step * np.arange(voltage.size, 0, -1, dtype=np.float64)
    return Conditioned(time, voltage, done.state)
