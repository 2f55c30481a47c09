"""Fast moves on simulated stages: what dynamics in the model are worth.

    python benchmarks/fast_moves.py [--sets NAME ...] [--seconds 60] [--amplifier-output]

For the parameter sets of ``sample_data/virtual_positioner.py``: a slow log of nested
turns and a small sweep are played, a model is identified from the two noisy recordings,
and sines and rounded triangles at f_r/1000 to f_r/5 are compensated and played. RMS
errors in % of the move, without the sensor's noise: of the model without dynamics, and
of the model as identified. Exit 1 where the second exceeds 0.05 % up to f_r/30, 0.08 %
at f_r/10 or 0.25 % at f_r/5. The stages' amplifiers lag before the gears: with
``--amplifier-output`` what is logged and driven is the amplifier's output.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
import time
import warnings
from pathlib import Path

import numpy as np
import plants
from numpy.typing import NDArray

from dbo_cli.drive.smooth import low_pass
from dbo_cli.identification import Options, Recording, identify
from dbo_cli.model import Cascade

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "sample_data"))
from virtual_positioner import PRESETS, PositionerParameters, VirtualPositioner

Floats = NDArray[np.float64]
BOUNDS = {1000: 0.05, 100: 0.05, 30: 0.05, 10: 0.08, 5: 0.25}
SLOW_RATE, FAST_RATE = 2_000.0, 20_000.0  # Hz
SHAPES = ("sine", "triangle")


def wave(shape: str, frequency: float) -> tuple[Floats, slice]:
    """Return a move between 0 and 1 that begins and ends at rest, and the rows that are judged."""
    rate = FAST_RATE
    cycles = 4 if frequency < 5.0 else 12
    rise, quiet = round(0.3 * rate), round(0.02 * rate)
    count = round(cycles / frequency * rate)
    phase = np.arange(count) * frequency / rate
    body = 0.5 + 0.3 * np.sin(2.0 * np.pi * phase)
    if shape == "triangle":
        corners = 0.5 + 0.6 / np.pi * np.arcsin(np.sin(2.0 * np.pi * phase))
        cutoff = max(5.0 * frequency, rate / 2_000.0)
        body = low_pass(corners, cutoff, 1.0 / rate)
    up = 0.25 - 0.25 * np.cos(np.pi * np.arange(rise) / rise)
    fade = np.clip(np.minimum(phase, phase[::-1]), 0.0, 1.0)
    fade = fade**3 * (10.0 - 15.0 * fade + 6.0 * fade**2)
    still = np.full(quiet, 0.5)
    move = 0.5 + fade * (body - 0.5)
    whole = np.concatenate([np.zeros(quiet), up, still, move, still])
    begin = 2 * quiet + rise
    edge = round(1.2 / frequency * rate)
    return whole, slice(begin + edge, begin + count - edge)


def sweep(low: float, high: float, highest: float) -> Floats:
    """Return a way to the middle, a sweep of 1 % of the range from highest/100 on, and the way back."""
    rate, seconds = FAST_RATE, max(2.0, 120.0 / highest)
    part = np.arange(round(seconds * rate)) / (seconds * rate)
    grown = np.log(100.0)
    periods = highest / 100.0 * seconds / grown * np.expm1(grown * part)
    edge = np.clip(np.minimum(part, 1.0 - part) / 0.05, 0.0, 1.0)
    size = 0.01 * 0.25**part * (0.5 - 0.5 * np.cos(np.pi * edge))
    way = 0.25 - 0.25 * np.cos(np.pi * np.arange(round(0.3 * rate)) / (0.3 * rate))
    rest = np.full(round(0.3 * rate), 0.5)
    moving = 0.5 + size * np.sin(2.0 * np.pi * periods)
    return low + (high - low) * np.concatenate([way, rest, moving, rest, way[::-1]])


def compensated(model: Cascade, wanted: Floats) -> Floats:
    """Return the drive of a move, from the lower end, within the identified range."""
    dt = 1.0 / FAST_RATE
    ahead = np.full(model.inverter(dt).ahead, wanted[-1])
    undone, _ = model.inverter(dt).run(np.concatenate([wanted, ahead]))
    low, high = model.input.min, model.input.max
    state = model.start_drive(undone[0], "empty", low, high)
    return np.asarray(model.drive(undone, state, dt, (low, high)).y)


def models_of(p: PositionerParameters, seconds: float) -> tuple[Cascade, Cascade]:
    """Return the model without dynamics and the model as identified."""
    stage = VirtualPositioner(p)
    turns = plants.nested(1, seconds)
    clock = np.arange(round(seconds * SLOW_RATE)) / SLOW_RATE
    slow = np.interp(clock, np.arange(turns.size) / plants.RATE, turns)
    slow = p.v_min + slow * (p.v_max - p.v_min)
    highest = min(1.25 * max(mode[0] for mode in p.modes), FAST_RATE / 10.0)
    fast = sweep(p.v_min, p.v_max, highest)
    logs = []
    for seed, (drive, rate) in enumerate([(slow, SLOW_RATE), (fast, FAST_RATE)]):
        time = np.arange(drive.size) / rate
        name = f"log{seed}.csv"
        logs.append(Recording(name, drive, stage.play(drive, rate, seed), time))
    return identify(logs[:1], Options(dynamics=0)), identify(logs)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sets", nargs="*", default=list(PRESETS))
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--amplifier-output", action="store_true")
    asked = parser.parse_args()
    warnings.simplefilter("ignore")
    bad = cells = 0
    for name in asked.sets:
        p = PRESETS[name]
        if asked.amplifier_output:
            p = dataclasses.replace(p, amplifier_lag=0.0)
        stage = VirtualPositioner(p)
        begun = time.perf_counter()
        models = models_of(p, asked.seconds)
        took = time.perf_counter() - begun
        print(
            f"{name}: modes {p.modes}, amplifier lag {p.amplifier_lag} s; {took:.0f} s"
        )
        print(f"  found {models[1].amplifier}")
        print(f"  found {models[1].dynamics and models[1].dynamics.sections}")
        low, high = models[0].output.min, models[0].output.max
        for shape in SHAPES:
            for part, bound in BOUNDS.items():
                unit, judged = wave(shape, p.modes[0][0] / part)
                wanted = low + (0.05 + 0.9 * unit) * (high - low)
                errors = []
                for model in models:
                    moved = stage.displacement(compensated(model, wanted), FAST_RATE)
                    away = (moved - wanted)[judged]
                    size = 100.0 / float(np.ptp(wanted[judged]))
                    errors.append(size * float(np.sqrt(np.mean(away**2))))
                cells += 1
                bad += errors[1] > bound
                mark = f"  above {bound}" if errors[1] > bound else ""
                print(f"  {shape:9} f_r/{part:<5}{errors[0]:9.3f}{errors[1]:9.3f}{mark}",
                      flush=True)  # fmt: skip
    print(f"{bad} of {cells} cells above their bound")
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
