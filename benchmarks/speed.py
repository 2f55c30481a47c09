"""Nanoseconds a sample of the compiled kernel, and microseconds a sample of live control.

    python benchmarks/speed.py [SAMPLES]

Each figure is the least of five passes. Kernel: a million samples through ``Gears.run``,
forward and inverse. ``smooth`` is a sine of 2,000 samples a cycle: with few gears most
steps turn none, with 6,400 each turns six. ``jumps`` go from one end to the other at
every sample, ``random`` steps go anywhere. ``identified`` are 1,280 gears in runs of 16
alike with five relaxation terms, as identification makes them. Copying the array stands
first: ratios hold, times do not. Live: controllers at 5 kHz with a slew limit, a
fiftieth of the samples; ``applied`` says to ``commit`` what a coarser source played.
Exit 1 where jumps or random steps cost three times as much with the most gears as with
the fewest, or smooth ones more than random ones; or where a live sample costs more than
20 us without dynamics and delay.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from dbo_cli.drive import Limits
from dbo_cli.drive.live import Controller
from dbo_cli.model import (
    Cascade,
    Delay,
    Dynamics,
    Gears,
    Points,
    Quantity,
    Relaxation,
    Resonance,
    Scale,
    Stage,
    State,
)

Floats = NDArray[np.float64]
SIZES = (25, 100, 400, 1600, 6400)
SPAN = 100.0  # V
DT = 1e-3  # s
MOST_GROWTH = 3.0
RATE = 5000.0  # Hz, live
MOST = 20.0  # us


def best(run: Callable[[], object]) -> float:
    """Return the least seconds of the processor of five runs."""
    least = float("inf")
    for _ in range(5):
        begun = time.process_time()
        run()
        least = min(least, time.process_time() - begun)
    return least


def signals(samples: int) -> dict[str, Floats]:
    """Return what drives the gears, from the lower end."""
    count = np.arange(samples)
    rng = np.random.default_rng(1)
    return {
        "smooth": SPAN * (0.5 - 0.5 * np.cos(2.0 * np.pi / 2000.0 * count)),
        "jumps": np.where(count % 2 == 0, SPAN, 0.0),
        "random": rng.uniform(0.0, SPAN, samples),
    }


def uneven(n: int) -> Gears:
    """Return gears with a width and a slope each."""
    rng = np.random.default_rng(n)
    dx = rng.uniform(0.5, 1.5, n)
    dx *= SPAN / dx.sum()
    return Gears(dx, dx * np.linspace(0.5, 1.5, n))


def identified() -> Gears:
    """Return gears as identification makes them."""
    dx = np.full(1280, SPAN / 1280)
    slopes = np.repeat(np.linspace(0.5, 1.5, 80), 16)
    memories = Relaxation(0.0, (0.002, 0.02, 0.2, 2.0, 20.0), (0.01,) * 5)
    return Gears(dx, dx * slopes, 0.0, 0.0, memories)


def costs(gears: Gears, inputs: dict[str, Floats]) -> list[float]:
    """Return ns a sample of each input, forward and back."""
    relaxation = gears.relaxation
    found = []
    for x in inputs.values():
        memory = None
        if relaxation is not None:
            memory = relaxation.lags(x[:1], DT)[1]
        state = State(0, memory)
        y = gears.run(x, state, DT).y

        def forward(x: Floats = x, state: State = state) -> object:
            return gears.run(x, state, DT)

        def inverse(y: Floats = y, state: State = state) -> object:
            return gears.undo(y, state, DT)

        found.append(1e9 * best(forward) / x.size)
        found.append(1e9 * best(inverse) / x.size)
    return found


def kernel(samples: int) -> bool:
    """Print the table of the kernel; return whether its bounds hold."""
    inputs = signals(samples)
    target = np.empty(samples)
    copy = 1e9 * best(lambda: np.copyto(target, inputs["smooth"])) / samples
    print(f"ns a sample, forward and inverse; copying {samples:,} of them: {copy:.2f}")
    print(f"{'gears':>12}" + "".join(f"{name:>16}" for name in inputs))
    table = {}
    for n in SIZES:
        table[f"{n:,}"] = costs(uneven(n), inputs)
    table["identified"] = costs(identified(), inputs)
    for name, row in table.items():
        pairs = zip(row[::2], row[1::2], strict=True)
        print(
            f"{name:>12}" + "".join(f"{there:8.1f}{back:8.1f}" for there, back in pairs)
        )
    growth = np.array(table[f"{SIZES[-1]:,}"]) / np.array(table[f"{SIZES[0]:,}"])
    print(
        f"{SIZES[-1]:,} gears over {SIZES[0]}: " + ", ".join(f"{g:.1f}" for g in growth)
    )
    most = table[f"{SIZES[-1]:,}"]
    return bool(growth[2:].max() <= MOST_GROWTH and most[0] <= most[4])


def actuator(
    gears: int, terms: int = 0, segments: int = 0, behind: tuple[Stage, ...] = ()
) -> Cascade:
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
    return Cascade("forward", voltage, displacement, (*stages, *behind))


def cost(model: Cascade, wanted: list[float], applied: bool) -> float:
    """Return microseconds a sample."""
    limits = Limits.within(model.input, max_slew=50_000.0)

    def run() -> None:
        live = Controller(model, RATE, limits, lookahead="auto")
        for value in wanted:
            volts = live.plan(value)
            live.commit(round(volts, 2) if applied else None)

    return 1e6 * best(run) / len(wanted)


def live(count: int) -> bool:
    """Print the table of live control; return whether its bound holds."""
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
        ahead = model.inverter(1.0 / RATE).ahead
        print(f"{name:36}{plain:8.2f}{told:10.2f}{ahead:10}")
        slow += ahead == 0 and max(plain, told) > MOST
    return slow == 0


def main() -> int:
    samples = int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000
    held = [kernel(samples), live(samples // 50)]
    return int(not all(held))


if __name__ == "__main__":
    sys.exit(main())
