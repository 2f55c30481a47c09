"""How long an actuator creeps and rings after a step of its drive, from its model."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from dbo_cli.hysteresis.linear_sections import Lag, Section
from dbo_cli.hysteresis.loops import slow_model
from dbo_cli.hysteresis.model import ActuatorModel

FOR_EVER = 50.0  # of the longest time constant: what creeps is over to 2e-22
SHORTEST = 1e-9  # s: shorter than any converter's row
HALVINGS = 60  # of the logarithm of time: 20 decades to the last digits


def settling_seconds(model: ActuatorModel, begin: float, end: float, distance: float) -> float:
    """Return the seconds after which a held step of the drive stays within a distance of where it ends.

    Creep is the model's own, from a rest at ``begin``; rings and lags count with their envelopes, so that the
    time is an upper bound, by up to half a period of the resonance.

    Parameters
    ----------
    model
        A forward model.
    begin, end
        Drive before and after the step.
    distance
        In the unit of the displacement.
    """
    terms = model.backlash.relaxation
    longest = FOR_EVER * max(terms.tau if terms is not None else (1.0,))
    slow = slow_model(model, but=(model.drive_lag,))

    def output(drive: float, seconds: float) -> float:
        """Return the displacement some seconds after the step, without ringing."""
        return float(slow.simulate([drive], rest, time_step=seconds).y[0])

    rest = slow.start(begin)
    for _ in range(2):  # the first sample's own time step does not matter
        rest = slow.simulate([begin], rest, time_step=longest).state
    aim, size = output(end, longest), abs(output(end, SHORTEST) - output(begin, SHORTEST))
    stages = (model.dynamics, model.drive_lag)
    fades = _fades([section for stage in stages if stage is not None for section in stage.sections])

    def left(seconds: float) -> float:
        rings = sum(part * math.exp(-seconds / fade) for part, fade in fades)
        return abs(output(end, seconds) - aim) + size * rings

    low, high = SHORTEST, max([longest, *(FOR_EVER * fade for _, fade in fades)])
    if left(low) <= distance:
        return 0.0
    for _ in range(HALVINGS):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if left(middle) > distance else (low, middle)
    return high


def _fades(sections: Sequence[Section]) -> list[tuple[float, float]]:
    """Return what part of a step each section rings or lags by, and the time constant with which that fades.

    A resonance is excited through the other sections: their gain at its frequency is its part.
    """
    fades = []
    for section in sections:
        if isinstance(section, Lag):
            fades.append((1.0, section.seconds))
            continue
        at = np.array([section.frequency])
        gains = (abs(complex(one.response(at)[0])) for one in sections if one is not section)
        fades.append((math.prod(gains), 0.5 / (math.pi * section.frequency * section.damping)))
    return fades
