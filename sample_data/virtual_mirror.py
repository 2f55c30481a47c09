#!/usr/bin/env python3
"""A stand-in for a deformable mirror or a scanner: virtual actuators that show in each other, and moves.

Nothing here was recorded. All actuators have one shape (``virtual_actuator.py``, the
stack) and gains and offsets of their own; every sensor sees, besides its own actuator,
a part of what others do: 2 % of each neighbour on the grid of a mirror, 1 % of every
other axis of a scanner. The same drive and seed give the same numbers.

    dbo excite --v-max 100 --sample-rate 400 --frequency 4 --duration 15 --channels 128 -o drives.h5
    python virtual_mirror.py drives.h5 -o log.h5
    python virtual_mirror.py --move 128 -o frames.h5

``drives`` has a column voltage_1, voltage_2, ... of each actuator, and perhaps
desired_1, ... which are carried through; CSV or HDF5, which needs h5py. As a module:
``VirtualMirror(128).play(time, voltages)``.
"""

from __future__ import annotations

import argparse
import csv
import dataclasses
import re

import numpy as np
from numpy.typing import NDArray
from virtual_actuator import PRESETS, VirtualActuator, write_table

Signals = NDArray[np.float64]
# gain of a neighbour on a mirror, of another axis of a scanner
NEIGHBOUR, AXIS = 0.02, 0.01
SCATTER = 0.05  # of the gains of a batch, standard deviation
MOVE_RATE, MOVE_SECONDS = 400.0, 8.0


class VirtualMirror:
    """Actuators on a grid, each of which shows in its neighbours; up to four are the axes of a scanner."""

    def __init__(self, actuators: int) -> None:
        chance = np.random.default_rng(actuators)
        gains = 1.0 + SCATTER * np.clip(chance.standard_normal(actuators), -2.0, 2.0)
        base = PRESETS["stack"]
        self.offsets = base.offset + chance.uniform(0.0, 1.0, actuators)
        self.strokes = base.stroke * gains
        self.noise = base.noise
        self.actuators = [
            VirtualActuator(dataclasses.replace(base, stroke=stroke, offset=offset))
            for stroke, offset in zip(self.strokes, self.offsets, strict=True)
        ]
        self.gains = np.eye(actuators)
        if actuators <= 4:
            self.gains += (
                AXIS
                * chance.choice([-1.0, 1.0], (actuators, actuators))
                * (1.0 - self.gains)
            )
        else:
            width = 2 ** round(np.log2(np.sqrt(2.0 * actuators)))
            row, column = np.divmod(np.arange(actuators), width)
            apart = abs(row[:, None] - row) + abs(column[:, None] - column)
            self.gains += NEIGHBOUR * (apart == 1)

    def displacement(self, time: Signals, voltages: Signals) -> Signals:
        """Return what the sensors would show without noise, (samples, actuators) in um."""
        alone = [
            one.displacement(time, volts)
            for one, volts in zip(self.actuators, voltages.T, strict=True)
        ]
        seen: Signals = (
            self.offsets + (np.column_stack(alone) - self.offsets) @ self.gains.T
        )
        return seen

    def play(self, time: Signals, voltages: Signals, seed: int = 0) -> Signals:
        """Return what the sensors show."""
        noise = self.noise * np.random.default_rng(seed).standard_normal(voltages.shape)
        return np.round(self.displacement(time, voltages) + noise, 4)

    def move(self, seed: int = 3) -> tuple[Signals, Signals]:
        """Return time and a desired displacement of each actuator: slow waves, from rest."""
        chance = np.random.default_rng(seed)
        time = np.arange(round(MOVE_RATE * MOVE_SECONDS)) / MOVE_RATE
        rise = np.clip(time, 0.0, 1.0)
        waves = np.zeros((len(time), len(self.actuators)))
        for _ in range(3):
            frequency, phase = (
                chance.uniform(0.3, 1.5, waves.shape[1]),
                chance.uniform(0, 6.3, waves.shape[1]),
            )
            waves += 0.1 * np.sin(2.0 * np.pi * frequency * time[:, None] + phase)
        shape = (0.5 - 0.5 * np.cos(np.pi * rise))[:, None] * (0.45 + waves)
        return time, np.round(self.offsets + 0.5 + self.strokes * 0.85 * shape, 5)


def read_table(path: str) -> dict[str, Signals]:
    """Read named columns, without units, from CSV or HDF5."""
    if path.endswith((".h5", ".hdf5")):
        import h5py

        with h5py.File(path) as file:
            return {re.sub("_(s|V|um)$", "", name): file[name][()] for name in file}
    with open(path, encoding="utf-8") as file:
        rows = list(csv.reader(line for line in file if not line.startswith("#")))
    values = np.array([[float(cell or "nan") for cell in row] for row in rows[1:]])
    return {
        re.sub("_(s|V|um)$", "", name): values[:, k] for k, name in enumerate(rows[0])
    }


def save_table(path: str, columns: dict[str, Signals]) -> None:
    """Write columns, whose names end in their units, as CSV or HDF5."""
    if not path.endswith((".h5", ".hdf5")):
        write_table(path, {name: (values, "") for name, values in columns.items()})
        return
    import h5py

    with h5py.File(path, "w") as file:
        file.attrs["origin"] = "simulated by sample_data/virtual_mirror.py"
        for name, values in columns.items():
            file[name] = values
            file[name].attrs["units"] = name.rpartition("_")[2]


def main() -> None:
    """Play drives through the simulated mirror, or write a move for it."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument(
        "drives",
        nargs="?",
        help="CSV or HDF5 with time_s and voltage_1_V, voltage_2_V, ...",
    )
    parser.add_argument(
        "--move", type=int, metavar="N", help="write a move for N actuators instead"
    )
    parser.add_argument("-o", "--output", required=True, help="CSV or HDF5")
    parser.add_argument(
        "--seed", type=int, default=0, help="of the sensors' noise (default: 0)"
    )
    options = parser.parse_args()
    if options.move is not None:
        time, wanted = VirtualMirror(options.move).move()
        made = {f"desired_{k}_um": column for k, column in enumerate(wanted.T, 1)}
        save_table(options.output, {"time_s": time} | made)
        return
    if options.drives is None:
        parser.error("give the drives to be played, or --move N")
    table = read_table(options.drives)
    count = sum(name.startswith("voltage_") for name in table)
    if not count or "time" not in table:
        parser.error(
            f"{options.drives}: no columns time_s and voltage_1_V; there are: {', '.join(table)}"
        )
    voltages = np.column_stack([table[f"voltage_{k}"] for k in range(1, count + 1)])
    shown = VirtualMirror(count).play(table["time"], voltages, options.seed)
    made = {"time_s": table["time"]}
    for k in range(count):
        made |= {
            f"voltage_{k + 1}_V": voltages[:, k],
            f"displacement_{k + 1}_um": shown[:, k],
        }
        desired = table.get(f"desired_{k + 1}")
        made |= {} if desired is None else {f"desired_{k + 1}_um": desired}
    save_table(options.output, made)


if __name__ == "__main__":
    main()
