"""Random drives against their limits: no row of any of them may leave them.

    python benchmarks/attack_drives.py [DRIVES] [SEED]       100,000 drives from seed 1

Models, moves, limits, clocks and options at random: starts inside and outside, ways in,
leads, sweeps, returns, loops, states of an earlier drive. Most drives are whole arrays,
every tenth comes in blocks; there, rows that left before a refusal count as well. Every
tenth is the drive of an inverse model, which `outside` has to hold or refuse, and every
tenth those of two channels, of which the shorter one holds. What
is written is looked at row by row, on its own terms: nothing here knows the program's
gate. Exit 1 where a row is beyond a limit, or anything but a refusal ends a drive.
"""

from __future__ import annotations

import sys
import time
import traceback
import warnings
from collections import Counter
from typing import Any

import numpy as np
from random_actuators import (
    Floats,
    Random,
    random_actuator,
    random_limits,
    random_move,
)

from dbo_cli.channels import together
from dbo_cli.drive import Drive, Driver, Lead, Limits
from dbo_cli.drive.limits import GateError
from dbo_cli.drive.simulate import Simulator
from dbo_cli.errors import DboError, LimitError
from dbo_cli.model import Cascade, State
from dbo_cli.model import steps_of as clock_steps

DT = 1e-3  # s
A_MODEL = 20  # drives
ROUNDING = 1e-12  # of the largest voltage: what a step may exceed its limit by


def random_options(rng: Random, model: Cascade, last: State | None) -> dict[str, Any]:
    """Return options of a drive, of which some exclude each other."""
    voltage = model.input
    reach = 0.6 if rng.random() < 0.2 else 0.02  # beyond the identified range
    stands = voltage.min + float(rng.uniform(-reach, 1.0 + reach)) * voltage.span
    starts = rng.random() < 0.5
    options: dict[str, Any] = {
        "on_limit": str(rng.choice(["clip", "clip", "clip", "auto", "error"])),
        "start": stands if starts else None,
        "approach": ["auto", 0.05, 3.0][int(rng.integers(3))] if starts else None,
        "lead": [None, None, "auto", 0.02][int(rng.integers(4))],
        "return_to": [None, None, voltage.min, stands][int(rng.integers(4))],
    }
    kind = int(rng.integers(8))
    if kind == 0:
        options["condition"] = True
    elif kind == 1:
        options["state"] = str(rng.choice(["empty", "full", "settled"]))
    elif kind == 2:
        options |= {"periodic": True, "passes": int(rng.integers(3))}
        options |= {"lead": None, "return_to": None}
    elif kind == 3:
        options["bandwidth"] = 20.0
    elif kind == 4 and last is not None:
        options |= {"state": last, "start": None}
    return options


def broken(
    voltage: Floats, move: slice, limits: Limits, steps: Any, before: float | None
) -> str:
    """Return which limit a drive breaks; nothing where it keeps all."""
    if not np.isfinite(voltage).all():
        return "a row is no number"
    if voltage.min() < limits.rating[0] or voltage.max() > limits.rating[1]:
        return "a row is outside the rating"
    own = voltage[move]
    if own.size and (own.min() < limits.move[0] or own.max() > limits.move[1]):
        return "a row of the move is outside its range"
    if limits.slew is None:
        return ""
    change = np.abs(np.diff(voltage, prepend=voltage[0] if before is None else before))
    most = limits.slew * steps + ROUNDING * max(np.abs(voltage).max(), 1e-300)
    return "a step is too fast" if (change > most).any() else ""


def steps_of(clock: Any, time_s: Any) -> Any:
    """Return the seconds of every row; the first row of an uneven clock has the first step that advances."""
    if np.ndim(clock) == 0:
        return np.inf if clock is None else clock
    differences = np.diff(clock)
    first = next(iter(differences[differences > 0.0]), 0.0)
    found = np.diff(time_s, prepend=time_s[0] - first)
    return found + 1e-15 * np.abs(time_s).max()


