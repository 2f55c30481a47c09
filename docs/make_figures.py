"""Draw the figures of the pages with the package itself: ``python docs/make_figures.py``."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dbo_cli.library import Model, identify, read_log
from dbo_cli.model import Gears, Points, Relaxation, State
from dbo_cli.reports.plots import (
    DASHED,
    FIRST,
    INK,
    MUTED,
    SOLID,
    TALL,
    THIN,
    WIDE,
    Floats,
    Plot,
    draw,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FOLDER = Path(__file__).parent / "figures"
LOG = FOLDER.parents[1] / "sample_data" / "identification.csv"
DOTTED: dict[str, Any] = {"color": MUTED, "linestyle": (0, (1, 1.6)), "linewidth": 0.9}
DOT: dict[str, Any] = {
    "marker": "o",
    "markersize": 4.5,
    "linestyle": "none",
    "color": INK,
}
THREE = Gears([0.8, 1.2, 1.6], [0.4, 1.1, 2.1])
RELAXING = Relaxation(0.0, (0.05, 2.0), (0.06, 0.12))


def sweep(*turns: float, rows: int = 400) -> Floats:
    """Return a drive that goes straight from each turn to the next."""
    legs = [np.linspace(begin, end, rows) for begin, end in pairwise(turns)]
    return np.concatenate(legs)


def even_gears(count: int, relaxation: Relaxation | None = None) -> Gears:
    """Return gears of one width over 0 to 3.6, with slopes that grow."""
    widths = np.full(count, 3.6 / count)
    slopes = 0.4 + 1.2 * (np.arange(count) + 0.5) / count
    return Gears(widths, widths * slopes, relaxation=relaxation)


def played(gears: Gears, drive: Floats, bits: int = 0, **options: Any) -> Floats:
    """Return the output of gears that start empty, or with these bits."""
    return gears.run(drive, State(bits), **options).y


def corner(gears: Gears, bits: int) -> tuple[float, float]:
    """Return X_B and Y_B, (2) and (3)."""
    taken = [place for place in range(gears.n) if bits >> place & 1]
    return float(gears.dx[taken].sum()), float(gears.dy[taken].sum())


def named(axes: Axes) -> None:
    """Label the axes of an operator."""
    axes.set(xlabel="Input x", ylabel="Output y")


def mark_corners(axes: Axes, gears: Gears) -> None:
    """Mark the corner of every state with its bits."""
    for bits in range(2**gears.n):
        x, y = corner(gears, bits)
        axes.plot([x], [y], zorder=4, **DOT)
        axes.annotate(
            f"{bits:0{gears.n}b}", (x, y), xytext=(6, -11), textcoords="offset points"
        )


def two_gears(axes: Axes) -> None:
    """Paint the loop of two gears, as in the paper's Fig. 1."""
    gears = Gears([1.6, 2.0], [0.7, 2.2])
    up, down = sweep(0.0, 3.6), sweep(3.6, 0.0)
    y = played(gears, np.concatenate([up, down]))
    axes.plot(up, y[: len(up)], label="up", **SOLID)
    axes.plot(down, y[len(up) :], label="down", **DASHED)
    mark_corners(axes, gears)
    for gear, (x, y0) in enumerate(((0.0, 0.0), (1.6, 0.7))):
        dx, dy = float(gears.dx[gear]), float(gears.dy[gear])
        axes.plot([x, x + dx, x + dx], [y0, y0, y0 + dy], color=MUTED, linewidth=0.8)
        axes.annotate(
            f"ΔX{'₀₁'[gear]}", (x + 0.5 * dx, y0), (0, 3), textcoords="offset points"
        )
        axes.annotate(
            f"ΔY{'₀₁'[gear]}",
            (x + dx, y0 + 0.35 * dy),
            (-22, 0),
            textcoords="offset points",
        )
    axes.set_ylim(-0.35, 3.3)
    named(axes)


