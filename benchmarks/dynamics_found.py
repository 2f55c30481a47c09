"""Resonances found and not found, and moves learned, on seeded simulated actuators.

    python benchmarks/dynamics_found.py [--actuators N] [--first SEED] [--learn]

Actuators of 80 gears with a random resonance (15 to 130 Hz at 2 kHz, damping 0.003 to
0.4) and lag are driven by ``excite`` with a small sweep and identified; the same
without a resonance. Prints the errors of frequency and damping, and how many of the
intervals hold the truth as they are printed; exits 1 where a frequency is off by more
than 0.5 %, a damping by more than 20 %, or a resonance is found where there is none.
``--learn`` prints instead the error by pass of repeated moves, slow and fast, with
models whose loop is 20 % or whose resonance is 5 % wrong, or that know no resonance.
"""

from __future__ import annotations

import argparse
import re
import sys
from pathlib import Path

import numpy as np

from dbo_cli.hysteresis.dynamics import Lag, Resonance
from dbo_cli.hysteresis.excitation import Excitation
from dbo_cli.hysteresis.identification import IdentificationOptions, identify
from dbo_cli.runs.api import Model

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))
sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests" / "extras"))
import test_runs_repeated as repeated
from test_hysteresis_identification_dynamics import RATE, plant, recorded

PRINTED = re.compile(
    r"resonance at \S+ Hz \((\S+) to (\S+)\), damping \S+ \((\S+) to ([^\s)]+)\)"
)
FEW = IdentificationOptions(gears=24, points=0, relaxation=(), delay=0.0)


def found(seeds: range) -> int:
    drive = Excitation(0.0, 100.0, RATE, 6.0, 1.0, sweep_to=200.0).drive()[1]
    bad = wrong = 0
    held: dict[str, list[bool]] = {"frequency": [], "damping": []}
    for seed in seeds:
        rng = np.random.default_rng(seed)
        frequency = float(np.exp(rng.uniform(np.log(15.0), np.log(130.0))))
        damping = float(np.exp(rng.uniform(np.log(0.003), np.log(0.4))))
        lag = float(np.exp(rng.uniform(np.log(1e-4), np.log(3e-3))))
        model = plant(Lag(lag), Resonance(frequency, damping))
        whole = identify([recorded(model, drive, seed)], FEW)
        resonances = whole.model.dynamics.resonances if whole.model.dynamics else ()
        if resonances:
            printed = PRINTED.search(" ".join(whole.summary))
            assert printed is not None, whole.summary
            low, high, thin, wide = (float(text) for text in printed.groups())
            held["frequency"].append(low <= frequency <= high)
            held["damping"].append(thin <= damping <= wide)
        off = [
            100.0 * (resonances[0].frequency / frequency - 1.0)
            if resonances
            else np.nan
        ]
        off.append(
            100.0 * (resonances[0].damping / damping - 1.0) if resonances else np.nan
        )
        fine = len(resonances) == 1 and abs(off[0]) <= 0.5 and abs(off[1]) <= 20.0
        bad += not fine
        none = identify([recorded(plant(Lag(lag)), drive, seed)], FEW).model.dynamics
        wrong += none is not None
        told = f"found {len(resonances)}, off {off[0]:+.3f} % and {off[1]:+.1f} %{'' if fine else '  BAD'}"
        other = f"without a resonance {'FOUND' if none else 'none'}"
        print(
            f"{seed:3} {frequency:7.2f} Hz, damping {damping:.4f}: {told}; {other}",
            flush=True,
        )
    print(
        f"{bad} of {len(seeds)} missed the bounds; a resonance where there is none: {wrong}"
    )
    shares = ", ".join(
        f"{name} {sum(some)} of {len(some)}" for name, some in held.items()
    )
    print(f"intervals that hold the truth, as printed: {shares}")
    return int(bad + wrong > 0)


def learned() -> int:
    worse = 0
    plants = [repeated.actuator(0.30 + 0.05 * k, 650.0 + 60.0 * k) for k in range(5)]
    for k, stage in enumerate(plants):
        loop, frequency = 0.30 + 0.05 * k, 650.0 + 60.0 * k
        for name, model in (
            ("loop 20 % wrong", repeated.actuator(0.8 * loop, frequency)),
            ("resonance 5 % wrong", repeated.actuator(loop, 0.95 * frequency)),
            ("no resonance", repeated.actuator(loop, None)),
        ):
            for fast in (100.0, 10.0):
                wanted, tracked, errors = repeated.move(frequency / fast), (), []
                for number in range(5):
                    done = Model(model).compensate(
                        wanted, tracked=tracked, **repeated.WIDE
                    )
                    y, measured = repeated.played(stage, done.values, seed=number)
                    errors.append(
                        100.0 * repeated.rms(y - wanted) / float(np.ptp(wanted))
                    )
                    tracked = (done.values, measured)
                worse += errors[4] > errors[0] and errors[4] > 0.025
                passes = " ".join(f"{error:8.4f}" for error in errors)
                print(
                    f"stage {k}, {name:20} f_r/{fast:<4.0f}{passes}  % of the move; sensor 0.025",
                    flush=True,
                )
    print(
        f"cases in which the fifth pass is worse than the first and than the sensor: {worse}"
    )
    return int(worse > 0)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--actuators", type=int, default=50)
    parser.add_argument(
        "--first", type=int, default=0, help="seed of the first actuator"
    )
    parser.add_argument("--learn", action="store_true")
    options = parser.parse_args()
    seeds = range(options.first, options.first + options.actuators)
    return learned() if options.learn else found(seeds)


if __name__ == "__main__":
    sys.exit(main())
