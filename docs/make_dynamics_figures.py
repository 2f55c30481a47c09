"""Draw the figures of theory.md on dynamics, learning and loops: ``python docs/make_dynamics_figures.py``."""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from make_figures import write

from dbo_cli.extras.repeat.learning import ORDER
from dbo_cli.hysteresis.cascade import slow_output_range
from dbo_cli.hysteresis.dynamics import DynamicsStage, Lag, Resonance
from dbo_cli.hysteresis.model import (
    ActuatorModel,
    BacklashStage,
    Quantity,
    Relaxation,
    ScaleStage,
    Stage,
)
from dbo_cli.hysteresis.model_state import StartName
from dbo_cli.hysteresis.move_error import RESONANCE_PART
from dbo_cli.reports import drawing as style
from dbo_cli.reports.drawing import Plot
from dbo_cli.reports.figures import label_decades, mark_curves
from dbo_cli.reports.sample_pairs import Floats
from dbo_cli.runs.api import Model

if TYPE_CHECKING:
    from matplotlib.axes import Axes

RATE = 20_000.0
RESONANCE = 800.0
NOISE = 0.002  # µm, of the sensor


def actuator(loop: float = 0.45, resonance: float | None = RESONANCE) -> ActuatorModel:
    """Return an actuator of 60 gears with creep, an amplifier's lag and a resonance; 0 to 100 V, 12 µm."""
    slopes = 1.0 - loop + 2.0 * loop * np.linspace(0.0, 1.0, 60)
    widths = np.full(60, 100.0 / 60.0)
    creep = Relaxation(0.0, (0.4, 6.0), (0.001, 0.002))
    stages: list[Stage] = [
        BacklashStage(widths, 0.1 * widths * slopes, 0.0, 0.0, creep),
        ScaleStage(1.2, 0.5),
    ]
    low, high = slow_output_range(stages, 0.0, 100.0)
    if resonance is not None:
        stages = [
            DynamicsStage((Lag(2e-4),)),
            *stages,
            DynamicsStage((Resonance(resonance, 0.02),)),
        ]
    voltage, displacement = (
        Quantity("voltage", "V", 0.0, 100.0),
        Quantity("displacement", "um", low, high),
    )
    return ActuatorModel("forward", voltage, displacement, tuple(stages))


def played(drive: Floats, start: StartName = "empty") -> Floats:
    """Return what the actuator does."""
    plant = actuator()
    return plant.simulate(
        drive, plant.start(float(drive[0]), start), time_step=1.0 / RATE
    ).y


def burst(frequency: float, seconds: float = 0.3) -> tuple[Floats, Floats]:
    """Return time and a sine of 8 µm that fades in from a rest and out to one."""
    time = np.arange(round(seconds * RATE)) / RATE
    rise = np.clip((time - 0.005) / 0.05, 0.0, 1.0) * np.clip(
        (time[-1] - 0.005 - time) / 0.05, 0.0, 1.0
    )
    rise = rise**3 * (10.0 - 15.0 * rise + 6.0 * rise**2)
    return time, 6.0 + 4.0 * rise * np.sin(2.0 * np.pi * frequency * time)


def compensated(model: ActuatorModel, wanted: Floats, **more: object) -> Floats:
    """Return the drive of a move from the lower end."""
    done: Floats = Model(model).compensate(
        wanted, sample_rate=RATE, v_min=-40.0, v_max=140.0, state="empty", **more  # type: ignore[arg-type]
    )  # fmt: skip
    return done


def fast_move(axes: Axes) -> None:
    """Paint the errors of a sine at a tenth of the resonance, by three models."""
    time, wanted = burst(RESONANCE / 10.0, 0.2)
    before = actuator()
    lag, moving = before.drive_lag, before.dynamics
    assert lag is not None
    assert moving is not None
    moved = DynamicsStage((*lag.sections, *moving.sections))
    kept = [
        stage for stage in before.stages if stage is not lag and stage is not moving
    ]
    behind = dataclasses.replace(before, stages=(*kept, moved))
    for model, label, look in (
        (actuator(resonance=None), "gears alone", style.DASHED),
        (behind, "lag taken behind", style.SOLID | {"color": style.THIRD}),
        (before, "lag before", style.SOLID),
    ):
        error = played(compensated(model, wanted)) - wanted
        axes.plot(1e3 * time, 1e3 * error, label=label, **look)
    axes.set(xlabel="Time (ms)", ylabel="Error (nm)")
    mark_curves(axes)


def reading_ahead(axes: Axes) -> None:
    """Paint what the inverse of a resonance makes of a smooth step: it begins before the step does."""
    time = np.arange(-60, 100) / RATE
    ramp = np.clip((time + 5e-4) / 1e-3, 0.0, 1.0)
    wanted = ramp**3 * (10.0 - 15.0 * ramp + 6.0 * ramp**2)
    stage = DynamicsStage((Resonance(RESONANCE, 0.02),))
    inverter = stage.inverter(1.0 / RATE)
    held = np.concatenate([wanted, np.full(inverter.ahead, wanted[-1])])
    asked, _ = inverter.run(held, inverter.rest(0.0))
    axes.plot(1e3 * time, asked, label="input", **style.SOLID)
    axes.plot(1e3 * time, wanted, label="output", **style.DASHED)
    axes.set(xlabel="Time (ms)", ylabel="Displacement")
    mark_curves(axes)


