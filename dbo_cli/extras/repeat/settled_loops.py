"""A loop after infinitely many passes: the drive that settles, and what a drive settles to.

Gears repeat after a pass. Relaxation would take as many passes as its longest time
constant lasts; its memory is linear in the drive, so that the memory that a periodic
drive leaves unchanged is computed at once. The drive depends on both: gears and memory
are those to which the last drive leads from the start, the next drive is the inverse's
in that state, until it stays. So the forward model does the same from that very start.
"""

from __future__ import annotations

import bisect
import dataclasses
import math
from typing import NamedTuple

import numpy as np

from dbo_cli.hysteresis.cascade import early_loop, late_loop, through, whole_and_part
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.hysteresis.model_state import DriveLimits, ModelState, Simulated
from dbo_cli.hysteresis.operators import BacklashState, Floats

MOST_PASSES = 200
"""Relaxation of half the gears' own slope settles within 60; limits that bind now and then take longer."""
# of the drive's range, by which a settled drive changes from pass to pass
SETTLED = 1e-12


FOR_EVER = 14.0  # of the longest time constant: what creeps is over to a millionth
EVER = 2**62  # passes: the longest range that Python searches
# a time that is found to 1 %, or an error of no more than 1 % above the least, will do
SPARE = 1.01
# of a frequency through a delay's interpolation, from which on it is undone
SMALLEST_GAIN = 0.1


class Settled(NamedTuple):
    """One period of a settled loop: the run of its last pass, the state before it, and whether it stays."""

    done: Simulated
    before: ModelState
    converged: bool


def read_ahead(model: ActuatorModel, x: Floats, step: float) -> Floats:
    """Return one period of what a forward model's output is to be, read ahead by its delay."""
    samples = model.delay_seconds / step
    if model.delay is None or model.delay.between == "smooth":
        return early_loop(x, samples)
    return _linear_shift(x, samples)


def undone_loop(model: ActuatorModel, desired: Floats, step: float) -> Floats:
    """Return what a forward model's dynamics and delay are to be given for one period of their output."""
    if model.delay is None or model.delay.between == "smooth":
        ahead = read_ahead(model, desired, step)
    else:
        ahead = _linear_undone(desired, model.delay_seconds / step)
    if model.dynamics is None:
        return ahead
    return model.dynamics.inverter(step).loop(ahead)


def _linear_shift(x: Floats, samples: float) -> Floats:
    """Return one period read ahead by so many samples (behind, where negative), linear between them."""
    whole, part = whole_and_part(samples)
    near = np.roll(x, -whole)
    return near + part * (np.roll(near, -1) - near) if part else near


def _linear_undone(x: Floats, samples: float) -> Floats:
    """Return one period of what a linear delay by so many samples makes ``x`` of.

    Between samples the delay takes the mean of two; frequencies that come through that
    are restored.
    """
    whole, part = whole_and_part(samples)
    ahead = np.roll(x, -whole)
    if not part:
        return ahead
    turn = np.exp(-2j * math.pi * np.fft.rfftfreq(x.size))
    gain = 1.0 - part + part * turn
    gain[np.abs(gain) < SMALLEST_GAIN] = 1.0
    return np.fft.irfft(np.fft.rfft(ahead) / gain, x.size)


def _late(model: ActuatorModel, y: Floats, step: float) -> Floats:
    """Return one period late by a forward model's delay."""
    samples = model.delay_seconds / step
    if model.delay is None or model.delay.between == "smooth":
        return late_loop(y, samples)
    return _linear_shift(y, -samples)


def settled_drive(
    model: ActuatorModel,
    undone: Floats,
    step: float,
    state: ModelState,
    limits: DriveLimits,
) -> Settled:
    """Return the drive of one period, its own state's end its beginning.

    Parameters
    ----------
    model
        The forward model.
    undone
        One period, dynamics and delay undone (``undone_loop``).
    step
        The even time step (s).
    state
        Before the first pass ever: gears that the loop does not reach keep it.
    limits
        Of the drive.
    """
    inverse = model.inverse()
    before, done = state, inverse.simulate(undone, state, time_step=step, limits=limits)
    for _ in range(MOST_PASSES):
        before = looped_state(model, done.y, step, state)
        again = inverse.simulate(undone, before, time_step=step, limits=limits)
        # gears that change at the seam ask a lag for a spike: not the loop's
        if model.drive_lag is not None:
            again = inverse.simulate(undone, again.state, time_step=step, limits=limits)
        away = float(np.abs(again.y - done.y).max())
        done = again
        if away <= SETTLED * model.input.span:
            return Settled(done, before, True)
    return Settled(done, before, False)


