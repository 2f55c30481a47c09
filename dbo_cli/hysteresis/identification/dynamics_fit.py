"""The fit of given dynamics to fast rows: parameters of least error, and the error on blocks left out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.signal import lfilter

from dbo_cli.hysteresis.cascade import late_by, whole_and_part
from dbo_cli.hysteresis.dynamics import Antiresonance, DynamicsStage, Lag, Resonance, Section
from dbo_cli.hysteresis.identification.evaluation import TINY
from dbo_cli.hysteresis.identification.recordings import FastPart, Floats
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.records import dataclass

Booleans = NDArray[np.bool_]
Band = tuple[float, float]  # lowest and highest frequency swept, Hz

FOLDS = 5  # of which each leaves out 8 of the blocks; chosen
BLOCKS = 40  # of the fast rows, dealt out to the folds in turn, so that every fold has all frequencies
LEAST_DAMPING, MOST_DAMPING = 1e-4, 0.98  # rings for 1,600 periods; hardly rings, and is no pair of lags yet
MOST_BESIDE = 0.1
"""Damping of resonances where one has an antiresonance: pairs damped by 0.2 to 0.8 stood in for slow moves
that the gears follow badly (at 6 Hz beside a resonance of 20), and hid a mode at 185 Hz."""
FEW_STEPS, FINALISTS, MOST_STEPS = 6, 2, 40  # of a refinement: of all starts, how many go on, to the end
SMALL = 1e-5  # of a parameter's logarithm: for derivatives, far above rounding and far below any bend
NO_LAG = 2e-3  # of a time step: a lag at the lower end of its range is none


@dataclass(frozen=True)
class Structure:
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
class Candidate:
    """Dynamics fitted.

    Attributes
    ----------
    structure : Structure
        What was fitted.
    parameters : array
        Logarithms: of frequency (Hz) and damping of each resonance, of the antiresonance's, of the lag (s).
    lag : float
        Seconds, 0 for none.
    rmse, left_out : float
        On all fast rows, and on blocks left out.
    spread : array
        Standard errors of the parameters.
    """

    structure: Structure
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
        self._at = np.linspace(-1.0, 1.0, self.measured.size)  # of the drift, at right angles to an offset
        self._at /= np.sqrt(np.einsum("i,i->", self._at, self._at))
        self._steady = self._without_drift(self.measured)
        self._model = model
        before = model.start(float(log.voltage[0]), "auto")
        self._state = model.simulate(log.voltage[: rows.start], before, time_step=part.time_step).state
        self._lag, self._predicted = (0.0, False), self._after(0.0, False)
        self._late = self._lag, self._predicted

    def predicted(self, lag_before: float = 0.0, sampled: bool = False) -> Floats:
        """Return what the slow model predicts, its drive passed through a lag (s) first."""
        if (lag_before, sampled) != self._lag:
            self._lag, self._predicted = (lag_before, sampled), self._after(lag_before, sampled)
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
        left: Floats = self._steady - np.einsum("i,i->", self._steady, free) / power * free
        return left

    def moved(self, parameters: Floats, structure: Structure) -> Floats:
        """Return the prediction through the lag, the gears and the resonances."""
        lag, *resonances = sections_of(parameters, structure)
        assert isinstance(lag, Lag)
        if structure.lag_before:
            moved = self.predicted(lag.seconds, structure.sampled_lag)
        else:
            behind = lag.seconds, structure.sampled_lag
            if behind != self._late[0]:  # most steps of a fit change a resonance alone
                self._late = behind, lagged(self.predicted(), behind[0], self.time_step, behind[1])
            moved = self._late[1]
        if resonances:
            moved, _ = DynamicsStage(tuple(resonances)).run(moved, self.time_step, None)
        if not structure.delay:
            return moved
        whole, part = whole_and_part(structure.delay / self.time_step)
        held = np.concatenate([np.full(min(whole + 1, moved.size), moved[0]), moved])
        return late_by(held[: moved.size + 1], part)


def lagged(x: Floats, seconds: float, time_step: float, sampled: bool = False) -> Floats:
    """Return a signal, straight between samples and at rest before, after an exact first-order lag.

    ``sampled``: after the one of the stage.

    The stage's own lag, whose inverse is stable, is right at low frequencies and 1 % off at a quarter of a
    radian a sample. Fitted with it, a lag of 0.2 ms in a sweep to 1 kHz (20 kHz) came out as 0.195 ms.
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


def residuals(signals: Sequence[Signals], parameters: Floats, structure: Structure) -> list[Floats]:
    """Return measured minus predicted through the dynamics, gain, offset and drift of each part fitted."""
    return [one.left(one.moved(parameters, structure)) for one in signals]


