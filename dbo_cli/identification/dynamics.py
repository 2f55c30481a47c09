"""Resonances and lags behind the gears, from small sweeps and fast logs.

What the static model predicts for the fast rows is the input of the dynamics, what was
measured their output. Starts come from the ratio of the two spectra; parameters are
refined on the output error. No, one or two resonances, the last with an antiresonance
or without, and a pure delay: by the error on blocks left out, one step from the whole
fit. ``find`` does this for a static model that knows no dynamics; the slow rows are then
identified again with the sections known, and ``refine`` fits the sections again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.signal import csd, welch

from dbo_cli.errors import FitError
from dbo_cli.identification.fast import FastPart
from dbo_cli.model import (
    Delay,
    Dynamics,
    Gears,
    Lag,
    Mode,
    Model,
    Relaxation,
    Resonance,
)

Floats = NDArray[np.float64]
Section = Lag | Resonance
Band = tuple[float, float]

MOST_RESONANCES = 2  # one sweep does not tell more apart
BLOCKS, FOLDS = 40, 5  # blocks of the fast rows, dealt out to the folds in turn
EARNED = 0.9  # of the error left out: what a resonance must lower it to
SURE, MOST_OF_IT = 200.0, 0.3
"""Or, for a second resonance: the squares left out fall by so many times the noise's mean square, and by
this share of what they are beyond white noise."""
LEAST_DAMPING, MOST_DAMPING = 1e-4, 0.98
MOST_BESIDE = 0.1  # damping of resonances one of which has an antiresonance
DAMPINGS = (0.002, 0.02, 0.1, 0.4)  # starts: the error has several minima in it
INSIDE = 1.02  # times a bound at which a fit would like to go on
APART = 0.3  # of the logarithms of two resonances
NEAR = (
    0.03  # of the logarithms of a resonance and an antiresonance that undo each other
)
NO_LAG = 2e-3  # of a time step: a lag at the lower end of its range is none
FEW_STEPS, FINALISTS, MOST_STEPS = 6, 2, 40  # of a refinement
SMALL = 1e-5  # of a parameter's logarithm, for derivatives
SEEN_DELAY = 0.1  # periods of the highest frequency: less is fitted as a lag
SAME_GAIN = 0.3  # of the logarithm: up to here the phase tells a delay
FAST_LAGS = 2.0  # periods of the lowest frequency: shorter relaxation is dynamics
ENERGY = 0.003  # of the strongest amplitude of the drive: with less nothing is known
COHERENT = 0.5  # least coherence of a response that is shown
SHOWN = 60  # frequencies of the response that a model keeps
UNEXPLAINED = 0.1  # of what the fast rows do: more is a warning
STUDENT = 2.0  # standard errors of a 95 % interval


@dataclass(frozen=True)
class Form:
    """How many resonances, an antiresonance of the highest or none, and a delay behind all or none."""

    resonances: int
    antiresonance: bool = False
    delay: bool = False


@dataclass(frozen=True)
class Fitted:
    """Dynamics fitted to the fast rows.

    Attributes
    ----------
    form
        What was fitted.
    parameters
        Logarithms: frequency (Hz) and damping of each resonance, of the antiresonance,
        the delay (s), the lag (s).
    rmse, left_out
        On all fast rows, and on blocks left out.
    noise
        Mean square of what is white in what is left.
    spread
        Standard errors of the parameters.
    """

    form: Form
    parameters: Floats
    rmse: float
    left_out: float
    noise: float
    spread: Floats

    @property
    def white(self) -> bool:
        """Whether what is left is noise alone."""
        return self.rmse**2 <= 1.05 * self.noise

    @property
    def delay(self) -> float:
        """The pure delay behind all (s)."""
        return float(np.exp(self.parameters[-2])) if self.form.delay else 0.0

    @property
    def resonances(self) -> list[Resonance]:
        """The resonances, lowest first."""
        return _resonances(self.parameters, self.form)


class Signals:
    """Of one fast part: what the static model predicts, and what was measured."""

    def __init__(self, model: Model, part: FastPart, creep: Sequence[Lag] = ()) -> None:
        log, rows = part.recording, part.rows
        still = without_fast_lags(model.static, FAST_LAGS / part.band[0])
        moved, _ = still.simulate(log.voltage[: rows.stop], dt=part.dt)
        if creep:
            moved, _ = Dynamics(tuple(creep)).run(moved, part.dt)
        self.dt = part.dt
        self.predicted = np.asarray(moved[rows], dtype=np.float64)
        self.measured = log.displacement[rows]
        size = self.measured.size
        self.block = np.arange(size) * BLOCKS // size
        ramp = np.linspace(-1.0, 1.0, size)
        self._drift = np.column_stack([np.ones(size), ramp])
        self._drift /= np.sqrt(np.sum(self._drift**2, axis=0))

    def free(self, signal: Floats) -> Floats:
        """Return what an offset and an even drift do not explain of a signal."""
        left: Floats = signal - self._drift @ (self._drift.T @ signal)
        return left

    def moved(self, parameters: Floats, form: Form) -> Floats:
        """Return the prediction through lag, resonances and delay."""
        sections: list[Section] = [Lag(float(np.exp(parameters[-1])))]
        sections += _resonances(parameters, form)
        moved, _ = Dynamics(tuple(sections)).run(self.predicted, self.dt)
        if form.delay:
            moved, _ = Delay(float(np.exp(parameters[-2]))).run(moved, self.dt)
        return np.asarray(moved, dtype=np.float64)

    def left(self, parameters: Floats, form: Form) -> Floats:
        """Return what the best gain, offset and drift of the prediction leave of the measured."""
        moved = self.free(self.moved(parameters, form))
        measured = self.free(self.measured)
        gain = float(moved @ measured) / max(float(moved @ moved), 1e-300)
        return measured - gain * moved


def find(
    static: Model, fast: Sequence[FastPart], wanted: str | int
) -> tuple[tuple[Section, ...], float, dict[str, Any]]:
    """Return sections, delay (s) and figures of the dynamics that the fast rows ask for.

    Parameters
    ----------
    static
        Identified from the slow rows; its own dynamics and delay do not count.
    fast
        The fast parts.
    wanted
        How many resonances, or "auto". Without any the sections are empty.

    Raises
    ------
    FitError
        Resonances are asked for, and no log has fast rows.
    """
    if not fast:
        if wanted == "auto":
            return (), 0.0, {}
        raise FitError(
            f"`dynamics` {wanted}: no log has a small sweep, nor is one ten times as fast as another "
            "(record a drive of excite with `sweep_to`)"
        )
    band = _band(fast)
    signals = [Signals(static, part) for part in fast]
    best = _with_delay(signals, band, wanted, _chosen(signals, band, wanted, 0.0))
    if not best.form.resonances:
        return (), 0.0, {"warnings": _unexplained(signals, fast, best)}
    return _sections(best, signals), best.delay, _figures(best, signals, fast)


def refine(
    static: Model,
    fast: Sequence[FastPart],
    sections: Sequence[Section],
    delay: float,
    wanted: str | int = "auto",
    creep: Sequence[Lag] = (),
) -> tuple[tuple[Section, ...], float, dict[str, Any]]:
    """Return sections, delay and figures fitted again around those found, with a static model that knew them.

    What hides a weak second resonance from the first reading of the slow rows is gone
    with the second: one more is offered. ``creep`` stands behind the gears and before
    the sections; it is not among those returned.
    """
    band = _band(fast)
    signals = [Signals(static, part, creep) for part in fast]
    form, start = _parameters(sections, delay, signals)
    best = fitted(signals, [start], form, band)
    if wanted == "auto" and form.resonances < MOST_RESONANCES and not best.white:
        best = _one_more(signals, best, band) or best
    return _sections(best, signals), best.delay, _figures(best, signals, fast)


def least_relaxation(fast: Sequence[FastPart]) -> float:
    """Return the shortest time constant (s) that slow rows may tell; what is faster is dynamics."""
    return FAST_LAGS / _band(fast)[0]


def without_fast_lags(model: Model, shortest: float) -> Model:
    """Return a model whose relaxation of less than ``shortest`` (s) is immediate.

    A memory of milliseconds stands in a slow model for what dynamics say better. At
    once, it makes every gear steeper by its gain.
    """
    gears = model.gears
    terms = gears.relaxation
    if terms is None or min(terms.tau) >= shortest:
        return model
    kept = [
        pair for pair in zip(terms.tau, terms.gain, strict=True) if pair[0] >= shortest
    ]
    added = sum(terms.gain) - sum(gain for _, gain in kept)
    rest = None
    if kept:
        rest = Relaxation(terms.reference, *map(tuple, zip(*kept, strict=True)))
    y0 = gears.y0 + added * (gears.x0 - terms.reference)
    steeper = Gears(gears.dx, gears.dy + added * gears.dx, gears.x0, y0, rest)
    stages = [steeper if stage is gears else stage for stage in model.stages]
    return model.with_stages(tuple(stages))


# --- which dynamics ---


def _chosen(
    signals: Sequence[Signals], band: Band, wanted: str | int, delay: float
) -> Fitted:
    """Return the dynamics that earn their place, or with as many resonances as are asked for."""
    starts = []
    for lag in (0.02, 0.3):
        starts.append(np.log([delay, lag / band[1]] if delay else [lag / band[1]]))
    best = fitted(signals, starts, Form(0, delay=delay > 0.0), band)
    most = MOST_RESONANCES if wanted == "auto" else int(wanted)
    while best.form.resonances < most:
        if wanted == "auto" and best.form.resonances and best.white:
            break
        more = _one_more(signals, best, band, always=wanted != "auto")
        if more is None:
            break
        best = more
    return best


def _with_delay(
    signals: Sequence[Signals], band: Band, wanted: str | int, without: Fitted
) -> Fitted:
    """Return dynamics with a pure delay behind them where the fast rows ask for it, else those without.

    A sensor that is late by half a period of a resonance turns its phase around:
    without the delay no resonance fits.
    """
    if without.form.resonances and without.white:
        return without
    late = _phase_delay(signals, band)
    if late * band[1] < SEEN_DELAY:
        return without
    behind = _chosen(signals, band, wanted, late)
    return behind if behind.left_out <= EARNED * without.left_out else without


def _one_more(
    signals: Sequence[Signals], best: Fitted, band: Band, always: bool = False
) -> Fitted | None:
    """Return dynamics with one more resonance, or None where it does not earn its place.

    It comes with an antiresonance where that earns its own, as two modes that add up
    have one.
    """
    count = best.form.resonances
    form = Form(count + 1, False, best.form.delay)
    *known, lag = best.parameters.tolist()
    tail = [known.pop()] if form.delay else []
    tail.append(max(lag, float(np.log(0.02 / band[1]))))
    peak = _peak(signals, best, band)
    starts = []
    for damping in DAMPINGS:
        for frequency in (peak, 0.8 * band[1])[: 1 + (count > 0)]:
            pair = np.log([frequency, damping]).tolist()
            starts.append(np.array([*known[: 2 * count], *pair, *tail]))
    more = fitted(signals, starts, form, band)
    if not count:
        starts = [more.parameters]
    notched = []
    for start in starts:
        frequency, damping = start[2 * count : 2 * count + 2]
        for side in (-NEAR, NEAR):
            beside = [frequency + side, damping]
            notched.append(np.array([*start[: 2 * count + 2], *beside, *tail]))
    with_notch = Form(count + 1, True, form.delay)
    other = fitted(signals, notched, with_notch, band)
    if _earned(signals, other, more, band):
        more = other
    return more if always or _earned(signals, more, best, band) else None


def _earned(signals: Sequence[Signals], more: Fitted, best: Fitted, band: Band) -> bool:
    """Return whether the error left out asks for more, all of it inside the swept band."""
    for resonance in more.resonances:
        if not _is_inside(resonance, band):
            return False
    if more.left_out <= EARNED * best.left_out:
        return True
    if not best.form.resonances:
        return False
    rows = sum(part.measured.size for part in signals)
    gained = rows * (best.left_out**2 - more.left_out**2)
    beyond = rows * (best.left_out**2 - best.noise)
    return gained >= max(SURE * best.noise, MOST_OF_IT * beyond)


def _is_inside(resonance: Resonance, band: Band) -> bool:
    """Return whether a resonance, and its antiresonance, lie inside the swept band and the bounds."""
    lowest, highest = INSIDE * band[0], band[1]
    if not lowest < resonance.frequency < highest:
        return False
    if resonance.damping < INSIDE * LEAST_DAMPING:
        return False
    beside = resonance.antiresonance
    if beside is None:
        return True
    if max(resonance.damping, beside.damping) > MOST_BESIDE / INSIDE:
        return False
    return lowest < beside.frequency < highest


# --- fits ---


def fitted(
    signals: Sequence[Signals], starts: Sequence[Floats], form: Form, band: Band
) -> Fitted:
    """Return the best of several refinements, judged (see ``_judged``)."""
    low, high = _bounds(signals, form, band)

    def error(parameters: Floats) -> Floats:
        return np.concatenate([part.left(parameters, form) for part in signals])

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
    step = min(part.dt for part in signals)
    pairs = form.resonances + form.antiresonance
    damping = MOST_BESIDE if form.antiresonance else MOST_DAMPING
    low = [band[0], LEAST_DAMPING] * pairs
    high = [1.5 * band[1], damping] * pairs
    if form.delay:
        low.append(0.01 / band[1])
        high.append(10.0 / band[1])
    low.append(0.5 * NO_LAG * step)
    high.append(10.0 / band[1])
    return np.log(low), np.log(high)


def _judged(signals: Sequence[Signals], parameters: Floats, form: Form) -> Fitted:
    """Return a fit with its error on blocks left out and the standard errors of its parameters.

    A fit without some blocks is one step from the whole fit. The standard errors hold
    where what is left is no white noise, too: (J'J)^-1 (sum of g g') (J'J)^-1 with g =
    J'r of each block (Liang and Zeger, Biometrika 73, 13, 1986).
    """
    left = np.concatenate([part.left(parameters, form) for part in signals])
    columns = []
    for direction in np.eye(parameters.size):
        beside = [part.left(parameters + SMALL * direction, form) for part in signals]
        columns.append((np.concatenate(beside) - left) / SMALL)
    along = np.column_stack(columns)
    block = np.concatenate([part.block for part in signals])
    squares = 0.0
    for fold in range(FOLDS):
        out = block % FOLDS == fold
        kept = along[~out]
        step = -np.linalg.lstsq(kept, left[~out], rcond=1e-9)[0]
        squares += float(np.sum((left[out] + along[out] @ step) ** 2))
    inverse = np.linalg.pinv(along.T @ along, hermitian=True)
    pulls = np.zeros((BLOCKS, parameters.size))
    np.add.at(pulls, block, along * left[:, None])
    spread = np.sqrt(np.diag(inverse @ (pulls.T @ pulls) @ inverse))
    noise = [np.diff(part.left(parameters, form), 2) for part in signals]
    return Fitted(
        form,
        parameters,
        float(np.sqrt(np.mean(left**2))),
        float(np.sqrt(squares / left.size)),
        float(np.mean(np.concatenate(noise) ** 2)) / 6.0,
        spread,
    )


def _in_order(parameters: Floats, form: Form) -> Floats:
    """Return parameters with the resonances in the order of their frequencies."""
    count = form.resonances
    pairs = parameters[: 2 * count].reshape(count, 2)
    ordered = pairs[np.argsort(pairs[:, 0])]
    return np.concatenate([ordered.ravel(), parameters[2 * count :]])


def _resonances(parameters: Floats, form: Form) -> list[Resonance]:
    """Return the resonances of logarithms, lowest first; the last one has the antiresonance."""
    count = form.resonances
    pairs = np.exp(parameters[: 2 * count]).reshape(count, 2)
    pairs = pairs[np.argsort(pairs[:, 0])]
    found = []
    for frequency, damping in pairs.tolist():
        found.append(Resonance(frequency, min(damping, MOST_DAMPING)))
    if form.antiresonance:
        frequency, damping = np.exp(parameters[2 * count : 2 * count + 2]).tolist()
        beside = Mode(frequency, min(damping, MOST_DAMPING))
        found[-1] = Resonance(found[-1].frequency, found[-1].damping, beside)
    return found


def _sections(best: Fitted, signals: Sequence[Signals]) -> tuple[Section, ...]:
    """Return the sections, a lag first where there is one."""
    lag = float(np.exp(best.parameters[-1]))
    if lag <= NO_LAG * min(part.dt for part in signals):
        return tuple(best.resonances)
    return (Lag(lag), *best.resonances)


def _parameters(
    sections: Sequence[Section], delay: float, signals: Sequence[Signals]
) -> tuple[Form, Floats]:
    """Return form and parameters of sections."""
    values: list[float] = []
    beside: list[float] = []
    lag = NO_LAG * min(part.dt for part in signals)
    for section in sections:
        if isinstance(section, Lag):
            lag = section.seconds
            continue
        values += [section.frequency, section.damping]
        if section.antiresonance is not None:
            beside = [section.antiresonance.frequency, section.antiresonance.damping]
    form = Form(len(values) // 2, bool(beside), delay > 0.0)
    late = [delay] if delay > 0.0 else []
    return form, np.log([*values, *beside, *late, lag])


# --- spectra ---


def _band(fast: Sequence[FastPart]) -> Band:
    return min(part.band[0] for part in fast), max(part.band[1] for part in fast)


def _spectra(
    before: Floats, after: Floats, dt: float, band: Band
) -> tuple[Floats, Floats, NDArray[np.complex128]]:
    """Return Hz, power and cross power of two signals, where the first has energy within the band."""
    size = min(before.size, max(256, round(8.0 / (band[0] * dt))))
    frequency, power = welch(before, 1.0 / dt, nperseg=size)
    both = csd(before, after, 1.0 / dt, nperseg=size)[1]
    driven = (frequency >= band[0]) & (frequency <= band[1])
    driven &= power > ENERGY**2 * power.max()
    return frequency[driven], power[driven], both[driven]


def _longest(signals: Sequence[Signals]) -> Signals:
    return max(signals, key=lambda part: part.measured.size)


def _peak(signals: Sequence[Signals], best: Fitted, band: Band) -> float:
    """Return where the measured departs most from the best found (Hz), away from its resonances."""
    one = _longest(signals)
    moved = one.moved(best.parameters, best.form)
    left = one.left(best.parameters, best.form)
    frequency, power, both = _spectra(moved, left, one.dt, band)
    away = np.ones(frequency.size, dtype=bool)
    for known in best.resonances:
        away &= np.abs(np.log(frequency / known.frequency)) > APART
    if not away.any():
        return 0.7 * band[1]
    ratio = np.abs(both[away]) / power[away]
    return float(frequency[away][np.argmax(ratio)])


def _phase_delay(signals: Sequence[Signals], band: Band) -> float:
    """Return how late the measured is (s), by the phase where its gain is still that of slow moves."""
    one = _longest(signals)
    frequency, power, both = _spectra(one.predicted, one.measured, one.dt, band)
    if frequency.size < 3:
        return 0.0
    gain = np.abs(both) / power
    changed = np.flatnonzero(np.abs(np.log(gain / np.median(gain[:3]))) > SAME_GAIN)
    rows = max(int(changed[0]) if changed.size else frequency.size, 3)
    phase = np.unwrap(np.angle(both[:rows]))
    w = 2.0 * np.pi * frequency[:rows]
    slope = float(np.sum(power[:rows] * w * phase) / np.sum(power[:rows] * w * w))
    return max(-slope, 0.0)


# --- what is said ---


def _figures(
    best: Fitted, signals: Sequence[Signals], fast: Sequence[FastPart]
) -> dict[str, Any]:
    """Return what the model file says of the dynamics."""
    resonances = []
    for k, resonance in enumerate(best.resonances):
        frequency, damping = best.spread[2 * k : 2 * k + 2].tolist()
        resonances.append(
            {
                "frequency": resonance.frequency,
                "damping": resonance.damping,
                "frequency_interval": _interval(resonance.frequency, frequency),
                "damping_interval": _interval(resonance.damping, damping),
            }
        )
    return {
        "resonances": resonances,
        "rmse": best.rmse,
        "left_out_rmse": best.left_out,
        "logs": [part.recording.name for part in fast],
        "swept": list(_band(fast)),
        "response": _response(signals, fast),
        "warnings": _unexplained(signals, fast, best),
    }


def _interval(value: float, spread: float) -> list[float]:
    """Return both ends of the interval of a parameter, from the standard error of its logarithm."""
    factor = float(np.exp(STUDENT * spread))
    return [value / factor, value * factor]


def _response(
    signals: Sequence[Signals], fast: Sequence[FastPart]
) -> dict[str, list[float]]:
    """Return the measured response to what the gears make of the drive: Hz, gain (1 at rest), degrees."""
    one, band = _longest(signals), _band(fast)
    frequency, power, both = _spectra(one.predicted, one.measured, one.dt, band)
    size = min(one.measured.size, max(256, round(8.0 / (band[0] * one.dt))))
    every, other = welch(one.measured, 1.0 / one.dt, nperseg=size)
    coherent = np.abs(both) ** 2 > COHERENT * power * np.interp(frequency, every, other)
    frequency, ratio = frequency[coherent], (both / power)[coherent]
    if frequency.size == 0:
        return {"frequency": [], "gain": [], "phase_degrees": []}
    at = np.geomspace(frequency[0], frequency[-1], SHOWN)
    rows = np.unique(np.argmin(np.abs(frequency - at[:, None]), axis=1))
    phase = np.degrees(np.unwrap(np.angle(ratio)))
    return {
        "frequency": _rounded(frequency[rows]),
        "gain": _rounded(np.abs(ratio)[rows]),
        "phase_degrees": _rounded(phase[rows]),
    }


def _rounded(values: Floats) -> list[float]:
    return [float(f"{value:.4g}") for value in values]


def _unexplained(
    signals: Sequence[Signals], fast: Sequence[FastPart], best: Fitted
) -> list[str]:
    """Return a warning for each fast part of which much is not explained; noise aside."""
    warnings = []
    for part, one in zip(fast, signals, strict=True):
        left = one.left(best.parameters, best.form)
        noise = float(np.mean(np.diff(left, 2) ** 2)) / 6.0
        beyond = max(float(np.var(left)) - noise, 0.0)
        share = float(np.sqrt(beyond / np.var(one.measured)))
        if share > UNEXPLAINED:
            low, high = part.band
            warnings.append(
                f"{part.recording.name}: rows {part.rows.start + 1} to {part.rows.stop} move at {low:.3g} to "
                f"{high:.3g} Hz, and {100.0 * share:.0f} % of that is not explained: the model is for slow "
                "moves only (a sweep of more volts, or to a higher frequency, may show what moves)"
            )
    return warnings
