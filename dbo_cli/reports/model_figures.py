"""The figures of a model: its gears as the loop they make, their slopes against their widths, its points.

``gears`` and ``points`` are drawn in the manner of the paper's Figs. 1 to 3.
"""

from __future__ import annotations

import dataclasses
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from dbo_cli.hysteresis.cascade import OtherHysteresis
from dbo_cli.hysteresis.delay import DelayStage
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.hysteresis.operators import DiscreteBacklashOperator, DiscretePointOperator
from dbo_cli.reports import figure_style as style
from dbo_cli.reports.drawing import Plot
from dbo_cli.reports.figures import axis_label, mark_curves
from dbo_cli.reports.running_statistics import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FEW = 40


def plots_of_model(model: ActuatorModel) -> list[Plot]:
    """Return the figures of a model in either direction; of one without gears, the loop of the whole."""
    if any(isinstance(stage, OtherHysteresis) for stage in model.stages):
        words = f"Output against input of the model with {model.size}, slowly up and back down."
        paint = partial(_paint_slow_loop, model)
        return [Plot("loop", f"The loop of the model with {model.size}", words, style.TALL, paint)]
    view = _ModelView(model)
    gears = model.backlash
    plots = [
        Plot(
            "gears",
            f"The loop of the {gears.n} gears",
            f"Output against input of the backlash operator of {gears.n} gears, up and back down.",
            style.TALL,
            view.gears,
        ),
        Plot(
            "slopes",
            "Slope of the gears against their width",
            "Slope of each gear, one step as wide as the gear, in the order they engage after a turn.",
            style.WIDE,
            view.slopes,
        ),
    ]
    return plots + [view.plot_of(place) for place in view.point_places]


def loop_of(operator: DiscreteBacklashOperator) -> tuple[Floats, Floats, Floats, Floats]:
    """Return the major loop, (2) and (3): x and y of the corners on the way up, then on the way down.

    Both ways start with gear 0: after a turn at either end it is the first that engages.
    """
    x = operator.x0 + np.concatenate([[0.0], np.cumsum(operator.dx)])
    y = operator.y0 + np.concatenate([[0.0], np.cumsum(operator.dy)])
    return x, y, x[-1] - (x - x[0]), y[-1] - (y - y[0])


class _ModelView:
    """Paint the figures of one model."""

    def __init__(self, model: ActuatorModel) -> None:
        self._model = model
        self._gears = model.backlash
        place = next(i for i, stage in enumerate(model.stages) if stage is self._gears)
        first, last = place == 0, place == len(model.stages) - 1
        self._input = (
            axis_label(model.input.quantity.capitalize(), model.input.unit) if first else "Input of the gears"
        )
        self._output = (
            axis_label(model.output.quantity.capitalize(), model.output.unit)
            if last
            else "Output of the gears"
        )
        self._gear_place = place
        self.point_places = [
            i for i, stage in enumerate(model.stages) if isinstance(stage, DiscretePointOperator)
        ]

    def plot_of(self, place: int) -> Plot:
        """Return the figure of the point stage at ``place`` of the cascade."""
        stage = self._model.stages[place]
        assert isinstance(stage, DiscretePointOperator)
        side = "before" if place < self._gear_place else "after"
        title = f"The curve {side} the gears, {stage.m} segment{'' if stage.m == 1 else 's'}"
        usual = "after" if self._model.direction == "forward" else "before"
        key = "points" if side == usual else f"points-{side}"
        words = f"Output against input of the point operator of {stage.m} segments {side} the gears."
        return Plot(key, title, words, style.TALL, partial(_paint_points, stage))

    def gears(self, axes: Axes) -> None:
        up_x, up_y, down_x, down_y = loop_of(self._gears)
        marks = {"marker": "o", "markersize": 3.2} if self._gears.n <= FEW else {}
        axes.plot(up_x, up_y, label="up", **(style.SOLID | marks))
        axes.plot(down_x, down_y, label="down", **(style.DASHED | marks))
        axes.set(xlabel=self._input, ylabel=self._output)
        mark_curves(axes)

    def slopes(self, axes: Axes) -> None:
        edges = np.concatenate([[0.0], np.cumsum(self._gears.dx)])
        slopes = self._gears.dy / self._gears.dx
        axes.stairs(slopes, edges, baseline=None, color=style.FIRST, linewidth=1.3)
        axes.set_ylim(0.0, 1.06 * float(slopes.max()))
        unit = self._model.input.unit if self._input != "Input of the gears" else None
        axes.set(xlabel=axis_label("Input travelled since the turn", unit), ylabel="Slope ΔY/ΔX of the gear")


def slow_loop(model: ActuatorModel, count: int = 1001) -> tuple[Floats, Floats, Floats]:
    """Return the input on the way up, and the output there and on the way down, slowly and without delay."""
    up = np.linspace(model.input.minimum, model.input.maximum, count)
    stages = tuple(stage for stage in model.stages if not isinstance(stage, DelayStage))
    still = dataclasses.replace(model, stages=stages)
    walk = np.concatenate((up, up[::-1]))
    start = still.start(float(up[0]), "empty")
    y = still.simulate(walk, start, time_step=1e9 if still.needs_time else None).y
    return up, y[:count], y[: count - 1 : -1]


def _paint_slow_loop(model: ActuatorModel, axes: Axes) -> None:
    drive, rising, falling = slow_loop(model)
    axes.plot(drive, rising, label="up", **style.SOLID)
    axes.plot(drive, falling, label="down", **style.DASHED)
    axes.set(xlabel=axis_label(model.input.quantity.capitalize(), model.input.unit))
    axes.set(ylabel=axis_label(model.output.quantity.capitalize(), model.output.unit))
    mark_curves(axes)


def _paint_points(stage: DiscretePointOperator, axes: Axes) -> None:
    x = stage.x0 + np.concatenate([[0.0], np.cumsum(stage.dx)])
    y = stage.y0 + np.concatenate([[0.0], np.cumsum(stage.dy)])
    ends = [x[0], x[-1]], [y[0], y[-1]]
    axes.plot(*ends, label="straight line", color=style.INK, linewidth=0.9, linestyle=(0, (1, 1.6)))
    marks = {"marker": "o", "markersize": 4.0} if stage.m <= FEW else {}
    axes.plot(x, y, label="points", **(style.SOLID | marks))
    axes.set(xlabel="Input of the points", ylabel="Output of the points")
    mark_curves(axes)
