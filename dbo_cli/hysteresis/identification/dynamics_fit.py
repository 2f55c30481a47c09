"""Which dynamics fast rows ask for: fits of given ones, and how many resonances, with antiresonances or none.

One resonance after the other is offered, and judged by the error on blocks of rows left
out. And what is said of them: intervals, the measured response, how far the model is
trusted.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.signal import csd, lfilter, welch

from dbo_cli.hysteresis.cascade import late_by, whole_and_part
from dbo_cli.hysteresis.dynamics import (
    Antiresonance,
    DynamicsStage,
    Lag,
    Resonance,
    Section,
    latency_text,
)
from dbo_cli.hysteresis.identification.evaluation import (
    FOLDS,
    STUDENT,
    TINY,
    WHOSE_LAG,
    beyond_noise,
    outward,
    white_noise,
)
from dbo_cli.hysteresis.identification.normal_equations import sum_of_squares
from dbo_cli.hysteresis.identification.recordings import MOST, FastPart, Floats
from dbo_cli.hysteresis.identification.statistics import EARNED
from dbo_cli.hysteresis.model import ActuatorModel

Booleans = NDArray[np.bool_]
Band = tuple[float, float]  # lowest and highest frequency swept, Hz

# of the fast rows, dealt out to the folds in turn, so that every fold has all
# frequencies
BLOCKS = 40
# rings for 1,600 periods; hardly rings, and is no pair of lags yet
LEAST_DAMPING, MOST_DAMPING = 1e-4, 0.98
MOST_BESIDE = 0.1
"""Largest damping of resonances where one has an antiresonance. Measured: docs/choices.md."""
# of a refinement: of all starts, how many go on, to the end
FEW_STEPS, FINALISTS, MOST_STEPS = 6, 2, 40
# of a parameter's logarithm: for derivatives, far above rounding and far below any bend
SMALL = 1e-5
NO_LAG = 2e-3  # of a time step: a lag at the lower end of its range is none


@dataclass(frozen=True)
class DynamicsStructure:
    """What is fitted.

    Attributes
    ----------
    resonances : int
        How many.
    antiresonance : bool
        Whether the highest has one.
    lag_before : bool
        Whether the lag stands before the gears, not behind them.
    sampled_lag : bool
        Whether it is the lag of the stage, not an exact one (see ``lagged``).
    delay : float
        Pure delay behind all (s): of a sensor, mostly.
    """

    resonances: int
    antiresonance: bool = False
    lag_before: bool = False
    sampled_lag: bool = False
    delay: float = 0.0


@dataclass(frozen=True)
class FittedDynamics:
    """Dynamics fitted.

    Attributes
    ----------
    structure : DynamicsStructure
        What was fitted.
    parameters : array
        Logarithms: of frequency (Hz) and damping of each resonance, of the
        antiresonance's, of the lag (s).
    lag : float
        Seconds, 0 for none.
    rmse, left_out : float
        On all fast rows, and on blocks left out.
    spread : array
        Standard errors of the parameters.
    """

    structure: DynamicsStructure
    parameters: Floats
    lag: float
    rmse: float
    left_out: float
    spread: Floats

    @property
    def resonances(self) -> tuple[Resonance, ...]:
        """The second-order sections, lowest first."""
        found = sections_of(self.parameters, self.structure)
        return tuple(section for section in found if isinstance(section, Resonance))

    @property
    def behind(self) -> tuple[Section, ...]:
        """The sections behind the gears, a lag first."""
        lagging = self.lag > 0.0 and not self.structure.lag_before
        lag: tuple[Section, ...] = (Lag(self.lag),) if lagging else ()
        return (*lag, *self.resonances)

    @property
    def lag_before(self) -> float:
        """The lag before the gears (s), 0 for none."""
        return self.lag if self.structure.lag_before else 0.0


class Signals:
    """Of one fast part: what the slow model predicts for its drive, and what was measured.

    Parameters
    ----------
    model
        Of the slow rows, without lag.
    part
        The fast rows. Those before them lead to the state in which the gears are.
    """

    def __init__(self, model: ActuatorModel, part: FastPart) -> None:
        log, rows = part.recording, part.rows
        self.time_step = part.time_step
        self.measured = log.displacement[rows]
        self.voltage = log.voltage[rows]
        self.block = (np.arange(self.measured.size) * BLOCKS) // self.measured.size
        # of the drift, at right angles to an offset
        self._at = np.linspace(-1.0, 1.0, self.measured.size)
        self._at /= np.sqrt(np.einsum("i,i->", self._at, self._at))
        self._steady = self._without_drift(self.measured)
        self._model = model
        before = model.start(float(log.voltage[0]), "auto")
        self._state = model.simulate(
            log.voltage[: rows.start], before, time_step=part.time_step
        ).state
        self._lag, self._predicted = (0.0, False), self._after(0.0, False)
        self._late = self._lag, self._predicted

    def predicted(self, lag_before: float = 0.0, sampled: bool = False) -> Floats:
        """Return what the slow model predicts, its drive passed through a lag (s) first."""
        if (lag_before, sampled) != self._lag:
            self._lag, self._predicted = (
                (lag_before, sampled),
                self._after(lag_before, sampled),
            )
        return self._predicted

    def _after(self, lag: float, sampled: bool) -> Floats:
        drive = lagged(self.voltage, lag, self.time_step, sampled)
        return self._model.simulate(drive, self._state, time_step=self.time_step).y

    def _without_drift(self, signal: Floats) -> Floats:
        """Return what an offset and an even drift do not explain of a signal."""
        free: Floats = signal - signal.mean()
        free -= np.einsum("i,i->", self._at, free) * self._at
        return free

    def left(self, moved: Floats) -> Floats:
        """Return what is measured beside a prediction, the best gain, offset and drift fitted."""
        free = self._without_drift(moved)
        power = max(float(np.einsum("i,i->", free, free)), TINY)
        left: Floats = (
            self._steady - np.einsum("i,i->", self._steady, free) / power * free
        )
        return left

    def moved(self, parameters: Floats, structure: DynamicsStructure) -> Floats:
        """Return the prediction through the lag, the gears and the resonances."""
        lag, *resonances = sections_of(parameters, structure)
        assert isinstance(lag, Lag)
        if structure.lag_before:
            moved = self.predicted(lag.seconds, structure.sampled_lag)
        else:
            behind = lag.seconds, structure.sampled_lag
            if behind != self._late[0]:  # most steps of a fit change a resonance alone
                self._late = (
                    behind,
                    lagged(self.predicted(), behind[0], self.time_step, behind[1]),
                )
            moved = self._late[1]
        if resonances:
            moved, _ = DynamicsStage(tuple(resonances)).run(moved, self.time_step, None)
        if not structure.delay:
            return moved
        whole, part = whole_and_part(structure.delay / self.time_step)
        held = np.concatenate([np.full(min(whole + 1, moved.size), moved[0]), moved])
        return late_by(held[: moved.size + 1], part)


def lagged(
    x: Floats, seconds: float, time_step: float, sampled: bool = False
) -> Floats:
    """Return a signal, straight between samples and at rest before, after an exact first-order lag.

    ``sampled``: after the one of the stage.

    The stage's own lag, whose inverse is stable, is right at low frequencies and 1 %
    off at a quarter of a radian a sample. Fitted with it, a lag of 0.2 ms in a sweep to
    1 kHz (20 kHz) came out as 0.195 ms.
    """
    if seconds <= 0.0:
        return x
    if sampled:
        return DynamicsStage((Lag(seconds),)).run(x, time_step, None)[0]
    ratio = time_step / seconds
    decay = math.exp(-ratio)
    hold = -math.expm1(-ratio) / ratio
    answer: Floats = x[0] + lfilter([1.0 - hold, hold - decay], [1.0, -decay], x - x[0])
    return answer


def residuals(
    signals: Sequence[Signals], parameters: Floats, structure: DynamicsStructure
) -> list[Floats]:
    """Return measured minus predicted through the dynamics, gain, offset and drift of each part fitted."""
    return [one.left(one.moved(parameters, structure)) for one in signals]


def sections_of(
    parameters: Floats, structure: DynamicsStructure
) -> tuple[Section, ...]:
    """Return the lag and the resonances of logarithms, lowest first, wherever the lag stands."""
    count = structure.resonances
    values = np.exp(parameters)
    pairs = []
    for k in range(count):
        damping = float(min(values[2 * k + 1], MOST_DAMPING))
        pairs.append((float(values[2 * k]), damping))
    pairs.sort()
    resonances = [Resonance(frequency, damping) for frequency, damping in pairs]
    if structure.antiresonance:
        frequency = float(values[2 * count])
        damping = float(min(values[2 * count + 1], MOST_DAMPING))
        beside = Antiresonance(frequency, damping)
        resonances[-1] = Resonance(*pairs[-1], beside)
    return (Lag(float(values[-1])), *resonances)


def _refined(
    signals: Sequence[Signals],
    start: Floats,
    structure: DynamicsStructure,
    bounds: tuple[Floats, Floats],
    keep: Booleans,
    known: dict[bytes, list[Floats]],
    most: int = MOST_STEPS,
) -> tuple[Floats, float]:
    """Return the parameters of least error on the blocks to keep, and that error (RMS).

    ``known`` holds the residuals of parameters, which fits of the same structure from
    one start share.
    """
    chosen = [keep[one.block] for one in signals]

    def error(parameters: Floats) -> Floats:
        key = parameters.tobytes()
        left = known.get(key)
        if left is None:
            left = residuals(signals, parameters, structure)
            # of the start and beside it: other fits begin there, too
            if len(known) <= parameters.size:
                known[key] = left
        return np.concatenate(
            [part[rows] for part, rows in zip(left, chosen, strict=True)]
        )

    # Its bound on the gradient is in the displacement's unit: in metres every start
    # would be the end.
    found = least_squares(
        error,
        np.clip(start, *bounds),
        bounds=bounds,
        x_scale=0.1,
        diff_step=SMALL,
        gtol=None,
        max_nfev=most,
    )
    return found.x, float(np.sqrt(np.mean(found.fun**2)))


def fitted(
    signals: Sequence[Signals],
    starts: Sequence[Floats],
    structure: DynamicsStructure,
    band: Band,
) -> FittedDynamics:
    """Return the best of several refinements, and its error on blocks left out.

    Parameters
    ----------
    signals
        The fast parts.
    starts
        Parameters to begin from (see ``FittedDynamics``).
    structure
        What is fitted.
    band
        Where resonances are looked for, and half as far again above.
    """
    step = min(one.time_step for one in signals)
    seconds = structure.resonances + structure.antiresonance
    damping = MOST_BESIDE if structure.antiresonance else MOST_DAMPING
    low = np.log([*[band[0], LEAST_DAMPING] * seconds, 0.5 * NO_LAG * step])
    high = np.log([*[1.5 * band[1], damping] * seconds, 10.0 / band[1]])
    every = np.ones(BLOCKS, dtype=bool)

    @cache
    def from_start(start: tuple[float, ...], most: int) -> tuple[Floats, float]:
        return _refined(
            signals, np.array(start), structure, (low, high), every, {}, most
        )

    # Within the bounds many a start is another one.
    tried = [
        from_start(tuple(np.clip(start, low, high).tolist()), FEW_STEPS)
        for start in starts
    ]
    tried = sorted(tried, key=lambda one: one[1])[:FINALISTS]
    best, rmse = min(
        (from_start(tuple(b.tolist()), MOST_STEPS) for b, _ in tried),
        key=lambda one: one[1],
    )
    squares, rows, known = 0.0, 0, dict[bytes, list[Floats]]()
    for fold in range(FOLDS):
        keep = np.arange(BLOCKS) % FOLDS != fold
        parameters, _ = _refined(signals, best, structure, (low, high), keep, known)
        left = residuals(signals, parameters, structure)
        for part, one in zip(left, signals, strict=True):
            out = part[~keep[one.block]]
            squares, rows = squares + sum_of_squares(out), rows + out.size
    spread = _spread(signals, best, structure)
    order = np.argsort(best[0 : 2 * structure.resonances : 2])
    places = [2 * k + side for k in order for side in (0, 1)]
    places += list(range(2 * structure.resonances, best.size))
    lag = float(np.exp(best[-1]))
    lag = lag if lag > NO_LAG * step else 0.0
    return FittedDynamics(
        structure,
        best[places],
        lag,
        rmse,
        float(np.sqrt(squares / rows)),
        spread[places],
    )


def _spread(
    signals: Sequence[Signals], best: Floats, structure: DynamicsStructure
) -> Floats:
    """Return the standard errors of parameters fitted, which hold where what is left over is no noise, too.

    (J'J)^-1 (sum of g g') (J'J)^-1 with g = J'r of each block: what the gears leave
    over repeats itself within a block, as noise does not (Liang and Zeger, Biometrika
    73, 13, 1986).
    """
    left = residuals(signals, best, structure)
    changed = []
    for direction in np.eye(best.size):
        changed.append(residuals(signals, best + SMALL * direction, structure))
    slopes, scatter = np.zeros((2, best.size, best.size))
    for k, part in enumerate(signals):
        along = np.array([(moved[k] - left[k]) / SMALL for moved in changed])
        slopes += np.einsum("ir,jr->ij", along, along)
        begins = np.flatnonzero(np.diff(part.block, prepend=-1))
        pulls = np.add.reduceat(along * left[k], begins, axis=1)
        scatter += np.einsum("ib,jb->ij", pulls, pulls)
    inverse = np.linalg.pinv(slopes, hermitian=True)
    spread: Floats = np.sqrt(
        np.maximum(np.einsum("ij,jk,ki->i", inverse, scatter, inverse), 0.0)
    )
    return spread


# what stages show within a sweep; more are not told apart by one (see SURE)
MOST_RESONANCES = 2
SURE, MOST_OF_IT = 200.0, 0.3
"""Or, once one resonance is found, to this: the sum of squares on blocks left out falls by so many times
the noise's mean square, and by this share of what it is beyond white noise. Measured:
docs/choices.md.
"""
# times the bound at which a fit would like to go on: what it found there is something
# else
INSIDE = 1.02
APART = 0.3  # of the logarithms of two resonances, at least
# of the logarithms of a resonance and an antiresonance from which a fit begins
NEAR = 0.03
SEEN_DELAY = 0.1
"""Periods of the highest swept frequency: an amplifier's lag of a tenth of one is fitted as a lag."""
# of the logarithm: a resonance of 2 % damping has this at half its frequency
SAME_GAIN = 0.3
FINEST_DELAY = 0.002  # of itself: a delay of 2 ms to 4 us, 0.4 degrees at 250 Hz
# a refinement starts from each: the error has several minima in it
DAMPINGS = (0.002, 0.02, 0.1, 0.4)


def chosen_dynamics(
    signals: Sequence[Signals], band: Band, asked: int | None, delay: float = 0.0
) -> tuple[FittedDynamics, list[str]]:
    """Return the dynamics that earn their place, or as many resonances as are asked for, and doubts of these.

    Parameters
    ----------
    delay
        A pure delay behind them (s).
    """
    lag_starts = [np.log([value]) for value in (0.02 / band[1], 0.3 / band[1])]
    best = fitted(signals, lag_starts, DynamicsStructure(0, delay=delay), band)
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
    signals: Sequence[Signals],
    band: Band,
    asked: int | None,
    without: FittedDynamics,
    doubts: list[str],
) -> tuple[FittedDynamics, list[str]]:
    """Return dynamics with a pure delay behind them, where the fast rows ask for one, else those without.

    A sensor that is late by half a period of a resonance turns its phase around:
    without the delay no resonance fits (250 Hz behind 2 ms were not found, and moves at
    a fifth of it missed by 21 %).
    """
    if without.resonances and _white(signals, without):
        return without, doubts
    late = _phase_delay(signals, band)
    if late * band[1] < SEEN_DELAY:
        return without, doubts
    best, more_doubts = chosen_dynamics(signals, band, asked, late)
    tried = {late: best}
    step = 0.25 * late
    # the lag took its part of the lateness: look to both sides
    while step > FINEST_DELAY * late:
        centre = best.structure.delay
        for delay in (centre - step, centre + step):
            if delay > 0.0 and delay not in tried:
                structure = dataclasses.replace(best.structure, delay=delay)
                tried[delay] = fitted(signals, [best.parameters], structure, band)
        nearest = min(tried.values(), key=lambda one: one.left_out)
        step = step if nearest.left_out < best.left_out else 0.5 * step
        best = nearest
    if best.left_out <= EARNED * without.left_out:
        return best, more_doubts
    return without, doubts


