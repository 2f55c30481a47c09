"""Fits of given sections to fast rows: output error, its size on blocks left out, and spectra for starts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.signal import csd, welch

from dbo_cli.arrays import Floats
from dbo_cli.identification.fast import FastPart
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

Band = tuple[float, float]  # lowest and highest frequency swept, Hz

BLOCKS, FOLDS = 40, 5  # blocks of the fast rows, dealt out to the folds in turn
LEAST_DAMPING, MOST_DAMPING = 1e-4, 0.98
MOST_BESIDE = 0.1  # damping of resonances one of which has an antiresonance
NO_LAG = 2e-3  # of a time step: a lag at the lower end of its range is none
FEW_STEPS, FINALISTS, MOST_STEPS = 6, 2, 40  # of a refinement
SMALL = 1e-5  # of a parameter's logarithm, for derivatives
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
    """Dynamics fitted to the fast rows.

    Attributes
    ----------
    form
        What was fitted.
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
    rmse: float
    left_out: float
    noise: float

    @property
    def amplifier(self) -> float:
        """The lag before the gears (s)."""
        return amplifier_of(self.parameters, self.form)

    @property
    def delay(self) -> float:
        """The pure delay behind all (s)."""
        return float(np.exp(self.parameters[-2])) if self.form.delay else 0.0

    @property
    def resonances(self) -> list[Resonance]:
        """The resonances, lowest first."""
        return resonances_of(self.parameters, self.form)


class Signals:
    """Of one fast part: what the static model predicts, and what was measured."""

    def __init__(
        self, static: Cascade, segment: FastPart, creep: Sequence[Lag] = ()
    ) -> None:
        log, rows = segment.recording, segment.rows
        if creep:
            static = static.with_stages((*static.stages, Dynamics(tuple(creep))))
        self._static, self._drive, self.dt = static, log.voltage[rows], segment.dt
        self._before: State | str = "auto"
        if rows.start:
            before = log.voltage[: rows.start]
            _, self._before = static.simulate(before, dt=self.dt)
        self.predicted = self._static_output(static)
        self._behind_amplifier = 0.0, self.predicted
        self.measured = log.displacement[rows]
        size = self.measured.size
        self.block = np.arange(size) * BLOCKS // size
        ramp = np.linspace(-1.0, 1.0, size)
        self._drift = np.column_stack([np.ones(size), ramp])
        self._drift /= np.sqrt(np.sum(self._drift**2, axis=0))

    def _static_output(self, model: Cascade) -> Floats:
        """Return what a model without dynamics predicts; an amplifier rests at the first row."""
        output, _ = model.simulate(self._drive, dt=self.dt, state=self._before)
        return output

    def behind_amplifier(self, seconds: float) -> Floats:
        """Return what the static model predicts for a drive that lags; the last is stored."""
        if not seconds:
            return self.predicted
        if seconds != self._behind_amplifier[0]:
            stages = (Amplifier(seconds), *self._static.stages)
            output = self._static_output(self._static.with_stages(stages))
            self._behind_amplifier = seconds, output
        return self._behind_amplifier[1]

    def free(self, signal: Floats) -> Floats:
        """Return what an offset and an even drift do not explain of a signal."""
        residuals: Floats = signal - self._drift @ (self._drift.T @ signal)
        return residuals

    def modelled(self, parameters: Floats, form: Form) -> Floats:
        """Return the prediction through lags, resonances and delay."""
        predicted = self.behind_amplifier(amplifier_of(parameters, form))
        sections: list[Section] = [Lag(float(np.exp(parameters[-1])))]
        sections += resonances_of(parameters, form)
        modelled = Dynamics(tuple(sections)).run(predicted, State(), self.dt).y
        if form.delay:
            pure_delay = Delay(float(np.exp(parameters[-2])))
            modelled = pure_delay.run(modelled, State(), self.dt).y
        return np.asarray(modelled, dtype=np.float64)

    def residuals(self, parameters: Floats, form: Form) -> Floats:
        """Return what the best gain, offset and drift of the prediction leave of the measured."""
        modelled = self.free(self.modelled(parameters, form))
        measured = self.free(self.measured)
        gain = float(modelled @ measured) / max(float(modelled @ modelled), 1e-300)
        return measured - gain * modelled


def fitted(
    signals: Sequence[Signals], starts: Sequence[Floats], form: Form, band: Band
) -> Fitted:
    """Return the best of several refinements, judged (see ``_judged``)."""
    low, high = _bounds(signals, form, band)

    def error(parameters: Floats) -> Floats:
        return np.concatenate(
            [segment.residuals(parameters, form) for segment in signals]
        )

    def refined(start: Floats, steps: int) -> tuple[float, Floats]:
        # no bound on the gradient: it has the displacement's unit
        found = least_squares(error, np.clip(start, low, high), bounds=(low, high),
                              x_scale=0.1, diff_step=SMALL, gtol=None, max_nfev=steps)  # fmt: skip
        return float(found.cost), np.asarray(found.x)

    different = {tuple(np.clip(start, low, high).tolist()) for start in starts}
    tried = [refined(np.array(start), FEW_STEPS) for start in sorted(different)]
    tried.sort(key=lambda one: one[0])
    finals = [refined(start, MOST_STEPS) for _, start in tried[:FINALISTS]]
    best = min(finals, key=lambda one: one[0])[1]
    return _judged(signals, _in_order(best, form), form)


