"""Live control as it is meant: slow, obvious, a block function of the model for every row.

Nothing of ``extras/live`` is used. A row that was played is a call of ``simulate``, a
row that is planned a call of ``compensate`` from the state before it; what looks ahead
is undone from everything that was wanted since the beginning; a converter's codes are
looked at one by one.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field

import numpy as np

from dbo_cli.hysteresis.dynamics import InverseMemory
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.hysteresis.model_state import DriveLimits, ModelState
from dbo_cli.interpolation.smooth import WINDOW, interpolated


@dataclass
class Rules:
    """What a live drive is to keep: a range, a change a row, a converter's codes, and how far it looks."""

    low: float
    high: float
    slew: float | None = None  # V/s
    step: float = math.inf  # V a row, what the slew comes to
    curve: list[float] | None = None
    ahead: int | None = None  # rows; None: nothing is undone


@dataclass
class Row:
    """A plan: the volts that the gears lead to, the codes that are as good, and if it is held back."""

    volts: float
    codes: list[int] = field(default_factory=list)
    held_back: bool = False
    wanted: float = 0.0


class SlowChannel:
    """One actuator, row by row."""

    def __init__(
        self,
        model: ActuatorModel,
        rate: float,
        rules: Rules,
        from_: float | None = None,
        state: ModelState | None = None,
    ) -> None:
        self.model, self.rate, self.rules = model, rate, rules
        self.state, self.last, self.saved, self.clipped = state, math.nan, 0.0, 0
        self.wanted: list[float] = []
        self.memory: InverseMemory | None = None  # of the inverse, before the first row
        if from_ is not None:
            self._play(from_)
        elif state is not None:
            drive = model.drive_of(state)
            assert drive is not None
            self.last = drive

    # --- what is asked for ---

    def plan(self, wanted: float) -> Row:
        """Return the row for what is wanted."""
        rules, last = self.rules, self.last
        followed = (
            self._undone([*self.wanted, wanted])[-1]
            if rules.ahead is not None
            else wanted
        )
        if rules.curve is None and self._away() > rules.step:
            inwards = last - rules.step if last > rules.high else last + rules.step
            return Row(inwards, held_back=True, wanted=wanted)
        limits = DriveLimits(
            rules.low, rules.high, rules.slew if rules.curve is None else None
        )
        begun = self.state or self.model.start_compensation(followed, "auto", limits)
        done = self.model.compensate(
            [followed], begun, limits=limits, time_step=1.0 / self.rate
        )
        row = Row(float(done.y[0]), held_back=done.clipped_count > 0, wanted=wanted)
        if rules.curve is not None:
            row.codes, slow = self._codes(row.volts)
            row.held_back |= slow
        return row

    def _away(self) -> float:
        """Return how far outside the range the drive stands."""
        return max(self.last - self.rules.high, self.rules.low - self.last, 0.0)

    def _most(self) -> float:
        """Return how far the converter may go in the next row."""
        curve, step = self.rules.curve, self.rules.step
        assert curve is not None
        if step == math.inf or math.isnan(self.last):
            return math.inf
        gaps = [b - a for a, b in itertools.pairwise(curve)]
        if step >= max(gaps):
            return step
        # The wider of the two codes beside the first one that is not below the voltage
        # that stands.
        place = min(
            [k for k, volts in enumerate(curve) if volts >= self.last],
            default=len(curve) - 1,
        )
        beside = [gaps[k] for k in (place - 1, place) if 0 <= k < len(gaps)]
        return min(self.saved + step, max(step, *beside))

    def _codes(self, volts: float) -> tuple[list[int], bool]:
        """Return the codes that are as good as each other, and whether the slew holds a better one back."""
        curve, last, most = self.rules.curve, self.last, self._most()
        assert curve is not None
        inside = [
            k for k, own in enumerate(curve) if self.rules.low <= own <= self.rules.high
        ]
        best = self._nearest(inside, volts)
        if math.isnan(last):
            return best, False
        reached = [k for k, own in enumerate(curve) if abs(own - last) <= most]
        both = [k for k in inside if k in set(reached)]
        if both:
            good = self._nearest(both, volts)
        elif last > curve[inside[-1]]:
            below = [k for k, own in enumerate(curve) if own <= last]
            good = [min([k for k in reached if k in set(below)], default=below[-1])]
        elif last < curve[inside[0]]:
            above = [k for k, own in enumerate(curve) if own >= last]
            good = [max([k for k in reached if k in set(above)], default=above[0])]
        else:
            good = self._nearest(inside, last)
        return good, not set(good) & set(best)

    def _nearest(self, codes: list[int], volts: float) -> list[int]:
        """Return the codes nearest to a voltage; more than one where the last digits decide."""
        assert self.rules.curve is not None
        away = {code: abs(self.rules.curve[code] - volts) for code in codes}
        least = min(away.values())
        return [
            code for code in codes if away[code] <= least + 1e-9 * self.model.input.span
        ]

    # --- what looks ahead ---

    def _undone(self, wanted: list[float]) -> list[float]:
        """Return what the gears are to follow for each row wanted; ``memory`` afterwards is not kept."""
        return self._inverted(wanted)[0]

    def _inverted(
        self, wanted: list[float]
    ) -> tuple[list[float], InverseMemory | None]:
        samples, model, step = self.rules.ahead, self.model, 1.0 / self.rate
        assert samples is not None
        inverter = None if model.dynamics is None else model.dynamics.inverter(step)
        ahead = 0 if inverter is None else inverter.ahead
        # rows of what was wanted first, so that no window of samples is cut off
        before = WINDOW
        known = np.array([wanted[0]] * (before + samples) + wanted)
        count = len(wanted) + ahead
        places = before + np.arange(count) + model.delay_seconds / step
        newest = before + samples - ahead
        later, _ = interpolated(
            np.arange(known.size, dtype=float), known, places, newest
        )
        if inverter is None:
            return later.tolist(), None
        memory = self.memory
        if memory is None and not self.wanted:
            memory = self._memory_before()
        memory = memory or inverter.rest(wanted[0])
        undone, after = inverter.run(np.ascontiguousarray(later), memory)
        return undone.tolist(), after

    # --- what was played ---

    def commit(self, volts: float, planned: Row | None) -> None:
        """Go on from what was played."""
        if self.rules.ahead is not None:
            if planned is not None:
                if not self.wanted and self.memory is None:
                    self.memory = self._memory_before()
                self.wanted.append(planned.wanted)
            elif self.wanted:
                self.wanted.append(self.wanted[-1])
            else:
                self.memory = None  # what moves did not follow what was wanted
        if self.rules.curve is not None:
            most, change = self._most(), abs(volts - self.last)
            self.saved = 0.0 if most == math.inf else max(most - change, 0.0)
        self.clipped += planned is not None and planned.held_back
        self._play(volts)

    def _memory_before(self) -> InverseMemory | None:
        """Return what the inverse goes on from, where rows were played before any was wanted."""
        if self.model.dynamics is None or self.state is None:
            return None
        return self.state.memory_for(self.model.dynamics.inverter(1.0 / self.rate))

    def _play(self, volts: float) -> None:
        begun = self.state or self.model.start(volts)
        self.state = self.model.simulate(
            [volts], begun, time_step=1.0 / self.rate
        ).state
        self.last = volts
