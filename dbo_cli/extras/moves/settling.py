"""How long an actuator creeps and rings after a step of its drive, from its model."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from dbo_cli.drives.gate import DriveFigures
from dbo_cli.errors import UsageError
from dbo_cli.hysteresis.dynamics import Lag, Section
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.logs.sample_block import FloatArray
from dbo_cli.logs.units import in_unit

FOR_EVER = 50.0  # of the longest time constant: what creeps is over to 2e-22
SHORTEST = 1e-9  # s: shorter than any converter's row
HALVINGS = 60  # of the logarithm of time: 20 decades to the last digits
FEW_PERIODS = 10.0  # of a resonance, in which half a period is more than 5 %
# of the highest resonance: a crossing is timed to 1.6 % of it; 16 did no worse
ROWS_A_PERIOD = 64.0
MOST_SAID = 12  # steps in a note; chosen
MOST_TIMED = 300  # different steps that are timed: 7 ms each
# rows at one value that count as a level; a sine sampled coarsely rests for two or
# three
FEWEST_HELD = 10


def distance_in(distance: float | str, unit: str | None) -> float:
    """Return a distance in a unit, from a number that is in it already or a text such as ``5nm``.

    Raises
    ------
    UsageError
        It is no distance above 0, or its unit is no known one or of another kind.
    """
    size = in_unit("settle", distance, unit)
    if not 0.0 < size < math.inf:
        raise UsageError(
            f"`settle` {distance}: give a distance above 0, such as 0.005 or 5nm"
        )
    return size


class StepTime(NamedTuple):
    """A step of the drive between held levels, and the seconds until it has settled."""

    begin: float
    end: float
    seconds: float


class StepTimes:
    """How long the steps of a drive have to be held, as it is computed: those between levels that are held.

    Parameters
    ----------
    model : ActuatorModel
        The forward model.
    settle : float or str
        The distance within which a level counts as reached (see ``distance_in``).

    Attributes
    ----------
    steps : list of (float, float)
        Drive of a level and of the next one, each at its tenth row; the last rows may
        lead to the next level.
    """

    def __init__(self, model: ActuatorModel, settle: float | str) -> None:
        self.model, self.distance = model, distance_in(settle, model.output.unit)
        self.steps: list[tuple[float, float]] = []
        self._level, self._rows, self._drive = math.nan, 0, math.nan
        self._before: tuple[float, float] | None = None
        self._timed: list[StepTime] = []
        self._count = 0

    def add(self, desired: FloatArray, drive: FloatArray) -> None:
        """Take a block of what is desired and of its drive."""
        if not desired.size:
            return
        begins = np.concatenate([[0], np.flatnonzero(np.diff(desired) != 0.0) + 1])
        rows = np.diff(begins, append=desired.size)
        carried = self._rows if desired[0] == self._level else 0
        if not carried:
            self._close()
        for k in np.flatnonzero(
            (rows >= FEWEST_HELD) | (begins == 0) | (begins == begins[-1])
        ).tolist():
            before = carried if k == 0 else 0
            rows_at_level = before + int(rows[k])
            if before < FEWEST_HELD <= rows_at_level:
                self._drive = float(drive[begins[k] + FEWEST_HELD - before - 1])
            self._level, self._rows = float(desired[begins[k]]), rows_at_level
            if k < rows.size - 1:
                self._close()

    def _close(self) -> None:
        if self._rows >= FEWEST_HELD:
            if self._before is not None and self._before[0] != self._level:
                self.steps.append((self._before[1], self._drive))
            self._before = self._level, self._drive
        self._rows = 0

    def times(self) -> list[StepTime]:
        """Return the settling time of each step so far; of very many, of some, from the smallest on."""
        self._close()
        steps = self.steps
        if len(steps) != self._count:
            self._count = len(steps)
            if len(set(steps)) > MOST_TIMED:
                sizes = sorted(
                    set(steps), key=lambda step: (abs(step[1] - step[0]), step)
                )
                steps = [
                    sizes[k]
                    for k in np.linspace(0, len(sizes) - 1, MOST_TIMED).astype(int)
                ]
            seconds = {
                step: settling_seconds(self.model, *step, self.distance)
                for step in dict.fromkeys(steps)
            }
            self._timed = [StepTime(*step, seconds[step]) for step in steps]
        return self._timed

    def summary(self) -> dict[str, Any]:
        """Return the steps as plain values for the summary of a run."""
        return {"settling": [step._asdict() for step in self.times()]}

    def notes(self, name: str, drive: DriveFigures) -> list[str]:
        """Say how long a step over the whole drive, and each between levels, has to be held."""
        if not drive.rows:
            return []
        model, distance, times, count = (
            self.model,
            self.distance,
            self.times(),
            len(self.steps),
        )
        unit, volts = model.output.suffix, model.input.suffix
        seconds = settling_seconds(model, drive.low, drive.high, distance)
        notes = [
            f"{name}: after a step from {drive.low:.6g} to {drive.high:.6g}{volts} that is held, creep and "
            f"ringing stay within {distance:.6g}{unit} after {seconds:.3g} s{below_error(model, distance)}"
        ]
        texts = [
            f"{step.seconds:.3g} s ({step.begin:.6g} to {step.end:.6g}{volts})"
            for step in times
        ]
        within = f"{name}: within {distance:.6g}{unit},"
        if 0 < count <= MOST_SAID:
            notes.append(f"{within} steps between held levels take {', '.join(texts)}")
        elif count:
            order = sorted(range(len(times)), key=lambda k: times[k].seconds)
            part = "" if count == len(times) else f" ({len(times)} looked at)"
            shortest, longest = texts[order[0]], texts[order[-1]]
            notes.append(
                f"{within} of {count:,} steps between held levels{part} the shortest takes {shortest}, "
                f"the longest {longest} (`summary` has each)"
            )
        return notes


def below_error(model: ActuatorModel, distance: float) -> str:
    """Return a hint where a model errs by more than a distance, so that its times say little."""
    rmse = model.fit.get("expected_rmse")
    below = isinstance(rmse, float) and distance < rmse
    return (
        f" (below the model's expected error of {rmse:.3g}{model.output.suffix})"
        if below
        else ""
    )


def _sections_of(model: ActuatorModel) -> list[Section]:
    """Return what rings or lags: the sections of the dynamics, and of a lag before the gears."""
    sections: list[Section] = []
    for stage in (model.dynamics, model.drive_lag):
        if stage is not None:
            sections.extend(stage.sections)
    return sections


def settling_seconds(
    model: ActuatorModel, begin: float, end: float, distance: float
) -> float:
    """Return the seconds after which a held step of the drive stays within a distance of where it ends.

    Creep is the model's own, from a rest at ``begin``; rings and lags count with their
    envelopes, so that the time is an upper bound, by up to half a period of the
    resonance. The first periods are simulated instead.

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
    slow = model.without_lag

    def output(drive: float, seconds: float) -> float:
        """Return the displacement some seconds after the step, without ringing."""
        return float(slow.simulate([drive], rest, time_step=seconds).y[0])

    rest = slow.start(begin)
    for _ in range(2):  # the first sample's own time step does not matter
        rest = slow.simulate([begin], rest, time_step=longest).state
    aim = output(end, longest)
    size = abs(output(end, SHORTEST) - output(begin, SHORTEST))
    fades = _fades(_sections_of(model))

    def left(seconds: float) -> float:
        rings = sum(part * math.exp(-seconds / fade) for part, fade in fades)
        return abs(output(end, seconds) - aim) + size * rings

    low, high = SHORTEST, max([longest, *(FOR_EVER * fade for _, fade in fades)])
    if left(low) <= distance:
        return 0.0
    for _ in range(HALVINGS):
        middle = math.sqrt(low * high)
        if left(middle) > distance:
            low = middle
        else:
            high = middle
    modes = []
    if model.dynamics is not None:
        modes = [resonance.frequency for resonance in model.dynamics.resonances]
    if not modes or high * min(modes) > FEW_PERIODS:
        return high
    step = 1.0 / (ROWS_A_PERIOD * max(modes))
    without_delay = tuple(stage for stage in model.stages if stage is not model.delay)
    whole = dataclasses.replace(model, stages=without_delay)
    begun = whole.simulate([begin], rest, time_step=step).state
    y = whole.simulate(np.full(math.ceil(high / step), end), begun, time_step=step).y
    return step * (int(np.flatnonzero(np.abs(y - aim) > distance).max(initial=-1)) + 1)


