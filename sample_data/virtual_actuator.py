#!/usr/bin/env python3
"""A stand-in for the bench: a simulated piezo actuator that turns a drive into a "measured" displacement.

Nothing here was recorded. The actuator is deliberately *not* a Discrete Backlash
Operator, so that identifying it is a task and not a formality: hundreds of continuous
plays with a smooth density, a curved static map (asymmetry), creep that follows the
hysteretic displacement, an amplifier and a sensor that lag, sensor noise, and a sensor
that rounds. The same parameters, drive and seed give the same numbers.

    python virtual_actuator.py drive.csv -o measured.csv --preset stack --seed 1

reads the columns ``time_s`` and ``voltage_V`` and writes
``time_s,voltage_V,displacement_um``. A column ``displacement_um`` or ``desired_um`` of
the drive file (what the drive was computed for) is carried through as ``desired_um``,
so that ``dbo report`` finds both in one file. As a module:

    VirtualActuator(PRESETS["stack"]).play(time, voltage, seed=1)
"""

from __future__ import annotations

import argparse
import csv
import dataclasses
import re
import sys
from typing import IO

import numpy as np
from numpy.typing import ArrayLike, NDArray

Signal = NDArray[np.float64]
FormattedColumn = tuple[Signal, str]


@dataclasses.dataclass(frozen=True)
class ActuatorParameters:
    """What the simulated bench is made of; lengths in µm, voltages in V, times in s.

    ``loop`` is the share of the slope that the plays carry: positive for plays that add
    slope after a turn (a piezo), negative for loops that soften after a turn (friction,
    magnetics). ``bend`` curves the static map. ``creep`` pairs a time constant with the
    share of the displacement that follows it.
    """

    v_min: float = 0.0
    v_max: float = 100.0
    stroke: float = 12.0
    offset: float = 0.8
    loop: float = 0.42
    reach: float = 0.13
    bend: float = 0.10
    bend_cubic: float = 0.03
    creep: tuple[tuple[float, float], ...] = ((0.4, 0.006), (6.0, 0.010), (60.0, 0.012))
    amplifier_lag: float = 0.002
    sensor_lag: float = 0.0008
    noise: float = 0.006
    resolution: float = 0.0005
    plays: int = 256


PRESETS = {
    "stack": ActuatorParameters(),
    "bender": ActuatorParameters(
        v_min=-60.0, v_max=60.0, stroke=240.0, offset=-115.0, loop=0.55, reach=0.18, bend=-0.16,
        bend_cubic=0.06, creep=((0.8, 0.010), (15.0, 0.018)), amplifier_lag=0.004, sensor_lag=0.001,
        noise=0.08, resolution=0.01,
    ),
    "softening": ActuatorParameters(
        v_max=10.0, stroke=35.0, offset=2.0, loop=-0.85, reach=0.10, bend=0.05, bend_cubic=0.0,
        creep=((2.0, 0.008),), noise=0.015, resolution=0.001,
    ),
    "inverted": ActuatorParameters(
        v_max=150.0, stroke=-18.0, offset=20.0, loop=0.48, reach=0.16, bend=0.12, bend_cubic=-0.04,
        noise=0.01,
    ),
    "creeping": ActuatorParameters(
        v_max=120.0, stroke=15.0, offset=0.0, loop=0.35, reach=0.12, bend=-0.08,
        creep=((0.15, 0.012), (2.0, 0.025), (25.0, 0.040)), noise=0.008,
    ),
}  # fmt: skip


