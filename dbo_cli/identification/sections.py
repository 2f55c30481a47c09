"""Fits of given sections to fast rows: output error, its size on blocks left out, and spectra for starts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.signal import csd, welch

from dbo_cli.arrays import Floats
from dbo_cli.identification.fast import Band, FastPart
from dbo_cli.identification.recording import white_noise
from dbo_cli.model import (
    Amplifier,
    Cascade,
    Delay,
    Dynamics,
    Lag,
    Mode,
    Resonance,
    Section,
    State,
)

FAST_BLOCKS, FOLDS = 40, 5  # blocks of the fast rows, dealt out to the folds in turn
LEAST_DAMPING, MOST_DAMPING = 1e-4, 0.98
MOST_BESIDE = 0.1  # damping of resonances one of which has an antiresonance
NO_LAG = 2e-3  # of a time step: a lag at the lower end of its range is none
SLOWEST_LAG = 10.0  # periods of the highest frequency: lags and delays are shorter
FEW_STEPS, FINALISTS, MOST_STEPS = 6, 2, 40  # of a refinement
DERIVATIVE_STEP = 1e-5  # of a parameter's logarithm, for derivatives
APART = 0.3  # of the logarithms of two resonances
SAME_GAIN = 0.3  # of the logarithm: up to here the phase tells a delay
ENERGY = 0.003  # of the strongest amplitude of the drive: with less nothing is known


@dataclass(frozen=True)
class Form:
    """How many resonances, an antiresonance of the highest or none, a delay behind all or none.

    With ``amplifier`` another lag stands before the gears.
    """

    resonances: int
    antiresonance: bool = False
    delay: bool = False
    amplifier: bool = False


@dataclass(frozen=True)
class Fitted:
    """Dynamics of the fast rows.

    Attributes
    ----------
    form
        What is fitted.
    parameters
        Logarithms: frequency (Hz) and damping of each resonance, of the antiresonance,
        the amplifier's lag (s), the delay (s), the lag (s).
    rmse, left_out
        On all fast rows, and on blocks left out.
    noise
        Mean square of what is white in what is left.
    """

    form: Form
    parameters: Floats
    rmse: float = np.inf
    left_out: float = np.inf
    noise: float = 0.0

    @property
    def amplifier(self) -> float:
        """The lag before the gears (s), 0 for none."""
        if not self.form.amplifier:
            return 0.0
        return float(np.exp(self.parameters[-2 - self.form.delay]))

    @property
    def delay(self) -> float:
        """The pure delay behind all (s), 0 for none."""
        return float(np.exp(self.parameters[-2])) if self.form.delay else 0.0

    @property
    def lag(self) -> float:
        """The lag behind the gears (s)."""
        return float(np.exp(self.parameters[-1]))

    @property
    def resonances(self) -> list[Resonance]:
        """The resonances, lowest first; the last one has the antiresonance."""
        count = self.form.resonances
        pairs = np.exp(self.parameters[: 2 * count]).reshape(count, 2)
        pairs = pairs[np.argsort(pairs[:, 0])]
        modes = [Resonance(*pair) for pair in pairs.tolist()]
        if self.form.antiresonance:
            pair = np.exp(self.parameters[2 * count : 2 * count + 2])
            modes[-1] = replace(modes[-1], antiresonance=Mode(*pair.tolist()))
        return modes


class Signals:
    """Of one fast part: what the static model predicts, and what was measured."""

    def __init__(self, static: Cascade, part: FastPart) -> None:
        log, rows = part.recording, part.rows
        self.static, self.drive, self.dt = static, log.voltage[rows], part.dt
        self._before: State | str = "auto"
        if rows.start:
            before = log.voltage[: rows.start]
            _, self._before = static.simulate(before, dt=self.dt)
        self.predicted = self._simulated(static)
        self._behind_amplifier = 0.0, self.predicted
        self.part, self.measured = part, log.displacement[rows]
        size = self.measured.size
        self.block = np.arange(size) * FAST_BLOCKS // size
        ramp = np.linspace(-1.0, 1.0, size)
        self._drift = np.column_stack([np.ones(size), ramp])
        self._drift /= np.sqrt(np.sum(self._drift**2, axis=0))

    def _simulated(self, model: Cascade) -> Floats:
        """Return what a model without dynamics predicts; an amplifier rests at the first row."""
        output, _ = model.simulate(self.drive, dt=self.dt, state=self._before)
        return output

    def behind_amplifier(self, seconds: float) -> Floats:
        """Return what the static model predicts for a drive that lags; the last is stored."""
        if not seconds:
            return self.predicted
        if seconds != self._behind_amplifier[0]:
            stages = (Amplifier(seconds), *self.static.stages)
            output = self._simulated(self.static.with_stages(stages))
            self._behind_amplifier = seconds, output
        return self._behind_amplifier[1]

    def free(self, signal: Floats) -> Floats:
        """Return what an offset and an even drift do not explain of a signal."""
        residuals: Floats = signal - self._drift @ (self._drift.T @ signal)
        return residuals

    def modelled(self, trial: Fitted) -> Floats:
        """Return the prediction through lags, resonances and delay."""
        predicted = self.behind_amplifier(trial.amplifier)
        sections = Dynamics((Lag(trial.lag), *trial.resonances))
        modelled = sections.run(predicted, State(), self.dt).y
        if trial.form.delay:
            modelled = Delay(trial.delay).run(modelled, State(), self.dt).y
        return np.asarray(modelled, dtype=np.float64)

    def residuals(self, trial: Fitted) -> Floats:
        """Return what the best gain, offset and drift of the prediction leave of the measured."""
        modelled = self.free(self.modelled(trial))
        measured = self.free(self.measured)
        gain = float(modelled @ measured) / max(float(modelled @ modelled), 1e-300)
        return measured - gain * modelled


class FastRows:
    """All fast parts beside one static model.

    Attributes
    ----------
    signals : of each part
    band : lowest and highest frequency swept (Hz)
    step : the shortest time step (s)
    count : how many rows there are
    """

    def __init__(self, static: Cascade, fast: Sequence[FastPart]) -> None:
        self.signals = [Signals(static, part) for part in fast]
        self.band = swept(fast)
        self.step = min(part.dt for part in fast)
        self.count = sum(signals.measured.size for signals in self.signals)

    @property
    def longest(self) -> Signals:
        """The part with the most rows."""
        return max(self.signals, key=lambda signals: signals.measured.size)

    def residuals(self, form: Form, parameters: Floats) -> list[Floats]:
        """Return what dynamics leave of each part."""
        trial = Fitted(form, parameters)
        return [signals.residuals(trial) for signals in self.signals]

    def sections(self, best: Fitted) -> tuple[Section, ...]:
        """Return the sections, a lag first where there is one."""
        if best.lag <= NO_LAG * self.step:
            return tuple(best.resonances)
        return (Lag(best.lag), *best.resonances)


def swept(fast: Sequence[FastPart]) -> Band:
    """Return the lowest and the highest frequency swept (Hz)."""
    lows, highs = zip(*(part.band for part in fast), strict=True)
    return min(lows), max(highs)


def fitted(rows: FastRows, starts: Sequence[Floats], form: Form) -> Fitted:
    """Return the best of several refinements, with its error on blocks left out."""
    low, high = _bounds(rows, form)

    def error(parameters: Floats) -> Floats:
        return np.concatenate(rows.residuals(form, parameters))

    def refined(start: Floats, steps: int) -> Any:
        # no bound on the gradient: it has the displacement's unit
        return least_squares(error, start, bounds=(low, high), x_scale=0.1,
                             diff_step=DERIVATIVE_STEP, gtol=None, max_nfev=steps)  # fmt: skip

    different = {tuple(np.clip(start, low, high).tolist()) for start in starts}
    tried = [refined(np.array(start), FEW_STEPS) for start in sorted(different)]
    tried.sort(key=lambda trial: trial.cost)
    finals = [refined(trial.x, MOST_STEPS) for trial in tried[:FINALISTS]]
    best = min(finals, key=lambda trial: trial.cost)
    parameters, count = np.array(best.x), 2 * form.resonances
    pairs = parameters[:count].reshape(-1, 2)
    parameters[:count] = pairs[np.argsort(pairs[:, 0])].ravel()
    return Fitted(
        form,
        parameters,
        float(np.sqrt(np.mean(best.fun**2))),
        _left_out(rows, best.fun, best.jac),
        white_noise(rows.residuals(form, parameters)),
    )


def _bounds(rows: FastRows, form: Form) -> tuple[Floats, Floats]:
    """Return the bounds of the logarithms of the parameters."""
    lowest, highest = rows.band
    damping = MOST_BESIDE if form.antiresonance else MOST_DAMPING
    mode = (lowest, 1.5 * highest), (LEAST_DAMPING, damping)
    lag = 0.5 * NO_LAG * rows.step, SLOWEST_LAG / highest
    bounds = [*mode] * (form.resonances + form.antiresonance)
    bounds += [lag] * form.amplifier
    bounds += [(0.01 / highest, SLOWEST_LAG / highest)] * form.delay
    low, high = np.log([*bounds, lag]).T
    return low, high


def _left_out(rows: FastRows, residuals: Floats, derivatives: Floats) -> float:
    """Return the error (RMS) on blocks left out, each one step from the whole fit."""
    block = np.concatenate([signals.block for signals in rows.signals])
    squares = 0.0
    for fold in range(FOLDS):
        out = block % FOLDS == fold
        kept = derivatives[~out]
        step = -np.linalg.lstsq(kept, residuals[~out], rcond=1e-9)[0]
        squares += float(np.sum((residuals[out] + derivatives[out] @ step) ** 2))
    return float(np.sqrt(squares / residuals.size))


# --- spectra: where a resonance is to be looked for, and how late all is ---


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


def peak_of(rows: FastRows, best: Fitted) -> float:
    """Return where the measured departs most from the best found (Hz), away from its resonances."""
    signals = rows.longest
    modelled, residuals = signals.modelled(best), signals.residuals(best)
    frequency, power, both = spectra(modelled, residuals, signals.dt, rows.band)
    distant = np.ones(frequency.size, dtype=bool)
    for resonance in best.resonances:
        distant &= np.abs(np.log(frequency / resonance.frequency)) > APART
    if not distant.any():
        return 0.7 * rows.band[1]
    ratio = np.abs(both[distant]) / power[distant]
    return float(frequency[distant][np.argmax(ratio)])


def phase_delay(fast: FastRows) -> float:
    """Return how late the measured is (s), by the phase where its gain is still that of slow moves."""
    signals = fast.longest
    frequency, power, both = spectra(
        signals.predicted, signals.measured, signals.dt, fast.band
    )
    if frequency.size < 3:
        return 0.0
    gain = np.abs(both) / power
    changed = np.flatnonzero(np.abs(np.log(gain / np.median(gain[:3]))) > SAME_GAIN)
    rows = max(int(changed[0]) if changed.size else frequency.size, 3)
    phase = np.unwrap(np.angle(both[:rows]))
    w = 2.0 * np.pi * frequency[:rows]
    slope = float(np.sum(power[:rows] * w * phase) / np.sum(power[:rows] * w * w))
    return max(-slope, 0.0)
