"""Spectra of fast rows: where a resonance is to be looked for, and how late all is."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.signal import csd, welch

from dbo_cli.identification.recording import Floats
from dbo_cli.identification.sections import Band, Fitted, Signals

APART = 0.3  # of the logarithms of two resonances
SAME_GAIN = 0.3  # of the logarithm: up to here the phase tells a delay
ENERGY = 0.003  # of the strongest amplitude of the drive: with less nothing is known


def spectra(
    before: Floats, after: Floats, dt: float, band: Band
) -> tuple[Floats, Floats, NDArray[np.complex128]]:
    """Return Hz, power and cross power of two signals, where the first has energy within the band."""
    size = min(before.size, max(256, round(8.0 / (band[0] * dt))))
    frequency, power = welch(before, 1.0 / dt, nperseg=size)
    both = csd(before, after, 1.0 / dt, nperseg=size)[1]
    driven = (frequency >= band[0]) & (frequency <= band[1])
    driven &= power > ENERGY**2 * power.max()
    return frequency[driven], power[driven], both[driven]


def longest(signals: Sequence[Signals]) -> Signals:
    """Return the fast part with the most rows."""
    return max(signals, key=lambda part: part.measured.size)


def peak_of(signals: Sequence[Signals], best: Fitted, band: Band) -> float:
    """Return where the measured departs most from the best found (Hz), away from its resonances."""
    one = longest(signals)
    moved = one.moved(best.parameters, best.form)
    left = one.left(best.parameters, best.form)
    frequency, power, both = spectra(moved, left, one.dt, band)
    away = np.ones(frequency.size, dtype=bool)
    for known in best.resonances:
        away &= np.abs(np.log(frequency / known.frequency)) > APART
    if not away.any():
        return 0.7 * band[1]
    ratio = np.abs(both[away]) / power[away]
    return float(frequency[away][np.argmax(ratio)])


def phase_delay(signals: Sequence[Signals], band: Band) -> float:
    """Return how late the measured is (s), by the phase where its gain is still that of slow moves."""
    one = longest(signals)
    frequency, power, both = spectra(one.predicted, one.measured, one.dt, band)
    if frequency.size < 3:
        return 0.0
    gain = np.abs(both) / power
    changed = np.flatnonzero(np.abs(np.log(gain / np.median(gain[:3]))) > SAME_GAIN)
    rows = max(int(changed[0]) if changed.size else frequency.size, 3)
    phase = np.unwrap(np.angle(both[:rows]))
    w = 2.0 * np.pi * frequency[:rows]
    slope = float(np.sum(power[:rows] * w * phase) / np.sum(power[:rows] * w * w))
    return max(-slope, 0.0)
