"""Which dynamics a log asks for: how many resonances, with an antiresonance or without.

One resonance after the other is offered, and judged by the error on blocks of rows left out.
And what is said of them: intervals, the measured response, how far the model is trusted.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy.signal import csd, welch

from dbo_cli.hysteresis.identification.dynamics_fit import (
    LEAST_DAMPING,
    MOST_BESIDE,
    Band,
    Candidate,
    Signals,
    Structure,
    fitted,
    residuals,
)
from dbo_cli.hysteresis.identification.evaluation import WHOSE_LAG, beyond_noise, white_noise
from dbo_cli.hysteresis.identification.recordings import Floats

MOST_RESONANCES = 2  # what stages show within a sweep; more are not told apart by one (see SURE)
EARNED = 0.9
"""Of the error on blocks left out: one more resonance, or an antiresonance, must lower it to this.

So must a lag behind the gears against one before them: a small sweep cannot tell (the gears hardly turn in
it), and an amplifier's lag is the usual one.
Actuators without a resonance, fitted with one, came to 0.97 to 1.00; with a heavily damped one at half the
swept band, 0.3.
"""
SURE, MOST_OF_IT = 200.0, 0.3
"""Or, once one resonance is found, to this: the sum of squares on blocks left out falls by so many times the
noise's mean square, and by this share of what it is beyond white noise.

On invented stages with one mode a second one lowered it by at most 48 where the slow rows had been read with
the lag (by 3 % of what was beyond the noise, up to 553, where they had not); on stages with a second mode of
3 to 6 %, behind amplifiers that let a fifth of it pass, in noise of 0.07 and 0.1 % of the range, by 400 and
more. Without such a mode lags came out 2 to 4 % wrong (0.634 ms for 0.612), and moves at f_r/10 missed by
0.1 to 0.25 % instead of 0.02 to 0.05.
"""
INSIDE = 1.02  # times the bound at which a fit would like to go on: what it found there is something else
APART = 0.3  # of the logarithms of two resonances, at least
NEAR = 0.03  # of the logarithms of a resonance and an antiresonance from which a fit begins
SEEN_DELAY = 0.1
"""Periods of the highest swept frequency: an amplifier's lag of a tenth of one is fitted as a lag."""
SAME_GAIN = 0.3  # of the logarithm: a resonance of 2 % damping has this at half its frequency
FINEST_DELAY = 0.002  # of itself: a delay of 2 ms to 4 us, 0.4 degrees at 250 Hz
DAMPINGS = (0.002, 0.02, 0.1, 0.4)  # a refinement starts from each: the error has several minima in it


def chosen_dynamics(
    signals: Sequence[Signals], band: Band, asked: int | None, delay: float = 0.0
) -> tuple[Candidate, list[str]]:
    """Return the dynamics that earn their place, or as many resonances as are asked for, and doubts of these.

    Parameters
    ----------
    delay
        A pure delay behind them (s).
    """
    lag_starts = [np.log([value]) for value in (0.02 / band[1], 0.3 / band[1])]
    best = fitted(signals, lag_starts, Structure(0, delay=delay), band)
    doubts = []
    for _ in range(MOST_RESONANCES if asked is None else asked):
        if asked is None and best.resonances and _white(signals, best):
            break
        more = one_more(signals, best, band, always=asked is not None)
        if more is None:
            break
        if not _earned(signals, more, best, band):
            gain = 100.0 * (1.0 - more.left_out / best.left_out)
            doubts.append(
                f"`dynamics` {asked}: the logs speak against {len(more.resonances)} resonances: the last one "
                f"lowers the error on blocks left out by {gain:.1f} %; ask for fewer, or let the logs decide"
            )
        best = more
    return best, doubts