class Spectra(NamedTuple):
    """Hz; power of what goes in, and of it with what comes out; where it has energy within the band."""

    frequency: Floats
    power: Floats
    both: NDArray[np.complex128]
    driven: Booleans


def _longest(signals: Sequence[Signals]) -> Signals:
    return max(signals, key=lambda part: part.measured.size)


def _spectra(before: Floats, after: Floats, time_step: float, band: Band) -> Spectra:
    """Return the spectra of two signals, from segments of eight periods of the lowest frequency."""
    size = min(before.size, max(256, round(8.0 / (band[0] * time_step))))
    frequency, power = welch(before, 1.0 / time_step, nperseg=size)
    both = csd(before, after, 1.0 / time_step, nperseg=size)[1]
    driven = (
        (frequency >= band[0])
        & (frequency <= band[1])
        & (power > ENERGY**2 * power.max())
    )
    return Spectra(frequency, power, both, driven)


def _phase_delay(signals: Sequence[Signals], band: Band) -> float:
    """Return how late the measured is (s), by the phase where its gain is still that of slow moves."""
    one = _longest(signals)
    seen = _spectra(one.predicted(), one.measured, one.time_step, band)
    rows = np.flatnonzero(seen.driven)
    if rows.size < 3:
        return 0.0
    gain = np.abs(seen.both[rows]) / seen.power[rows]
    changed = np.flatnonzero(np.abs(np.log(gain / np.median(gain[:3]))) > SAME_GAIN)
    rows = rows[: max(int(changed[0]) if changed.size else rows.size, 3)]
    phase, w = np.unwrap(np.angle(seen.both[rows])), 2.0 * np.pi * seen.frequency[rows]
    weight = seen.power[rows]
    return max(-float(np.sum(weight * w * phase) / np.sum(weight * w * w)), 0.0)


