"""Resonances and lags behind the gears, from small sweeps.

What the static model predicts for the fast rows is the input of the dynamics, what was
measured their output. Starts come from the ratio of the two spectra; parameters are
refined on the output error. No, one or two resonances, the last with an antiresonance
or without, and a pure delay: by the error on blocks left out, one step from the whole
fit. ``find`` does this beside a static model that knows no dynamics; the slow rows are
then identified again with the sections known, and ``refine`` fits the sections again.
"""

from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np

from dbo_cli.identification.sections import (
    LEAST_DAMPING,
    MOST_BESIDE,
    Band,
    FastDynamics,
    FastRows,
    Form,
    fitted,
    peak_of,
    phase_delay,
)
from dbo_cli.model import Mode, Resonance
from dbo_cli.signals import noise

MOST_RESONANCES = 2  # one sweep does not tell more apart
SURE, EARNED = 200.0, 0.3
"""The squares left out must fall by so many times the noise's mean square, and by this share of what they
are beyond white noise."""
SHORT_LAG = 0.02  # periods of the highest frequency: a first guess
DAMPINGS = (0.002, 0.02, 0.1, 0.4)  # starts: the error has several minima in it
INSIDE = 1.02  # times a bound at which a fit would like to go on
NEAR = 0.03  # of the logarithms of two resonances that undo each other
LATE = 0.5  # of a step: a shorter lag is no amplifier's
SEEN_DELAY = 0.1  # periods of the highest frequency: less is fitted as a lag
UNEXPLAINED = 0.1  # of what the fast rows do: more is a warning


def find(rows: FastRows, order: str | int) -> FastDynamics:
    """Return the dynamics that the fast rows ask for, with ``order`` resonances or "auto".

    A sensor that is late by half a period of a resonance turns its phase around: without
    a pure delay no resonance fits.
    """
    best = _chosen(rows, order, 0.0)
    phase_lag = phase_delay(rows)
    if phase_lag * rows.band[1] < SEEN_DELAY:
        return best
    return _preferred(rows, _chosen(rows, order, phase_lag), best)


def refine(
    rows: FastRows, found: FastDynamics, order: str | int = "auto"
) -> FastDynamics:
    """Return dynamics fitted again beside a static model that knew those ``found``.

    The lag may stand before the gears: the actuator is the capacity that an amplifier
    charges. In a sweep of 1 % of the range the gears are nearly straight, and both places
    explain it alike; a larger one tells them apart. A lag of less than half a step is no
    more than late. What hides a weak second resonance from the first reading of the slow
    rows is gone with the second: one more is offered.
    """
    best = fitted(rows, [found.parameters], found.form)
    *delay, lag = best.times
    shortest = np.log(LATE * rows.step)
    if lag > shortest:
        start = np.array([*best.modes, lag, *delay, shortest])
        before = fitted(rows, [start], replace(best.form, amplifier=True))
        best = _preferred(rows, best, before)
    if order == "auto" and found.form.resonances < MOST_RESONANCES:
        best = _preferred(rows, _one_more(rows, best), best)
    return best


# --- which dynamics ---


def _chosen(rows: FastRows, order: str | int, delay: float) -> FastDynamics:
    """Return the dynamics that earn their place, or with as many resonances as are asked for."""
    pure_delay = [delay] if delay else []
    starts = []
    for lag in (SHORT_LAG, 0.3):
        starts.append(np.log([*pure_delay, lag / rows.band[1]]))
    best = fitted(rows, starts, Form(0, delay=delay > 0.0))
    limit = MOST_RESONANCES if order == "auto" else int(order)
    while best.form.resonances < limit:
        more = _one_more(rows, best)
        if order == "auto" and _preferred(rows, more, best) is best:
            break
        best = more
    return best


def _one_more(rows: FastRows, best: FastDynamics) -> FastDynamics:
    """Return dynamics with one more resonance.

    It comes with an antiresonance where that earns its place, as two modes that add up
    have one.
    """
    count = best.form.resonances
    form = replace(best.form, resonances=count + 1, antiresonance=False)
    resonances, highest = best.modes[: 2 * count], rows.band[1]
    times = best.times.copy()
    times[-1] = max(times[-1], np.log(SHORT_LAG / highest))
    frequencies = [peak_of(rows, best)]
    if count:
        frequencies.append(0.8 * highest)
    starts = []
    for damping, frequency in product(DAMPINGS, frequencies):
        pair = np.log([frequency, damping])
        starts.append(np.concatenate((resonances, pair, times)))
    more = fitted(rows, starts, form)
    notched = []
    for side in (-NEAR, NEAR):
        notch = more.modes[-2:] + np.array([side, 0.0])
        notched.append(np.concatenate((more.modes, notch, more.times)))
    with_notch = fitted(rows, notched, replace(form, antiresonance=True))
    return _preferred(rows, with_notch, more)


def _preferred(rows: FastRows, more: FastDynamics, best: FastDynamics) -> FastDynamics:
    """Return ``more`` where the error left out asks for it, and all of it is inside the swept band."""
    if not all(_is_inside(resonance, rows.band) for resonance in more.resonances):
        return best
    residuals = rows.residuals(best)
    white = noise(residuals) ** 2
    gained = best.left_out**2 - more.left_out**2
    least = SURE * white / residuals.size, EARNED * (best.left_out**2 - white)
    return more if gained >= max(least) else best


def _is_inside(resonance: Resonance, band: Band) -> bool:
    """Return whether a resonance, and its antiresonance, lie inside the swept band and the bounds."""
    notch = resonance.antiresonance
    modes: list[Mode] = [resonance]
    if notch is not None:
        modes.append(notch)
        if max(mode.damping for mode in modes) > MOST_BESIDE / INSIDE:
            return False
    if resonance.damping < INSIDE * LEAST_DAMPING:
        return False
    return all(INSIDE * band[0] < mode.frequency < band[1] for mode in modes)


def figures_of(rows: FastRows, best: FastDynamics) -> dict[str, Any]:
    """Return what the model file says of the dynamics; warnings where much beyond noise is unexplained."""
    warnings = []
    for signals in rows.signals:
        residuals, sweep = signals.residuals(best), signals.sweep
        excess = max(float(np.var(residuals)) - noise(residuals) ** 2, 0.0)
        share = float(np.sqrt(excess / np.var(signals.measured)))
        if share > UNEXPLAINED:
            low, high = sweep.band
            warnings.append(
                f"{sweep.recording.name}: rows {sweep.rows.start + 1} to {sweep.rows.stop}, {low:.3g} "
                f"to {high:.3g} Hz: {100.0 * share:.0f} % unexplained: slow moves only; try a larger sweep"
            )
    return {
        "rmse": best.rmse,
        "left_out_rmse": best.left_out,
        "logs": [signals.sweep.recording.name for signals in rows.signals],
        "warnings": warnings,
    }
