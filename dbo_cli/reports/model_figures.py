"""The figures of a model: its gears as the loop they make, their slopes against their widths, its points.

``gears`` and ``points`` are drawn in the manner of the paper's Figs. 1 to 3.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from dbo_cli.hysteresis.cascade import OtherHysteresis
from dbo_cli.hysteresis.delay import DelayStage
from dbo_cli.hysteresis.dynamics import Lag, Resonance
from dbo_cli.hysteresis.linear_sections import Complexes
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.hysteresis.operators import DiscreteBacklashOperator, DiscretePointOperator
from dbo_cli.reports import figure_style as style
from dbo_cli.reports.drawing import Plot
from dbo_cli.reports.figures import axis_label, label_decades, mark_curves
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
    return plots + [view.plot_of(place) for place in view.point_places] + _bode_plots(model)


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


def _bode_plots(model: ActuatorModel) -> list[Plot]:
    """Return gain and phase of the dynamics; of an inverse model those that it undoes."""
    stages = [stage for stage in (model.drive_lag, model.dynamics) if stage is not None]
    if not stages:
        return []
    words = "of the dynamics against frequency, both measured and of the model, frequency logarithmic."
    return [
        Plot("bode", "Gain of the dynamics", f"Gain {words}", style.WIDE, partial(_paint_gain, model)),
        Plot(
            "bode-phase", "Phase of the dynamics", f"Phase {words}", style.WIDE, partial(_paint_phase, model)
        ),
    ]


def _measured_response(model: ActuatorModel) -> dict[str, Floats]:
    """Return what the identification kept of the measured response; empty where it kept none."""
    told = model.fit.get("dynamics")
    kept = told.get("response") if isinstance(told, Mapping) else None
    keys = ("frequency", "gain", "phase_degrees")
    if not isinstance(kept, Mapping) or not all(isinstance(kept.get(key), list) for key in keys):
        return {}
    try:
        found = {key: np.array(kept[key], dtype=np.float64) for key in keys}
    except (TypeError, ValueError):
        return {}
    alike = len({values.shape for values in found.values()}) == 1 and found["frequency"].ndim == 1
    return found if alike and found["frequency"].size and bool(np.all(found["frequency"] > 0.0)) else {}


def _modelled_response(model: ActuatorModel) -> tuple[Floats, Complexes]:
    """Return frequencies (Hz) around what was swept, or around the resonances, and the response there."""
    measured = _measured_response(model)
    stages = [stage for stage in (model.drive_lag, model.dynamics) if stage is not None]
    sections = [section for stage in stages for section in stage.sections]
    sections = [
        one for one in sections if not (isinstance(one, Lag) and one.lead)
    ] or sections  # creep is slow
    corners = [s.highest if isinstance(s, Resonance) else 0.5 / (np.pi * s.seconds) for s in sections]
    low, high = 0.03 * min(corners), 3.0 * max(corners)
    if measured:
        low, high = float(measured["frequency"].min()), float(measured["frequency"].max())
    peaks = [s.frequency for s in sections if isinstance(s, Resonance)]
    near = [peak * np.linspace(0.9, 1.1, 101) for peak in peaks]  # a peak is narrower than a step elsewhere
    at = np.unique(np.concatenate([np.geomspace(low, high, 400), *near]))
    at = at[(at >= low) & (at <= high)]
    return at, np.prod([stage.response(at) for stage in stages], axis=0)


def _paint_gain(model: ActuatorModel, axes: Axes) -> None:
    at, response = _modelled_response(model)
    measured = _measured_response(model)
    if measured:
        gain = measured["gain"] / measured["gain"][0] * abs(response[0])
        axes.loglog(measured["frequency"], gain, label="measured", **_POINTS)
    axes.loglog(at, np.abs(response), label="model", **style.SOLID)
    _finish_bode(model, axes)
    label_decades(axes.yaxis)
    axes.set_ylabel("Gain")


def _paint_phase(model: ActuatorModel, axes: Axes) -> None:
    at, response = _modelled_response(model)
    phase = np.degrees(np.unwrap(np.angle(response)))
    measured = _measured_response(model)
    if measured:
        shift = 360.0 * np.round((phase[0] - measured["phase_degrees"][0]) / 360.0)
        axes.semilogx(measured["frequency"], measured["phase_degrees"] + shift, label="measured", **_POINTS)
    axes.semilogx(at, phase, label="model", **style.SOLID)
    _finish_bode(model, axes)
    axes.set_ylabel("Phase (degrees)")


def _finish_bode(model: ActuatorModel, axes: Axes) -> None:
    trusted = model.fit.get("trusted_hz")
    if isinstance(trusted, int | float) and trusted > 0.0:
        axes.axvline(trusted, label="trusted up to", color=style.INK, linewidth=0.9, linestyle=(0, (1, 1.6)))
    label_decades(axes.xaxis)
    axes.set_xlabel("Frequency (Hz)")
    mark_curves(axes)


_POINTS = {"color": style.SECOND, "linestyle": "none", "marker": "o", "markersize": 3.2}


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
