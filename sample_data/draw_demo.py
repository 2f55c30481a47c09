#!/usr/bin/env python3
"""Draw what the demo is about in one picture: the same move by a straight-line drive and compensated.

    python draw_demo.py uncompensated.csv compensated.csv picture.png

Above, what was desired and what came out; below, the error of both. The logs are the
virtual actuator's. The errors stand in the file's description, too.
"""

from __future__ import annotations

import sys

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from virtual_actuator import read_drive

from dbo_cli.reports.plots import DASHED, INK, SOLID, style


def draw(uncompensated: str, compensated: str, picture: str) -> None:
    """Write the picture of two measured logs of one trajectory."""
    logs = []
    for path in (uncompensated, compensated):
        with open(path, encoding="utf-8") as file:
            log = read_drive(file)
        move = log["time"] >= 0.0  # without the way to its first row
        logs.append({name: column[move] for name, column in log.items()})
    time, desired = logs[0]["time"], logs[0]["desired"]
    labels = []
    looks = [("straight-line drive", DASHED), ("compensated by dbo", SOLID)]
    with style():
        figure = Figure(figsize=(8.0, 4.2), layout="constrained")
        FigureCanvasAgg(figure)
        above, below = figure.subplots(2, 1, sharex=True)
        above.plot(time, desired, color=INK, linewidth=2.4, alpha=0.25, label="desired")
        for log, (label, look) in zip(logs, looks, strict=True):
            error = log["displacement"] - log["desired"]
            rmse = float(np.sqrt(np.mean(error**2)))
            above.plot(time, log["displacement"], label=label, **look)
            labels.append(f"{label}: {rmse:.2g} µm RMSE")
            below.plot(time, error, label=labels[-1], **look)
        above.set_title("Simulated actuator", loc="left")
        above.set_ylabel("Displacement (µm)")
        below.set_ylabel("Error (µm)")
        below.set_xlabel("Time (s)")
        above.legend(loc="upper right", ncols=3, bbox_to_anchor=(1.0, 1.22))
        below.legend(loc="upper right", ncols=2, bbox_to_anchor=(1.0, 1.2))
        figure.savefig(
            picture,
            dpi=160,
            metadata={"Software": None, "Description": "; ".join(labels)},
        )


if __name__ == "__main__":
    draw(*sys.argv[1:4])