def with_delay(
    signals: Sequence[Signals], band: Band, asked: int | None, without: Candidate, doubts: list[str]
) -> tuple[Candidate, list[str]]:
    """Return dynamics with a pure delay behind them, where the fast rows ask for one, else those without.

    A sensor that is late by half a period of a resonance turns its phase around: without the delay no
    resonance fits (250 Hz behind 2 ms were not found, and moves at a fifth of it missed by 21 %).
    """
    if without.resonances and _white(signals, without):
        return without, doubts
    late = _phase_delay(signals, band)
    if late * band[1] < SEEN_DELAY:
        return without, doubts
    best, more_doubts = chosen_dynamics(signals, band, asked, late)
    tried = {late: best}
    step = 0.25 * late
    while step > FINEST_DELAY * late:  # the lag took its part of the lateness: look to both sides
        centre = best.structure.delay
        for delay in (centre - step, centre + step):
            if delay > 0.0 and delay not in tried:
                structure = dataclasses.replace(best.structure, delay=delay)
                tried[delay] = fitted(signals, [best.parameters], structure, band)
        nearest = min(tried.values(), key=lambda one: one.left_out)
        step = step if nearest.left_out < best.left_out else 0.5 * step
        best = nearest
    return (best, more_doubts) if best.left_out <= EARNED * without.left_out else (without, doubts)


def _phase_delay(signals: Sequence[Signals], band: Band) -> float:
    """Return how late the measured is (s), by the phase where its gain is still that of slow moves."""
    one = max(signals, key=lambda part: part.measured.size)
    rate, before = 1.0 / one.time_step, one.predicted()
    size = min(before.size, max(256, round(8.0 / (band[0] * one.time_step))))
    frequency, power = welch(before, rate, nperseg=size)
    both = csd(before, one.measured, rate, nperseg=size)[1]
    rows = np.flatnonzero((frequency >= band[0]) & (frequency <= band[1]) & (power > ENERGY**2 * power.max()))
    if rows.size < 3:
        return 0.0
    gain = np.abs(both[rows]) / power[rows]
    changed = np.flatnonzero(np.abs(np.log(gain / np.median(gain[:3]))) > SAME_GAIN)
    rows = rows[: max(int(changed[0]) if changed.size else rows.size, 3)]
    phase, w = np.unwrap(np.angle(both[rows])), 2.0 * np.pi * frequency[rows]
    weight = power[rows]
    return max(-float(np.sum(weight * w * phase) / np.sum(weight * w * w)), 0.0)


def one_more(
    signals: Sequence[Signals], best: Candidate, band: Band, always: bool = False
) -> Candidate | None:
    """Return dynamics with a resonance more, or None where it does not earn its place.

    It comes with an antiresonance where that earns its own, as two modes that add up have one. ``always``:
    whether it is asked for.
    """
    structure = dataclasses.replace(best.structure, resonances=len(best.resonances) + 1, antiresonance=False)
    starts = _starts(signals, best, band)
    more = fitted(signals, starts, structure, band)
    starts = _notched(starts) if best.resonances else _with_notch(signals, more, band)
    notched = fitted(signals, starts, dataclasses.replace(structure, antiresonance=True), band)
    if _earned(signals, notched, more, band):
        more = notched
    return more if always or _earned(signals, more, best, band) else None


def _earned(signals: Sequence[Signals], more: Candidate, best: Candidate, band: Band) -> bool:
    """Return whether the error on blocks left out asks for more, all of it inside the swept band."""
    found = [one.frequency for one in more.resonances]
    found += [one.antiresonance.frequency for one in more.resonances if one.antiresonance]
    if not all(INSIDE * band[0] < one < band[1] for one in found):
        return False
    if any(one.damping < INSIDE * LEAST_DAMPING for one in more.resonances):
        return False
    pairs = [(one.damping, one.antiresonance.damping) for one in more.resonances if one.antiresonance]
    if any(max(pair) > MOST_BESIDE / INSIDE for pair in pairs):
        return False
    if more.left_out <= EARNED * best.left_out:
        return True
    if not best.resonances:
        return False
    rows, noise = (
        sum(one.measured.size for one in signals),
        white_noise(residuals(signals, best.parameters, best.structure)),
    )
    gained = rows * (best.left_out**2 - more.left_out**2)
    return gained >= max(SURE * noise, MOST_OF_IT * rows * (best.left_out**2 - noise))


