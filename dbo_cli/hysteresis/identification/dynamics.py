"""Identification of dynamics: resonances and a lag, from small sweeps and fast logs.

The gears, the points and creep come from the slow rows; what they predict for the fast ones is the input of
the dynamics, and what was measured their output. Frequencies and dampings start from the ratio of the two
spectra and are refined on the output error. None, one or two resonances: by the error on rows left out.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.signal import csd, welch

from dbo_cli.errors import FitError
from dbo_cli.hysteresis.cascade import slow_output_range
from dbo_cli.hysteresis.dynamics import DynamicsStage, Lag, Resonance, Section
from dbo_cli.hysteresis.identification.evaluation import predict, validation_of
from dbo_cli.hysteresis.identification.fast_parts import FastPart, split
from dbo_cli.hysteresis.identification.options import IdentificationOptions
from dbo_cli.hysteresis.identification.recordings import Floats, Recording
from dbo_cli.hysteresis.model import ActuatorModel, BacklashStage, DelayStage, Relaxation

Booleans = NDArray[np.bool_]
Found = tuple[ActuatorModel, dict[str, object], list[str], list[str]]

FOLDS = 5
BLOCKS = 40  # of the fast rows, dealt out to the folds in turn, so that every fold has all frequencies
EARNED = 0.9
"""Of the error on blocks left out: one more resonance must lower it to this.

