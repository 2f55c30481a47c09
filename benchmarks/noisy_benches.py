"""README's own day, steps 1 to 5, on simulated benches that read the voltage back with noise.

    python benchmarks/noisy_benches.py [--benches 20] [--noise 0.5] [--rate 5000]

The command lines are those of README. Between them a bench plays what they wrote:
another actuator each time, at 0 to 100 V, whose displacement follows the voltage itself
while the log has the voltage with noise (``--noise`` is its standard deviation in % of
the range). The exit code of each step is printed, the ends of the model's range, the
least and the greatest voltage of the drive, and the tracking error; the exit code is 1
where a step failed or a drive left 0 to 100 V.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "sample_data"))
from virtual_actuator import (
    PRESETS,
    ActuatorParameters,
    VirtualActuator,
    read_drive,
    write_table,
)

ROOT = Path(__file__).resolve().parent.parent

Floats = NDArray[np.float64]

SECONDS = 4.0  # of the move
RANGE = 100.0  # V, README's


class Day(NamedTuple):
    """What came of a bench.

    Attributes
    ----------
    codes
        Exit codes of README's steps.
    model, drive
        The ends of the model's range and of the drive, V.
    error
        Of the move, RMS in % of its range.
    """

    codes: list[int]
    model: tuple[float, float]
    drive: tuple[float, float]
    error: float

    @property
    def passed(self) -> bool:
        """Whether every step passed and no voltage left the range."""
        return not any(self.codes) and 0.0 <= self.drive[0] and self.drive[1] <= RANGE


def steps_of_readme() -> list[list[str]]:
    """Return the words of the five command lines of README's day."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    day = text.split("## A real day")[1].split("\n- ")[0]
    lines = [
        line.split("#")[0].strip() for line in day.replace("\\\n", "").splitlines()
    ]
    steps = [shlex.split(line) for line in lines if line.startswith("dbo ")]
    assert [words[1] for words in steps] == [
        "excite",
        "identify",
        "compensate",
        "check",
        "report",
    ]
    return steps


def at_rate(words: list[str], rate: float) -> list[str]:
    """Return a command line with another sample rate."""
    if "--sample-rate" not in words:
        return words
    place = words.index("--sample-rate") + 1
    return [*words[:place], f"{rate:g}", *words[place + 1 :]]


def actuator_of(seed: int) -> ActuatorParameters:
    """Return an actuator: loop, asymmetry, creep and lag of its own."""
    random = np.random.default_rng([seed, 1])
    usual = PRESETS["stack"]
    creep = tuple((tau, share * random.uniform(0.5, 1.5)) for tau, share in usual.creep)
    return dataclasses.replace(
        usual,
        loop=random.uniform(0.3, 0.55),
        reach=random.uniform(0.08, 0.18),
        bend=random.uniform(-0.12, 0.12),
        stroke=random.uniform(6.0, 30.0),
        creep=creep,
        amplifier_lag=random.uniform(0.0005, 0.003),
    )


def trajectory_of(
    seed: int, parameters: ActuatorParameters, rate: float
) -> dict[str, Floats]:
    """Return a move: a sum of sines over most of the stroke, from rest to rest."""
    random = np.random.default_rng([seed, 2])
    time = np.arange(round(SECONDS * rate)) / rate
    swing = np.zeros(time.size)
    for _ in range(3):
        swing += np.sin(
            2.0 * np.pi * (random.uniform(0.3, 3.0) * time + random.uniform())
        )
    swing *= np.sin(np.pi * time / SECONDS) ** 2
    middle = parameters.offset + 0.5 * parameters.stroke
    return {
        "time": time,
        "displacement": middle + 0.48 * parameters.stroke * swing / np.abs(swing).max(),
    }


def play(
    actuator: VirtualActuator,
    folder: Path,
    drive: str,
    recorded: list[str],
    noise: float,
    seed: int,
) -> None:
    """Play a drive and write what the bench recorded."""
    with open(folder / drive, encoding="utf-8") as file:
        columns = read_drive(file)
    displacement = actuator.play(columns["time"], columns["voltage"], seed)
    random = np.random.default_rng([seed, 3])
    voltage = columns["voltage"] + 0.01 * noise * RANGE * random.standard_normal(
        displacement.size
    )
    log = {
        "time_s": (columns["time"], ""),
        "voltage_V": (voltage, ".5f"),
        "displacement_um": (displacement, ".4f"),
    }
    for name in recorded:
        write_table(str(folder / name), log)


def day(seed: int, noise: float, rate: float, folder: Path) -> Day:
    """Go through README's steps on one bench."""
    parameters = actuator_of(seed)
    actuator = VirtualActuator(parameters)
    wanted = trajectory_of(seed, parameters, rate)
    table = {
        "time_s": (wanted["time"], ""),
        "displacement_um": (wanted["displacement"], ".6f"),
    }
    write_table(str(folder / "trajectory.csv"), table)
    codes = []
    for words in steps_of_readme():
        command = [sys.executable, "-m", "dbo_cli", *at_rate(words, rate)[1:]]
        environment = os.environ | {"PYTHONPATH": str(ROOT)}
        done = subprocess.run(
            command,
            cwd=folder,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
        codes.append(done.returncode)
        if done.returncode:
            print(f"{shlex.join(words)}\n{done.stderr}", file=sys.stderr)
            break
        if words[1] == "excite":
            play(actuator, folder, "excitation.csv", ["recorded.csv"], noise, seed)
        if words[1] == "compensate":
            play(
                actuator,
                folder,
                "drive.csv",
                ["played.csv", "tracked.csv"],
                noise,
                1000 + seed,
            )
    return _outcome(codes, folder)


def _outcome(codes: list[int], folder: Path) -> Day:
    """Return what came of a bench, from the files that are left."""
    model, drive, error = (np.nan, np.nan), (np.nan, np.nan), np.nan
    if (folder / "model.json").exists():
        quantity = json.loads((folder / "model.json").read_text())["input"]
        model = quantity["min"], quantity["max"]
    if (folder / "drive.csv").exists():
        with open(folder / "drive.csv", encoding="utf-8") as file:
            columns = read_drive(file)
        with open(folder / "tracked.csv", encoding="utf-8") as file:
            measured = read_drive(file)["displacement"]
        desired, voltage = columns["desired"], columns["voltage"]
        move = columns["time"] >= 0.0
        left = (measured - desired)[move]
        error = 100.0 * float(np.sqrt(np.mean(left**2))) / float(np.ptp(desired[move]))
        drive = float(voltage.min()), float(voltage.max())
    return Day(codes, model, drive, error)


def main() -> int:
    """Print a line a bench."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--benches", type=int, default=20)
    parser.add_argument(
        "--noise", type=float, default=0.5, help="standard deviation, %% of the range"
    )
    parser.add_argument("--rate", type=float, default=5000.0, help="samples a second")
    options = parser.parse_args()
    passed = 0
    print("bench  exit codes  model's range, V      drive, V            error, %")
    for seed in range(options.benches):
        with tempfile.TemporaryDirectory() as folder:
            one = day(seed, options.noise, options.rate, Path(folder))
        passed += one.passed
        codes = "".join(map(str, one.codes))
        print(
            f"{seed:5}  {codes:10}  {one.model[0]:8.3f} {one.model[1]:9.3f}  "
            f"{one.drive[0]:8.3f} {one.drive[1]:9.3f}  {one.error:8.3f}",
            flush=True,
        )
    print(f"{passed} of {options.benches} passed")
    return 0 if passed == options.benches else 1


if __name__ == "__main__":
    raise SystemExit(main())