def one_more(
    signals: Sequence[Signals], best: FittedDynamics, band: Band, always: bool = False
) -> FittedDynamics | None:
    """Return dynamics with a resonance more, or None where it does not earn its place.

    It comes with an antiresonance where that earns its own, as two modes that add up
    have one. ``always``: whether it is asked for.
    """
    structure = dataclasses.replace(
        best.structure, resonances=len(best.resonances) + 1, antiresonance=False
    )
    starts = _starts(signals, best, band)
    more = fitted(signals, starts, structure, band)
    starts = _notched(starts) if best.resonances else _with_notch(signals, more, band)
    notched = fitted(
        signals, starts, dataclasses.replace(structure, antiresonance=True), band
    )
    if _earned(signals, notched, more, band):
        more = notched
    return more if always or _earned(signals, more, best, band) else None


def _earned(
    signals: Sequence[Signals], more: FittedDynamics, best: FittedDynamics, band: Band
) -> bool:
    """Return whether the error on blocks left out asks for more, all of it inside the swept band."""
    for resonance in more.resonances:
        if not _is_inside(resonance, band):
            return False
    if more.left_out <= EARNED * best.left_out:
        return True
    if not best.resonances:
        return False
    rows = sum(part.measured.size for part in signals)
    noise = white_noise(residuals(signals, best.parameters, best.structure))
    gained = rows * (best.left_out**2 - more.left_out**2)
    return gained >= max(SURE * noise, MOST_OF_IT * rows * (best.left_out**2 - noise))


