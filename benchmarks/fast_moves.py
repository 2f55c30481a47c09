"""Fast moves on simulated stages: what dynamics in the model are worth.

    python benchmarks/fast_moves.py [--sets NAME ...] [--rate HZ] [--figure FILE]

For every parameter set of sample_data/virtual_positioner.py: a drive of ``excite`` and
a small sweep are played, a model is identified from the two noisy recordings, and sines
and triangles with rounded turns are compensated and played, at f_r/1000 to f_r/5.
Columns, RMS error in % of the move, without the sensor's noise: a straight line from
displacement to voltage; the model without dynamics, from the slow rows; the model as
identified; the same with the stage's true resonance and lag in place of those found.
Exits 1 where the third exceeds 0.05 % up to f_r/30, 0.1 % at f_r/10 or 0.5 % at f_r/5.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
import warnings
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

import dbo_cli as dbo
from dbo_cli.hysteresis.dynamics import (
    Antiresonance,
    DynamicsStage,
    Lag,
    Resonance,
    ZeroPhaseLowPass,
)
from dbo_cli.hysteresis.excitation import Excitation, sweep
from dbo_cli.runs.api import Model

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "sample_data"))
from virtual_positioner import PRESETS, PositionerParameters, VirtualPositioner

Floats = NDArray[np.float64]
PARTS = (1000, 100, 30, 10, 5)
BOUNDS = {1000: 0.05, 100: 0.05, 30: 0.05, 10: 0.1, 5: 0.5}
NAMES = ("line", "without", "dynamics", "oracle")
SLOW_RATE = 2_000.0  # Hz, of the slow log
SLOW_SECONDS = 60.0
"""Its length: creep of 8 s is not to be seen in 15 s.

RMS error of the scanner after 15, 30, 60 s, in % of the move: at f_r/1000 0.034, 0.022,
0.011, at f_r/30 0.062, 0.018, 0.010, at f_r/5 0.17, 0.06, 0.07.
"""
SHAPES = ("sine", "triangle")


def wave(shape: str, frequency: float, rate: float) -> tuple[Floats, slice]:
    """Return a move between 0 and 1 that begins and ends at rest at 0, and the rows that are judged."""
    cycles = 4 if frequency < 5.0 else 12
    rise, quiet = round(0.3 * rate), round(0.02 * rate)
    count = round(cycles / frequency * rate)
    phase = np.arange(count) * frequency / rate
    if shape == "sine":
        body = 0.5 + 0.3 * np.sin(2.0 * np.pi * phase)
    else:
        corners = 0.5 + 0.3 * (2.0 / np.pi) * np.arcsin(np.sin(2.0 * np.pi * phase))
        body = ZeroPhaseLowPass(max(5.0 * frequency, rate / 2_000.0), 1.0 / rate).whole(
            corners
        )
    up = 0.25 - 0.25 * np.cos(np.pi * np.arange(rise) / rise)
    fade = np.clip(np.minimum(phase, phase[::-1]), 0.0, 1.0)
    fade = fade**3 * (10.0 - 15.0 * fade + 6.0 * fade**2)
    whole = np.concatenate(
        [
            np.zeros(quiet),
            up,
            np.full(quiet, 0.5),
            0.5 + fade * (body - 0.5),
            np.full(quiet, 0.5),
        ]
    )
    begin = 2 * quiet + rise
    edge = round(1.2 / frequency * rate)
    return whole, slice(begin + edge, begin + count - edge)


def true_dynamics(p: PositionerParameters, model: Model) -> Model:
    """Return the model with the stage's own resonances, antiresonance and lag."""
    sections = [Resonance(frequency, damping) for frequency, damping, _ in p.modes]
    # a/A + b/B = (a B + b A)/(A B), A and B being 1 + 2ζs/ω + s²/ω²
    if len(p.modes) == 2:
        (first, zeta, share), (second, eta, other) = p.modes
        square = share / second**2 + other / first**2
        linear = share * 2.0 * eta / second + other * 2.0 * zeta / first
        at = square**-0.5
        sections[1] = Resonance(second, eta, Antiresonance(at, 0.5 * linear * at))
    actuator = model.actuator
    between = [one for one in actuator.stages if not isinstance(one, DynamicsStage)]
    known = actuator.dynamics.sections if actuator.dynamics else ()
    # creep as identified
    sections = [one for one in known if isinstance(one, Lag) and one.lead] + sections
    stages = (
        DynamicsStage((Lag(p.amplifier_lag),)),
        *between,
        DynamicsStage(tuple(sections)),
    )
    return Model(dataclasses.replace(actuator, stages=stages))


