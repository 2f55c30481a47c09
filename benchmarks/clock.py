"""What the one clock leaves: delays between samples, plants with a delay of their own, a fast log.

    python benchmarks/clock.py [table] [plants] [day]

``table``: a sine with 5 to 100 samples a period through models with a delay of so many
samples and a half: what simulate(compensate(x)) leaves of x, and what a plant leaves
whose delay is analytic (RMS, % of peak to peak), by linear delays (model files of
version 2) and by smooth ones. ``plants``: models identified from logs of plants with a
delay of 1 and 3 ms at 500 Hz: error on a new move beside the one stated. ``day``: a log
at 5 kHz, 2.4 ms of delay, a trajectory at 500 Hz.
"""

from __future__ import annotations

import re
import sys
import warnings

import numpy as np

import dbo_cli as dbo
from dbo_cli.hysteresis.cascade import DelayStage
from dbo_cli.hysteresis.model import ActuatorModel, BacklashStage, Quantity, ScaleStage

VOLTAGE = Quantity("voltage", "V", 0.0, 100.0)


def made(seed: int, *behind: DelayStage) -> ActuatorModel:
    """Return a random actuator of 100 V and some 10 um."""
    rng = np.random.default_rng(seed)
    gears = int(rng.integers(20, 200))
    slopes = np.sort(rng.uniform(0.5, 1.5, gears))
    dx = np.full(gears, 100.0 / gears)
    dy = 0.1 * slopes / slopes.mean() * dx
    stages = (
        BacklashStage(dx, dy),
        ScaleStage(1.0, float(rng.uniform(-3.0, 3.0))),
        *behind,
    )
    low = stages[1].offset
    return ActuatorModel(
        "forward", VOLTAGE, Quantity("displacement", "um", low, low + 10.0), stages
    )


def percent(left: np.ndarray, wanted: np.ndarray) -> float:
    """Return an error, RMS, in percent of peak to peak."""
    return 100.0 * float(np.sqrt(np.mean(left**2))) / float(np.ptp(wanted))


def sine(periods: np.ndarray, middle: float) -> np.ndarray:
    """Return a move of 6 um around a middle."""
    return middle - 3.0 * np.cos(2.0 * np.pi * periods)


def table() -> None:
    """Print what a delay between samples leaves."""
    print(
        "| samples a period | delay | there and back: linear | smooth | analytic plant: linear | smooth |"
    )
    print("|---|---|---|---|---|---|")
    for whole in (0, 1, 3):
        for period in (5, 10, 20, 50, 100):
            found: list[list[float]] = [[], [], [], []]
            for seed in range(5):
                rows, rate = 30 * period, 1000.0
                delay = (whole + 0.5) / rate
                time = np.arange(rows) / rate
                middle = made(seed).output.minimum + 5.0
                late = np.random.default_rng(seed).uniform(0.0, 1.0)

                wanted = sine(time * rate / period + late, middle)
                for kind, between in enumerate(("linear", "smooth")):
                    model = dbo.Model(made(seed, DelayStage(delay, between)))
                    drive = model.compensate(wanted, sample_rate=rate, on_limit="clip")
                    back = model.simulate(drive, sample_rate=rate)
                    # The gears reach now what is asked for a delay later; there the
                    # plant shows it.
                    bare = dbo.Model(made(seed)).simulate(drive)
                    used = slice(3 * period, -period)
                    found[kind].append(percent((back - wanted)[used], wanted))
                    later = sine((time + delay) * rate / period + late, middle)
                    found[2 + kind].append(percent((bare - later)[used], wanted))
            cells = " | ".join(f"{max(one):.2g}" for one in found)
            print(f"| {period} | {whole + 0.5} samples | {cells} |")


def excitation(time: np.ndarray, frequency: float) -> np.ndarray:
    """Return a drive of falling amplitude that shows loops within loops."""
    swing = 0.25 + 0.75 * np.abs(np.cos(np.pi * time / time[-1]))
    return 50.0 - 50.0 * swing * np.cos(2.0 * np.pi * frequency * time)