def _is_inside(resonance: Resonance, band: Band) -> bool:
    """Return whether a resonance, and its antiresonance, lie inside the swept band and the bounds."""
    lowest, highest = INSIDE * band[0], band[1]
    if not lowest < resonance.frequency < highest:
        return False
    if resonance.damping < INSIDE * LEAST_DAMPING:
        return False
    beside = resonance.antiresonance
    if not beside:
        return True
    if max(resonance.damping, beside.damping) > MOST_BESIDE / INSIDE:
        return False
    return lowest < beside.frequency < highest


def _white(signals: Sequence[Signals], best: FittedDynamics) -> bool:
    """Return whether what is left over is noise alone."""
    return beyond_noise(residuals(signals, best.parameters, best.structure)) == 0.0


def _starts(
    signals: Sequence[Signals], best: FittedDynamics, band: Band
) -> list[Floats]:
    """Return where to begin with one resonance more."""
    known = [resonance.frequency for resonance in best.resonances]
    before = best.parameters[: 2 * len(known)]
    lag = np.log(max(best.lag, 0.02 / band[1]))
    peak = _peak(signals, best, band)
    places = (peak, 0.8 * band[1]) if known else (peak,)  # chosen
    starts = []
    for damping in DAMPINGS:
        for frequency in places:
            starts.append(np.array([*before, np.log(frequency), np.log(damping), lag]))
    return starts