def looped_state(
    model: ActuatorModel, drive: Floats, step: float, state: ModelState
) -> ModelState:
    """Return the state before a pass, of gears, memory and drive lag, when a drive was repeated for ever."""
    inner, seconds = model.without_dynamics_and_delay, drive.size * step
    begun = dataclasses.replace(state, dynamics=None, undoing=None, history=None)
    # a pass for what reaches further at first, one for the loop
    for lagging in (None, model.drive_lag):
        if lagging is not None:
            begun = dataclasses.replace(begun, drive_lag=lagging.loop(drive, step)[1])
        done = inner.simulate(drive, begun, time_step=step)
        starts = begun.backlash.memory
        begun = done.state
        ends = begun.backlash.memory
        terms = inner.backlash.relaxation
        if ends is not None and terms is not None and starts is not None:
            memory = tuple(  # that further passes of the same drive would lead to
                (end - math.exp(-seconds / tau) * start) / -math.expm1(-seconds / tau)
                for start, end, tau in zip(starts, ends, terms.tau, strict=True)
            )
            begun = dataclasses.replace(
                begun, backlash=BacklashState(begun.backlash.bits, memory)
            )
    return begun


def slow_output(
    model: ActuatorModel, drive: Floats, step: float, before: ModelState
) -> Floats:
    """Return what gears, points and creep make of one period, without dynamics and delay behind them."""
    inner = model.without_dynamics_and_delay
    return inner.simulate(drive, before, time_step=step).y


def settled_run(
    model: ActuatorModel, drive: Floats, step: float, state: ModelState
) -> Simulated:
    """Return the settled period of a repeated drive, and the state at its end."""
    inner, lagging = model.without_lag, None
    begun = dataclasses.replace(looped_state(model, drive, step, state), drive_lag=None)
    if model.drive_lag is not None:
        drive, lagging = model.drive_lag.loop(drive, step)
    done = inner.simulate(drive, begun, time_step=step)
    y, sections = done.y, None
    if model.dynamics is not None:
        y, sections = model.dynamics.loop(y, step)
    after = dataclasses.replace(done.state, dynamics=sections, drive_lag=lagging)
    return done._replace(y=_late(model, y, step), state=after)


def settling(
    model: ActuatorModel,
    drive: Floats,
    step: float,
    begun: ModelState,
    before: ModelState,
    within: float,
) -> tuple[float, int]:
    """Return how far off the mean of a loop's first pass is, and after how many passes it stays within.

    Gears repeat after the first pass. What creep is off decays with its own time
    constants: each term's part of the mean is found by a pass with that term alone off,
    and their sizes are added up.

    Parameters
    ----------
    begun, before
        The state before the first pass, and before every pass of the settled loop.
    within
        How far the mean may be off, in the unit of the output.
    """
    mean = float(slow_output(model, drive, step, before).mean())
    first = (
        float(
            slow_output(
                model, drive, step, dataclasses.replace(begun, dynamics=None)
            ).mean()
        )
        - mean
    )
    terms, memory = model.backlash.relaxation, before.backlash.memory
    rest = begun.backlash.memory
    # at rest at the sample to come: what it has after that
    if rest is None and model.needs_time:
        still = dataclasses.replace(begun, dynamics=None, undoing=None, history=None)
        after = model.without_dynamics_and_delay.simulate(
            drive[:1], still, time_step=step
        ).state
        rest = after.backlash.memory
    if terms is None or memory is None or rest is None:
        return first, int(abs(first) > within)
    effects = memory_effects(model, drive, step, before)
    parts = [
        abs(effect * (at_rest - settled))
        for effect, at_rest, settled in zip(effects, rest, memory, strict=True)
    ]
    seconds, fewest = drive.size * step, int(abs(first) > within)

    def stays(passes: int) -> bool:
        left = zip(parts, terms.tau, strict=True)
        return (
            not sum(part * math.exp(-passes * seconds / tau) for part, tau in left)
            > within
        )

    return first, fewest + bisect.bisect_left(range(fewest, EVER), True, key=stays)


