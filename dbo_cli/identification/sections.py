"""Fast parts of logs, small sweeps, and fits of given sections to them.

Gears, curve and creep are told from the slow rows; resonances from the fast ones, which
a fit without resonances would take for hysteresis. Of a fit: output error, its size on
blocks left out, and spectra for starts.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from dbo_cli.arrays import Floats
from dbo_cli.identification.recording import Recording, detrended, runs_of
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
from dbo_cli.signals import turns

NOTICEABLE = 3e-4  # of the range: a smaller reversal of the drive is no turn
SMALL_SWING = 0.35  # of the range: a sweep's largest swing
FEWEST_IN_PART = 40  # rows of a sweep, and of what is left of its log
SWEPT = 5.0  # highest over lowest frequency of a sweep, at least
SMOOTH = 0.7  # of the logarithms of neighbouring half periods: a sweep is gradual
FEWEST_A_PERIOD = 6  # samples of the highest frequency
WIDER = 2.0  # periods of the lowest frequency that belong to a sweep on either side
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


Band = tuple[float, float]  # lowest and highest frequency of a drive, Hz


@dataclass(frozen=True)
class Sweep:
    """Rows of a log in which the drive is fast; those before them tell the state of the gears.

    Attributes
    ----------
    recording
        The whole log.
    rows
        The fast rows.
    dt
        Time step (s).
    band
        Lowest and highest frequency of the drive there (Hz).
    """

    recording: Recording
    rows: slice
    dt: float
    band: Band


def split(recordings: Sequence[Recording]) -> tuple[list[Recording], list[Sweep]]:
    """Return the logs with only their slow rows usable, and their fast parts."""
    span = max(float(np.ptp(log.voltage)) for log in recordings)
    slow: list[Recording] = []
    fast: list[Sweep] = []
    for log in recordings:
        sweep = _sweep_of(log, span)
        if sweep is not None:
            fast.append(sweep)
            usable = log.usable.copy()
            usable[sweep.rows] = False  # driven through, but they do not count
            log = replace(log, good=usable)
        slow.append(log)
    return slow, fast


def _sweep_of(log: Recording, span: float) -> Sweep | None:
    """Return the longest run of small swings whose frequency changes gradually over a wide band."""
    step = log.even_step
    if step is None:
        return None
    rows = turns(log.voltage, NOTICEABLE * span)
    halves = np.diff(rows).astype(np.float64)
    small = np.abs(np.diff(log.voltage[rows])) <= SMALL_SWING * span
    gradual = np.abs(np.diff(np.log(np.maximum(halves, 1.0)))) <= SMOOTH
    quick = np.minimum(halves[1:], halves[:-1]) <= FEWEST_A_PERIOD
    runs = runs_of(small[1:] & small[:-1] & (gradual | quick)).tolist()
    first, last = max(runs, key=lambda run: run[1] - run[0], default=(0, 0))
    if last - first < FEWEST_IN_PART:
        return None
    periods = 2.0 * step * halves[first : last + 1]
    fastest, slowest = np.quantile(periods, (0.05, 0.98)).tolist()
    if slowest < SWEPT * fastest or fastest < 0.5 * FEWEST_A_PERIOD * step:
        return None
    wider = round(WIDER * slowest / step)
    begin = max(int(rows[first]) - wider, 0)
    end = min(int(rows[last + 1]) + wider, len(log.voltage))
    if begin + len(log.voltage) - end < FEWEST_IN_PART:
        return None  # nothing else is left to tell the gears from
    band = 1.0 / slowest, 1.0 / float(periods.min())
    return Sweep(log, slice(begin, end), step, band)


# --- dynamics of the fast parts ---


@dataclass(frozen=True)
class Form:
    """How many resonances, an antiresonance of the highest or none, a delay behind all or none.

    With ``amplifier`` another lag stands before the gears.
    """

    resonances: int
    antiresonance: bool = False
    delay: bool = False
    amplifier: bool = False

    @property
    def modes(self) -> int:
        """How many numbers resonances and antiresonance have."""
        return 2 * (self.resonances + self.antiresonance)


@dataclass(frozen=True)
class FastDynamics:
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
    """

    form: Form
    parameters: Floats
    rmse: float = np.inf
    left_out: float = np.inf

    @property
    def modes(self) -> Floats:
        """The logarithms of frequency and damping: of resonances, and of the antiresonance."""
        return np.split(self.parameters, [self.form.modes])[0]

    @property
    def times(self) -> Floats:
        """The logarithms of the amplifier's lag and the delay, as far as there are any, and of the lag."""
        return np.split(self.parameters, [self.form.modes])[1]

    @property
    def amplifier(self) -> float:
        """The lag before the gears (s), 0 for none."""
        return float(np.exp(self.times[0])) if self.form.amplifier else 0.0

    @property
    def delay(self) -> float:
        """The pure delay behind all (s), 0 for none."""
        return float(np.exp(self.times[-2])) if self.form.delay else 0.0

    @property
    def lag(self) -> float:
        """The lag behind the gears (s)."""
        return float(np.exp(self.times[-1]))

    @property
    def resonances(self) -> list[Resonance]:
        """The resonances, lowest first; the last one has the antiresonance."""
        count = self.form.resonances
        pairs = np.exp(self.modes).reshape(-1, 2)
        order = np.argsort(pairs[:count, 0])
        resonances = [Resonance(*pair) for pair in pairs[order].tolist()]
        if self.form.antiresonance:
            notch = Mode(*pairs[-1].tolist())
            resonances[-1] = replace(resonances[-1], antiresonance=notch)
        return resonances