Actuators without a resonance, fitted with one, came to 0.97 to 1.00; with a heavily damped one at half the
swept band, 0.3.
"""
DAMPINGS = (0.002, 0.02, 0.1, 0.4)  # a refinement starts from each: the error has several minima in it
LEAST_DAMPING, MOST_DAMPING = 1e-4, 0.98
FAST_LAGS = 2.0  # periods of the lowest swept frequency: shorter relaxation is part of the dynamics
TRUSTED = 0.1  # of what was predicted, in a third of an octave: the error up to which a model is trusted
TRUSTED_PART = 0.7  # of the lowest resonance, the most that is trusted: a change of 5 % there costs a tenth
ENERGY = 0.003  # of the strongest third of an octave of the drive (amplitude): with less, nothing is known
OVERLAP = 2.0  # standard errors on either side make an interval


class Signals(NamedTuple):
    """Of one fast part: what the slow model predicts, what was measured, its offset columns, and blocks."""

    predicted: Floats
    measured: Floats
    offsets: Floats
    block: NDArray[np.int64]
    time_step: float


@dataclass(frozen=True)
class Candidate:
    """Dynamics fitted: resonances, a lag (0 for none), the error on all rows and on blocks left out."""

    resonances: tuple[tuple[float, float], ...]
    lag: float
    rmse: float
    left_out: float
    spread: tuple[float, ...]

    @property
    def sections(self) -> tuple[Section, ...]:
        """The sections of the stage, the lag first."""
        lag: tuple[Section, ...] = (Lag(self.lag),) if self.lag > 0.0 else ()
        return (*lag, *(Resonance(f, z) for f, z in self.resonances))


def with_dynamics(
    recordings: Sequence[Recording],
    options: IdentificationOptions,
    validation: Sequence[Recording],
    identify: Callable[..., Any],
) -> Found | None:
    """Return a model with dynamics, its figures, summary and warnings; None where the logs show none.

    Parameters
    ----------
    recordings, options, validation
        As of ``identify``.
    identify
        Identifies the slow rows alone.

    Raises
    ------
    FitError
        Resonances are asked for, and no log has a part in which they would show.
    """
    slow, fast = split(recordings)
    asked = options.dynamics
    if not fast or not slow:
        if asked:
            raise FitError(
                f"`dynamics` {asked}: no log has a small sweep, nor is one ten times as fast as another "
                "(record a drive of excite with `sweep_to`)"
            )
        return None
    try:
        base = identify(slow, dataclasses.replace(options, dynamics=0))
    except FitError:
        if asked:
            raise
        return None
    model = _instantaneous(base.model, min(part.lowest for part in fast))
    signals = [_signals(model, part) for part in fast]
    highest = max(part.highest for part in fast)
    chosen = _chosen(signals, min(part.lowest for part in fast), highest, asked)
    if chosen is None:
        return None
    return _assembled(base, model, chosen, signals, fast, validation, options, highest)


def _instantaneous(model: ActuatorModel, lowest: float) -> ActuatorModel:
    """Return a model without delay, its fast relaxation taken as immediate.

    A delay and relaxation of milliseconds stand in a slow model for what the dynamics say better.
    """
    stages = []
    for stage in model.stages:
        if isinstance(stage, DelayStage):
            continue
        if isinstance(stage, BacklashStage) and stage.relaxation is not None:
            stage = _without_fast_lags(stage, FAST_LAGS / lowest)
        stages.append(stage)
    return dataclasses.replace(model, stages=tuple(stages))


def _without_fast_lags(gears: BacklashStage, shortest: float) -> BacklashStage:
    terms = gears.relaxation
    assert terms is not None
    kept = [(tau, gain) for tau, gain in zip(terms.tau, terms.gain, strict=True) if tau >= shortest]
    added = sum(gain for tau, gain in zip(terms.tau, terms.gain, strict=True) if tau < shortest)
    # gain·(v − reference), at once: every gear steeper by it, and the corner where it then lies.
    heights = gears.dy + added * gears.dx
    y0 = gears.y0 + added * (gears.x0 - terms.reference)
    rest = None
    if kept:
        rest = Relaxation(terms.reference, tuple(t for t, _ in kept), tuple(g for _, g in kept))
    return BacklashStage(gears.dx, heights, gears.x0, y0, rest)


def _signals(model: ActuatorModel, part: FastPart) -> Signals:
    rows = part.rows
    predicted = predict(model, part.recording)[rows]
    measured = part.recording.displacement[rows]
    at = np.linspace(-1.0, 1.0, measured.size)
    block = (np.arange(measured.size) * BLOCKS) // measured.size
    return Signals(predicted, measured, np.column_stack([np.ones_like(at), at]), block, part.time_step)


def _residuals(signals: Sequence[Signals], sections: tuple[Section, ...]) -> list[Floats]:
    """Return measured minus predicted through the sections, gain, offset and drift of each part fitted."""
    left = []
    for one in signals:
        moved = one.predicted
        if sections:
            moved, _ = DynamicsStage(sections).run(one.predicted, one.time_step, None)
        columns = np.column_stack([moved, one.offsets])
        left.append(one.measured - columns @ np.linalg.lstsq(columns, one.measured, rcond=None)[0])
    return left


def _sections(parameters: Floats, count: int) -> tuple[Section, ...]:
    """Return the sections of logarithms: frequency and damping each, then the lag."""
    values = np.exp(parameters)
    resonances = [
        Resonance(float(values[2 * k]), float(min(values[2 * k + 1], MOST_DAMPING))) for k in range(count)
    ]
    return (Lag(float(values[-1])), *resonances)


def _refined(
    signals: Sequence[Signals], start: Floats, count: int, bounds: tuple[Floats, Floats], keep: Booleans
) -> tuple[Floats, float]:
    """Return the parameters of least error on the blocks to keep, and that error (RMS)."""
    chosen = [keep[one.block] for one in signals]

    def error(parameters: Floats) -> Floats:
        left = _residuals(signals, _sections(parameters, count))
        return np.concatenate([part[rows] for part, rows in zip(left, chosen, strict=True)])

    found = least_squares(
        error, np.clip(start, *bounds), bounds=bounds, x_scale=0.1, diff_step=1e-5, max_nfev=40
    )
    return found.x, float(np.sqrt(np.mean(found.fun**2)))


def _fitted(signals: Sequence[Signals], starts: Sequence[Floats], count: int, highest: float) -> Candidate:
    """Return the best of several refinements, and its error on blocks left out."""
    step = min(one.time_step for one in signals)
    low = np.log([*[highest / 1e3, LEAST_DAMPING] * count, 1e-3 * step])
    high = np.log([*[1.5 * highest, MOST_DAMPING] * count, 10.0 / highest])
    every = np.ones(BLOCKS, dtype=bool)
    tried = [_refined(signals, start, count, (low, high), every) for start in starts]
    best, rmse = min(tried, key=lambda one: one[1])
    squares, rows, folds = 0.0, 0, []
    for fold in range(FOLDS):
        keep = np.arange(BLOCKS) % FOLDS != fold
        parameters, _ = _refined(signals, best, count, (low, high), keep)
        folds.append(parameters)
        left = _residuals(signals, _sections(parameters, count))
        for part, one in zip(left, signals, strict=True):
            out = part[~keep[one.block]]
            squares, rows = squares + float(out @ out), rows + out.size
    away = np.array(folds) - np.mean(folds, axis=0)
    spread = np.sqrt((FOLDS - 1.0) / FOLDS * np.sum(away * away, axis=0))  # the jackknife's standard error
    values = np.exp(best)
    order = np.argsort(values[0 : 2 * count : 2])
    resonances = [(float(values[2 * k]), float(values[2 * k + 1])) for k in order]
    spread = np.array([spread[2 * k + side] for k in order for side in (0, 1)])
    lag = float(values[-1]) if values[-1] > 2e-3 * step else 0.0
    return Candidate(tuple(resonances), lag, rmse, float(np.sqrt(squares / rows)), tuple(spread.tolist()))


def _peaks(signals: Sequence[Signals], lowest: float, highest: float, but: Sequence[float] = ()) -> float:
    """Return where the measured exceeds the predicted most (Hz), away from the resonances found already."""
    one = max(signals, key=lambda part: part.measured.size)
    size = min(one.measured.size, max(256, round(8.0 / (lowest * one.time_step))))
    rate = 1.0 / one.time_step
    frequency, power = welch(one.predicted, rate, nperseg=size)
    cross = csd(one.predicted, one.measured, rate, nperseg=size)[1]
    ratio = np.abs(cross) / np.maximum(power, 1e-12 * power.max())
    inside = (frequency >= lowest) & (frequency <= highest) & (power > ENERGY**2 * power.max())
    for known in but:
        inside &= np.abs(np.log(np.maximum(frequency, 1e-9) / known)) > 0.3
    if not inside.any():
        return 0.7 * highest
    return float(frequency[inside][np.argmax(ratio[inside])])


def _chosen(signals: Sequence[Signals], lowest: float, highest: float, asked: int | None) -> Candidate | None:
    """Return the dynamics that earn their place on blocks left out, or None."""
    lag_starts = [np.log([value]) for value in (0.02 / highest, 0.3 / highest)]
    best = _fitted(signals, lag_starts, 0, highest)
    most = 2 if asked is None else asked
    for count in range(1, most + 1):
        known = [frequency for frequency, _ in best.resonances]
        peak = _peaks(signals, lowest, highest, known)
        lag = np.log(max(best.lag, 0.02 / highest))
        before = [x for f, z in best.resonances for x in (np.log(f), np.log(z))]
        starts = [np.array([*before, np.log(at), np.log(z), lag]) for z in DAMPINGS
                  for at in ((peak,) if count == 1 else (peak, 0.8 * highest))]  # fmt: skip
        more = _fitted(signals, starts, count, highest)
        inside = all(lowest < frequency < highest for frequency, _ in more.resonances)
        earned = more.left_out <= EARNED * best.left_out and inside
        if not earned and asked is None:
            break
        best = more
    return best if best.resonances else None


def _assembled(
    base: Any,
    model: ActuatorModel,
    chosen: Candidate,
    signals: Sequence[Signals],
    fast: Sequence[FastPart],
    validation: Sequence[Recording],
    options: IdentificationOptions,
    highest: float,
) -> Found:
    """Return the whole model with what is to be said of it."""
    stages = (*model.stages, DynamicsStage(chosen.sections))
    low, high = slow_output_range(stages, model.input.minimum, model.input.maximum)
    output = dataclasses.replace(model.output, minimum=low, maximum=high)
    trusted, why = _trusted(signals, chosen, highest)
    figures: dict[str, object] = dict(base.fit)
    figures["dynamics"] = {
        "resonances": [
            {
                "frequency": frequency,
                "damping": damping,
                "frequency_interval": _interval(frequency, chosen.spread[2 * k]),
                "damping_interval": _interval(damping, chosen.spread[2 * k + 1]),
            }
            for k, (frequency, damping) in enumerate(chosen.resonances)
        ],
        "lag_seconds": chosen.lag,
        "rmse": chosen.rmse,
        "cross_validated_rmse": chosen.left_out,
        "logs": [part.recording.name for part in fast],
        "swept": [min(part.lowest for part in fast), highest],
    }
    figures["trusted_hz"] = trusted
    figures["delay_seconds"] = 0.0
    whole = dataclasses.replace(model, stages=stages, output=output, fit={})
    checks = [validation_of(whole, options.sensor.taken_off(log), options.skip_seconds) for log in validation]
    unit = f" {model.output.unit}" if model.output.unit else ""
    summary = [*base.summary, *_said(figures, chosen, trusted, why, unit)]
    if checks:
        rows = sum(len(one.values) for one in checks)
        rmse = float(np.sqrt(sum(float(one.values @ one.values) for one in checks) / rows))
        figures["validation_rmse"] = rmse
        figures["validation_percent"] = 100.0 * rmse / output.span
        figures["validation"] = [
            {"name": one.name, "samples": len(one.values), "rmse": one.rmse} for one in checks
        ]
        summary += [f"{one.name}: predicts it to {one.rmse:.4g}{unit} RMSE, offset removed" for one in checks]
    return dataclasses.replace(whole, fit=figures), figures, summary, list(base.warnings)


def _interval(value: float, spread: float) -> list[float]:
    return [value * float(np.exp(-OVERLAP * spread)), value * float(np.exp(OVERLAP * spread))]


def _trusted(signals: Sequence[Signals], chosen: Candidate, highest: float) -> tuple[float, str]:
    """Return the frequency (Hz) up to which the model is good, and what ends it."""
    one = max(signals, key=lambda part: part.measured.size)
    moved, _ = DynamicsStage(chosen.sections).run(one.predicted, one.time_step, None)
    (left,) = _residuals([one], chosen.sections)
    size = min(moved.size, 8192)
    frequency, power = welch(moved, 1.0 / one.time_step, nperseg=size)
    off = welch(left, 1.0 / one.time_step, nperseg=size)[1]
    band = np.floor(3.0 * np.log2(np.maximum(frequency[1:] / frequency[1], 1.0))).astype(int)
    energy = np.sqrt(np.bincount(band, power[1:]))
    error = np.sqrt(np.bincount(band, off[1:]))
    tops = frequency[1] * 2.0 ** ((np.arange(energy.size) + 1) / 3.0)
    ceiling = TRUSTED_PART * min(f for f, _ in chosen.resonances)
    trusted = float(frequency[1])
    for top, has, wrong in zip(tops.tolist(), energy.tolist(), error.tolist(), strict=True):
        if has <= ENERGY * float(energy.max()):
            if top < highest / 50.0:
                continue
            return min(trusted, ceiling), "beyond, the sweep was too small" if trusted < ceiling else ""
        if wrong > TRUSTED * has and top > 0.02 * highest:
            return min(trusted, ceiling), "beyond, the error grows" if trusted < ceiling else ""
        trusted = top
    return min(trusted, ceiling, highest), ""


def _said(figures: dict[str, object], chosen: Candidate, trusted: float, why: str, unit: str) -> list[str]:
    """Return the lines about the dynamics."""
    parts = []
    for k, (frequency, damping) in enumerate(chosen.resonances):
        low, high = _interval(frequency, chosen.spread[2 * k])
        thin, wide = _interval(damping, chosen.spread[2 * k + 1])
        parts.append(
            f"resonance at {frequency:.5g} Hz ({low:.5g} to {high:.5g}), damping {damping:.3g} "
            f"({thin:.3g} to {wide:.3g})"
        )
    lag = f", lag {1e3 * chosen.lag:.3g} ms" if chosen.lag > 0.0 else ""
    return [
        f"dynamics: {'; '.join(parts)}{lag}; fast rows RMSE {chosen.rmse:.3g}{unit}, on blocks left out "
        f"{chosen.left_out:.3g}{unit}",
        f"trust the model to {trusted:.3g} Hz{': ' + why if why else ''}",
    ]
