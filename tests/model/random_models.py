"""Random models and signals, from a seed: what the tests of this room run."""

import numpy as np
from numpy.typing import NDArray

from dbo_cli.model import (
    Cascade,
    Delay,
    Gears,
    Points,
    Quantity,
    Relaxation,
    Scale,
    Stage,
)

Floats = NDArray[np.float64]
DT = 1e-3


def random_gears(rng: np.random.Generator, negative: bool | None = None) -> Gears:
    """Gears of one to some hundred, uneven or in runs; relaxation of both signs."""
    n = int(rng.integers(1, 300))
    dx = rng.uniform(0.2, 1.0, n)
    dy = rng.uniform(0.2, 1.0, n) * 10.0 ** rng.uniform(-3, 3)
    if rng.random() < 0.3:
        dx = np.full(n, 0.7)
        dy = np.repeat(dy, 5)[:n]
    x0, y0 = rng.normal() * dx.sum(), rng.normal() * dy.sum()
    if rng.random() < 0.5 and not negative:
        return Gears(dx, dy, x0, y0)
    terms = int(rng.integers(1, 6))
    mean = dy.sum() / dx.sum()
    gain = rng.uniform(0.0, 0.5, terms) * mean
    room = float((dy / dx).min()) - 0.03 * mean
    if room > 0.0 and (negative or rng.random() < 0.6):
        chosen = rng.random(terms) < 0.5
        chosen[0] = True
        share = rng.dirichlet(np.ones(chosen.sum())) * room * rng.uniform(0.1, 0.999)
        gain[chosen] = -share
    tau = 10.0 ** rng.uniform(-4, 2, terms)
    memories = Relaxation(x0 + rng.normal(), tuple(tau.tolist()), tuple(gain.tolist()))
    return Gears(dx, dy, x0, y0, memories)


def random_points(rng: np.random.Generator, low: float, high: float) -> Points:
    """A curve over a range, with a range of its own for its values."""
    m = int(rng.integers(1, 12))
    widths = rng.uniform(0.5, 1.0, m)
    heights = rng.uniform(0.5, 1.0, m)
    return Points(
        widths * ((high - low) / widths.sum()),
        heights * ((high - low) / heights.sum()),
        low,
        low,
    )


def random_model(
    rng: np.random.Generator, delays: bool = True, negative: bool | None = None
) -> Cascade:
    """A forward model of gears, points on either side, a scale, and a delay of whole samples."""
    gears = random_gears(rng, negative)
    low, high = gears.x_range
    stages: list[Stage] = []
    if rng.random() < 0.5:
        stages.append(random_points(rng, low, high))
    stages.append(gears)
    if rng.random() < 0.5:
        stages.append(random_points(rng, *gears.y_range))
    if rng.random() < 0.7:
        gain = float(rng.choice([-3.0, 0.01, 12.5]))
        stages.append(Scale(gain, rng.normal() * gain * gears.height))
    if delays and rng.random() < 0.5:
        stages.append(Delay(DT * int(rng.integers(0, 20))))
    drive = Quantity("voltage", "V", low, high)
    span = 100.0 * float(np.abs(gears.y_range).max()) + 10.0
    return Cascade(
        "forward", drive, Quantity("displacement", "um", -span, span), tuple(stages)
    )


def random_drive(
    rng: np.random.Generator, low: float, high: float, rows: int
) -> Floats:
    """A random walk, smooth or rough, over most of a range; some rows stand on gear edges or at rest."""
    walk = np.cumsum(rng.normal(size=rows + 30))
    if rng.random() < 0.5:
        walk = np.convolve(walk, np.ones(25) / 25, "same")
    walk = walk[15 : rows + 15]
    part = (walk - walk.min()) / np.ptp(walk)
    drive = low + (0.02 + 0.96 * part) * (high - low)
    drive[rows // 2 : rows // 2 + 20] = drive[rows // 2]
    return drive
