"""Random operators and trajectories for the tests and the benchmarks; everything follows from the seed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dbo_cli.hysteresis.operators import DiscreteBacklashOperator, Relaxation
from dbo_cli.logs.sample_block import Places, SampleBlock

Floats = NDArray[np.float64]


def random_operator(
    rng: np.random.Generator, n: int, relaxation: bool = False, run: int = 1
) -> DiscreteBacklashOperator:
    """Return an operator of n gears, of one of several kinds of widths and slopes, ``run`` equal in a row."""
    kind = int(rng.integers(4))
    dx = np.full(n, rng.uniform(0.1, 2.0)) if kind == 0 else rng.uniform(0.1, 1.0, n)
    if kind == 3:
        dx = np.exp(rng.normal(0.0, 1.0, n))
    slopes = rng.uniform(0.2, 2.0, n)
    if kind < 2:
        slopes.sort()
    # as identification makes them: even gears, one slope for each run of neighbours
    if run > 1:
        dx, slopes = np.full(n, dx[0]), slopes[np.arange(n) // run]
    scale = 10.0 ** rng.uniform(-3.0, 3.0)
    terms = None
    if relaxation:
        count = int(rng.integers(1, 5))
        tau = tuple((10.0 ** rng.uniform(-3.0, 2.0, count)).tolist())
        terms = Relaxation(
            float(rng.normal()),
            tau,
            tuple((scale * rng.uniform(0.0, 0.3, count)).tolist()),
        )
    return DiscreteBacklashOperator(
        dx, scale * dx * slopes, float(rng.normal()), float(rng.normal() * scale), terms
    )


def random_trajectory(
    rng: np.random.Generator, operator: DiscreteBacklashOperator, count: int
) -> Floats:
    """Return inputs that turn inside gears, on breakpoints exactly and within an ulp, and at full scale."""
    low, high = (
        operator.x_range
        if operator.memory_on == "input"
        else operator.inverse().y_range
    )
    x = rng.uniform(low, high, count)
    breakpoints = low + np.concatenate([[0.0], np.cumsum(operator.gears[:, 0])])
    kinds = rng.integers(0, 8, count)
    x = np.where(kinds == 0, low, np.where(kinds == 1, high, x))
    x = np.where(kinds == 2, rng.choice(breakpoints, count), x)
    x = np.where(
        kinds == 3,
        np.nextafter(rng.choice(breakpoints, count), rng.choice([low, high], count)),
        x,
    )
    # A turn on a breakpoint of the way back: the state's own gears, counted down from
    # the full scale.
    x = np.where(kinds == 4, high - (rng.choice(breakpoints, count) - low), x)
    near = np.clip(
        np.roll(x, 1) + rng.normal(0.0, 0.02 * (high - low), count), low, high
    )
    return np.where(kinds == 5, near, x)


def pairs(
    rows: Places,
    desired: Floats,
    measured: Floats,
    time: Floats | None = None,
    voltage: Floats | None = None,
) -> SampleBlock:
    """Return a block as a report takes it."""
    values = {"desired": desired, "measured": measured}
    return SampleBlock(
        rows, None, time, values if voltage is None else values | {"voltage": voltage}
    )
