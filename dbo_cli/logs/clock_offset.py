"""How far the clocks of two recorders are apart: one has the drive, the other the displacement.

A displacement follows the drive through a loop: it turns where the drive turns, but is no
function of it, so a plain correlation takes a loop of 18 % for a delay of 17 ms. Here the
displacement is described by the drive, its powers and plays of it (a Prandtl-Ishlinskii
sum, linear in its weights) and a straight drift. The offset is the one that leaves least
of it, found by Gauss and Newton from the places where a correlation is high. A delay of
the actuator or its sensor looks the same, and is part of what is found.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dbo_cli.arrays import Floats
from dbo_cli.errors import InputError

_PLAYS = np.geomspace(0.003, 0.7, 24)  # half widths, in parts of the drive's range
_FINE = 20_000  # places at which the drive is followed
_MOST_ROWS = 3_000  # of the sensor that are used (means of neighbours)
_COARSE = 2_000  # steps of the coarse search over the shorter record
_CANDIDATES = 6  # best places of the coarse search that are refined
_STEPS = 12  # of Gauss and Newton at most
_COVERED = 0.5  # of the shorter record must be covered by both
_FEWEST_ROWS = 40  # of the sensor, and a tenth of them, where the drive's past is known
_PARTS = 8  # of a record: the scatter of their offsets is the uncertainty
_EXPLAINED = 0.09  # of the displacement's variance may be left unexplained
_ALIKE = 1.3  # times the least residual: a second place that explains as well
_PERFECT = 1e-6  # of the variance: below that, no place fits better than another
_KNOWN_TO = 0.5  # samples of the slower clock, two standard deviations
_APART = 5.0  # standard deviations from which on two clocks count as apart
# times less unexplained variance, where the drive's clock is moved: an amplifier's lag
# of 3 ms made 2 to 6 of a cycle of a second, 10 ms between clocks 14 to 42
_BETTER = 10.0


@dataclass(frozen=True)
class OffsetFit:
    """An offset (s), its standard deviation (s), and the part of the variance left unexplained."""

    offset: float
    deviation: float
    residual: float


@dataclass(frozen=True)
class RecordPair:
    """A drive on a fine clock with what the displacement may be made of, and the sensor's rows.

    ``slower`` is the usual step (s) of the slower recorder.
    """

    drive_time: Floats
    drive: Floats
    columns: Floats
    time: Floats
    displacement: Floats
    slower: float

    @classmethod
    def of(
        cls,
        drive_time: Floats,
        drive: Floats,
        time: Floats,
        displacement: Floats,
    ) -> RecordPair:
        """Prepare two records, whose times (s) do not fall.

        Raises
        ------
        InputError
            One is too short, or stands still. The message has no files in front.
        """
        if min(len(drive_time), len(time)) < _FEWEST_ROWS or np.ptp(drive_time) == 0.0:
            raise InputError(f"{_FEWEST_ROWS} rows of each are needed")
        if np.ptp(drive) == 0.0 or np.ptp(displacement) == 0.0:
            raise InputError("one of the two stands still")
        steps = [np.ptp(times) / (len(times) - 1) for times in (drive_time, time)]
        fine = np.linspace(drive_time[0], drive_time[-1], _FINE)
        drive = np.interp(fine, drive_time, drive)
        group = -(-len(time) // _MOST_ROWS)
        count = len(time) // group * group
        time = time[:count].reshape(-1, group).mean(axis=1)
        displacement = displacement[:count].reshape(-1, group).mean(axis=1)
        return cls(fine, drive, _columns(drive), time, displacement, float(max(steps)))

    def fits(self) -> list[OffsetFit]:
        """Return the fits near the places that look alike, the best first."""
        fits: list[OffsetFit] = []
        for start in self._coarse():
            fit = self._refined(start)
            if fit is not None:
                fits.append(fit)
        fits.sort(key=lambda fit: fit.residual)
        if fits:
            # every second play: what the description of the loop does to the offset
            fewer = np.hstack([self.columns[:, :3], self.columns[:, 3::2]])
            again = replace(self, columns=fewer)._refined(fits[0].offset)
            change = 0.0 if again is None else again.offset - fits[0].offset
            deviation = math.hypot(fits[0].deviation, change)
            fits[0] = replace(fits[0], deviation=deviation)
        return fits

    def residual(self, offset: float) -> float:
        """Return what part of the variance an offset leaves; 0 where too little is in common."""
        inside = self._inside(offset)
        return (
            0.0
            if inside is None
            else self._share(self._remainder(offset, inside), inside)
        )

    def _share(self, remainder: Floats, inside: NDArray[np.bool_]) -> float:
        variance = max(float(np.var(self.displacement[inside])), 1e-300)
        return float(np.mean(remainder**2)) / variance

    def _coarse(self) -> list[float]:
        """Return offsets (s) at which the two correlate most, whatever the sign, the best first."""
        from scipy.signal import correlate

        shorter = min(float(np.ptp(self.drive_time)), float(np.ptp(self.time)))
        step = max(self.slower, shorter / _COARSE)
        grid = np.arange(self.drive_time[0], self.drive_time[-1], step)
        v = np.interp(grid, self.drive_time, self.drive)
        grid = np.arange(self.time[0], self.time[-1], step)
        y = np.interp(grid, self.time, self.displacement)
        v, y = v - v.mean(), y - y.mean()
        count = np.rint(correlate(np.ones(len(y)), np.ones(len(v))))
        enough = count >= _COVERED * min(len(v), len(y))
        alike = np.where(enough, correlate(y, v) ** 2 / np.maximum(count, 1.0), 0.0)
        inner = alike[1:-1]
        is_peak = (inner >= alike[:-2]) & (inner >= alike[2:]) & (inner > 0.0)
        peaks = 1 + np.flatnonzero(is_peak)
        best = peaks[np.argsort(-alike[peaks], kind="stable")][:_CANDIDATES]
        begin = float(self.time[0] - self.drive_time[0])
        return [begin + (int(k) - (len(v) - 1)) * step for k in best]

    def _refined(self, start: float) -> OffsetFit | None:
        """Return the best fit near an offset; None where too little is in common."""
        span = float(np.ptp(self.drive_time))
        step = span / (_FINE - 1)
        offset = start
        fit: OffsetFit | None = None
        for _ in range(_STEPS):
            inside = self._inside(offset)
            if inside is None:
                return None
            remainder = self._remainder(offset, inside)
            later = self._remainder(offset + step, inside)
            slope = (later - self._remainder(offset - step, inside)) / (2.0 * step)
            steepness = max(float(slope @ slope), 1e-300)
            change = -float(slope @ remainder) / steepness
            farthest = 2.0 * step + 0.01 * span  # that one step of the search goes
            change = min(max(change, -farthest), farthest)
            offset += change
            deviation = _scatter(remainder, slope) / steepness
            share = self._share(remainder + slope * change, inside)
            fit = OffsetFit(offset, deviation, share)
            if abs(change) < 0.02 * deviation + 1e-9 * span:
                break
        return fit

    def _inside(self, offset: float) -> NDArray[np.bool_] | None:
        """Return which rows of the sensor the drive covers, once its past no longer matters."""
        margin = 2.0 * float(self.drive_time[1] - self.drive_time[0])
        at = self.time - offset
        begin = float(self.drive_time[_known_from(self.columns[:, 0])])
        inside = (at >= begin + margin) & (at <= self.drive_time[-1] - margin)
        is_enough = np.count_nonzero(inside) >= max(0.1 * len(at), _FEWEST_ROWS)
        return inside if is_enough else None

    def _remainder(self, offset: float, inside: NDArray[np.bool_]) -> Floats:
        """Return what the columns, moved by an offset (s), cannot explain of the displacement."""
        position = (self.time[inside] - offset - self.drive_time[0]) / (
            self.drive_time[1] - self.drive_time[0]
        )
        row = position.astype(np.intp)
        fraction = (position - row)[:, None]
        terms = self.columns[row] * (1.0 - fraction) + self.columns[row + 1] * fraction
        terms = np.column_stack([terms, np.ones(len(row)), position / _FINE])
        y = self.displacement[inside]
        basis = np.linalg.qr(terms)[0]
        remainder: Floats = y - basis @ (basis.T @ y)
        return remainder


def find_offset(pair: RecordPair) -> OffsetFit:
    """Return what is to be added to the drive's clock.

    Raises
    ------
    InputError
        The records do not tell it to half a sample of the slower clock.
    """
    fits = pair.fits()
    if not fits:
        raise InputError("the two overlap too little")
    best = fits[0]
    if best.residual > _EXPLAINED:
        share = 100.0 * (1.0 - best.residual)
        raise InputError(
            f"the drive explains at most {share:.0f} % of the displacement"
        )
    if 2.0 * best.deviation > _KNOWN_TO * pair.slower:
        raise InputError(
            f"{best.offset:.6g} s is uncertain by {2.0 * best.deviation:.2g} s, more than half a "
            "sample"
        )
    _require_single(fits, pair.slower)
    return best


def _require_single(fits: Sequence[OffsetFit], slower: float) -> None:
    """Refuse a second place that explains the records as well (InputError)."""
    best = fits[0]
    alike = _ALIKE * max(best.residual, _PERFECT)
    for fit in fits[1:]:
        if abs(fit.offset - best.offset) > slower and fit.residual < alike:
            raise InputError(
                f"{best.offset:.6g} s and {fit.offset:.6g} s fit equally: the drive repeats"
            )


def clocks_apart(pair: RecordPair) -> float:
    """Return the offset (s) by which clocks are clearly apart; 0 where they may agree."""
    fits = pair.fits()
    if not fits or fits[0].residual > _EXPLAINED:
        return 0.0
    best = fits[0]
    is_better = pair.residual(0.0) > _BETTER * max(best.residual, _PERFECT)
    is_apart = abs(best.offset) > pair.slower + _APART * best.deviation
    return best.offset if is_better and is_apart else 0.0


def _columns(drive: Floats) -> Floats:
    """Return what the displacement may be made of: powers of the drive, and plays of it.

    The plays begin where a drive of this range leaves them: one that starts at the lower
    end has come down to it, and each play lags by its half width.
    """
    u = (drive - drive.min()) / np.ptp(drive)
    plays = np.empty((len(u), len(_PLAYS)))
    half = np.minimum(_PLAYS, 0.5)
    play = np.clip(u[0], half, 1.0 - half)
    for row, value in enumerate(u.tolist()):
        play = np.minimum(np.maximum(play, value - _PLAYS), value + _PLAYS)
        plays[row] = play
    return np.column_stack([u, u**2, u**3, plays])


def _scatter(remainder: Floats, slope: Floats) -> float:
    """Return how the pull on the offset scatters between parts of the record.

    What is wrong with the description of the loop scatters so, and so does a clock that
    runs faster than the other.
    """
    parts = np.array_split(slope * remainder, _PARTS)
    pulls = np.array([float(section.sum()) for section in parts])
    return math.sqrt(float(pulls @ pulls) * _PARTS / (_PARTS - 1))


def _known_from(drive: Floats) -> int:
    """Return the first place whose past no longer matters.

    That is where the drive has been at both ends of its range, if more than half of the
    record follows; else where it has been at one, as if it had never gone farther.
    """
    low = int(np.argmax(drive <= 0.005))
    high = int(np.argmax(drive >= 0.995))
    both = max(low, high)
    return both if both < 0.5 * len(drive) else min(low, high)