def sections_of(parameters: Floats, structure: Structure) -> tuple[Section, ...]:
    """Return the lag and the resonances of logarithms, lowest first, wherever the lag stands."""
    count = structure.resonances
    values = np.exp(parameters)
    pairs = sorted((float(values[2 * k]), float(min(values[2 * k + 1], MOST_DAMPING))) for k in range(count))
    resonances = [Resonance(frequency, damping) for frequency, damping in pairs]
    if structure.antiresonance:
        at, damping = float(values[2 * count]), float(min(values[2 * count + 1], MOST_DAMPING))
        resonances[-1] = Resonance(*pairs[-1], Antiresonance(at, damping))
    return (Lag(float(values[-1])), *resonances)


def _refined(
    signals: Sequence[Signals],
    start: Floats,
    structure: Structure,
    bounds: tuple[Floats, Floats],
    keep: Booleans,
    known: dict[bytes, list[Floats]],
    most: int = MOST_STEPS,
) -> tuple[Floats, float]:
    """Return the parameters of least error on the blocks to keep, and that error (RMS).

    ``known`` holds the residuals of parameters, which fits of the same structure from one start share.
    """
    chosen = [keep[one.block] for one in signals]

    def error(parameters: Floats) -> Floats:
        key = parameters.tobytes()
        left = known.get(key)
        if left is None:
            left = residuals(signals, parameters, structure)
            if len(known) <= parameters.size:  # of the start and beside it: other fits begin there, too
                known[key] = left
        return np.concatenate([part[rows] for part, rows in zip(left, chosen, strict=True)])

    # Its bound on the gradient is in the displacement's unit: in metres every start would be the end.
    found = least_squares(
        error, np.clip(start, *bounds), bounds=bounds, x_scale=0.1, diff_step=SMALL, gtol=None, max_nfev=most
    )
    return found.x, float(np.sqrt(np.mean(found.fun**2)))


def fitted(
    signals: Sequence[Signals], starts: Sequence[Floats], structure: Structure, band: Band
) -> Candidate:
    """Return the best of several refinements, and its error on blocks left out.

    Parameters
    ----------
    signals
        The fast parts.
    starts
        Parameters to begin from (see ``Candidate``).
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
        return _refined(signals, np.array(start), structure, (low, high), every, {}, most)

    # Within the bounds many a start is another one.
    tried = [from_start(tuple(np.clip(start, low, high).tolist()), FEW_STEPS) for start in starts]
    tried = sorted(tried, key=lambda one: one[1])[:FINALISTS]
    best, rmse = min((from_start(tuple(b.tolist()), MOST_STEPS) for b, _ in tried), key=lambda one: one[1])
    squares, rows, known = 0.0, 0, dict[bytes, list[Floats]]()
    for fold in range(FOLDS):
        keep = np.arange(BLOCKS) % FOLDS != fold
        parameters, _ = _refined(signals, best, structure, (low, high), keep, known)
        left = residuals(signals, parameters, structure)
        for part, one in zip(left, signals, strict=True):
            out = part[~keep[one.block]]
            squares, rows = squares + float(out @ out), rows + out.size
    spread = _spread(signals, best, structure)
    order = np.argsort(best[0 : 2 * structure.resonances : 2])
    places = [2 * k + side for k in order for side in (0, 1)]
    places += list(range(2 * structure.resonances, best.size))
    lag = float(np.exp(best[-1]))
    lag = lag if lag > NO_LAG * step else 0.0
    return Candidate(structure, best[places], lag, rmse, float(np.sqrt(squares / rows)), spread[places])


def _spread(signals: Sequence[Signals], best: Floats, structure: Structure) -> Floats:
    """Return the standard errors of parameters fitted, which hold where what is left over is no noise, too.

    (J'J)^-1 (sum of g g') (J'J)^-1 with g = J'r of each block: what the gears leave over repeats itself
    within a block, as noise does not (Liang and Zeger, Biometrika 73, 13, 1986).
    """
    left = residuals(signals, best, structure)
    changed = [residuals(signals, best + SMALL * one, structure) for one in np.eye(best.size)]
    slopes, scatter = np.zeros((2, best.size, best.size))
    for k, one in enumerate(signals):
        along = np.array([(other[k] - left[k]) / SMALL for other in changed])
        slopes += np.einsum("ir,jr->ij", along, along)
        begins = np.flatnonzero(np.diff(one.block, prepend=-1))
        pulls = np.add.reduceat(along * left[k], begins, axis=1)
        scatter += np.einsum("ib,jb->ij", pulls, pulls)
    inverse = np.linalg.pinv(slopes, hermitian=True)
    spread: Floats = np.sqrt(np.maximum(np.einsum("ij,jk,ki->i", inverse, scatter, inverse), 0.0))
    return spread