@cache
def lessons(frequency: float) -> dict[str, list[float]]:
    """Return the error of six passes, in % of the move, by what is wrong with the model."""
    _, wanted = burst(frequency)
    models = {
        "loop 20 % too small": actuator(loop=0.36),
        "resonance 5 % too low": actuator(resonance=0.95 * RESONANCE),
        "no dynamics": actuator(resonance=None),
    }
    found: dict[str, list[float]] = {}
    for name, model in models.items():
        tracked: tuple[Floats, ...] = ()
        found[name] = []
        for number in range(6):
            drive = compensated(
                model, wanted, **({"tracked": tracked} if tracked else {})
            )
            reached = played(drive)
            tracked = (
                drive,
                reached
                + np.random.default_rng(number).normal(0.0, NOISE, reached.size),
            )
            error = float(np.sqrt(np.mean((reached - wanted) ** 2)))
            found[name].append(100.0 * error / float(np.ptp(wanted)))
    return found


def learning_factor(axes: Axes) -> None:
    """Paint what a pass multiplies what was learned by, Q(1 - M), and what r + Q e would, 1 - MQ."""
    frequency = RESONANCE * np.geomspace(0.1, 2.0, 2000)
    weight = 1.0 / (1.0 + (frequency / (RESONANCE / RESONANCE_PART)) ** (2 * ORDER))
    model = Resonance(RESONANCE, 0.02).response(frequency)
    for part, look in zip((0.75, 0.88, 1.12, 1.25), style.SEVERAL, strict=False):
        ratio = Resonance(part * RESONANCE, 0.005).response(frequency) / model
        name = f"{abs(round(100.0 * (part - 1.0)))} % {'lower' if part < 1.0 else 'higher'}"
        axes.loglog(frequency, np.abs(weight * (1.0 - ratio)), label=name, **look)
    usual = np.abs(
        1.0 - weight * Resonance(0.75 * RESONANCE, 0.005).response(frequency) / model
    )
    axes.loglog(
        frequency,
        usual,
        label="r + Q e",
        color=style.INK,
        linewidth=0.9,
        linestyle=(0, (1, 1.6)),
    )
    axes.axhline(1.0, color=style.INK, linewidth=0.6)
    axes.set(
        xlabel="Frequency (Hz)",
        ylabel="Factor of a pass",
        xlim=(80.0, 1600.0),
        ylim=(1e-5, 10.0),
    )
    axes.set_xticks(
        [100.0, 200.0, 400.0, 800.0, 1600.0],
        ["100", "200", "400", "800", "1600"],
        minor=False,
    )
    axes.minorticks_off()
    label_decades(axes.yaxis)
    mark_curves(axes, columns=2)


def learning(axes: Axes) -> None:
    """Paint the error by pass of a move at a thirtieth of the resonance."""
    for (name, errors), look in zip(
        lessons(RESONANCE / 30.0).items(), style.SEVERAL, strict=False
    ):
        axes.semilogy(
            range(1, 7), errors, label=name, marker="o", markersize=4.0, **look
        )
    axes.axhline(
        100.0 * NOISE / 8.0,
        color=style.INK,
        linewidth=0.9,
        linestyle=(0, (1, 1.6)),
        label="sensor",
    )
    label_decades(axes.yaxis)
    axes.set(xlabel="Pass", ylabel="Error (RMS, % of the move)")
    mark_curves(axes, columns=2)


def loop(axes: Axes) -> None:
    """Paint the error of a looped move: the drive of one pass repeated, and that of the settled loop."""
    count = round(RATE / 40.0)
    period = 6.0 + 4.0 * np.sin(2.0 * np.pi * np.arange(count) / count)
    model = Model(actuator())
    wide = {"sample_rate": RATE, "v_min": -40.0, "v_max": 140.0}
    once = model.compensate(period, **wide)  # type: ignore[arg-type]
    settled = model.compensate(period, periodic=True, **wide)  # type: ignore[arg-type]
    time = np.arange(3 * count) / RATE
    for drive, label, look in (
        (once, "one pass, repeated", style.DASHED),
        (settled, "settled", style.SOLID),
    ):
        reached = played(np.tile(drive, 1000), "auto")
        error = reached[-3 * count :] - np.tile(period, 3)
        axes.plot(1e3 * time, 1e3 * error, label=label, **look)
    axes.set(xlabel="Time (ms)", ylabel="Error (nm)")
    mark_curves(axes)


PLOTS = (
    Plot(
        "fast-move",
        "A fast move",
        "Errors at a tenth of the resonance.",
        style.WIDE,
        fast_move,
    ),
    Plot(
        "reading-ahead",
        "The inverse of a resonance",
        "A step and its input.",
        style.WIDE,
        reading_ahead,
    ),
    Plot(
        "learning-factor",
        "Learning",
        "Factor of a pass.",
        style.WIDE,
        learning_factor,
        head=0.26,
    ),
    Plot(
        "learning",
        "Learning",
        "Error by pass for three models.",
        style.WIDE,
        learning,
        head=0.17,
    ),
    Plot("loop", "A loop", "Errors of a looped move.", style.WIDE, loop),
)


if __name__ == "__main__":
    write(PLOTS)
