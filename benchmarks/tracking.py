"""Tracking of the virtual actuator, all presets: the compensated drive's error against a straight line's.

For each preset and seed: the sample identification drive is played, a model is identified with everything
automatic (and once more without relaxation and delay), a trajectory inside the reach is compensated, and both
drives are played again with other noise. The bound: 0.06 of the straight line's RMSE, or twice the noise.

    python benchmarks/tracking.py [--seeds 3]
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "sample_data"))

import numpy as np
from make_samples import identification_drive, trajectory
from numpy.typing import NDArray
from virtual_actuator import PRESETS, ActuatorParameters, VirtualActuator

from dbo_cli.hysteresis.delay import read_ahead
from dbo_cli.hysteresis.identification import IdentificationOptions, Recording, identify
from dbo_cli.hysteresis.model import ActuatorModel, DriveLimits

Floats = NDArray[np.float64]
BOUND = 0.06


def scaled(signal: Floats, low: float, high: float) -> Floats:
    """Stretch a signal to a range."""
    out: Floats = low + (high - low) * (signal - signal.min()) / np.ptp(signal)
    return out


def compensated(model: ActuatorModel, time: Floats, desired: Floats) -> Floats:
    """Drive of the model for a whole trajectory, read ahead by its delay."""
    steps = np.diff(time, prepend=time[0])
    blocks = list(read_ahead([(None, time, desired)], model.delay_seconds))
    ahead = np.concatenate([block[-1] for block in blocks])
    limits = DriveLimits(model.input.minimum, model.input.maximum)
    start = model.start_compensation(float(ahead[0]), "auto", limits)
    return model.compensate(ahead, start, limits=limits, time_step=steps).y


def straight(voltage: Floats, displacement: Floats, desired: Floats) -> Floats:
    """Drive of the best straight line through the log."""
    slope, level = np.polyfit(voltage, displacement, 1)
    return np.clip((desired - level) / slope, voltage.min(), voltage.max())


def tracking(parameters: ActuatorParameters, seed: int) -> tuple[float, float, float]:
    """RMSE of the straight line, of the model with everything automatic, and of that without any lag."""
    actuator = VirtualActuator(parameters)
    time, shape = identification_drive()
    voltage = scaled(shape, parameters.v_min, parameters.v_max)
    displacement = actuator.play(time, voltage, seed)
    log = Recording("identification", voltage, displacement, time, None, "V", "um")
    auto = identify([log]).model
    plain = identify([log], IdentificationOptions(relaxation=(), delay=0.0)).model
    when, curve = trajectory()
    low, span = auto.output.minimum, auto.output.span
    desired = scaled(curve, low + 0.04 * span, low + 0.92 * span)
    if parameters.stroke < 0.0:
        desired = 2.0 * low + span - desired  # begin at the voltage's lower end
    errors = []
    for drive in (
        straight(voltage, displacement, desired),
        compensated(auto, when, desired),
        compensated(plain, when, desired),
    ):
        error = actuator.play(when, drive, seed + 1000) - desired
        errors.append(float(np.sqrt(np.mean(error**2))))
    return errors[0], errors[1], errors[2]


def main() -> None:
    """Print one line a preset and seed, and the verdict."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--seeds", type=int, default=3)
    seeds = parser.parse_args().seeds
    print("preset        seed  straight line  compensated  ratio   noise  without lag  ratio")
    missed = 0
    for name, parameters in PRESETS.items():
        for seed in range(1, seeds + 1):
            line, auto, plain = tracking(parameters, seed)
            noise = float(np.hypot(parameters.noise, parameters.resolution / np.sqrt(12.0)))
            good = auto <= max(BOUND * line, 2.0 * noise)
            missed += not good
            print(
                f"{name:12}  {seed:4}  {line:10.4f} um  {auto:8.4f} um  {auto / line:.3f}  {noise:.4f}  "
                f"{plain:8.4f} um  {plain / line:.3f}{'' if good else '   MISSED'}"
            )
    print(f"bound {BOUND} of the straight line's RMSE or twice the noise: missed {missed} times")


if __name__ == "__main__":
    main()