def whole(
    model: Cascade, desired: Floats, clock: Any, limits: Limits, options: dict[str, Any]
) -> tuple[str, State | None]:
    """Plan one drive from arrays; return what is wrong with it, and the state after it."""
    names = ("bandwidth", "periodic", "passes")
    in_memory = {name: options[name] for name in names if name in options}
    is_even = not isinstance(clock, np.ndarray)
    driver = driver_of(model, limits, options)
    step = clock if is_even else clock_steps(clock)
    drive = driver.whole(desired, step, None if is_even else clock, **in_memory)
    before = options["start"]
    if isinstance(options.get("state"), State):
        before = options["state"].drive
    steps = None if limits.slew is None else steps_of(clock, drive.time)
    wrong = broken(drive.voltage, drive.move, limits, steps, before)
    rows = drive.move.stop - drive.move.start
    if rows != desired.size or drive.voltage.size != drive.desired.size:
        wrong = "rows are missing"
    if drive.clipped and options["on_limit"] == "error":
        wrong = "clipped, and an error was asked for"
    if options.get("periodic") and limits.slew is not None:
        period = drive.voltage[drive.move]
        if abs(period[0] - period[-1]) > limits.slew * step * (1.0 + 1e-9) + 1e-12:
            wrong = "the loop does not close"
    return wrong, drive.state


def driver_of(
    model: Cascade,
    limits: Limits,
    options: dict[str, Any],
    hold: int = 0,
    return_rows: int = 0,
) -> Driver:
    """Return a driver by its options."""
    lead = Lead(
        model,
        limits,
        state=options.get("state", "auto"),
        start=options.get("start"),
        approach=options.get("approach"),
        condition=options.get("condition", False),
        rest=options.get("lead"),
        hold=hold,
    )
    return Driver(
        lead,
        on_limit=options.get("on_limit", "auto"),
        return_to=options.get("return_to"),
        name="move",
        return_rows=return_rows,
    )


def in_blocks(
    rng: Random,
    model: Cascade,
    desired: Floats,
    limits: Limits,
    options: dict[str, Any],
) -> str:
    """Plan one drive block by block; what has left before a refusal counts."""
    for name in ("periodic", "passes", "bandwidth"):
        options.pop(name, None)
    rows = int(rng.integers(1, 100))
    clock = DT * np.arange(desired.size)
    blocks = [
        (clock[k : k + rows], DT, desired[k : k + rows])
        for k in range(0, desired.size, rows)
    ]
    sent = []
    try:
        driver = driver_of(model, limits, options)
        for stamps, step, rows_of_move in blocks:
            sent.append(driver.rows(rows_of_move, step, stamps).y)
        sent.append(driver.finish()[0].y)
    except GateError:
        raise
    except DboError:
        pass
    voltage = np.concatenate([np.empty(0), *sent])
    if not voltage.size:
        return ""
    before = options["start"]
    if isinstance(options.get("state"), State):
        before = options["state"].drive
    return broken(voltage, slice(0, 0), limits, DT, before)


def side_by_side(
    rng: Random,
    models: list[Cascade],
    limits: list[Limits],
    options: list[dict[str, Any]],
) -> str:
    """Drive the channels of a set, of which the shorter ones hold; return what is wrong with one."""
    count = int(rng.integers(1, 100))
    moves = [random_move(rng, model, count) for model in models]

    def drive_of(name: str, hold: int, after: int) -> Drive:
        channel = int(name)
        bounds, chosen = limits[channel], options[channel]
        driver = driver_of(models[channel], bounds, chosen, hold, after)
        return driver.whole(moves[channel], DT)

    drives = together(drive_of, [str(channel) for channel in range(len(models))])
    rows = {(drive.voltage.size, drive.move.start) for drive in drives.values()}
    if len(rows) != 1:
        return "the channels are not equally long"
    for name, drive in drives.items():
        before = options[int(name)]["start"]
        channel_limits = limits[int(name)]
        wrong = broken(drive.voltage, drive.move, channel_limits, DT, before)
        if wrong:
            return f"channel {name}: {wrong}"
    return ""


