"""Microseconds that one sample of live control costs: plan and commit.

    python benchmarks/live_speed.py [SAMPLES]

Controllers at 5 kHz with a slew limit, of models as identification makes them; each
figure is the least of five passes. ``applied`` says to ``commit`` what a coarser source
played. Exit 1 where a sample costs more than 20 us without dynamics and delay.
"""

from __future__ import annotations

import sys
import time

import numpy as np

from dbo_cli.drive.live import Controller
from dbo_cli.model import (
    Delay,
    Dynamics,
    Gears,
    Model,
    Points,
    Quantity,
    Relaxation,
    Resonance,
    Scale,
    Stage,
)

RATE = 5000.0  # Hz
MOST = 20.0  # us


def actuator(
    gears: int, terms: int = 0, segments: int = 0, behind: tuple[Stage, ...] = ()
) -> Model:
    """Return a model of a piezo stage of 100 V and 12 um."""
    heights = np.linspace(0.5, 1.5, gears) / gears
    memory = None
    if terms:
        taus = tuple((0.002 * 10.0 ** np.arange(terms)).tolist())
        memory = Relaxation(0.0, taus, (0.0002,) * terms)
    stages: list[Stage] = [
        Gears(np.full(gears, 100.0 / gears), heights, 0.0, 0.0, memory)
    ]
    if segments:
        width = np.full(segments, 1.1 / segments)
        stages.append(Points(width, np.linspace(0.9, 1.1, segments) * width))
    stages.append(Scale(12.0, 0.0))
    voltage = Quantity("voltage", "V", 0.0, 100.0)
    displacement = Quantity("displacement", "um", 0.0, 12.0)
    return Model("forward", voltage, displacement, (*stages, *behind))


def cost(model: Model, wanted: list[float], applied: bool) -> float:
    """Return microseconds a sample."""
    least = float("inf")
    for _ in range(5):
        live = Controller(model, RATE, max_slew=50_000.0, lookahead="auto")
        live.step(wanted[0])
        begun = time.process_time()
        for value in wanted:
            volts = live.plan(value)
            live.commit(round(volts, 2) if applied else None)
        least = min(least, time.process_time() - begun)
    return 1e6 * least / len(wanted)


def main() -> int:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 20_000
    wanted = (6.0 + 5.0 * np.sin(2.0 * np.pi * 20.0 * np.arange(count) / RATE)).tolist()
    mode = Dynamics((Resonance(800.0, 0.02),))
    cases = {
        "25 gears": actuator(25),
        "1,280 gears, 5 memories": actuator(1280, 5),
        "1,280 gears, 5 memories, 16 points": actuator(1280, 5, 16),
        "the same with a delay": actuator(1280, 5, 16, (Delay(0.0011),)),
        "the same with a resonance": actuator(1280, 5, 16, (mode,)),
    }
    print(f"us a sample{'':27}commit   applied   samples ahead")
    slow = 0
    for name, model in cases.items():
        plain = cost(model, wanted, False)
        told = cost(model, wanted, True)
        ahead = Controller(model, RATE, lookahead="auto").lookahead
        print(f"{name:36}{plain:8.2f}{told:10.2f}{ahead:10}")
        slow += ahead == 0 and max(plain, told) > MOST
    return int(slow > 0)


if __name__ == "__main__":
    sys.exit(main())
