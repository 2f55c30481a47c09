"""Six kinds of plants that no rule and no constant of the package was chosen on.

``foreign_plants.py --held-out`` judges by them what the package says of itself. Look at
their figures to judge a change, never to find one: for that there are the kinds in
``foreign_plants.KINDS``.

A plant takes a drive of 0 to 1 and the seconds since switching on, and returns a
displacement of about 0 to 1; its drives have ``RATE`` rows a second.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from invented_actuators import RATE, Plays, first_order
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Plant = Callable[[Floats, float], Floats]
STEP = 1.0 / RATE

FINEST = 0.002  # of the drive's range: longer steps are taken in parts


def room_warms(share: float, tau: float) -> Plant:
    """Return a piezo whose zero moves by ``share`` of the stroke as the room warms up, with ``tau`` s."""

    def run(u: Floats, since: float) -> Floats:
        clock = since + STEP * np.arange(len(u))
        return Plays(0.4, 0.15).run(u) + share * (1.0 - np.exp(-clock / tau))

    return run


def jiles_atherton(
    shape: float, pinning: float, coupling: float, reversible: float
) -> Plant:
    """Return a rod whose magnetisation follows Jiles and Atherton, on the rising part of its curve.

    ``shape`` is that of the anhysteretic curve, ``pinning`` makes the loop's width,
    ``coupling`` is that of the domains and ``reversible`` the share that bends back;
    fields in units of the drive's range.
    """

    def anhysteretic(field: float) -> tuple[float, float]:
        x = field / shape
        if abs(x) < 1e-3:
            return x / 3.0, 1.0 / (3.0 * shape)
        value = 1.0 / np.tanh(x) - 1.0 / x
        slope = (1.0 - 1.0 / np.tanh(x) ** 2 + 1.0 / x**2) / shape
        return float(value), float(slope)

    def run(u: Floats, _: float) -> Floats:
        magnetisation, field = 0.0, 0.0
        out = np.empty(len(u))
        for k, value in enumerate(u.tolist()):
            parts = max(1, int(abs(value - field) / FINEST))
            step = (value - field) / parts
            direction = 1.0 if step >= 0.0 else -1.0
            for _ in range(parts):
                field += step
                aim, slope = anhysteretic(field + coupling * magnetisation)
                missing = aim - magnetisation
                moved = (
                    missing / (direction * pinning - coupling * missing)
                    if missing * step > 0.0
                    else 0.0
                )
                magnetisation += step * (
                    (1.0 - reversible) * moved + reversible * slope
                )
            out[k] = magnetisation
        return out / anhysteretic(1.0)[0]

    return run


def dahl(force: float, reach: float, power: float) -> Plant:
    """Return a stage on a spring with Dahl's friction: its force nears ``force`` within ``reach``."""

    def run(u: Floats, _: float) -> Floats:
        friction, last = 0.0, float(u[0])
        out = np.empty(len(u))
        for k, value in enumerate(u.tolist()):
            parts = max(1, int(abs(value - last) / FINEST))
            step = (value - last) / parts
            direction = 1.0 if step >= 0.0 else -1.0
            for _ in range(parts):
                room = max(1.0 - direction * friction / force, 0.0)
                friction += step * force / reach * room**power
            last = value
            out[k] = value - friction
        return out

    return run


def stiffening(creep: float, growth: float, cube: float) -> Plant:
    """Return a polymer: creep that grows as a power of time, behind a spring that stiffens."""

    def run(u: Floats, _: float) -> Floats:
        x = Plays(0.3, 0.2).run(u)
        taus = 0.02 * 10.0 ** (np.arange(9) / 2.0)
        late = sum(tau**growth * (first_order(x, STEP, float(tau)) - x) for tau in taus)
        strain = x + creep * late
        return (1.0 + cube) * strain - cube * strain**3

    return run


def scaled_branches(width: float, steepness: float) -> Plant:
    """Return branches that aim from every turn at the ends of the outer loop, which two S curves are."""

    def sigmoid(u: float, middle: float) -> float:
        low, high, at = (np.tanh(steepness * (x - middle)) for x in (0.0, 1.0, u))
        return float((at - low) / (high - low))

    def branch(u: float, direction: float) -> float:
        return 0.6 * u + 0.4 * sigmoid(u, 0.5 + direction * width / 2.0)

    def run(u: Floats, _: float) -> Floats:
        at, turned_at, direction, last = 0.0, (0.0, 0.0), 1.0, float(u[0])
        out = np.empty(len(u))
        for k, value in enumerate(u.tolist()):
            if (value - last) * direction < 0.0:
                direction, turned_at = -direction, (last, at)
            begin, height = turned_at
            end = 1.0 if direction > 0.0 else 0.0
            way = branch(end, direction) - branch(begin, direction)
            if abs(way) > 1e-9:
                gone = (branch(value, direction) - branch(begin, direction)) / way
                at = height + (end - height) * gone
            last = value
            out[k] = at
        return out

    return run


def slow_domains(straight: float, rate: float, seed: int) -> Plant:
    """Return domains that switch the faster the further the drive is beyond their thresholds."""
    rng = np.random.default_rng(seed)
    middle = 0.5 + 0.45 * rng.uniform(-1.0, 1.0, 300)
    half = 0.5 * rng.exponential(0.12, 300)
    up, down = np.minimum(middle + half, 0.97), np.maximum(middle - half, 0.03)

    def run(u: Floats, _: float) -> Floats:
        state = np.zeros(len(up))
        out = np.empty(len(u))
        for k, value in enumerate(u.tolist()):
            over, under = np.maximum(value - up, 0.0), np.maximum(down - value, 0.0)
            speed = rate * np.minimum((over + under) / 0.02, 1.0)
            state += (1.0 - np.exp(-speed * STEP)) * ((over > 0.0) - state)
            out[k] = state.mean()
        return straight * u + (1.0 - straight) * out

    return run


PLANTS: dict[str, Plant] = {
    "room warms": room_warms(0.02, 40.0),
    "jiles-atherton": jiles_atherton(0.35, 0.08, 0.02, 0.2),
    "dahl": dahl(0.1, 0.14, 1.5),
    "polymer": stiffening(0.004, 0.15, 0.15),
    "scaled branches": scaled_branches(0.15, 4.0),
    "slow domains": slow_domains(0.6, 150.0, 7),
}
