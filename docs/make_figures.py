"""Draw the figures of theory.md, with the package itself: ``python docs/make_figures.py``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dbo_cli.hysteresis.identification import IdentificationOptions, Recording, identify
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.hysteresis.operators import (
    DiscreteBacklashOperator,
    DiscretePointOperator,
    Outside,
    Relaxation,
)
from dbo_cli.reports import drawing as style
from dbo_cli.reports.drawing import Plot, draw
from dbo_cli.reports.figures import mark_curves
from dbo_cli.reports.sample_pairs import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FOLDER = Path(__file__).parent / "figures"
DOTTED: dict[str, Any] = {
    "color": style.INK,
    "linewidth": 0.9,
    "linestyle": (0, (1, 1.6)),
}
DOT: dict[str, Any] = {
    "marker": "o",
    "markersize": 4.5,
    "linestyle": "none",
    "color": style.INK,
}
STATE_LABELS = {
    2: ((0, 7), "center"),
    4: ((-6, 5), "right"),
    5: ((-2, -14), "center"),
    6: ((-6, 5), "right"),
    7: ((-6, 5), "right"),
}
THREE = DiscreteBacklashOperator([0.8, 1.2, 1.6], [0.4, 1.1, 2.1])


def sweep(*turns: float, samples: int = 400) -> Floats:
    """Return a drive that goes straight from each turn to the next."""
    legs = [np.linspace(start, stop, samples) for start, stop in pairwise(turns)]
    return np.concatenate(legs)


def response(
    operator: DiscreteBacklashOperator, drive: Floats, decay: Floats | None = None
) -> Floats:
    """Return the output of an operator that starts empty."""
    return operator.run(drive, operator.empty(), decay=decay)[0]


def corners(operator: DiscreteBacklashOperator, bits: int) -> tuple[float, float]:
    """Return X_B and Y_B, (2) and (3)."""
    chosen = [i for i in range(operator.n) if bits >> i & 1]
    return (
        operator.x0 + float(sum(operator.dx[i] for i in chosen)),
        operator.y0 + float(sum(operator.dy[i] for i in chosen)),
    )


def named(axes: Axes) -> None:
    """Label the axes of an operator."""
    axes.set(xlabel="Input x", ylabel="Output y")


def two_gears(axes: Axes) -> None:
    """Paint the loop of two gears in the manner of the paper's Fig. 1."""
    gears = DiscreteBacklashOperator([1.6, 2.0], [0.7, 2.2])
    up, down = sweep(0.0, 3.6), sweep(3.6, 0.0)
    y = response(gears, np.concatenate([up, down]))
    axes.plot(up, y[: len(up)], label="up", **style.SOLID)
    axes.plot(down, y[len(up) :], label="down", **style.DASHED)
    for bits in range(4):
        x, y_b = corners(gears, bits)
        axes.plot([x], [y_b], zorder=4, **DOT)
        place = {0: (2, -14), 1: (8, -10), 2: (-8, 6), 3: (-6, 7)}[bits]
        axes.annotate(
            f"B = {bits:02b}", (x, y_b), xytext=place, textcoords="offset points",
            ha="left" if place[0] > 0 else "right",
        )  # fmt: skip
    for x0, y0, gear in ((0.0, 0.0, 0), (1.6, 0.7, 1)):
        dx, dy = float(gears.dx[gear]), float(gears.dy[gear])
        axes.plot(
            [x0, x0 + dx, x0 + dx], [y0, y0, y0 + dy], color=style.MUTED, linewidth=0.8
        )
        axes.annotate(
            f"ΔX{'₀₁'[gear]}",
            (x0 + 0.55 * dx, y0),
            xytext=(0, -11),
            textcoords="offset points",
        )
        if gear == 0:
            axes.annotate(
                f"ΔY{'₀₁'[gear]}",
                (x0 + dx, y0 + 0.3 * dy),
                xytext=(4, 0),
                textcoords="offset points",
            )
        else:
            axes.annotate(
                f"ΔY{'₀₁'[gear]}",
                (x0 + dx, y0 + 0.4 * dy),
                xytext=(-24, 0),
                textcoords="offset points",
            )
    axes.set_ylim(-0.35, 3.3)
    named(axes)
    mark_curves(axes)


def eight_states(axes: Axes) -> None:
    """Paint the states of three gears, and the ways that lead on, as in the paper's Fig. 2."""
    for bits in range(8):
        x, y = corners(THREE, bits)
        for turn in (0.0, 3.6):  # from every state, the ways up and down that are open
            state = replace(THREE.empty(), bits=bits)
            drive = sweep(x, turn, samples=200)
            axes.plot(
                drive, THREE.run(drive, state)[0], color=style.FILL, linewidth=0.9
            )
    drive = sweep(0.0, 3.6, 0.0)
    axes.plot(drive, response(THREE, drive), label="full loop", **style.SOLID)
    for bits in range(8):
        x, y = corners(THREE, bits)
        axes.plot([x], [y], zorder=4, **DOT)
        place, side = STATE_LABELS.get(bits, ((6, -11), "left"))
        axes.annotate(
            f"{bits:03b}", (x, y), xytext=place, textcoords="offset points", ha=side
        )
    axes.set_ylim(-0.35, 3.9)
    named(axes)
    mark_curves(axes)


