#!/usr/bin/env python3
"""Make the sample logs beside this file, with the virtual actuator as the bench; the same bytes every time.

``identification.csv/.h5``  the drive of ``dbo excite`` over 0…100 V, and what the actuator makes of it.
``trajectory.csv/.h5``      a displacement to follow: slow scan, soft steps, a mixed-frequency part.

    python make_samples.py [FOLDER]

The HDF5 copies need h5py and hold the same numbers as the CSV.
"""

from __future__ import annotations

import itertools
import pathlib
import sys

import numpy as np
from numpy.typing import NDArray
from virtual_actuator import PRESETS, VirtualActuator, write_table

from dbo_cli.drive.excite import excite

RATE = 500.0  # Hz: recorded faster and decimated, as most loggers do
SEED = 20180701


def identification_drive() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return time in s and drive in V of ``dbo excite --v-max 100 --max-slew 2000 --sample-rate 500``."""
    time, voltage = excite(0.0, 100.0, sample_rate=RATE, max_slew=2000.0)
    return time, np.round(voltage, 4)


def trajectory() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return time in s and the desired displacement in µm, from the lower end, inside the reach."""
    low, high = 0.9, 12.2
    t = np.arange(int(3.0 * RATE)) / RATE
    scan = 0.46 * (1.0 - 0.1 * t / 3.0) * (1.0 - np.cos(2 * np.pi * (2.0 / 3.0) * t))
    targets = [float(scan[-1]), 0.35, 0.60, 0.25, 0.80, 0.45, 0.45]
    steps: list[float] = []
    edge, hold = int(0.12 * RATE), int(0.35 * RATE)
    for start, end in itertools.pairwise(targets):
        soft = (1.0 - np.cos(np.pi * np.arange(1, edge + 1) / edge)) / 2.0
        steps += (start + (end - start) * soft).tolist() + [end] * hold
    u = np.arange(int(4.0 * RATE)) / RATE
    fade = np.sin(np.pi * u / 4.0) ** 2
    mixed = 0.45 + fade * (
        0.28 * np.sin(2 * np.pi * 0.9 * u) + 0.12 * np.sin(2 * np.pi * 2.3 * u + 0.5)
    )
    shape = np.concatenate([scan, steps, mixed])
    desired = np.round(low + (high - low) * shape, 4)
    return np.arange(len(desired)) / RATE, desired


def write_hdf5(
    path: pathlib.Path, columns: dict[str, NDArray[np.float64]], units: dict[str, str]
) -> None:
    """Write columns as datasets of the root group, each with its unit, and the sample rate."""
    import h5py

    with h5py.File(path, "w") as file:
        file.attrs["sample_rate"] = RATE
        file.attrs["origin"] = "simulated by sample_data/virtual_actuator.py"
        for name, values in columns.items():
            dataset = file.create_dataset(
                name, data=values, chunks=True, compression="gzip", shuffle=True
            )
            dataset.attrs["units"] = units[name]


def main() -> None:
    """Write the four sample files into the folder given, or beside this script."""
    folder = (
        pathlib.Path(sys.argv[1])
        if len(sys.argv) > 1
        else pathlib.Path(__file__).parent
    )
    units = {"time": "s", "voltage": "V", "displacement": "um"}
    time, voltage = identification_drive()
    measured = VirtualActuator(PRESETS["stack"]).play(time, voltage, SEED)
    write_table(
        str(folder / "identification.csv"),
        {
            "time_s": (time, ".6g"),
            "voltage_V": (voltage, ".6g"),
            "displacement_um": (measured, ".4f"),
        },
    )
    columns = {"time": time, "voltage": voltage, "displacement": np.round(measured, 4)}
    write_hdf5(folder / "identification.h5", columns, units)
    time, desired = trajectory()
    table = {"time_s": (time, ".6g"), "displacement_um": (desired, ".6g")}
    write_table(str(folder / "trajectory.csv"), table)
    write_hdf5(folder / "trajectory.h5", {"time": time, "displacement": desired}, units)


if __name__ == "__main__":
    main()