def stated(done: dbo.Result) -> float:
    """Return the error that a compensation says to expect (um)."""
    for note in done.notes:
        match = re.search(r"expected error of the move ([\d.e-]+)", note)
        if match is not None:
            return float(match[1])
    return float("nan")


def plants() -> None:
    """Print errors of models of plants with a delay beside those stated."""
    print("| plant | error, um | stated, um |")
    print("|---|---|---|")
    fine, rate = 10_000.0, 500.0
    every = round(fine / rate)
    for milliseconds in (1.0, 2.0, 3.0, 4.0):
        for seed in (0, 1):
            rng = np.random.default_rng(seed)
            plant = dbo.Model(made(seed, DelayStage(1e-3 * milliseconds)))
            time = np.arange(int(20 * fine)) / fine
            drive = excitation(time, 2.0)
            moved = plant.simulate(drive, sample_rate=fine) + 0.003 * rng.normal(
                size=drive.size
            )
            part = slice(None, None, every)
            model = dbo.identify(drive[part], moved[part], time=time[part])
            clock = np.arange(2000) / rate
            low, span = (
                plant.output.minimum,
                plant.output.maximum - plant.output.minimum,
            )
            swing = (
                0.35 * np.cos(2.0 * np.pi * 5.0 * clock) * np.cos(np.pi * clock / 8.0)
            )
            wanted = low + span * (0.5 - swing)
            done = model.compensate(wanted, sample_rate=rate, details=True)
            at = np.arange(clock.size * every) / fine
            played, _ = played_between(clock, done.values, at)
            reached = plant.simulate(played, sample_rate=fine)[part][100:]
            error = float(np.sqrt(np.mean((reached - wanted[100:]) ** 2)))
            print(f"| {milliseconds:g} ms, {seed} | {error:.4f} | {stated(done):.4f} |")


def day() -> None:
    """Print what a log at 5 kHz, a delay of 2.4 ms and a trajectory at 500 Hz leave."""
    rate, fine = 500.0, 10_000.0
    plant = dbo.Model(made(3, DelayStage(0.0024)))
    time = np.arange(int(10 * fine)) / fine
    drive = excitation(time, 3.0)
    moved = plant.simulate(drive, sample_rate=fine)
    noise = 0.003 * np.random.default_rng(3).normal(size=moved.size)
    model = dbo.identify(drive[::2], (moved + noise)[::2], time=time[::2])
    clock = np.arange(1000) / rate
    wanted = plant.output.minimum + 10.0 * (
        0.5 - 0.4 * np.cos(2.0 * np.pi * 10.0 * clock)
    )
    done = model.compensate(wanted, sample_rate=rate, details=True)
    played, _ = played_between(clock, done.values, np.arange(clock.size * 20) / fine)
    reached = plant.simulate(played, sample_rate=fine)[::20]
    error = float(np.sqrt(np.mean((reached - wanted)[100:-50] ** 2)))
    back = model.simulate(done.values, sample_rate=rate)
    there = float(np.sqrt(np.mean((back - wanted)[100:] ** 2)))
    print(
        f"simulate(compensate(x)) leaves {there:.5f} um, the plant {error:.4f} um, "
        f"stated {stated(done):.4f} um"
    )


def played_between(
    times: np.ndarray, values: np.ndarray, wanted: np.ndarray
) -> tuple[np.ndarray, int]:
    """Return what an amplifier makes of rows: straight lines between them."""
    return np.interp(wanted, times, values), 0


if __name__ == "__main__":
    warnings.simplefilter("ignore")  # starts within the loop
    chosen = sys.argv[1:] or ["table", "plants", "day"]
    for name in chosen:
        {"table": table, "plants": plants, "day": day}[name]()
        print()