def turn_inside(axes: Axes) -> None:
    """Paint few gears beside many, with turns inside a gear."""
    drive = sweep(0.0, 3.6, 0.9, 2.9, 1.4, 2.2)
    for count, look in ((6, style.SOLID), (256, style.DASHED)):
        even = np.full(count, 3.6 / count)
        slope = 0.4 + 1.2 * (np.arange(count) + 0.5) / count
        gears = DiscreteBacklashOperator(even, even * slope)
        axes.plot(drive, response(gears, drive), label=f"{count} gears", **look)
    named(axes)
    mark_curves(axes)


def compared_exactly(dx: Floats, dy: Floats, drive: Floats) -> Floats:
    """Return the output of the printed procedure with exact comparisons: what goes wrong."""
    bits = [0] * len(dx)
    output = []
    for x in drive.tolist():
        while True:
            x_b, y_b = float(np.dot(bits, dx)), float(np.dot(bits, dy))
            free = next((i for i, bit in enumerate(bits) if not bit), None)
            taken = next((i for i, bit in enumerate(bits) if bit), None)
            if free is not None and x >= x_b + dx[free]:
                bits[free] = 1
            elif taken is not None and x <= x_b - dx[taken]:
                bits[taken] = 0
            else:
                gear = (
                    free
                    if x >= x_b and free is not None
                    else taken
                    if taken is not None
                    else len(dx) - 1
                )
                output.append(y_b + dy[gear] / dx[gear] * (x - x_b))
                break
    return np.array(output)


def breakpoint_turn(axes: Axes) -> None:
    """Paint the way back from a turn one rounding error below the top."""
    dx = np.array([0.3, 0.5, 0.8, 0.9, 1.1])
    dy = dx * np.array([0.35, 0.6, 0.9, 1.2, 1.6])
    top = float(np.nextafter(dx.sum(), 0.0))
    drive = sweep(0.0, top, 0.0)
    operator = DiscreteBacklashOperator(dx, dy)
    axes.plot(
        drive,
        response(operator, drive),
        label="crossed at 1 − 10⁻⁹ of the gear",
        **style.SOLID,
    )
    axes.plot(
        drive, compared_exactly(dx, dy, drive), label="compared exactly", **style.DASHED
    )
    named(axes)
    mark_curves(axes)


def outside(axes: Axes) -> None:
    """Paint what lies beyond the range."""
    drive = sweep(0.0, 4.4, -0.8, 3.6)
    rules: tuple[tuple[Outside, dict[str, Any]], ...] = (
        ("extend", style.SOLID),
        ("hold", style.DASHED),
    )
    for rule, look in rules:
        axes.plot(
            drive, THREE.run(drive, THREE.empty(), outside=rule)[0], label=rule, **look
        )
    for edge in (0.0, 3.6):
        axes.axvline(edge, **DOTTED)
    named(axes)
    mark_curves(axes)


def segments(axes: Axes) -> None:
    """Paint a point operator as in the paper's Fig. 3."""
    points = DiscretePointOperator([1.0, 1.4, 1.2], [1.5, 1.3, 0.8])
    x = np.linspace(-0.4, 4.0, 200)
    axes.plot(x, points.run(x), label="three segments", **style.SOLID)
    knots = np.array([0.0, 1.0, 2.4, 3.6])
    axes.plot(knots, points.run(knots), zorder=4, **DOT)
    for count, (low, high) in enumerate(pairwise(knots)):
        middle = 0.5 * (low + high)
        axes.annotate(
            f"C = {count}",
            (middle, float(points.run([middle])[0])),
            xytext=(8, -9),
            textcoords="offset points",
        )
    named(axes)
    mark_curves(axes)


def inverse(axes: Axes) -> None:
    """Paint an operator, its inverse and the two in cascade."""
    count = 24
    even = np.full(count, 3.6 / count)
    slope = 0.4 + 1.2 * (np.arange(count) + 0.5) / count
    gears = DiscreteBacklashOperator(even, even * slope)
    desired = sweep(0.0, 3.6, 0.7, 2.8, 0.0)
    drive = gears.inverse().run(desired, gears.inverse().empty())[0]
    axes.plot(drive, response(gears, drive), label="Γ", **style.SOLID)
    axes.plot(desired, drive, label="Γ⁻¹", **style.DASHED)
    axes.plot(
        desired,
        response(gears, drive),
        label="Γ after Γ⁻¹",
        color=style.INK,
        linewidth=1.6,
    )
    axes.set(xlabel="Input", ylabel="Output")
    mark_curves(axes)