def _bounds(
    signals: Sequence[Signals], form: Form, band: Band
) -> tuple[Floats, Floats]:
    """Return the bounds of the logarithms of the parameters."""
    step = min(segment.dt for segment in signals)
    pairs = form.resonances + form.antiresonance
    damping = MOST_BESIDE if form.antiresonance else MOST_DAMPING
    low = [band[0], LEAST_DAMPING] * pairs
    high = [1.5 * band[1], damping] * pairs
    if form.amplifier:
        low.append(0.5 * NO_LAG * step)
        high.append(10.0 / band[1])
    if form.delay:
        low.append(0.01 / band[1])
        high.append(10.0 / band[1])
    low.append(0.5 * NO_LAG * step)
    high.append(10.0 / band[1])
    return np.log(low), np.log(high)


def _judged(signals: Sequence[Signals], parameters: Floats, form: Form) -> Fitted:
    """Return a fit with its error on blocks left out, each one step from the whole fit."""
    parts = [segment.residuals(parameters, form) for segment in signals]
    residuals = np.concatenate(parts)
    columns = []
    for direction in np.eye(parameters.size):
        stepped = [
            segment.residuals(parameters + SMALL * direction, form)
            for segment in signals
        ]
        columns.append((np.concatenate(stepped) - residuals) / SMALL)
    along = np.column_stack(columns)
    block = np.concatenate([segment.block for segment in signals])
    squares = 0.0
    for fold in range(FOLDS):
        out = block % FOLDS == fold
        kept = along[~out]
        step = -np.linalg.lstsq(kept, residuals[~out], rcond=1e-9)[0]
        squares += float(np.sum((residuals[out] + along[out] @ step) ** 2))
    return Fitted(
        form,
        parameters,
        float(np.sqrt(np.mean(residuals**2))),
        float(np.sqrt(squares / residuals.size)),
        white_noise(parts),
    )


def _in_order(parameters: Floats, form: Form) -> Floats:
    """Return parameters with the resonances in the order of their frequencies."""
    count = form.resonances
    pairs = parameters[: 2 * count].reshape(count, 2)
    ordered = pairs[np.argsort(pairs[:, 0])]
    return np.concatenate([ordered.ravel(), parameters[2 * count :]])


def amplifier_of(parameters: Floats, form: Form) -> float:
    """Return the lag before the gears (s) of logarithms, 0 where the form has none."""
    return float(np.exp(parameters[-2 - form.delay])) if form.amplifier else 0.0


def resonances_of(parameters: Floats, form: Form) -> list[Resonance]:
    """Return the resonances of logarithms, lowest first; the last one has the antiresonance."""
    count = form.resonances
    pairs = np.exp(parameters[: 2 * count]).reshape(count, 2)
    pairs = pairs[np.argsort(pairs[:, 0])]
    found = []
    for frequency, damping in pairs.tolist():
        found.append(Resonance(frequency, min(damping, MOST_DAMPING)))
    if form.antiresonance:
        frequency, damping = np.exp(parameters[2 * count : 2 * count + 2]).tolist()
        notch = Mode(frequency, min(damping, MOST_DAMPING))
        found[-1] = Resonance(found[-1].frequency, found[-1].damping, notch)
    return found


def sections_of(best: Fitted, signals: Sequence[Signals]) -> tuple[Section, ...]:
    """Return the sections, a lag first where there is one."""
    lag = float(np.exp(best.parameters[-1]))
    if lag <= NO_LAG * min(segment.dt for segment in signals):
        return tuple(best.resonances)
    return (Lag(lag), *best.resonances)


def parameters_of(
    sections: Sequence[Section], delay: float, signals: Sequence[Signals]
) -> tuple[Form, Floats]:
    """Return form and parameters of sections."""
    values: list[float] = []
    notch: list[float] = []
    lag = NO_LAG * min(segment.dt for segment in signals)
    for section in sections:
        if isinstance(section, Lag):
            lag = section.seconds
            continue
        values += [section.frequency, section.damping]
        if section.antiresonance is not None:
            notch = [section.antiresonance.frequency, section.antiresonance.damping]
    form = Form(len(values) // 2, bool(notch), delay > 0.0)
    pure_delay = [delay] if delay > 0.0 else []
    return form, np.log([*values, *notch, *pure_delay, lag])


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


def longest(signals: Sequence[Signals]) -> Signals:
    """Return the fast part with the most rows."""
    return max(signals, key=lambda segment: segment.measured.size)


def peak_of(signals: Sequence[Signals], best: Fitted, band: Band) -> float:
    """Return where the measured departs most from the best found (Hz), away from its resonances."""
    one = longest(signals)
    modelled = one.modelled(best.parameters, best.form)
    residuals = one.residuals(best.parameters, best.form)
    frequency, power, both = spectra(modelled, residuals, one.dt, band)
    distant = np.ones(frequency.size, dtype=bool)
    for resonance in best.resonances:
        distant &= np.abs(np.log(frequency / resonance.frequency)) > APART
    if not distant.any():
        return 0.7 * band[1]
    ratio = np.abs(both[distant]) / power[distant]
    return float(frequency[distant][np.argmax(ratio)])


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