def _white(signals: Sequence[Signals], best: Candidate) -> bool:
    """Return whether what is left over is noise alone."""
    return beyond_noise(residuals(signals, best.parameters, best.structure)) == 0.0


def _starts(signals: Sequence[Signals], best: Candidate, band: Band) -> list[Floats]:
    """Return where to begin with one resonance more."""
    known = [one.frequency for one in best.resonances]
    before = best.parameters[: 2 * len(known)]
    lag = np.log(max(best.lag, 0.02 / band[1]))
    peak = _peak(signals, best, band)
    places = (peak, 0.8 * band[1]) if known else (peak,)  # chosen
    return [np.array([*before, np.log(at), np.log(z), lag]) for z in DAMPINGS for at in places]


def _with_notch(signals: Sequence[Signals], best: Candidate, band: Band) -> list[Floats]:
    """Return where to begin with an antiresonance beside resonances that are found."""
    places = (_peak(signals, best, band), 0.9 * band[1])
    return [np.array([*best.parameters[:-1], np.log(at), np.log(z), best.parameters[-1]])
            for at in places for z in DAMPINGS[1:3]]  # fmt: skip


def _notched(starts: Sequence[Floats]) -> list[Floats]:
    """Return where to begin with an antiresonance on either side of the last resonance.

    So near to it and so like it that the two undo each other: the fit begins where it was without them.
    """
    return [np.array([*start[:-1], start[-3] + side, start[-2], start[-1]])
            for start in starts for side in (-NEAR, NEAR)]  # fmt: skip


def _peak(signals: Sequence[Signals], best: Candidate, band: Band) -> float:
    """Return where the measured departs most from the best found (Hz), away from its resonances."""
    one = max(signals, key=lambda part: part.measured.size)
    size = min(one.measured.size, max(256, round(8.0 / (band[0] * one.time_step))))
    moved = one.moved(best.parameters, best.structure)
    (left,) = residuals([one], best.parameters, best.structure)
    rate = 1.0 / one.time_step
    frequency, power = welch(moved, rate, nperseg=size)
    ratio = np.abs(csd(moved, left, rate, nperseg=size)[1]) / np.maximum(power, 1e-12 * power.max())
    inside = (frequency >= band[0]) & (frequency <= band[1]) & (power > ENERGY**2 * power.max())
    for known in best.resonances:
        inside &= np.abs(np.log(np.maximum(frequency, 1e-9) / known.frequency)) > APART
    if not inside.any():
        return 0.7 * band[1]  # chosen
    return float(frequency[inside][np.argmax(ratio[inside])])


ENERGY = 0.003  # of the strongest third of an octave of the drive (amplitude): with less, nothing is known
TRUSTED = 0.1  # of what was predicted, in a third of an octave: the error up to which a model is trusted
TRUSTED_PART = 0.7  # of the lowest resonance, the most that is trusted: a change of 5 % there costs a tenth
COHERENT = 0.5  # of the square of the response, at least, is no noise where it is shown
MOST_SHOWN = 60  # frequencies of the response that the model keeps, for its figure
OVERLAP = 2.776
"""Standard errors on either side: Student's t with four degrees of freedom, 95 %, as few blocks are near a
resonance. They held frequency and damping of 22 of 23 simulated stages (sample_data/virtual_positioner.py),
and of 100 plants of gears (benchmarks/dynamics_found.py) 94 and 99; those of a jackknife held 84 and 90.
"""


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
    return [
        *([f"creep of the displacement, behind the gears: {told}"] if told else []),
        f"dynamics: {'; '.join(parts)}{lag}; fast rows RMSE {chosen.rmse:.3g}{unit}, on blocks left out "
        f"{chosen.left_out:.3g}{unit}"
        + (
            f"; its lateness is {WHOSE_LAG}"
            if max(chosen.lag, chosen.structure.delay) > 0.0 and "sensor" not in figures
            else ""
        ),
        f"trust the model to {trusted:.3g} Hz{': ' + why if why else ''}",
    ]