def memory_effects(
    model: ActuatorModel, drive: Floats, step: float, before: ModelState
) -> list[float]:
    """Return by how much the mean of a pass changes with each memory before it, per volt."""
    mean, off, effects = (
        float(slow_output(model, drive, step, before).mean()),
        0.01 * model.drive.span,
        [],
    )
    memory = before.backlash.memory or ()
    for k in range(len(memory)):
        moved = tuple(value + off * (i == k) for i, value in enumerate(memory))
        changed = dataclasses.replace(
            before, backlash=BacklashState(before.backlash.bits, moved)
        )
        effects.append(
            (float(slow_output(model, drive, step, changed).mean()) - mean) / off
        )
    return effects


def creep_rest(
    model: ActuatorModel,
    settled: Settled,
    step: float,
    begun: tuple[float, ...] | None,
    rise: Floats,
    within: float,
    between: tuple[float, float],
    bias: float,
) -> tuple[float, float]:
    """Return a voltage inside a loop's drive, and the seconds to rest there, that make creep what it needs.

    A rest at V takes each memory m to V + (m - V) exp(-T/tau), and the run-in behind it
    changes that. For every T, V is the one at which the mean of the first pass is right
    (where it begins unknown, that of a long rest); T is the shortest at which the sizes
    of all terms' parts add up to at most half ``within``.

    Parameters
    ----------
    begun
        The memories where the rest begins; not known: those of the range's end that is
        further away.
    rise
        How much of the run-in's rows is the loop: 0 at the rest, 1 in the end.
    within
        How far the mean of the first pass may be off.
    between
        The least and the greatest seconds.
    bias
        How far off the mean was where this was tried, beyond what is planned here.
    """
    terms = model.backlash.relaxation
    memory = settled.before.backlash.memory
    drive = settled.done.y
    if terms is None or memory is None:
        return float(drive.min() + drive.max()) / 2.0, between[0]
    effects = np.array(memory_effects(model, drive, step, settled.before))
    tau = np.array(terms.tau)
    inner = through(model.head, drive) - terms.reference
    ends_of_range = np.array([model.input.minimum, model.input.maximum])
    ends = through(model.head, ends_of_range) - terms.reference
    far: Floats = np.where(np.array(memory) > ends.mean(), ends[0], ends[1])
    begins = far if begun is None else np.array(begun)
    bare = dataclasses.replace(terms, reference=0.0)
    none = [0.0] * tau.size
    through_run_in = np.exp(-rise.size * step / tau)
    of_level = np.array(bare.lags(1.0 - rise, step, none)[1])
    off = (
        np.array(bare.lags(rise * np.resize(inner, rise.size), step, none)[1]) - memory
    )

    def rest(wait: float) -> tuple[float, float]:
        """Return the best level of a rest, and what the terms are off then, sizes added up."""
        decay = np.exp(-wait / tau)
        slope = through_run_in * (1.0 - decay) + of_level
        constant = through_run_in * begins * decay + off
        known = through_run_in + of_level, off
        if begun is not None:
            known = slope, constant
        level = -(float(effects @ known[1]) + bias) / float(effects @ known[0])
        level = min(max(level, float(inner.min())), float(inner.max()))
        return level, float(np.abs(effects * (slope * level + constant)).sum())

    short = max(between[0], step)
    long = min(between[1], max(between[0], FOR_EVER * float(tau.max())))
    most = max(0.5 * within, SPARE * rest(long)[1])
    seconds = between[0]
    if rest(seconds)[1] > most:
        while long / short > SPARE:
            middle = math.sqrt(short * long)
            if rest(middle)[1] > most:
                short = middle
            else:
                long = middle
        seconds = long
    level = rest(seconds)[0] + terms.reference
    return float(through(model.head_inverse, np.array([level]))[0]), seconds