class VirtualActuator:
    """One simulated actuator; ``play`` starts it anew, at rest, the drive last at the lower end."""

    def __init__(self, parameters: ActuatorParameters | None = None) -> None:
        self.parameters = parameters or ActuatorParameters()
        p = self.parameters
        span = p.v_max - p.v_min
        # Half a step off zero: a play of radius 0 would be a plain gain, which the
        # direct share already is.
        self.radii = (np.arange(p.plays) + 0.5) / p.plays * 0.5 * span
        density = (self.radii / span) ** 0.5 * np.exp(-self.radii / (p.reach * span))
        loading = np.maximum(0.0, span - 2.0 * self.radii)
        self.weights = p.loop * span * density / float(density @ loading)
        self.direct = 1.0 - p.loop

    def play(self, time: ArrayLike, voltage: ArrayLike, seed: int = 0) -> Signal:
        """Return the measured displacement in µm of the drive ``voltage`` in V at ``time`` in s."""
        displacement = self.displacement(time, voltage)
        p = self.parameters
        noisy = displacement + p.noise * np.random.default_rng(seed).standard_normal(
            len(displacement)
        )
        return (
            np.round(noisy / p.resolution) * p.resolution
            if p.resolution > 0.0
            else noisy
        )

    def displacement(self, time: ArrayLike, voltage: ArrayLike) -> Signal:
        """Return the displacement in µm as a sensor without noise and rounding would show it."""
        instants = np.asarray(time, dtype=np.float64)
        applied = self._lag(
            instants,
            np.asarray(voltage, dtype=np.float64),
            self.parameters.amplifier_lag,
        )
        shape = self._static_map(self._hysteresis(applied))
        crept = shape.copy()
        for tau, share in self.parameters.creep:
            crept += share * (self._lag(instants, shape, tau) - shape)
        seen = self._lag(instants, crept, self.parameters.sensor_lag)
        return self.parameters.offset + self.parameters.stroke * seen

    def _hysteresis(self, voltage: Signal) -> Signal:
        """Return the plays' weighted sum, 0 at the lower and 1 at the upper end of the first full loading."""
        p = self.parameters
        summed = np.empty(len(voltage))
        # A drive that was at the lower end leaves every play at its upper edge: v_min +
        # r.
        state = p.v_min + self.radii
        low, high = np.empty_like(state), np.empty_like(state)
        for k, v in enumerate(voltage):
            np.subtract(v, self.radii, out=low)
            np.add(v, self.radii, out=high)
            np.maximum(state, low, out=state)
            np.minimum(state, high, out=state)
            summed[k] = self.weights @ state
        at_rest = float(self.weights @ (p.v_min + self.radii))
        return (self.direct * (voltage - p.v_min) + summed - at_rest) / (
            p.v_max - p.v_min
        )

    def _static_map(self, x: Signal) -> Signal:
        """Bend the straight line 0…1 smoothly, both ends kept; strictly growing for small coefficients."""
        p = self.parameters
        return (
            x + p.bend * x * (1.0 - x) + p.bend_cubic * x * (1.0 - x) * (1.0 - 2.0 * x)
        )

    @staticmethod
    def _lag(time: Signal, signal: Signal, tau: float) -> Signal:
        """Follow ``signal`` with the time constant ``tau``, at rest at first, linear in between."""
        if tau <= 0.0 or len(signal) == 0:
            return signal.copy()
        ratio = np.maximum(np.diff(time), 1e-12) / tau
        decay = np.exp(-ratio)
        # Exact answer of a first-order lag to an input that runs straight from one
        # sample to the next.
        hold = -np.expm1(-ratio) / ratio
        drive = signal[1:] * (1.0 - hold) + signal[:-1] * (hold - decay)
        answer = np.empty_like(signal)
        answer[0] = value = float(signal[0])
        for k, (a, d) in enumerate(
            zip(decay.tolist(), drive.tolist(), strict=True), start=1
        ):
            value = a * value + d
            answer[k] = value
        return answer


def read_drive(lines: IO[str]) -> dict[str, Signal]:
    """Read a CSV with a header into named columns in s, V and um, without that unit (``voltage``)."""
    rows = list(csv.reader(line for line in lines if not line.startswith("#")))
    units = re.compile(
        "_(s|V|um)$"
    )  # a column in another one keeps its name, and is not found
    names = [units.sub("", name.strip()) for name in rows[0]]
    table = np.array([[float(cell) for cell in row] for row in rows[1:]])
    return {name: table[:, k] for k, name in enumerate(names)}


def write_table(path: str, columns: dict[str, FormattedColumn]) -> None:
    """Write columns, each with its number format, as CSV; ``-`` is the standard output."""
    header = ",".join(columns)
    body = zip(
        *([f"{value:{form}}" for value in values] for values, form in columns.values()),
        strict=True,
    )
    text = "\n".join([header, *(",".join(row) for row in body)]) + "\n"
    if path == "-":
        sys.stdout.write(text)
        return
    with open(path, "w", encoding="utf-8", newline="\n") as file:
        file.write(text)


def measure(
    drive: dict[str, Signal], preset: str, seed: int
) -> dict[str, FormattedColumn]:
    """Play a drive and return the columns of the measured log."""
    measured = VirtualActuator(PRESETS[preset]).play(
        drive["time"], drive["voltage"], seed
    )
    columns = {"time_s": (drive["time"], ""), "voltage_V": (drive["voltage"], "")}
    desired = drive.get("desired", drive.get("displacement"))
    if desired is not None:
        columns["desired_um"] = (desired, "")
    return columns | {"displacement_um": (measured, ".4f")}


def main() -> None:
    """Play a drive file through the simulated actuator and write what its sensor shows."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument(
        "drive",
        help="CSV with the columns time_s and voltage_V; - is the standard input",
    )
    parser.add_argument(
        "-o",
        "--output",
        default="-",
        help="the measured CSV; - (default): standard output",
    )
    parser.add_argument(
        "--preset", choices=sorted(PRESETS), default="stack", help="default: stack"
    )
    parser.add_argument(
        "--seed", type=int, default=0, help="seed of the sensor noise (default: 0)"
    )
    options = parser.parse_args()
    if options.drive == "-":
        drive = read_drive(sys.stdin)
    else:
        with open(options.drive, encoding="utf-8") as file:
            drive = read_drive(file)
    if not {"time", "voltage"} <= drive.keys():
        parser.error(
            f"{options.drive}: no columns time_s and voltage_V; there are: {', '.join(drive)}"
        )
    write_table(options.output, measure(drive, options.preset, options.seed))


if __name__ == "__main__":
    main()