def models_of(
    p: PositionerParameters, rate: float
) -> tuple[dict[str, Model], list[str]]:
    """Return the models to compare, and what identification said."""
    highest = min(1.25 * max(mode[0] for mode in p.modes), rate / 10.0)
    stage = VirtualPositioner(p)
    _, slow = Excitation(p.v_min, p.v_max, SLOW_RATE, SLOW_SECONDS, 1.0).drive()
    fast = sweep(p.v_min, p.v_max, rate, highest)
    logs = [
        pd.DataFrame(
            {
                "time_s": np.arange(drive.size) / hz,
                "voltage_V": drive,
                "displacement_um": stage.play(drive, hz, seed),
            }
        )
        for seed, (drive, hz) in enumerate([(slow, SLOW_RATE), (fast, rate)])
    ]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = dbo.identify(logs)
        without = dbo.identify(logs[:1], dynamics=0)
    told = [line for line in found.summary if "dynamics" in line or "trust" in line]
    return {
        "without": without,
        "dynamics": found,
        "oracle": true_dynamics(p, found),
    }, told


def errors_of(
    p: PositionerParameters, models: dict[str, Model], rate: float
) -> dict[tuple[str, int], list[float]]:
    """Return the errors in % of the move, by shape and part of the resonance."""
    stage, found = VirtualPositioner(p), {}
    low, high = models["without"].output.minimum, models["without"].output.maximum
    for shape in SHAPES:
        for part in PARTS:
            unit, judged = wave(shape, p.modes[0][0] / part, rate)
            wanted = low + (0.05 + 0.9 * unit) * (high - low)
            drives = [p.v_min + (wanted - low) / (high - low) * (p.v_max - p.v_min)]
            for name in NAMES[1:]:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    drives.append(
                        models[name].compensate(
                            wanted,
                            sample_rate=rate,
                            v_min=p.v_min,
                            v_max=p.v_max,
                            state="empty",
                        )
                    )
            away = [
                (stage.displacement(drive, rate) - wanted)[judged] for drive in drives
            ]
            move = float(np.ptp(wanted[judged]))
            found[shape, part] = [
                100.0 * float(np.sqrt(np.mean(one**2))) / move for one in away
            ]
    return found


def figure(path: str, table: dict[str, dict[tuple[str, int], list[float]]]) -> None:
    """Draw the errors over the frequency, one curve a set."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    fig, axes = plt.subplots(1, 2, figsize=(9.0, 3.6), sharey=True)
    for axis, shape in zip(axes, SHAPES, strict=True):
        for name, colour in zip(NAMES[::-1], ("k", "C0", "C1", "0.6"), strict=True):
            k = NAMES.index(name)
            curves = np.array(
                [[table[one][shape, part][k] for part in PARTS] for one in table]
            )
            for curve in curves:
                axis.loglog(
                    [1.0 / part for part in PARTS],
                    curve,
                    color=colour,
                    lw=0.6,
                    alpha=0.5,
                )
            middle = np.exp(np.log(curves).mean(axis=0))
            axis.loglog(
                [1.0 / part for part in PARTS], middle, color=colour, lw=2.0, label=name
            )
        axis.set(title=shape, xlabel="frequency / first resonance")
        axis.grid(alpha=0.3)
    axes[0].set_ylabel("RMS error, % of the move")
    axes[1].legend(frameon=False)
    fig.tight_layout()
    fig.savefig(path)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sets", nargs="*", default=list(PRESETS))
    parser.add_argument("--rate", type=float, default=20_000.0)
    parser.add_argument("--figure")
    options = parser.parse_args()
    table, bad = {}, 0
    for name in options.sets:
        p = PRESETS[name]
        models, told = models_of(p, options.rate)
        print(f"{name}: modes {p.modes}, amplifier lag {1e3 * p.amplifier_lag:g} ms")
        print("\n".join(f"  {line}" for line in told))
        table[name] = errors_of(p, models, options.rate)
        print(f"  {'':18}" + "".join(f"{one:>10}" for one in NAMES))
        for (shape, part), values in table[name].items():
            beyond = values[2] > BOUNDS[part]
            bad += beyond
            cells = "".join(f"{value:10.3f}" for value in values)
            print(
                f"  {shape:9} f_r/{part:<5}{cells}{'  above ' + str(BOUNDS[part]) if beyond else ''}",
                flush=True,
            )
    if options.figure:
        figure(options.figure, table)
    print(f"{bad} of {sum(map(len, table.values()))} cells above their bound")
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