class Signals:
    """Of one sweep: what the static model predicts, and what was measured."""

    def __init__(self, static: Cascade, sweep: Sweep) -> None:
        log, rows = sweep.recording, sweep.rows
        self.static, self.drive, self.dt = static, log.voltage[rows], sweep.dt
        self._before: State | str = "auto"
        if rows.start:
            before = log.voltage[: rows.start]
            _, self._before = static.simulate(before, dt=self.dt)
        self.predicted = self._simulated(static)
        self.sweep, self.measured = sweep, log.displacement[rows]
        self.time: Floats = sweep.dt * np.arange(float(self.measured.size))

    def _simulated(self, model: Cascade) -> Floats:
        """Return what a model without dynamics predicts; an amplifier rests at the first row."""
        output, _ = model.simulate(self.drive, dt=self.dt, state=self._before)
        return output

    def modelled(self, trial: FastDynamics) -> Floats:
        """Return the prediction through lags, resonances and delay."""
        predicted = self.predicted
        if trial.amplifier:
            stages = (Amplifier(trial.amplifier), *self.static.stages)
            predicted = self._simulated(self.static.with_stages(stages))
        sections = Dynamics((Lag(trial.lag), *trial.resonances))
        modelled = sections.run(predicted, State(), self.dt).y
        if trial.form.delay:
            modelled = Delay(trial.delay).run(modelled, State(), self.dt).y
        return np.asarray(modelled, dtype=np.float64)

    def residuals(self, trial: FastDynamics) -> Floats:
        """Return what the best gain, offset and drift of the prediction leave of the measured."""
        modelled, _ = detrended(self.modelled(trial), self.time)
        measured, _ = detrended(self.measured, self.time)
        gain = float(modelled @ measured) / max(float(modelled @ modelled), 1e-300)
        return measured - gain * modelled


class FastRows:
    """All fast parts beside one static model.

    Attributes
    ----------
    signals : of each part
    band : lowest and highest frequency swept (Hz)
    step : the shortest time step (s)
    """

    def __init__(self, static: Cascade, fast: Sequence[Sweep]) -> None:
        self.signals = [Signals(static, sweep) for sweep in fast]
        lows, highs = zip(*(sweep.band for sweep in fast), strict=True)
        self.band: Band = min(lows), max(highs)
        self.step = min(sweep.dt for sweep in fast)

    @property
    def longest(self) -> Signals:
        """The part with the most rows."""
        return max(self.signals, key=lambda signals: signals.measured.size)

    def residuals(self, trial: FastDynamics) -> Floats:
        """Return what dynamics leave of all sweeps, one after another."""
        return np.concatenate([signals.residuals(trial) for signals in self.signals])

    def sections(self, best: FastDynamics) -> tuple[Section, ...]:
        """Return the sections, a lag first where there is one."""
        if best.lag <= NO_LAG * self.step:
            return tuple(best.resonances)
        return (Lag(best.lag), *best.resonances)


def fitted(rows: FastRows, starts: Sequence[Floats], form: Form) -> FastDynamics:
    """Return the best of several refinements, with its error on blocks left out."""
    low, high = _bounds(rows, form)

    def error(parameters: Floats) -> Floats:
        return rows.residuals(FastDynamics(form, parameters))

    def refined(start: Floats, steps: int) -> Any:
        # no bound on the gradient: it has the displacement's unit
        return least_squares(error, start, bounds=(low, high), x_scale=0.1,
                             diff_step=DERIVATIVE_STEP, gtol=None, max_nfev=steps)  # fmt: skip

    different = {tuple(np.clip(start, low, high).tolist()) for start in starts}
    tried = [refined(np.array(start), FEW_STEPS) for start in sorted(different)]
    tried.sort(key=lambda trial: trial.cost)
    finals = [refined(trial.x, MOST_STEPS) for trial in tried[:FINALISTS]]
    best = min(finals, key=lambda trial: trial.cost)
    rmse = float(np.sqrt(np.mean(best.fun**2)))
    return FastDynamics(form, best.x, rmse, _left_out(rows, best.fun, best.jac))


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
    sizes = [signals.measured.size for signals in rows.signals]
    blocks = [np.arange(size) * FAST_BLOCKS // size for size in sizes]
    block = np.concatenate(blocks)
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
    from scipy.signal import csd, welch  # as long to load as a short log is identified

    size = min(before.size, max(256, round(8.0 / (band[0] * dt))))
    frequency, power = welch(before, 1.0 / dt, nperseg=size)
    both = csd(before, after, 1.0 / dt, nperseg=size)[1]
    driven = (frequency >= band[0]) & (frequency <= band[1])
    driven &= power > ENERGY**2 * power.max()
    return frequency[driven], power[driven], both[driven]


def peak_of(rows: FastRows, best: FastDynamics) -> float:
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
