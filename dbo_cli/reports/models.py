"""The figures of a model.

``gears`` and ``points`` are drawn in the manner of the paper's Figs. 1 to 3.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from dbo_cli.errors import counted
from dbo_cli.hysteresis.dynamics import Complexes, Lag, Resonance, Section
from dbo_cli.hysteresis.model import ActuatorModel, Quantity
from dbo_cli.hysteresis.operators import DiscreteBacklashOperator, DiscretePointOperator
from dbo_cli.reports import drawing as style
from dbo_cli.reports.drawing import Plot
from dbo_cli.reports.figures import axis_label, finish, label_decades
from dbo_cli.reports.sample_pairs import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FEW = 40  # gears or segments that are marked one by one; chosen


def plots_of_model(model: ActuatorModel) -> list[Plot]:
    """Return the figures of a model in either direction; of one without gears, the loop of the whole."""
    if not model.has_gears:
        title = f"The loop of the model with {model.size}"
        words = f"Output against input of the model with {model.size}, slowly up and back down."
        paint = partial(_paint_slow_loop, model)
        return [Plot("loop", title, words, style.TALL, paint)]
    return [
        *_plots_of_gears(model),
        *_plots_of_points(model),
        *_bode_plots(model),
    ]


def _plots_of_gears(model: ActuatorModel) -> list[Plot]:
    """Return the loop of the gears, and their slopes."""
    gears = model.backlash
    x_label, y_label = "Input of the gears", "Output of the gears"
    travelled = "Input travelled since the turn"
    if model.stages[0] is gears:
        x_label = _quantity(model.input)
        travelled = axis_label(travelled, model.input.unit)
    if model.stages[-1] is gears:
        y_label = _quantity(model.output)
    # Spare gears stand beyond both ends of the logs' range; what they would do was
    # never seen.
    covered = model.covered_gears
    if model.direction == "inverse":
        covered = covered.inverse()
    paint_loop = partial(_paint_gears, covered, (x_label, y_label))
    paint_slopes = partial(_paint_slopes, covered, travelled)
    loop = (
        "Output against input of the backlash operator over the logs' range,"
        f" {covered.n} gears, up and down."
    )
    slopes = "Slope of each gear, one step as wide as the gear, in the order they engage after a turn."
    return [
        Plot(
            "gears",
            f"The loop of the {covered.n} gears over the logs' range",
            loop,
            style.TALL,
            paint_loop,
        ),
        Plot(
            "slopes",
            "Slope of the gears against their width",
            slopes,
            style.WIDE,
            paint_slopes,
        ),
    ]


def _plots_of_points(model: ActuatorModel) -> list[Plot]:
    """Return the curves before and after the gears."""
    plots = []
    usual = "after" if model.is_forward else "before"
    side = "before"
    for stage in model.stages:
        if stage is model.backlash:
            side = "after"
        if isinstance(stage, DiscretePointOperator):
            key = "points"
            if side != usual:
                key = f"points-{side}"
            title = f"The curve {side} the gears, {counted(stage.m, 'segment')}"
            words = f"Output against input of the point operator of {stage.m} segments {side} the gears."
            paint = partial(_paint_points, stage)
            plots.append(Plot(key, title, words, style.TALL, paint))
    return plots


def _quantity(quantity: Quantity) -> str:
    return axis_label(quantity.quantity.capitalize(), quantity.unit)


def _corners(
    operator: DiscreteBacklashOperator | DiscretePointOperator,
) -> tuple[Floats, Floats]:
    """Return where the gears or segments begin and the last one ends."""
    x = operator.x0 + np.concatenate([[0.0], np.cumsum(operator.dx)])
    return x, operator.y0 + np.concatenate([[0.0], np.cumsum(operator.dy)])


def loop_of(
    operator: DiscreteBacklashOperator,
) -> tuple[Floats, Floats, Floats, Floats]:
    """Return the major loop, (2) and (3): x and y of the corners on the way up, then on the way down.

    Both ways start with gear 0: after a turn at either end it is the first that
    engages.
    """
    x, y = _corners(operator)
    return x, y, x[-1] - (x - x[0]), y[-1] - (y - y[0])


def _paint_gears(
    gears: DiscreteBacklashOperator, labels: tuple[str, str], axes: Axes
) -> None:
    up_x, up_y, down_x, down_y = loop_of(gears)
    marks = {}
    if gears.n <= FEW:
        marks = {"marker": "o", "markersize": 3.2}
    axes.plot(up_x, up_y, label="up", **(style.SOLID | marks))
    axes.plot(down_x, down_y, label="down", **(style.DASHED | marks))
    finish(axes, *labels)


def _paint_slopes(gears: DiscreteBacklashOperator, travelled: str, axes: Axes) -> None:
    edges = np.concatenate([[0.0], np.cumsum(gears.dx)])
    slopes = gears.dy / gears.dx
    axes.stairs(slopes, edges, baseline=None, color=style.FIRST, linewidth=1.3)
    axes.set_ylim(0.0, 1.06 * float(slopes.max()))
    axes.set(xlabel=travelled, ylabel="Slope ΔY/ΔX of the gear")


def _bode_plots(model: ActuatorModel) -> list[Plot]:
    """Return gain and phase of the dynamics; of an inverse model those that it undoes."""
    if model.drive_lag is None and model.dynamics is None:
        return []
    words = "of the dynamics against frequency, both measured and of the model, frequency logarithmic."
    plots = []
    for key, what in (("bode", "Gain"), ("bode-phase", "Phase")):
        title = f"{what} of the dynamics"
        paint = partial(_paint_bode, model, what)
        plots.append(Plot(key, title, f"{what} {words}", style.WIDE, paint))
    return plots


def _measured_response(model: ActuatorModel) -> dict[str, Floats]:
    """Return what the identification kept of the measured response; empty where it kept none."""
    dynamics = model.fit.get("dynamics")
    if not isinstance(dynamics, Mapping):
        return {}
    response = dynamics.get("response")
    if not isinstance(response, Mapping):
        return {}
    columns: dict[str, Floats] = {}
    for key in ("frequency", "gain", "phase_degrees"):
        values = response.get(key)
        if not isinstance(values, list):
            return {}
        try:
            columns[key] = np.array(values, dtype=np.float64)
        except (TypeError, ValueError):
            return {}
    frequency = columns["frequency"]
    alike = all(column.shape == frequency.shape for column in columns.values())
    if not alike or frequency.ndim != 1 or not frequency.size:
        return {}
    if not np.all(frequency > 0.0):
        return {}
    return columns


def _modelled_response(model: ActuatorModel) -> tuple[Floats, Complexes]:
    """Return frequencies (Hz) around what was swept, or around the resonances, and the response there."""
    measured = _measured_response(model)
    stages = [stage for stage in (model.drive_lag, model.dynamics) if stage is not None]
    sections = [section for stage in stages for section in stage.sections]
    quick = [section for section in sections if not _is_creep(section)]
    corners = [_corner_of(section) for section in quick or sections]
    low = 0.03 * min(corners)
    high = 3.0 * max(corners)
    if measured:
        low = float(measured["frequency"].min())
        high = float(measured["frequency"].max())
    near = []
    for section in sections:
        if isinstance(section, Resonance):
            # a peak is narrower than a step elsewhere
            near.append(section.frequency * np.linspace(0.9, 1.1, 101))
    at = np.unique(np.concatenate([np.geomspace(low, high, 400), *near]))
    at = at[(at >= low) & (at <= high)]
    return at, np.prod([stage.response(at) for stage in stages], axis=0)


def _is_creep(section: Section) -> bool:
    """Whether a section is slow: a lag with a lead."""
    return isinstance(section, Lag) and section.lead > 0.0


def _corner_of(section: Section) -> float:
    """Return the frequency (Hz) about which a section changes gain and phase most."""
    if isinstance(section, Resonance):
        return section.highest
    return 0.5 / (math.pi * section.seconds)


def _paint_bode(model: ActuatorModel, what: str, axes: Axes) -> None:
    at, response = _modelled_response(model)
    measured = _measured_response(model)
    axes.set_xscale("log")
    if what == "Gain":
        axes.set_yscale("log")
        shown = np.abs(response)
        if measured:
            points = measured["gain"] / measured["gain"][0] * shown[0]
    else:
        shown = np.degrees(np.unwrap(np.angle(response)))
        if measured:
            points = measured["phase_degrees"]
            points = points + 360.0 * np.round((shown[0] - points[0]) / 360.0)
    if measured:
        axes.plot(measured["frequency"], points, label="measured", **style.POINTS)
    axes.plot(at, shown, label="model", **style.SOLID)
    trusted = model.fit.get("trusted_hz")
    if isinstance(trusted, int | float) and trusted > 0.0:
        axes.axvline(trusted, label="trusted up to", **style.DOTTED)
    label_decades(axes.xaxis)
    if what == "Gain":
        label_decades(axes.yaxis)
        finish(axes, "Frequency (Hz)", "Gain")
    else:
        finish(axes, "Frequency (Hz)", "Phase (degrees)")


def slow_loop(model: ActuatorModel, count: int = 1001) -> tuple[Floats, Floats, Floats]:
    """Return the input on the way up, and the output there and on the way down, slowly and without delay."""
    up = np.linspace(model.input.minimum, model.input.maximum, count)
    still = model.without(model.delay)
    walk = np.concatenate((up, up[::-1]))
    start = still.start(float(up[0]), "empty")
    slowly = 1e9 if still.needs_time else None
    y = still.simulate(walk, start, time_step=slowly).y
    return up, y[:count], y[: count - 1 : -1]


def _paint_slow_loop(model: ActuatorModel, axes: Axes) -> None:
    drive, rising, falling = slow_loop(model)
    axes.plot(drive, rising, label="up", **style.SOLID)
    axes.plot(drive, falling, label="down", **style.DASHED)
    finish(axes, _quantity(model.input), _quantity(model.output))


def _paint_points(stage: DiscretePointOperator, axes: Axes) -> None:
    x, y = _corners(stage)
    axes.plot([x[0], x[-1]], [y[0], y[-1]], label="straight line", **style.DOTTED)
    marks = {}
    if stage.m <= FEW:
        marks = {"marker": "o", "markersize": 4.0}
    axes.plot(x, y, label="points", **(style.SOLID | marks))
    finish(axes, "Input of the points", "Output of the points")
