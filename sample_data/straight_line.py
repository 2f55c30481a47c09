#!/usr/bin/env python3
"""Turn a trajectory into the drive a lab without a hysteresis model would use: a straight line.

    python straight_line.py identification.csv trajectory.csv -o drive.csv

The line is the least-squares fit of voltage on displacement over the whole
identification log, the best that one gain and one offset can do there; the drive is
kept within the voltages of that log.
"""

from __future__ import annotations

import argparse

import numpy as np
from virtual_actuator import read_drive, write_table


def main() -> None:
    """Write ``time_s,displacement_um,voltage_V`` for the trajectory given."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("log", help="CSV with voltage and displacement")
    parser.add_argument("trajectory", help="CSV with time and the desired displacement")
    parser.add_argument(
        "-o", "--output", default="-", help="the drive; - (default): standard output"
    )
    options = parser.parse_args()
    with open(options.log, encoding="utf-8") as file:
        log = read_drive(file)
    with open(options.trajectory, encoding="utf-8") as file:
        wanted = read_drive(file)
    gain, offset = np.polyfit(log["displacement"], log["voltage"], 1)
    line = gain * wanted["displacement"] + offset
    voltage = np.clip(line, log["voltage"].min(), log["voltage"].max())
    columns = {
        "time_s": wanted["time"],
        "displacement_um": wanted["displacement"],
        "voltage_V": voltage,
    }
    write_table(
        options.output, {name: (values, "") for name, values in columns.items()}
    )


if __name__ == "__main__":
    main()
