"""A state machine that does with live control what a laboratory does, beside ``slow_live``.

Plans, plans again, plans that are refused, commits, voltages and codes that were
applied instead, knobs that were turned, states that are saved and gone on from; of a
controller, and of banks of 1, 2 and 55 channels, with and without converter, slew
limit, points, drive lag, dynamics and look-ahead.
"""

from __future__ import annotations

import functools
import math
import pickle
from collections import Counter
from typing import Any, NamedTuple

import numpy as np
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    precondition,
    rule,
)
from slow_live import Row, Rules, SlowChannel
from test_runs_bank import actuator as settled_actuator
from test_runs_controller import moving

from dbo_cli import DboError, InputError, UsageError
from dbo_cli.drives.gate import GateError
from dbo_cli.extras.live.bank import Bank
from dbo_cli.extras.live.controller import Controller
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.hysteresis.model_state import DriveLimits, ModelState

RATE = 20_000.0
NEAR = 1e-7  # of the range: two ways to the same row
KINDS = (
    "gears",
    "gears",
    "gears",
    "plain",
    "between",
    "drive lag",
    "lag alone",
    "points",
)
COUNTS = (0, 0, 0, 1, 2, 2, 55)  # channels; 0: a controller without a bank
BAD: tuple[Any, ...] = (
    math.nan,
    math.inf,
    -math.inf,
    1e300,
    True,
    "5",
    None,
    1j,
    [1.0],
)
TALLY: Counter[str] = Counter()


class Setting(NamedTuple):
    """What is driven, and within which limits."""

    kind: str
    channels: int
    slew: float | None  # of the range, a row
    codes: int  # of a converter; 0: none
    margin: float  # of the range that the limits leave out at both ends
    begin: float | None  # of the range, where the drive stands
    more: int  # rows that are looked ahead beyond what the model needs


SETTINGS = st.builds(
    Setting,
    st.sampled_from(KINDS),
    st.sampled_from(COUNTS),
    st.sampled_from([None, 0.3, 0.02, 0.001]),
    st.sampled_from([0, 0, 40, 700]),
    st.sampled_from([0.0, 0.0, 0.1]),
    st.sampled_from([None, None, 0.4, -0.1, 1.1]),
    st.sampled_from([0, 3]),
)
PART = st.one_of(st.sampled_from([-0.5, 0.0, 0.5, 1.0, 1.5, 1e9]), st.floats(0.0, 1.0))
PLAYED = st.one_of(st.sampled_from([-0.15, 0.0, 1.0, 1.12]), st.floats(0.0, 1.0))


@functools.cache
def models_of(kind: str, count: int) -> tuple[ActuatorModel, ...]:
    """Return a model for each channel."""
    if kind == "gears":
        return tuple(settled_actuator(number).actuator for number in range(count))
    return (moving(kind).actuator,) * count