def _with_notch(
    signals: Sequence[Signals], best: FittedDynamics, band: Band
) -> list[Floats]:
    """Return where to begin with an antiresonance beside resonances that are found."""
    *before, lag = best.parameters
    starts = []
    for frequency in (_peak(signals, best, band), 0.9 * band[1]):
        for damping in DAMPINGS[1:3]:
            starts.append(np.array([*before, np.log(frequency), np.log(damping), lag]))
    return starts


def _notched(starts: Sequence[Floats]) -> list[Floats]:
    """Return where to begin with an antiresonance on either side of the last resonance.

    So near to it and so like it that the two undo each other: the fit begins where it
    was without them.
    """
    notched = []
    for *before, lag in starts:
        frequency, damping = before[-2:]
        for side in (-NEAR, NEAR):
            notched.append(np.array([*before, frequency + side, damping, lag]))
    return notched


def _peak(signals: Sequence[Signals], best: FittedDynamics, band: Band) -> float:
    """Return where the measured departs most from the best found (Hz), away from its resonances."""
    one = _longest(signals)
    (left,) = residuals([one], best.parameters, best.structure)
    seen = _spectra(
        one.moved(best.parameters, best.structure), left, one.time_step, band
    )
    ratio = np.abs(seen.both) / np.maximum(seen.power, 1e-12 * seen.power.max())
    inside = seen.driven
    frequencies = np.maximum(seen.frequency, 1e-9)
    for known in best.resonances:
        inside &= np.abs(np.log(frequencies / known.frequency)) > APART
    if not inside.any():
        return 0.7 * band[1]  # chosen
    return float(seen.frequency[inside][np.argmax(ratio[inside])])


