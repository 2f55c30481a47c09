"""Settling times against long simulations.

    python benchmarks/settling.py [N] [--seed S]

N random actuators (two creep terms, perhaps a resonance and a lag), a step of random
size from a long rest, a random distance. The time that is said, and the one after which
a simulation of 25 of the longest time constants at 20 kHz stays within the distance.
Exits 1 where one is off by more than 10 % and two rows.
"""

from __future__ import annotations

import argparse
import sys

import numpy as np

from dbo_cli.extras.moves.settling import settling_seconds
from dbo_cli.hysteresis.cascade import slow_output_range
from dbo_cli.hysteresis.dynamics import DynamicsStage, Lag, Resonance
from dbo_cli.hysteresis.model import (
    ActuatorModel,
    BacklashStage,
    Quantity,
    Relaxation,
    ScaleStage,
    Stage,
)

RATE = 20_000.0
MOST_OFF = 0.1


def actuator(random: np.random.Generator) -> ActuatorModel:
    taus = tuple(sorted((10.0 ** random.uniform(-1.5, 1.0, 2)).tolist()))
    creep = Relaxation(0.0, taus, tuple(random.uniform(0.0005, 0.004, 2).tolist()))
    widths = np.full(60, 100.0 / 60.0)
    stages: list[Stage] = [
        BacklashStage(
            widths, 0.1 * widths * np.linspace(0.55, 1.45, 60), 0.0, 0.0, creep
        ),
        ScaleStage(1.2, 0.5),
    ]
    low, high = slow_output_range(stages, 0.0, 100.0)
    if random.random() < 2.0 / 3.0:
        ring = Resonance(
            random.uniform(100.0, 1500.0), 10.0 ** random.uniform(-2.2, -0.8)
        )
        late = (
            (Lag(10.0 ** random.uniform(-4.0, -2.5)),) if random.random() < 0.5 else ()
        )
        stages.append(DynamicsStage((*late, ring)))
    voltage, displacement = (
        Quantity("voltage", "V", 0.0, 100.0),
        Quantity("displacement", "um", low, high),
    )
    return ActuatorModel("forward", voltage, displacement, tuple(stages))


def simulated(plant: ActuatorModel, begin: float, end: float, distance: float) -> float:
    terms = plant.backlash.relaxation
    assert terms is not None
    longest = max(terms.tau)
    rest = plant.simulate(
        np.full(int(5000.0 * longest), begin), plant.start(begin), time_step=0.005
    ).state
    drive = np.full(int((25.0 * longest + 1.0) * RATE), end)
    y = plant.simulate(drive, rest, time_step=1.0 / RATE).y
    return (
        float(np.flatnonzero(np.abs(y - y[-1]) > distance).max(initial=-1) + 1) / RATE
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("count", type=int, nargs="?", default=100)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    away = []
    for k in range(options.count):
        random = np.random.default_rng([options.seed, k])
        plant = actuator(random)
        begin = random.uniform(0.0, 100.0)
        end = begin + random.uniform(10.0, 50.0) * (1.0 if begin < 50.0 else -1.0)
        distance = abs(end - begin) * 0.12 * 10.0 ** random.uniform(-3.5, -0.7)
        said, found = (
            settling_seconds(plant, begin, end, distance),
            simulated(plant, begin, end, distance),
        )
        off = max(abs(said - found) - 2.0 / RATE, 0.0) / max(found, 1.0 / RATE)
        away.append(off)
        if off > MOST_OFF:
            print(
                f"actuator {k}: {said:.5g} s said, {found:.5g} s simulated", flush=True
            )
    beyond = sum(one > MOST_OFF for one in away)
    print(
        f"{options.count} steps: off by {100.0 * float(np.median(away)):.2g} % in the median, "
        f"{100.0 * max(away):.2g} % at most, {beyond} beyond {100.0 * MOST_OFF:g} %"
    )
    return int(beyond > 0)


if __name__ == "__main__":
    sys.exit(main())
