"""Repeated moves: the error by pass, for actuators whose resonance is not where the model has it.

    python benchmarks/learning.py [--passes N] [--seeds N] [--quick] [--gears N]

The actuator's resonance is 5, 12 and 25 % lower and higher than the model's 800 Hz, its
damping 0.005 to 0.05 (the model's 0.02), its hysteresis 25 % wider; the sensor has
noise of 0 to 0.5 % of the move. A burst of 80 Hz between two rests is learned again and
again, with the filter's default cut-off. Further cases: the sensor's zero off by 30 %
of the range, or drifting by 1 % of the move a pass; a gain that drifts by 0.1 % a pass;
two modes. Both have the 1,024 gears that identification gives (``--gears``): with 128,
a turn that falls on a gear's end leaves the gear crossed in every other pass, 0.009 %
of the move below half the cut-off.

For every case the error of the middle of the move, RMS in % of it, after 0, 5, 10, 20
and 40 passes (median of the seeds), the last passes' part below half the cut-off, and
what the noise has there (the floor). What lies above the cut-off stays. Exits 1 where
the last pass has more than 1.1 times the error of pass 5, or where the resonance is 5 %
off, noise is there, and the error below half the cut-off exceeds 1.2 of its floor, or
where a pass is refused.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dbo_cli.drives.options import DriveOptions
from dbo_cli.errors import InputError
from dbo_cli.extras.repeat.learning import ORDER, RepeatedMove, Tracked
from dbo_cli.hysteresis.cascade import slow_output_range
from dbo_cli.hysteresis.dynamics import DynamicsStage, Resonance, ZeroPhaseLowPass
from dbo_cli.hysteresis.model import (
    ActuatorModel,
    BacklashStage,
    Quantity,
    Relaxation,
    ScaleStage,
    Stage,
)
from dbo_cli.runs.api import Model

Floats = NDArray[np.float64]
RATE, ROWS = 20_000.0, 6_000
GEARS = [1024]
MIDDLE = slice(700, -700)
SHOWN = (0, 5, 10, 20, 40)
GROWN, ABOVE_FLOOR = 1.1, 1.2
WIDE: dict[str, Any] = {
    "sample_rate": RATE,
    "v_min": -40.0,
    "v_max": 140.0,
    "extrapolate": True,
    "state": "empty",
}


def actuator(
    loop: float, frequency: float, damping: float, gain: float = 1.0, modes: int = 1
) -> ActuatorModel:
    slopes = 1.0 - loop + 2.0 * loop * np.linspace(0.0, 1.0, GEARS[0])
    widths = np.full(GEARS[0], 100.0 / GEARS[0])
    creep = Relaxation(0.0, (0.5, 20.0), (0.002, 0.002))
    stages: list[Stage] = [
        BacklashStage(widths, 0.1 * widths * slopes, 0.0, 0.0, creep),
        ScaleStage(gain, 0.0),
    ]
    low, high = slow_output_range(stages, 0.0, 100.0)
    sections = [Resonance(frequency * (1.0 + 1.2 * k), damping) for k in range(modes)]
    stages.append(DynamicsStage(tuple(sections)))
    voltage, displacement = (
        Quantity("voltage", "V", 0.0, 100.0),
        Quantity("displacement", "um", low, high),
    )
    return ActuatorModel("forward", voltage, displacement, tuple(stages))


def burst() -> Floats:
    time = np.arange(ROWS) / RATE
    u = np.clip((time / time[-1] - 0.1) / 0.8, 0.0, 1.0)
    wanted: Floats = 5.0 + 2.5 * np.sin(2.0 * np.pi * 19.0 * u) * np.sin(np.pi * u) ** 2
    return wanted


def learned(
    plant: ActuatorModel,
    model: Model,
    passes: int,
    noise: float,
    seed: int,
    zero: float = 0.0,
    drift: float = 0.0,
    fade: float = 0.0,
    **more: Any,
) -> tuple[list[float], float, float]:
    """Return the error of each pass (% of the move), its part below half the cut-off, and the noise there."""
    options = DriveOptions(state="empty", **more)
    wanted, random = burst(), np.random.default_rng(seed)
    time, span = np.arange(ROWS) / RATE, float(np.ptp(wanted))
    drive, errors, parts, floors = model.compensate(wanted, **WIDE), [], [], []
    for k in range(passes + 1):
        begun = plant.start(float(drive[0]), "empty")
        reached = plant.simulate(drive, begun, time_step=1.0 / RATE).y * (
            1.0 - fade * k
        )
        away = (reached - wanted)[MIDDLE]
        errors.append(100.0 * float(np.std(away)) / span)  # the mean is not learned
        hiss = random.normal(0.0, noise * span, ROWS)
        measured = reached + hiss + zero + drift * span * k
        played = [Tracked("pass", drive, measured)]
        asked = RepeatedMove(model.actuator, wanted, time, 1.0 / RATE, options).lesson(
            played
        )
        low = ZeroPhaseLowPass(0.5 * asked.cutoff, 1.0 / RATE, ORDER)
        parts.append(100.0 * float(np.std(low.whole(reached - wanted)[MIDDLE])) / span)
        floors.append(100.0 * float(np.std(low.whole(hiss)[MIDDLE])) / span)
        drive = model.compensate(asked.request, **WIDE)
    return errors, float(np.median(parts[-10:])), float(np.median(floors[-10:]))


def shown(
    name: str,
    plant: ActuatorModel,
    model: Model,
    passes: int,
    seeds: int,
    strict: bool,
    **more: Any,
) -> bool:
    """Print a case; True where it is beyond its bounds."""
    try:
        runs = [
            learned(plant, model, passes, seed=seed, **more) for seed in range(seeds)
        ]
    except InputError as problem:
        print(f"{name:58} REFUSED: {problem}", flush=True)
        return True
    errors = np.median([one[0] for one in runs], axis=0)
    part, floor = (float(np.median([one[k] for one in runs])) for k in (1, 2))
    beyond = errors[-1] > GROWN * errors[min(5, passes)]
    beyond |= strict and floor > 0.0 and part > ABOVE_FLOOR * floor
    numbers = " ".join(f"{errors[k]:8.4f}" for k in SHOWN if k <= passes)
    print(
        f"{name:58} {numbers}  below f_c/2 {part:.4f}, floor {floor:.4f}{'  BAD' if beyond else ''}",
        flush=True,
    )
    return bool(beyond)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--passes", type=int, default=40)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument(
        "--quick", action="store_true", help="a third of the cases, one seed"
    )
    parser.add_argument("--gears", type=int, default=GEARS[0])
    asked = parser.parse_args()
    GEARS[0] = asked.gears
    warnings.simplefilter("ignore")
    passes, seeds, bad, cases = asked.passes, 1 if asked.quick else asked.seeds, 0, 0
    model = Model(actuator(0.2, 800.0, 0.02))
    dampings = (0.005, 0.02) if asked.quick else (0.005, 0.02, 0.05)
    noises = (0.001,) if asked.quick else (0.0, 0.0002, 0.001, 0.005)
    offs = (
        (0.88, 1.12, 0.75, 1.25)
        if asked.quick
        else (0.95, 1.05, 0.88, 1.12, 0.75, 1.25)
    )
    print(
        f"{'error in % of the move after passes':58} {' '.join(f'{k:8}' for k in SHOWN if k <= passes)}"
    )
    for part in offs:
        for damping in dampings:
            for noise in noises:
                name = f"f_r {100 * (part - 1):+.0f} %, damping {damping}, noise {100 * noise:g} %"
                plant = actuator(0.25, 800.0 * part, damping)
                bad += shown(
                    name,
                    plant,
                    model,
                    passes,
                    seeds if noise else 1,
                    abs(part - 1) < 0.1,
                    noise=noise,
                )
                cases += 1
    plant = actuator(0.25, 760.0, 0.02)
    for name, more in (
        ("zero off by 30 % of the range", {"zero": 0.3 * plant.output.span}),
        ("zero drifts by 1 % of the move a pass", {"drift": 0.01}),
        ("gain drifts by 0.1 % a pass", {"fade": 0.001}),
    ):
        bad += shown(name, plant, model, passes, seeds, False, noise=0.001, **more)
        cases += 1
    two, plant = (
        Model(actuator(0.2, 800.0, 0.02, modes=2)),
        actuator(0.25, 600.0, 0.005, modes=2),
    )
    bad += shown(
        "two modes, both -25 %, damping 0.005",
        plant,
        two,
        passes,
        seeds,
        False,
        noise=0.001,
    )
    print(f"{bad} of {cases + 1} beyond their bounds")
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
