"""What is said of identified dynamics: intervals, the measured response, how far the model is trusted."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.signal import csd, welch

from dbo_cli.hysteresis.identification.dynamics_fit import Candidate, Signals, residuals

ENERGY = 0.003  # of the strongest third of an octave of the drive (amplitude): with less, nothing is known
TRUSTED = 0.1  # of what was predicted, in a third of an octave: the error up to which a model is trusted
TRUSTED_PART = 0.7  # of the lowest resonance, the most that is trusted: a change of 5 % there costs a tenth
COHERENT = 0.5  # of the square of the response, at least, is no noise where it is shown
MOST_SHOWN = 60  # frequencies of the response that the model keeps, for its figure
OVERLAP = 2.776  # standard errors on either side: Student's t of the jackknife's five folds, 95 %


def response(signals: Sequence[Signals], lowest: float, highest: float) -> dict[str, list[float]]:
    """Return the measured response to what the gears make of the drive: Hz, gain (1 at rest), degrees."""
    one = max(signals, key=lambda part: part.measured.size)
    before, rate = one.predicted(), 1.0 / one.time_step
    size = min(before.size, max(256, round(8.0 / (lowest * one.time_step))))
    frequency, power = welch(before, rate, nperseg=size)
    both, other = csd(before, one.measured, rate, nperseg=size)[1], welch(one.measured, rate, nperseg=size)[1]
    ratio = both / np.maximum(power, 1e-12 * power.max())
    inside = (frequency >= lowest) & (frequency <= highest) & (np.abs(both) ** 2 > COHERENT * power * other)
    rows = np.flatnonzero(inside)
    if not rows.size:
        return {"frequency": [], "gain": [], "phase_degrees": []}
    wanted = np.geomspace(frequency[rows[0]], frequency[rows[-1]], MOST_SHOWN)
    rows = np.unique(rows[np.argmin(np.abs(frequency[rows][None] - wanted[:, None]), axis=1)])
    found = {"frequency": frequency[rows], "gain": np.abs(ratio[rows]),
             "phase_degrees": np.degrees(np.unwrap(np.angle(ratio[rows])))}  # fmt: skip
    return {key: [float(f"{value:.4g}") for value in values] for key, values in found.items()}


def interval(value: float, spread: float) -> list[float]:
    """Return both ends of the interval of a parameter, from the standard error of its logarithm."""
    return [value * float(np.exp(-OVERLAP * spread)), value * float(np.exp(OVERLAP * spread))]


def trusted(signals: Sequence[Signals], chosen: Candidate, highest: float) -> tuple[float, str]:
    """Return the frequency (Hz) up to which the model is good, and what ends it."""
    one = max(signals, key=lambda part: part.measured.size)
    moved = one.moved(chosen.parameters, chosen.structure)
    (left,) = residuals([one], chosen.parameters, chosen.structure)
    size = min(moved.size, 8192)
    frequency, power = welch(moved, 1.0 / one.time_step, nperseg=size)
    off = welch(left, 1.0 / one.time_step, nperseg=size)[1]
    band = np.floor(3.0 * np.log2(np.maximum(frequency[1:] / frequency[1], 1.0))).astype(int)
    energy = np.sqrt(np.bincount(band, power[1:]))
    error = np.sqrt(np.bincount(band, off[1:]))
    tops = frequency[1] * 2.0 ** ((np.arange(energy.size) + 1) / 3.0)
    ceiling = TRUSTED_PART * chosen.resonances[0].frequency
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


def said(figures: dict[str, object], chosen: Candidate, trusted: float, why: str, unit: str) -> list[str]:
    """Return the lines about the dynamics."""
    parts = []
    for k, one in enumerate(chosen.resonances):
        low, high = interval(one.frequency, chosen.spread[2 * k])
        thin, wide = interval(one.damping, chosen.spread[2 * k + 1])
        parts.append(
            f"resonance at {one.frequency:.5g} Hz ({low:.5g} to {high:.5g}), damping {one.damping:.3g} "
            f"({thin:.3g} to {wide:.3g})"
        )
        if one.antiresonance:
            parts[-1] += f" with an antiresonance at {one.antiresonance.frequency:.5g} Hz"
    place = "before" if chosen.structure.lag_before else "behind"
    lag = f", lag {1e3 * chosen.lag:.3g} ms {place} the gears" if chosen.lag > 0.0 else ""
    if chosen.structure.delay:
        lag += f", delay {1e3 * chosen.structure.delay:.4g} ms behind all"
    crept = figures.get("creep", [])
    assert isinstance(crept, list)
    told = ", ".join(f"{100.0 * one['share']:.2g} % with {one['seconds']:.3g} s" for one in crept)
    beside = figures["relaxation_seconds"]
    assert isinstance(beside, list)
    memories = ", ".join(f"{tau:.3g}" for tau in beside)
    return [
        *([f"creep of the displacement, behind the gears: {told}"] if told else []),
        *([f"relaxation beside the gears: {memories} s"] if memories else []),
        f"dynamics: {'; '.join(parts)}{lag}; fast rows RMSE {chosen.rmse:.3g}{unit}, on blocks left out "
        f"{chosen.left_out:.3g}{unit}"
        + (
            "; whether the actuator or its sensor is late a log cannot tell: all of it will be compensated "
            "(`sensor_delay`, `sensor_lag` take the sensor's part off)"
            if max(chosen.lag, chosen.structure.delay) > 0.0 and "sensor" not in figures
            else ""
        ),
        f"trust the model to {trusted:.3g} Hz{': ' + why if why else ''}",
    ]