def relaxation(axes: Axes) -> None:
    """Paint steps of an actuator that creeps, compensated without and with its memory."""
    count, step = 64, 0.01
    even = np.full(count, 3.6 / count)
    slope = 0.5 + 0.7 * (np.arange(count) + 0.5) / count
    gears = DiscreteBacklashOperator(
        even, even * slope, relaxation=Relaxation(0.0, (0.05, 2.0), (0.06, 0.12))
    )
    time = np.arange(0.0, 8.0, step)
    wanted = np.select([time < 0.5, time < 3.0, time < 5.5], [0.0, 2.4, 0.8], 1.6)
    decay = np.exp(-step / np.array([0.05, 2.0]))[None, :].repeat(len(time), axis=0)
    decay[0] = 0.0
    without = DiscreteBacklashOperator(even, even * slope)
    plain = without.inverse().run(wanted, without.inverse().empty())[0]
    axes.plot(
        time,
        response(gears, plain, decay),
        label="gears alone inverted",
        **style.DASHED,
    )
    back = gears.inverse()
    drive = back.run(wanted, back.empty(), decay=decay)[0]
    axes.plot(
        time,
        response(gears, drive, decay),
        label="inverted with its memory",
        **style.SOLID,
    )
    axes.set(xlabel="Time (s)", ylabel="Displacement")
    mark_curves(axes)


@cache
def sample() -> tuple[ActuatorModel, Floats, Floats, Floats]:
    """Return the model of the sample log, the log's voltage and displacement, and the model's prediction."""
    log = FOLDER.parents[1] / "sample_data" / "identification.csv"
    time, voltage, displacement = np.loadtxt(log, delimiter=",", skiprows=1).T
    model = identify(
        [Recording(log.name, voltage, displacement, time)], IdentificationOptions(), []
    ).model
    start = model.start(float(voltage[0]))
    steps = np.diff(time, prepend=time[0])
    return (
        model,
        voltage,
        displacement,
        model.simulate(voltage, start, time_step=steps).y,
    )


def identified(axes: Axes) -> None:
    """Paint the loops of the sample log beside those of its model."""
    _, voltage, measured, predicted = sample()
    shift = float(np.mean(measured - predicted))
    axes.plot(voltage, measured - shift, label="measured", **style.DASHED)
    axes.plot(voltage, predicted, label="model", **(style.SOLID | {"linewidth": 0.8}))
    axes.set(xlabel="Drive voltage (V)", ylabel="Displacement (µm)")
    mark_curves(axes)


def slopes(axes: Axes) -> None:
    """Paint the slopes of the gears of the sample log's model."""
    gears = sample()[0].backlash
    edges = np.concatenate([[0.0], np.cumsum(gears.dx)])
    axes.stairs(
        gears.dy / gears.dx, edges, baseline=None, color=style.FIRST, linewidth=1.3
    )
    axes.set_ylim(0.0)
    axes.set(xlabel="Voltage travelled since the turn (V)", ylabel="Slope ΔY/ΔX")


PLOTS = (
    Plot("two-gears", "Two gears", "The loop of two gears.", style.TALL, two_gears),
    Plot(
        "eight-states",
        "Three gears",
        "The eight states of three gears.",
        style.TALL,
        eight_states,
    ),
    Plot(
        "turn-inside",
        "Turns inside a gear",
        "Six gears beside 256.",
        style.TALL,
        turn_inside,
    ),
    Plot(
        "breakpoint",
        "A turn on a breakpoint",
        "Exact comparison and tolerance.",
        style.TALL,
        breakpoint_turn,
    ),
    Plot("outside", "Outside the range", "Extended and held.", style.TALL, outside),
    Plot("segments", "The point operator", "Three segments.", style.WIDE, segments),
    Plot(
        "inverse", "The inverse", "Operator, inverse and identity.", style.TALL, inverse
    ),
    Plot(
        "relaxation",
        "Creep and lag",
        "Steps with creep, compensated.",
        style.WIDE,
        relaxation,
    ),
    Plot(
        "identified",
        "Measured and model",
        "Loops of the sample log.",
        style.TALL,
        identified,
    ),
    Plot(
        "slopes",
        "Slopes of the gears",
        "Slopes of the sample log's model.",
        style.WIDE,
        slopes,
    ),
)


def write(plots: Sequence[Plot]) -> None:
    """Write every figure."""
    FOLDER.mkdir(exist_ok=True)
    for plot in plots:
        (FOLDER / f"{plot.key}.svg").write_bytes(draw(plot, "svg"))


if __name__ == "__main__":
    write(PLOTS)