def settling_shown(model: ActuatorModel, settle: str) -> dict[str, Any]:
    """Return what ``show`` says of a step over the whole drive of a forward model.

    Parameters
    ----------
    model
        The model.
    settle
        The distance to stay within, with or without its unit.
    """
    unit, drive = model.output.unit, model.input
    distance = distance_in(settle, unit)
    up = settling_seconds(model, drive.minimum, drive.maximum, distance)
    down = settling_seconds(model, drive.maximum, drive.minimum, distance)
    shown = {"distance": distance, "unit": unit, "seconds": max(up, down)}
    hint = below_error(model, distance)
    if hint:
        shown["hint"] = hint.strip(" ()")
    return {"settling": shown}


def _fades(sections: Sequence[Section]) -> list[tuple[float, float]]:
    """Return what part of a step each section rings or lags by, and the time constant with which that fades.

    A resonance is excited through the other sections: their gain at its frequency is
    its part.
    """
    fades = []
    for section in sections:
        if isinstance(section, Lag):
            fades.append((1.0, section.seconds))
            continue
        at = np.array([section.frequency])
        gain = 1.0
        for section_beside in sections:
            if section_beside is not section:
                gain *= abs(complex(section_beside.response(at)[0]))
        fade = 0.5 / (math.pi * section.frequency * section.damping)
        fades.append((gain, fade))
    return fades
