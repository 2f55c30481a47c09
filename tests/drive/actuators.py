"""Models of invented actuators, for the tests of drives."""

import math

import numpy as np
from hypothesis import strategies as st

import dbo_cli.model as dm
from dbo_cli.drive import Driver, Lead, Limits
from dbo_cli.drive.simulate import stacked


def actuator(
    gears=200,
    low=0.0,
    high=100.0,
    stroke=10.0,
    growth=3.0,
    tau=(),
    gain=(),
    bend=(),
    curve=(),
    scale=1.0,
    sections=(),
    delay=0.0,
    amplifier=0.0,
):
    """Return a forward model; ``bend`` and ``curve`` are slopes of points before and behind the gears."""
    dx = np.full(gears, (high - low) / gears)
    slopes = np.linspace(1.0, growth, gears)
    dy = slopes * dx * stroke / float((slopes * dx).sum())
    stages = []
    if amplifier:
        stages.append(dm.Amplifier(amplifier))
    if bend:
        stages.append(_points(bend, low, high))
    relaxation = dm.Relaxation(low, tau, gain) if tau else None
    stages.append(dm.Gears(dx, dy, low, 0.0, relaxation))
    if curve:
        stages.append(_points(curve, 0.0, stroke))
    if scale != 1.0:
        stages.append(dm.Scale(scale, 1.0))
    if sections:
        stages.append(dm.Dynamics(sections))
    if delay:
        stages.append(dm.Delay(delay))
    voltage = dm.Quantity("voltage", "V", low, high)
    guess = dm.Quantity("displacement", "um", -1e3, 1e3)
    model = dm.Cascade("forward", voltage, guess, tuple(stages))
    ends = reach(model, low, high)
    reached = dm.Quantity("displacement", "um", min(ends), max(ends))
    return dm.Cascade("forward", voltage, reached, tuple(stages))


def limits_of(model, *typed, **named):
    """Return limits as they are typed."""
    return Limits.within(model.input, *typed, **named)


def _points(slopes, low, high):
    """Return a curve from ``low`` to ``high`` whose ends are where they were."""
    dx = np.full(len(slopes), (high - low) / len(slopes))
    dy = np.array(slopes) * dx
    return dm.Points(dx, dy * (high - low) / dy.sum(), low, low)


def reach(model, low, high):
    """Return the displacement at rest at two voltages."""
    static = model.static
    bottom = static.run(np.array([low]), static.start(low, "empty"), 1.0).y[0]
    top = static.run(np.array([high]), static.start(high, "full"), 1.0).y[0]
    return float(bottom), float(top)


def ripple(model, rows, part=0.8, cycles=3.0, phase=0.0):
    """Return a sine over a part of what a model reaches."""
    middle = 0.5 * (model.output.min + model.output.max)
    t = np.arange(rows) / rows
    swing = 0.5 * part * model.output.span
    return middle + swing * np.sin(2.0 * math.pi * (cycles * t + phase))


def gentle(model, rows, part=0.3):
    """Return a hump that begins and ends at rest."""
    t = np.clip((np.arange(rows) / rows - 0.2) / 0.6, 0.0, 1.0)
    base = model.output.min + 0.4 * model.output.span
    return base + part * model.output.span * np.sin(math.pi * t) ** 4


def blocks_of(values, dt, rows):
    """Return a trajectory in blocks of so many rows, as ``driven_in_blocks`` takes it."""
    time = dt * np.arange(values.size)
    places = range(0, values.size, rows)
    return [(time[k : k + rows], dt, values[k : k + rows]) for k in places]


MEMORIES = st.sampled_from(
    [
        ((), ()),
        ((0.05,), (0.004,)),
        ((0.01, 0.3, 5.0), (0.003, 0.002, 0.004)),
        ((0.2,), (-0.004,)),
    ]
)
SECTIONS = st.sampled_from(
    [
        (),
        (dm.Lag(4e-4),),
        (dm.Resonance(60.0, 0.02),),
        (dm.Lag(1e-3), dm.Resonance(120.0, 0.05)),
    ]
)


@st.composite
def actuators(draw, static=False):
    """Draw a model of any kind."""
    tau, gain = draw(MEMORIES)
    low = draw(st.sampled_from([0.0, -20.0, 0.236]))
    span = draw(st.sampled_from([3.5, 100.0, 150.0]))
    stroke = draw(st.sampled_from([0.5, 10.0]))
    gain = tuple(value * stroke / span * 10.0 for value in gain)
    return actuator(
        gears=draw(st.sampled_from([1, 2, 7, 64])),
        low=low,
        high=low + span,
        stroke=stroke,
        growth=draw(st.sampled_from([1.0, 1.5, 4.0])),
        tau=tau,
        gain=gain,
        bend=draw(st.sampled_from([(), (1.0, 1.3)])),
        curve=draw(st.sampled_from([(), (1.0, 0.7, 1.2)])),
        scale=draw(st.sampled_from([1.0, -3.0])),
        sections=() if static else draw(SECTIONS),
        delay=0.0 if static else draw(st.sampled_from([0.0, 0.002, 0.00137])),
        amplifier=0.0 if static else draw(st.sampled_from([0.0, 7e-4])),
    )


def plan(model, desired, clock, limits, *, on_limit="auto", return_to=None, **options):
    """Return the drive of a whole trajectory; ``clock`` is a step, the time of each row, or None."""
    names = ("state", "start", "approach", "condition")
    around = {name: options.pop(name) for name in names if name in options}
    lead = Lead(model, limits, rest=options.pop("lead", None), **around)
    driver = Driver(lead, on_limit=on_limit, return_to=return_to)
    dt, time = clock, None
    if np.ndim(clock):
        time = np.asarray(clock, dtype=np.float64)
        dt = dm.steps_of(time)
    return driver.whole(np.asarray(desired, dtype=np.float64), dt, time, **options)


def driven_in_blocks(driver, blocks):
    """Return the drive of a trajectory that comes in blocks, with its rows."""
    parts = [driver.rows(desired, dt, time) for time, dt, desired in blocks]
    rest, drive = driver.finish()
    return drive.with_rows(stacked([*parts, rest]))