def eight_states(axes: Axes) -> None:
    """Paint the eight states of three gears, and the ways between them, as in the paper's Fig. 2."""
    for bits in range(8):
        x, _ = corner(THREE, bits)
        for end in (0.0, 3.6):
            drive = sweep(x, end, rows=200)
            axes.plot(drive, played(THREE, drive, bits), color=MUTED, linewidth=0.5)
    drive = sweep(0.0, 3.6, 0.0)
    axes.plot(drive, played(THREE, drive), label="full loop", **SOLID)
    mark_corners(axes, THREE)
    axes.set_ylim(-0.35, 3.9)
    named(axes)


def turn_inside(axes: Axes) -> None:
    """Paint few gears beside many, with turns inside a gear."""
    drive = sweep(0.0, 3.6, 0.9, 2.9, 1.4, 2.2)
    for count, look in ((6, SOLID), (256, DASHED)):
        y = played(even_gears(count), drive)
        axes.plot(drive, y, label=f"{count} gears", **look)
    named(axes)


def compared_exactly(dx: Floats, dy: Floats, drive: Floats) -> Floats:
    """Return the output of the printed procedure with exact comparisons: what goes wrong."""
    bits = np.zeros(len(dx), dtype=bool)
    output = []
    for x in drive.tolist():
        while True:
            x_b, y_b = float(dx @ bits), float(dy @ bits)
            free, taken = int(np.argmin(bits)), int(np.argmax(bits))
            if not bits[free] and x >= x_b + dx[free]:
                bits[free] = True
            elif bits[taken] and x <= x_b - dx[taken]:
                bits[taken] = False
            else:
                gear = free if x >= x_b and not bits[free] else taken
                output.append(y_b + dy[gear] / dx[gear] * (x - x_b))
                break
    return np.array(output)


def breakpoint_turn(axes: Axes) -> None:
    """Paint the way back from a turn one rounding error below the top."""
    dx = np.array([0.3, 0.5, 0.8, 0.9, 1.1])
    dy = dx * np.array([0.35, 0.6, 0.9, 1.2, 1.6])
    drive = sweep(0.0, float(np.nextafter(dx.sum(), 0.0)), 0.0)
    axes.plot(drive, played(Gears(dx, dy), drive), label="with tolerance", **SOLID)
    axes.plot(
        drive, compared_exactly(dx, dy, drive), label="compared exactly", **DASHED
    )
    named(axes)


def outside(axes: Axes) -> None:
    """Paint what lies beyond the range."""
    drive = sweep(0.0, 4.4, -0.8, 3.6)
    axes.plot(drive, played(THREE, drive), label="extend", **SOLID)
    axes.plot(drive, played(THREE, drive, extend=False), label="hold", **DASHED)
    for edge in (0.0, 3.6):
        axes.axvline(edge, **DOTTED)
    named(axes)


def segments(axes: Axes) -> None:
    """Paint a point operator, as in the paper's Fig. 3."""
    points = Points([1.0, 1.4, 1.2], [1.5, 1.3, 0.8], 0.0, 0.0)
    x = np.linspace(-0.4, 4.0, 200)
    axes.plot(x, points(x), label="three segments", **SOLID)
    knots = np.array([0.0, 1.0, 2.4, 3.6])
    axes.plot(knots, points(knots), zorder=4, **DOT)
    named(axes)


def inverse(axes: Axes) -> None:
    """Paint an operator, its inverse and the two in cascade."""
    gears = even_gears(24)
    wanted = sweep(0.0, 3.6, 0.7, 2.8, 0.0)
    drive = gears.undo(wanted, State(0)).y
    reached = played(gears, drive)
    axes.plot(drive, reached, label="Γ", **SOLID)
    axes.plot(wanted, drive, label="Γ⁻¹", **DASHED)
    axes.plot(wanted, reached, label="Γ after Γ⁻¹", **THIN)
    axes.set(xlabel="Input", ylabel="Output")


