"""A model with fewer gears, and what that costs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dbo_cli.errors import UsageError
from dbo_cli.export.self_test_moves import self_test_moves
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.hysteresis.operators import DiscreteBacklashOperator

Floats = NDArray[np.float64]

_TRIALS = 20


def with_fewer_gears(model: ActuatorModel, gears: int) -> tuple[ActuatorModel, dict[str, float]]:
    """Return a forward model with ``gears`` even gears on the same loading curve, and what is lost.

    The loading curve keeps its value at every new breakpoint; turns between them are what gets coarser.
    The loss is the difference of the two models' outputs over 20 test moves: ``max``, ``rms`` in the
    output's unit, and ``max_percent`` of its range.

    Raises
    ------
    UsageError
        ``gears`` is not between 1 and the number that the model has.
    """
    full = model.forward_backlash
    if not 1 <= gears <= full.n:
        raise UsageError(f"`gears` {gears}: the model has {full.n}; give a number from 1 to that")
    forward = model if model.direction == "forward" else model.inverse()
    if gears == full.n:
        return forward, {}
    across = np.concatenate([[0.0], np.cumsum(full.dx)])
    up = np.concatenate([[0.0], np.cumsum(full.dy)])
    ends = across[-1] * np.arange(gears + 1) / gears
    heights = np.diff(np.interp(ends, across, up))
    reduced = DiscreteBacklashOperator(
        np.full(gears, across[-1] / gears), heights, full.x0, full.y0, full.relaxation, "input"
    )
    stages = tuple(reduced if stage is forward.backlash else stage for stage in forward.stages)
    fewer = ActuatorModel("forward", forward.input, forward.output, stages, forward.fit, forward.provenance)
    return fewer, _loss(forward, fewer)


def _loss(full: ActuatorModel, fewer: ActuatorModel) -> dict[str, float]:
    differences = []
    step = max(full.backlash.relaxation.tau) if full.backlash.relaxation else None
    if full.needs_time and step is None:
        step = max(full.delay_seconds, 1e-9)
    for seed in range(_TRIALS):
        moves = self_test_moves(full.input.minimum, full.input.maximum, seed)
        outputs = [m.simulate(moves, m.start(float(moves[0])), time_step=step).y for m in (full, fewer)]
        differences.append(outputs[1] - outputs[0])
    every = np.concatenate(differences)
    worst = float(np.max(np.abs(every)))
    return {
        "max": worst,
        "rms": float(np.sqrt(np.mean(every**2))),
        "max_percent": 100.0 * worst / full.output.span,
    }