# of the strongest third of an octave of the drive (amplitude): with less, nothing is
# known
ENERGY = 0.003
# of what was predicted, in a third of an octave: the error up to which a model is
# trusted
TRUSTED = 0.1
# of the lowest resonance, the most that is trusted: a change of 5 % there costs a tenth
TRUSTED_PART = 0.7
MOST_SHOWN = 60  # frequencies of the response that the model keeps, for its figure


def response(
    signals: Sequence[Signals], lowest: float, highest: float
) -> dict[str, list[float]]:
    """Return the measured response to what the gears make of the drive: Hz, gain (1 at rest), degrees."""
    one = _longest(signals)
    before, after = one.predicted(), one.measured
    frequency, power, both, _ = _spectra(
        before, after, one.time_step, (lowest, highest)
    )
    other = _spectra(after, after, one.time_step, (lowest, highest)).power
    ratio = both / np.maximum(power, 1e-12 * power.max())
    inside = (
        (frequency >= lowest)
        & (frequency <= highest)
        & (np.abs(both) ** 2 > MOST * power * other)
    )
    rows = np.flatnonzero(inside)
    if not rows.size:
        return {"frequency": [], "gain": [], "phase_degrees": []}
    wanted = np.geomspace(frequency[rows[0]], frequency[rows[-1]], MOST_SHOWN)
    rows = np.unique(
        rows[np.argmin(np.abs(frequency[rows][None] - wanted[:, None]), axis=1)]
    )
    found = {"frequency": frequency[rows], "gain": np.abs(ratio[rows]),
             "phase_degrees": np.degrees(np.unwrap(np.angle(ratio[rows])))}  # fmt: skip
    return {
        key: [float(f"{value:.4g}") for value in values]
        for key, values in found.items()
    }