def by_inverse(rng: Random, model: Cascade, desired: Floats) -> str:
    """Run the inverse model over a move; return what is wrong with its drive."""
    outside: Any = ["hold", "error", "extend"][int(rng.integers(3))]
    simulator = Simulator(model.inverse(), "auto", outside, "move")
    rows, parts = int(rng.integers(1, 100)), []
    low, high = model.input.min, model.input.max
    slack = 1e-9 * model.input.span
    try:
        for k in range(0, desired.size, rows):
            parts.append(simulator.rows(desired[k : k + rows], DT).y)
        parts.append(simulator.finish().y)
    except LimitError:
        if outside != "error":
            return f"refused with {outside}"
    voltage = np.concatenate([np.empty(0), *parts])
    beyond = (voltage < low - slack) | (voltage > high + slack)
    if outside != "extend" and beyond.any():
        return f"a row of an inverse model is outside with {outside}"
    if outside == "extend" and beyond.any() and not simulator.outside_count:
        return "a row of an inverse model is outside, and nothing is said"
    return ""


def trial(
    rng: Random, number: int, model: Cascade, last: State | None
) -> tuple[str, State | None]:
    """Make one drive; return what is wrong with it, and the state after it."""
    if number % 10 == 3:
        models = [model, random_actuator(rng, DT)]
        bounds = [Limits.within(m.input, **random_limits(rng, m.input)) for m in models]  # type: ignore[arg-type]
        chosen = [random_options(rng, m, None) for m in models]
        return side_by_side(rng, models, bounds, chosen), None
    limits = Limits.within(model.input, **random_limits(rng, model.input))  # type: ignore[arg-type]
    desired = random_move(rng, model, int(rng.integers(1, 300)))
    options = random_options(rng, model, last)
    if number % 10 == 5:
        return by_inverse(rng, model, desired), None
    if number % 10 == 0:
        return in_blocks(rng, model, desired, limits, options), None
    clock: Any = [DT, DT, 1e-2][int(rng.integers(3))]
    if rng.random() < 0.05:
        clock = None
    elif rng.random() < 0.15:
        clock = np.cumsum(rng.uniform(0.0, 0.01, desired.size))
    return whole(model, desired, clock, limits, options)


def main() -> int:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 100_000
    seed = int(sys.argv[2]) if len(sys.argv) > 2 else 1
    warnings.simplefilter("ignore")
    begun = time.perf_counter()
    outcomes: Counter[str] = Counter()
    model, last = random_actuator(np.random.default_rng(seed), DT), None
    for number in range(count):
        if number % A_MODEL == 0:
            chance = np.random.default_rng([seed, number // A_MODEL])
            model, last = random_actuator(chance, DT), None
        rng = np.random.default_rng([seed, number, 1])
        try:
            wrong, last = trial(rng, number, model, last)
            outcomes["broken" if wrong else "written"] += 1
            if wrong:
                print(f"drive {number} of seed {seed}: {wrong}", flush=True)
        except GateError as problem:
            outcomes["broken"] += 1
            print(f"drive {number} of seed {seed}: {problem}", flush=True)
        except DboError as problem:
            outcomes[f"refused: {type(problem).__name__}"] += 1
        except Exception:
            outcomes["broken"] += 1
            print(f"drive {number} of seed {seed}:\n{traceback.format_exc()}")
    for outcome, times in outcomes.most_common():
        print(f"{times:8,} {outcome}")
    print(
        f"{count:,} drives, {outcomes['broken']} broken; {time.perf_counter() - begun:.0f} s"
    )
    return int(outcomes["broken"] > 0 or outcomes["written"] < 0.4 * count)


if __name__ == "__main__":
    sys.exit(main())