def relaxation(axes: Axes) -> None:
    """Paint steps of an actuator that creeps, compensated without and with its memory."""
    step = 0.01
    gears = even_gears(64, RELAXING)
    time = np.arange(0.0, 8.0, step)
    wanted = np.select([time < 0.5, time < 3.0, time < 5.5], [0.0, 2.4, 0.8], 1.6)
    plain = even_gears(64).undo(wanted, State(0)).y
    known = gears.undo(wanted, State(0), step).y
    for drive, label, look in (
        (plain, "gears alone inverted", DASHED),
        (known, "inverted with its memory", SOLID),
    ):
        axes.plot(time, played(gears, drive, dt=step), label=label, **look)
    axes.set(xlabel="Time (s)", ylabel="Displacement")


@cache
def sample() -> tuple[Model, Floats, Floats, Floats]:
    """Return the model of the sample log, the log's drive and displacement, and the model's prediction."""
    log = read_log(LOG)
    model = identify(log)
    time, voltage = log["time"].to_numpy(), log["voltage"].to_numpy()
    predicted = model.simulate(voltage, time=time)
    return model, voltage, log["displacement"].to_numpy(), predicted


def identified(axes: Axes) -> None:
    """Paint the loops of the sample log beside those of its model."""
    _, voltage, measured, predicted = sample()
    axes.plot(voltage, measured, label="measured", **DASHED)
    axes.plot(voltage, predicted, label="model", color=FIRST, linewidth=0.7)
    axes.set(xlabel="Drive voltage (V)", ylabel="Displacement (µm)")


def slopes(axes: Axes) -> None:
    """Paint the slopes of the gears of the sample log's model."""
    gears = sample()[0].actuator.gears
    edges = np.concatenate([[0.0], np.cumsum(gears.dx)])
    axes.stairs(gears.dy / gears.dx, edges, baseline=None, color=FIRST, linewidth=1.3)
    axes.set_ylim(0.0)
    axes.set(xlabel="Voltage travelled since the turn (V)", ylabel="Slope (µm/V)")


def loop(axes: Axes) -> None:
    """Paint the error of a looped move: one pass repeated, and the settled drive behind a run-in."""
    model, rate, periods = sample()[0], 500.0, 8
    period = 6.0 - 3.0 * np.cos(2.0 * np.pi * np.arange(250) / 250.0)
    one = model.compensate(period, sample_rate=rate, state="empty")
    settled = model.compensate(
        period, sample_rate=rate, periodic=True, passes=2, details=True, state="empty"
    )
    repeated = np.tile(one, periods)
    led = np.concatenate(
        [settled.voltage, np.tile(settled.voltage[settled.move], periods - 3)]
    )
    time = np.arange(len(repeated)) / rate
    for drive, label, look in (
        (repeated, "one pass repeated", DASHED),
        (led[: len(repeated)], "run-in, then settled", SOLID),
    ):
        reached = model.simulate(drive, sample_rate=rate, state="empty")
        error = reached - np.resize(period, len(drive))
        axes.plot(time[250:], 1e3 * error[250 : len(time)], label=label, **look)
    axes.set(xlabel="Time (s)", ylabel="Error (nm)")


PAINTERS: tuple[tuple[str, str, tuple[float, float], Callable[[Axes], None]], ...] = (
    ("two-gears", "The loop of two gears", TALL, two_gears),
    ("eight-states", "The eight states of three gears", TALL, eight_states),
    ("turn-inside", "Turns inside a gear", TALL, turn_inside),
    ("breakpoint", "A turn on a breakpoint", TALL, breakpoint_turn),
    ("outside", "Outside the range", TALL, outside),
    ("segments", "The point operator", WIDE, segments),
    ("inverse", "Operator, inverse and identity", TALL, inverse),
    ("relaxation", "Steps with creep, compensated", WIDE, relaxation),
    ("identified", "Loops of the sample log", TALL, identified),
    ("slopes", "Slopes of the sample log's model", WIDE, slopes),
    ("loop", "Errors of a looped move", WIDE, loop),
)


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    for key, title, size, paint in PAINTERS:
        picture = draw(Plot(key, title, size, paint), "svg")
        (FOLDER / f"{key}.svg").write_bytes(picture)
