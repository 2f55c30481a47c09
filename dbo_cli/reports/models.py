"""The figures of a model.

``gears`` and ``points`` are drawn in the manner of the paper's Figs. 1 to 3.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from dbo_cli.hysteresis.cascade import OtherHysteresis
from dbo_cli.hysteresis.dynamics import Complexes, Lag, Resonance
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
    if any(isinstance(stage, OtherHysteresis) for stage in model.stages):
        words = f"Output against input of the model with {model.size}, slowly up and back down."
        paint = partial(_paint_slow_loop, model)
        return [
            Plot(
                "loop",
                f"The loop of the model with {model.size}",
                words,
                style.TALL,
                paint,
            )
        ]
    gears = model.backlash
    place = next(i for i, stage in enumerate(model.stages) if stage is gears)
    first, last = place == 0, place == len(model.stages) - 1
    labels = (
        _quantity(model.input) if first else "Input of the gears",
        _quantity(model.output) if last else "Output of the gears",
    )
    travelled = axis_label(
        "Input travelled since the turn", model.input.unit if first else None
    )
    # Spare gears stand beyond both ends of the logs' range; what they would do was
    # never seen.
    covered = model.covered_gears
    if model.direction == "inverse":
        covered = covered.inverse()
    paint_loop = partial(_paint_gears, covered, labels)
    paint_slopes = partial(_paint_slopes, covered, travelled)
    loop = (
        "Output against input of the backlash operator over the logs' range,"
        f" {covered.n} gears, up and down."
    )
    slopes = "Slope of each gear, one step as wide as the gear, in the order they engage after a turn."
    plots = [
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
    usual = "after" if model.direction == "forward" else "before"
    for number, stage in enumerate(model.stages):
        if isinstance(stage, DiscretePointOperator):
            side = "before" if number < place else "after"
            title = f"The curve {side} the gears, {stage.m} segment{'' if stage.m == 1 else 's'}"
            words = f"Output against input of the point operator of {stage.m} segments {side} the gears."
            key = "points" if side == usual else f"points-{side}"
            plots.append(
                Plot(key, title, words, style.TALL, partial(_paint_points, stage))
            )
    return plots + _bode_plots(model)


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
    marks = {"marker": "o", "markersize": 3.2} if gears.n <= FEW else {}
    axes.plot(up_x, up_y, label="up", **(style.SOLID | marks))
    axes.plot(down_x, down_y, label="down", **(style.DASHED | marks))
    finish(axes, *labels)


def _paint_slopes(gears: DiscreteBacklashOperator, travelled: str, axes: Axes) -> None:
    edges, slopes = np.concatenate([[0.0], np.cumsum(gears.dx)]), gears.dy / gears.dx
    axes.stairs(slopes, edges, baseline=None, color=style.FIRST, linewidth=1.3)
    axes.set_ylim(0.0, 1.06 * float(slopes.max()))
    axes.set(xlabel=travelled, ylabel="Slope ΔY/ΔX of the gear")


def _bode_plots(model: ActuatorModel) -> list[Plot]:
    """Return gain and phase of the dynamics; of an inverse model those that it undoes."""
    if model.drive_lag is None and model.dynamics is None:
        return []
    words = "of the dynamics against frequency, both measured and of the model, frequency logarithmic."
    return [
        Plot(
            key,
            f"{what} of the dynamics",
            f"{what} {words}",
            style.WIDE,
            partial(_paint_bode, model, what),
        )
        for key, what in (("bode", "Gain"), ("bode-phase", "Phase"))
    ]


def _measured_response(model: ActuatorModel) -> dict[str, Floats]:
    """Return what the identification kept of the measured response; empty where it kept none."""
    dynamics = model.fit.get("dynamics")
    kept = dynamics.get("response") if isinstance(dynamics, Mapping) else None
    keys = ("frequency", "gain", "phase_degrees")
    if not isinstance(kept, Mapping) or not all(
        isinstance(kept.get(key), list) for key in keys
    ):
        return {}
    try:
        found = {key: np.array(kept[key], dtype=np.float64) for key in keys}
    except (TypeError, ValueError):
        return {}
    alike = (
        len({values.shape for values in found.values()}) == 1
        and found["frequency"].ndim == 1
    )
    return (
        found
        if alike and found["frequency"].size and bool(np.all(found["frequency"] > 0.0))
        else {}
    )


def _modelled_response(model: ActuatorModel) -> tuple[Floats, Complexes]:
    """Return frequencies (Hz) around what was swept, or around the resonances, and the response there."""
    measured = _measured_response(model)
    stages = [stage for stage in (model.drive_lag, model.dynamics) if stage is not None]
    sections = [section for stage in stages for section in stage.sections]
    # creep is slow
    quick = [one for one in sections if not (isinstance(one, Lag) and one.lead)]
    corners = [
        s.highest if isinstance(s, Resonance) else 0.5 / (np.pi * s.seconds)
        for s in quick or sections
    ]
    low, high = 0.03 * min(corners), 3.0 * max(corners)
    if measured:
        low, high = (
            float(measured["frequency"].min()),
            float(measured["frequency"].max()),
        )
    peaks = [s.frequency for s in sections if isinstance(s, Resonance)]
    # a peak is narrower than a step elsewhere
    near = [peak * np.linspace(0.9, 1.1, 101) for peak in peaks]
    at = np.unique(np.concatenate([np.geomspace(low, high, 400), *near]))
    at = at[(at >= low) & (at <= high)]
    return at, np.prod([stage.response(at) for stage in stages], axis=0)


def _paint_bode(model: ActuatorModel, what: str, axes: Axes) -> None:
    at, response = _modelled_response(model)
    measured = _measured_response(model)
    axes.set_xscale("log")
    if what == "Gain":
        axes.set_yscale("log")
        shown = np.abs(response)
        if measured:
            seen = measured["gain"] / measured["gain"][0] * shown[0]
    else:
        shown = np.degrees(np.unwrap(np.angle(response)))
        if measured:
            seen = measured["phase_degrees"]
            seen = seen + 360.0 * np.round((shown[0] - seen[0]) / 360.0)
    if measured:
        axes.plot(measured["frequency"], seen, label="measured", **style.POINTS)
    axes.plot(at, shown, label="model", **style.SOLID)
    trusted = model.fit.get("trusted_hz")
    if isinstance(trusted, int | float) and trusted > 0.0:
        axes.axvline(trusted, label="trusted up to", **style.DOTTED)
    label_decades(*([axes.xaxis, axes.yaxis] if what == "Gain" else [axes.xaxis]))
    finish(axes, "Frequency (Hz)", what if what == "Gain" else "Phase (degrees)")


def slow_loop(model: ActuatorModel, count: int = 1001) -> tuple[Floats, Floats, Floats]:
    """Return the input on the way up, and the output there and on the way down, slowly and without delay."""
    up = np.linspace(model.input.minimum, model.input.maximum, count)
    still = model.without(model.delay)
    walk = np.concatenate((up, up[::-1]))
    start = still.start(float(up[0]), "empty")
    y = still.simulate(walk, start, time_step=1e9 if still.needs_time else None).y
    return up, y[:count], y[: count - 1 : -1]


def _paint_slow_loop(model: ActuatorModel, axes: Axes) -> None:
    drive, rising, falling = slow_loop(model)
    axes.plot(drive, rising, label="up", **style.SOLID)
    axes.plot(drive, falling, label="down", **style.DASHED)
    finish(axes, _quantity(model.input), _quantity(model.output))


def _paint_points(stage: DiscretePointOperator, axes: Axes) -> None:
    x, y = _corners(stage)
    axes.plot([x[0], x[-1]], [y[0], y[-1]], label="straight line", **style.DOTTED)
    marks = {"marker": "o", "markersize": 4.0} if stage.m <= FEW else {}
    axes.plot(x, y, label="points", **(style.SOLID | marks))
    finish(axes, "Input of the points", "Output of the points")