class LiveMachine(RuleBasedStateMachine):
    """Live control beside its slow model."""

    live: Any = None

    @initialize(setting=SETTINGS)
    def begin(self, setting: Setting) -> None:
        """Make both."""
        count = max(setting.channels, 1)
        if setting.kind != "gears":
            count = min(count, 2)  # each row of a slow one takes a millisecond
        setting = setting._replace(channels=min(setting.channels, count))
        self.setting, self.models = setting, models_of(setting.kind, count)
        self.looks_ahead = (
            self.models[0].dynamics is not None or self.models[0].delay is not None
        )
        self.rows: list[Row] | None = None
        self.rules = [self.rules_of(model) for model in self.models]
        begins = [self.place(model, setting.begin) for model in self.models]
        self.slow = [
            SlowChannel(model, RATE, rules, begin)
            for model, rules, begin in zip(self.models, self.rules, begins, strict=True)
        ]
        self.live = self.made(begins, None)
        TALLY[f"{setting.kind}, {setting.channels or 'a controller'}"] += 1

    def rules_of(self, model: ActuatorModel) -> Rules:
        """Return what the drive of a model is to keep."""
        low, span = model.input.minimum, model.input.span
        margin = self.setting.margin * span
        slew = None if self.setting.slew is None else self.setting.slew * span * RATE
        limits = DriveLimits(low + margin, model.input.maximum - margin, slew)
        step = limits.largest_change(1.0 / RATE)
        curve = self.curve(model).tolist() if self.setting.codes else None
        ahead = self.seconds_ahead() if self.looks_ahead else None
        rows = None if ahead is None else math.ceil(ahead * RATE - 1e-6)
        return Rules(
            limits.v_min,
            limits.v_max,
            slew,
            math.inf if step is None else step,
            curve,
            rows,
        )

    def curve(self, model: ActuatorModel) -> Any:
        """Return the voltage of each code: uneven, beyond the range at both ends."""
        even = np.linspace(-0.25, 1.25, self.setting.codes)
        uneven = even + 0.3 * (even[1] - even[0]) * np.sin(7.0 * np.arange(even.size))
        return model.input.minimum + model.input.span * uneven

    def seconds_ahead(self) -> float:
        """Return how much is looked ahead."""
        model = self.models[0]
        rows = math.ceil(model.delay_seconds * RATE - 1e-6) + self.setting.more
        if model.dynamics is not None:
            rows += model.dynamics.inverter(1.0 / RATE).ahead
        return max(rows, 1) / RATE

    def place(self, model: ActuatorModel, part: float | None) -> float | None:
        """Return a voltage of a model's range."""
        return None if part is None else model.input.minimum + part * model.input.span

    def made(self, begins: list[float | None], states: list[ModelState] | None) -> Any:
        """Return a controller or a bank."""
        first = self.rules[0]
        options: dict[str, Any] = {
            "dac": None if first.curve is None else np.array(first.curve)
        }
        if self.looks_ahead:
            options["lookahead"] = self.seconds_ahead()
        each = {
            "v_min": [rules.low for rules in self.rules],
            "v_max": [rules.high for rules in self.rules],
            "max_slew": [rules.slew for rules in self.rules],
            "from_": begins,
        }
        if self.setting.channels == 0:
            alone = {name: values[0] for name, values in each.items()}
            if states is not None:
                alone["state"] = states[0]
            return Controller(self.models[0], RATE, **options, **alone)
        names = [str(number) for number in range(len(self.models))]
        kept = None if states is None else dict(zip(names, states, strict=True))
        return Bank(
            dict(zip(names, self.models, strict=True)),
            RATE,
            states=kept,
            **options,
            **each,
        )

    # --- both as lists, a value a channel ---

    def given(self, values: list[Any]) -> Any:
        return values[0] if self.setting.channels == 0 else values

    def listed(self, values: Any) -> list[Any]:
        return [values] if self.setting.channels == 0 else values.tolist()

    def states(self) -> list[ModelState | None]:
        return (
            [self.live.state]
            if self.setting.channels == 0
            else list(self.live.states.values())
        )

    # --- rules ---

    @rule(parts=st.lists(PART, min_size=1, max_size=3))
    def plan(self, parts: list[float]) -> None:
        """Plan a row, perhaps after another one that was never committed."""
        wanted = [
            model.output.minimum + parts[k % len(parts)] * model.output.span
            for k, model in enumerate(self.models)
        ]
        planned = self.listed(self.live.plan(self.given(wanted)))
        self.rows = [
            slow.plan(value) for slow, value in zip(self.slow, wanted, strict=True)
        ]
        self.planned = planned
        TALLY["plans"] += 1
        TALLY["plans of rows outside the range"] += any(
            slow._away() > 0.0 for slow in self.slow
        )
        held_back = (
            [self.live.held_back]
            if self.setting.channels == 0
            else self.live.held_back.tolist()
        )
        for k, (slow, row) in enumerate(zip(self.slow, self.rows, strict=True)):
            self.compare(slow, row, planned[k], held_back[k])

    def compare(
        self, slow: SlowChannel, row: Row, planned: Any, held_back: bool
    ) -> None:
        """Hold a planned row against the slow one, and against the limits themselves."""
        rules, last, span = slow.rules, slow.last, slow.model.input.span
        if rules.curve is None:
            volts = planned
            assert abs(volts - row.volts) <= NEAR * span, (volts, row)
            most = rules.step
        else:
            volts = rules.curve[planned]
            assert planned in row.codes, (planned, row)
            gaps = np.diff(rules.curve)
            most = max(rules.step, float(gaps.max()))
        if not math.isnan(last):
            assert abs(volts - last) <= most * (1.0 + 1e-12) + 1e-12 * span
        low, high = rules.low, rules.high
        coming = last <= volts < low if last < low else high < volts <= last
        assert low <= volts <= high or coming, (last, volts)
        clear = rules.curve is None and abs(row.volts - last) < 0.999 * rules.step
        if rules.curve is None or len(row.codes) == 1:
            row.held_back = held_back if not clear else row.held_back

    @rule(parts=st.lists(PART, min_size=1, max_size=12))
    def follow(self, parts: list[float]) -> None:
        """Plan and commit some rows."""
        for part in parts:
            self.plan([part])
            self.commit()
            self.both_are_in_the_same_state()

    @rule(part=PART)
    def plan_and_commit(self, part: float) -> None:
        """Plan and commit a row."""
        self.follow([part])

    @rule(bad=st.sampled_from(BAD), place=st.integers(0, 54))
    def refuse_a_plan(self, bad: Any, place: int) -> None:
        """Ask for what is no number: nothing is left to commit."""
        wanted: list[Any] = [model.output.minimum for model in self.models]
        wanted[place % len(wanted)] = bad
        self.refused(InputError, self.live.plan, self.given(wanted))
        self.rows = None
        assert self.live.planned is None
        TALLY["plans refused"] += 1

    @rule()
    def commit(self) -> None:
        """Commit what was planned, or be refused."""
        if self.rows is None:
            self.refused(UsageError, self.live.commit)
            TALLY["commits refused"] += 1
            return
        self.live.commit()
        self.go_on(self.planned)
        TALLY["commits"] += 1

    @rule(parts=st.lists(PLAYED, min_size=1, max_size=3))
    def apply(self, parts: list[float]) -> None:
        """Something else was played: the operator turned a knob."""
        applied: list[Any] = []
        for k, slow in enumerate(self.slow):
            part = parts[k % len(parts)]
            if slow.rules.curve is None:
                applied.append(self.place(slow.model, part))
            else:
                applied.append(
                    round(
                        min(max(part / 1.5 + 0.2, 0.0), 1.0)
                        * (len(slow.rules.curve) - 1)
                    )
                )
        self.live.commit(self.given(applied))
        self.go_on(applied)
        TALLY["applied"] += 1

    @rule(bad=st.sampled_from(BAD), place=st.integers(0, 54))
    def refuse_what_was_applied(self, bad: Any, place: int) -> None:
        """Say that something was played that is no number: nothing moves, and the plan stays."""
        applied: list[Any] = [1 for _ in self.models]
        applied[place % len(applied)] = bad
        if bad is None and self.setting.channels == 0:
            return
        self.refused(InputError, self.live.commit, self.given(applied))
        assert (self.live.planned is None) == (self.rows is None)
        TALLY["applied refused"] += 1

    @precondition(lambda self: self.live is not None and self.slow[0].state is not None)
    @rule(pickled=st.booleans())
    def save_and_resume(self, pickled: bool) -> None:
        """Go on in another process, or from the states."""
        TALLY["resumed"] += 1
        clipped = np.copy(self.live.clipped)
        if pickled:
            self.live, self.rows = pickle.loads(pickle.dumps(self.live)), None
            assert (self.live.clipped == clipped).all()
            return
        states = self.states()
        if any(state is None for state in states):
            return
        self.live = self.made([None] * len(self.models), states)  # type: ignore[arg-type]
        self.rows = None
        for slow, state in zip(self.slow, states, strict=True):
            assert state is not None
            slow.memory, slow.wanted = state.undoing, []
            slow.saved, slow.clipped = 0.0, 0

    def go_on(self, played: list[Any]) -> None:
        """Let the slow model play the same."""
        for k, (slow, value) in enumerate(zip(self.slow, played, strict=True)):
            volts = value if slow.rules.curve is None else slow.rules.curve[int(value)]
            slow.commit(volts, None if self.rows is None else self.rows[k])
        self.rows = None

    def refused(self, kind: type[DboError], called: Any, *words: Any) -> None:
        """Hold that something is refused, and that nothing has moved."""
        before, clipped = self.states(), np.copy(self.live.clipped)
        try:
            called(*words)
        except kind as problem:
            assert not isinstance(problem, GateError)
            assert "\n" not in str(problem)
        else:
            raise AssertionError(f"{words} were taken")
        assert self.states() == before
        assert (self.live.clipped == clipped).all()

    @invariant()
    def both_are_in_the_same_state(self) -> None:
        """Gears, memories, dynamics, counts and plan are the slow model's."""
        if self.live is None:
            return
        assert (self.live.planned is None) == (self.rows is None)
        clipped = np.ravel(self.live.clipped).tolist()
        for k, (slow, state) in enumerate(zip(self.slow, self.states(), strict=True)):
            assert clipped[k] == slow.clipped
            if slow.state is None or state is None:
                assert (state is None) == (slow.state is None)
                continue
            same_state(slow.model, state, slow.state)


def same_state(model: ActuatorModel, state: ModelState, expected: ModelState) -> None:
    """Hold two states against each other."""
    near = NEAR * model.input.span
    assert state.drive is not None and expected.drive is not None
    assert abs(state.drive - expected.drive) <= near
    assert state.backlash.bits == expected.backlash.bits
    for name in ("memory",):
        own, slow = getattr(state.backlash, name), getattr(expected.backlash, name)
        assert (own is None) == (slow is None)
        assert own is None or np.allclose(own, slow, rtol=0.0, atol=near)
    for name in ("dynamics", "drive_lag"):
        own, slow = getattr(state, name), getattr(expected, name)
        assert (own is None) == (slow is None), name
        size = max(model.input.span, model.output.span)
        assert own is None or np.allclose(own, slow, rtol=1e-6, atol=NEAR * size), name