def interval(value: float, spread: float) -> list[float]:
    """Return both ends of the interval of a parameter, from the standard error of its logarithm."""
    return [
        value * float(np.exp(-STUDENT * spread)),
        value * float(np.exp(STUDENT * spread)),
    ]


def trusted(
    signals: Sequence[Signals], chosen: FittedDynamics, highest: float
) -> tuple[float, str]:
    """Return the frequency (Hz) up to which the model is good, and what ends it."""
    one = _longest(signals)
    moved = one.moved(chosen.parameters, chosen.structure)
    (left,) = residuals([one], chosen.parameters, chosen.structure)
    size = min(moved.size, 8192)
    frequency, power = welch(moved, 1.0 / one.time_step, nperseg=size)
    off = welch(left, 1.0 / one.time_step, nperseg=size)[1]
    band = np.floor(
        3.0 * np.log2(np.maximum(frequency[1:] / frequency[1], 1.0))
    ).astype(int)
    energy = np.sqrt(np.bincount(band, power[1:]))
    error = np.sqrt(np.bincount(band, off[1:]))
    tops = frequency[1] * 2.0 ** ((np.arange(energy.size) + 1) / 3.0)
    ceiling = TRUSTED_PART * chosen.resonances[0].frequency
    trusted = float(frequency[1])
    for top, has, wrong in zip(
        tops.tolist(), energy.tolist(), error.tolist(), strict=True
    ):
        why = ""
        if has <= ENERGY * float(energy.max()):
            if top < highest / 50.0:
                continue
            why = "beyond, the sweep was too small"
        elif wrong > TRUSTED * has and top > 0.02 * highest:
            why = "beyond, the error grows"
        if why:
            return (trusted, why) if trusted < ceiling else (ceiling, "")
        trusted = top
    return min(trusted, ceiling, highest), ""


def said(
    figures: dict[str, object],
    chosen: FittedDynamics,
    trusted: float,
    why: str,
    unit: str,
) -> list[str]:
    """Return the lines about the dynamics."""
    parts = []
    for k, resonance in enumerate(chosen.resonances):
        frequency = outward(interval(resonance.frequency, chosen.spread[2 * k]), 5)
        damping = outward(interval(resonance.damping, chosen.spread[2 * k + 1]), 3)
        parts.append(
            f"resonance at {resonance.frequency:.5g} Hz ({frequency}), "
            f"damping {resonance.damping:.3g} ({damping})"
        )
        if resonance.antiresonance:
            parts[-1] += (
                f" with an antiresonance at {resonance.antiresonance.frequency:.5g} Hz"
            )
    lines = []
    creep = figures.get("creep", [])
    assert isinstance(creep, list)
    if creep:
        terms = [
            f"{100.0 * term['share']:.2g} % with {term['seconds']:.3g} s"
            for term in creep
        ]
        lines.append(f"creep of the displacement, behind the gears: {', '.join(terms)}")
    delay = chosen.structure.delay
    late = ""
    if chosen.lag > 0.0:
        place = "before" if chosen.structure.lag_before else "behind"
        late += f", lag {latency_text(chosen.lag)} {place} the gears"
    if delay:
        late += f", delay {1e3 * delay:.4g} ms behind all"
    line = (
        f"dynamics: {'; '.join(parts)}{late}; fast rows RMSE {chosen.rmse:.3g}{unit}, on blocks left out "
        f"{chosen.left_out:.3g}{unit}"
    )
    if max(chosen.lag, delay) > 0.0 and "sensor" not in figures:
        line += f"; its lateness is {WHOSE_LAG}"
    lines.append(line)
    line = f"trust the model to {trusted:.3g} Hz"
    lines.append(f"{line}: {why}" if why else line)
    return lines
