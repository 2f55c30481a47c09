"""Random calls of live control: nothing beyond a limit, nothing half done.

    python benchmarks/attack_live.py [CALLS] [SEED]          100,000 calls from seed 1

Plans, values that are no numbers, commits, applied voltages inside and far outside, and
states gone on from, in any order. A twin is told only what was committed: it has to
plan the same voltage to the bit, so that a plan without commit and a refused call leave
no trace. Exit 1 where a voltage is beyond a limit, the twins differ, or anything but a
refusal comes out.
"""

from __future__ import annotations

import math
import sys
import time
import warnings
from collections import Counter
from typing import Any

import numpy as np
from random_actuators import Random, random_actuator, random_limits

from dbo_cli.drive import Limits
from dbo_cli.drive.live import Controller
from dbo_cli.errors import DboError, InputError, UsageError
from dbo_cli.model import Cascade

DT = 1e-3  # s
CALLS = 200  # of a controller
ODD: tuple[Any, ...] = (math.nan, math.inf, "3", True, None, 1e300, [1.0, 2.0])
ACTIONS = ("plan", "step", "commit", "applied", "odd plan", "odd commit", "go on")
SHARES = (0.25, 0.45, 0.1, 0.1, 0.04, 0.03, 0.03)


class Wrong(Exception):
    """What was found."""


class Machine:
    """One controller, its twin, and what may happen to them."""

    def __init__(
        self, rng: Random, model: Cascade, limits: Limits, start: float | None
    ) -> None:
        self.rng = rng
        self.model = model
        self.limits = limits
        self.live, self.twin = self.made(from_=start), self.made(from_=start)
        self.wanted = model.output.min
        self.planned: float | None = None
        self.committed = False

    def made(self, **options: Any) -> Controller:
        """Return a controller that looks ahead as far as it has to."""
        return Controller(
            self.model, 1.0 / DT, self.limits, lookahead="auto", **options
        )

    def act(self, action: str) -> None:
        """Do one thing at random, and look at what came of it."""
        if action == "plan":
            self.plan()
        elif action == "step":
            self.plan()
            self.commit(None)
        elif action == "commit":
            self.commit(None)
        elif action == "applied":
            self.commit(self.applied())
        elif action == "odd plan":
            self.odd_plan(ODD[int(self.rng.integers(len(ODD)))])
        elif action == "odd commit":
            self.odd_commit(ODD[int(self.rng.integers(len(ODD)))])
        else:
            self.go_on()

    def plan(self) -> None:
        """Plan, mostly near what was wanted before."""
        span = self.model.output.span
        if self.rng.random() < 0.1:
            self.wanted = self.model.output.min + span * float(self.rng.uniform(-3, 4))
        else:
            self.wanted += span * float(self.rng.normal(0.0, 0.05))
        self.planned = self.live.plan(self.wanted)
        self.require_inside(self.planned)

    def require_inside(self, voltage: float) -> None:
        """Look at a voltage: in the range, or on the way into it, and slow enough."""
        low, high = self.live.limits.move
        last = self.live.last
        inside = low <= voltage <= high
        if last is not None:
            inside = inside or last < voltage <= low or high <= voltage < last
            most = self.limits.slew
            slack = 1e-12 * max(abs(voltage), abs(last))
            if most is not None and abs(voltage - last) > most * DT + slack:
                raise Wrong(f"{voltage!r} after {last!r}: faster than {most!r} V/s")
        if not inside:
            raise Wrong(f"{voltage!r} after {last!r}: outside {low!r} to {high!r}")

    def applied(self) -> float:
        """Return a voltage that a source might have played."""
        reach = 1.0 if self.rng.random() < 0.3 else 0.0
        part = float(self.rng.uniform(-reach, 1.0 + reach))
        return self.model.input.min + part * self.model.input.span

    def commit(self, applied: float | None) -> None:
        """Commit, and let the twin do the same at once."""
        if self.planned is None:
            self.refused(self.live.commit, applied, UsageError)
            return
        same = self.twin.plan(self.wanted)
        if same != self.planned:
            raise Wrong(f"{self.planned!r} was planned, and {same!r} by its twin")
        self.live.commit(applied)
        self.twin.commit(applied)
        expected = self.planned if applied is None else applied
        if self.live.last != expected:
            raise Wrong(f"{expected!r} was committed, and {self.live.last!r} stands")
        self.planned = None
        self.committed = True

    def refused(self, call: Any, value: Any, kind: type[DboError]) -> None:
        """Call with what must be refused; nothing may move."""
        before = self.live.last, self.live.clipped
        try:
            call(value)
        except kind:
            pass
        else:
            raise Wrong(f"{value!r} was accepted")
        if (self.live.last, self.live.clipped) != before:
            raise Wrong(f"{value!r} was refused and left a trace")

    def odd_plan(self, value: Any) -> None:
        """Plan what is no number; then nothing is left to commit."""
        self.refused(self.live.plan, value, InputError)
        self.planned = None
        self.refused(self.live.commit, None, UsageError)

    def odd_commit(self, value: Any) -> None:
        """Commit what is no number (None is the planned voltage); the plan still stands."""
        if value is None:
            return
        kind = UsageError if self.planned is None else InputError
        self.refused(self.live.commit, value, kind)

    def go_on(self) -> None:
        """Go on with new controllers from the state, where that lies within the limits."""
        state = self.live.state
        if not self.committed or state is None:
            return
        try:
            self.live, self.twin = self.made(state=state), self.made(state=state)
        except DboError:
            return
        self.planned = None
        if self.live.last != state.drive:
            raise Wrong(f"a state of {state.drive!r} V goes on from {self.live.last!r}")


def machine(rng: Random) -> Machine | None:
    """Return a machine of a random model; None where its limits or its rate are refused."""
    model = random_actuator(rng, DT)
    typed: dict[str, Any] = random_limits(rng, model.input)
    start = None
    if rng.random() < 0.3:
        start = model.input.min + float(rng.random()) * model.input.span
    try:
        return Machine(rng, model, Limits.within(model.input, **typed), start)
    except DboError:
        return None


def main() -> int:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 100_000
    seed = int(sys.argv[2]) if len(sys.argv) > 2 else 1
    warnings.simplefilter("ignore")
    begun = time.perf_counter()
    done: Counter[str] = Counter()
    number = faults = 0
    while done.total() < count:
        number += 1
        rng = np.random.default_rng([seed, number])
        running = machine(rng)
        if running is None:
            continue
        try:
            for action in rng.choice(ACTIONS, CALLS, p=SHARES):
                done[str(action)] += 1
                running.act(str(action))
        except Exception as problem:
            faults += 1
            print(
                f"machine {number} of seed {seed}: {type(problem).__name__}: {problem}"
            )
    for action, times in done.most_common():
        print(f"{times:8,} {action}")
    print(
        f"{done.total():,} calls of {number:,} controllers, {faults} faults; "
        f"{time.perf_counter() - begun:.0f} s"
    )
    return int(faults > 0)


if __name__ == "__main__":
    sys.exit(main())
