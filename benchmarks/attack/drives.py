"""Random drives against exact rationals: no row beyond a limit, no step at a join that nobody asked for.

    python benchmarks/attack/drives.py [COUNT] [SEED]

COUNT drives through planner and gate, a fiftieth of them through the API (sweeps, ways,
leads, returns, loops with run-ins, states, converters, uneven clocks, infinities), a
thousandth as processes. A tally of what was written and what was refused is printed; at
least 60 % must be written. Exit 1 where anything was broken.
"""

from __future__ import annotations

import itertools
import subprocess
import sys
import tempfile
import warnings
from collections import Counter
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dbo_cli import DboError, DboWarning
from dbo_cli.drives.gate import ROUNDING, DriveGate
from dbo_cli.errors import InputError, LimitError, UsageError
from dbo_cli.hysteresis.cascade import slow_output_range
from dbo_cli.hysteresis.dynamics import DynamicsStage, Lag, Resonance
from dbo_cli.hysteresis.model import (
    ActuatorModel,
    BacklashStage,
    DelayStage,
    DriveLimits,
    PointStage,
    Quantity,
    Relaxation,
    ScaleStage,
    Stage,
)
from dbo_cli.runs.api import Model

Floats = NDArray[np.float64]
Random = np.random.Generator
SMALLEST_SHARE = 0.6
WIDE = 1e6  # V: no limit
# of the pieces' own steps: 1.3 at most in 1,500 drives, 575 where a join was not looked
# at
KICK = 3.0


def random_model(pick: Random, rate: float) -> ActuatorModel:
    """Return a model of random stages of every kind, on a clock that resolves it."""
    low, span = (
        float(pick.choice([0.0, -20.0, -150.0, 3.3])),
        float(pick.choice([3.6, 100.0, 150.0, 1000.0])),
    )
    stages: list[Stage] = []
    if pick.random() < 0.25:
        stages.append(DynamicsStage((Lag(float(10 ** pick.uniform(0.0, 2.0) / rate)),)))
    inner_low, inner = low, span
    if pick.random() < 0.3:
        part = pick.uniform(0.5, 1.5, int(pick.integers(1, 5)))
        part *= span / part.sum()
        heights = pick.uniform(0.5, 1.5, part.size) * part
        stages.append(PointStage(part, heights, low, low))
        inner = float(heights.sum())
    elif pick.random() < 0.2:
        gain = float(pick.choice([0.01, 1.0 / 3.0, -1.0, -0.3]))
        stages.append(ScaleStage(gain, 0.5))
        inner, inner_low = abs(gain) * span, min(gain * low, gain * (low + span)) + 0.5
    gears = int(pick.choice([1, 2, 3, 8, 25, 64, 130]))
    widths = pick.uniform(0.3, 1.7, gears) if pick.random() < 0.5 else np.ones(gears)
    widths *= inner / widths.sum()
    heights = widths * np.sort(pick.uniform(0.2, 2.0, gears))
    memory = None
    if pick.random() < 0.5:
        count = int(pick.integers(1, 4))
        taus = tuple(sorted((10 ** pick.uniform(-3.0, 1.0, count)).tolist()))
        memory = Relaxation(
            inner_low, taus, tuple(pick.uniform(0.0, 0.1, count).tolist())
        )
    stages.append(
        BacklashStage(
            widths, heights, inner_low, float(pick.uniform(-1.0, 1.0)), memory
        )
    )
    if pick.random() < 0.4:
        part = pick.uniform(0.5, 1.5, int(pick.integers(1, 5)))
        part *= heights.sum() / part.sum()
        stages.append(
            PointStage(part, pick.uniform(0.5, 1.5, part.size) * part, 0.0, 0.0)
        )
    stages.append(
        ScaleStage(
            float(pick.choice([1.0, 12.5, -3.0, 0.1])), float(pick.uniform(-30.0, 30.0))
        )
    )
    ends = slow_output_range(stages, low, low + span)
    if pick.random() < 0.35:
        frequency = float(rate / 10 ** pick.uniform(0.8, 2.3))
        stages.append(
            DynamicsStage(
                (Resonance(frequency, float(pick.choice([0.01, 0.05, 0.3]))),)
            )
        )
    if pick.random() < 0.3:
        stages.append(DelayStage(float(pick.choice([1.0, 1.23, 7.0])) / rate))
    voltage = Quantity("voltage", "V", low, low + span)
    return ActuatorModel(
        "forward", voltage, Quantity("displacement", "um", *ends), tuple(stages)
    )


def trajectory(pick: Random, model: ActuatorModel, count: int, loop: bool) -> Floats:
    """Return a move of some kind, in and beyond what the model reaches."""
    low, span = model.output.minimum, model.output.span
    t, size = np.arange(count) / count, span * float(pick.choice([0.2, 0.4, 0.6, 1.5]))
    kind = 0 if loop else int(pick.integers(0, 5))
    if kind == 0:
        turns = int(pick.integers(1, 4)) if loop else pick.uniform(0.5, 9.0)
        found = (
            low
            + 0.5 * span
            + 0.5 * size * np.sin(2.0 * np.pi * turns * t + pick.uniform(0.0, 6.0))
        )
    elif kind == 1:
        found = low + 0.5 * span + np.cumsum(pick.normal(0.0, 0.05 * span, count))
    elif kind == 2:
        found = (
            low + span * np.repeat(pick.uniform(-0.1, 1.1, 6), -(-count // 6))[:count]
        )
    elif kind == 3:
        found = pick.uniform(low - 0.3 * span, low + 1.3 * span, count)
    else:
        found = np.full(count, low + pick.uniform(0.1, 0.9) * span)
    return np.asarray(found, dtype=np.float64)


def random_limits(pick: Random, model: ActuatorModel, rate: float) -> DriveLimits:
    """Return a range, sometimes infinite, and a slew limit, sometimes none."""
    low, span = model.input.minimum, model.input.span
    ends = (
        np.sort(low + span * pick.uniform(-0.2, 1.2, 2))
        if pick.random() < 0.5
        else [low, low + span]
    )
    v_min, v_max = float(ends[0]), max(float(ends[1]), float(ends[0]) + 0.05 * span)
    if pick.random() < 0.05:
        v_max = float(pick.choice([np.inf, 1e12]))
    slew = (
        float(span * rate * 10 ** pick.uniform(-4.0, 0.5))
        if pick.random() < 0.7
        else None
    )
    return DriveLimits(v_min, v_max, float("inf") if pick.random() < 0.05 else slew)


def what_holds(
    limits: DriveLimits, model: ActuatorModel, options: dict[str, Any]
) -> DriveLimits:
    """Return the limits that have to hold: the identified range cut by those that were typed."""
    if options.get("extrapolate"):
        return limits
    low = max(limits.v_min, model.input.minimum)
    high = min(limits.v_max, model.input.maximum)
    if low >= high:  # refused
        return limits
    return DriveLimits(low, high, limits.max_slew)


def broken(
    drive: Floats, steps: Floats | float, limits: DriveLimits, last: float | None
) -> str:
    """Return what is broken, in rational arithmetic; the last digits of a step aside. Empty where nothing."""
    if not np.isfinite(drive).all():
        return "not finite"
    rows = drive if last is None else np.concatenate([[last], drive])
    own = drive
    # it may come inwards
    if last is not None and not limits.v_min <= last <= limits.v_max:
        inside = (drive >= limits.v_min) & (drive <= limits.v_max)
        own = drive[int(np.argmax(inside)) if inside.any() else drive.size :]
    if (own < limits.v_min).any() or (own > limits.v_max).any():
        return "range"
    if limits.max_slew is None:
        return ""
    seconds = (
        np.broadcast_to(steps, rows.size - 1)
        if np.ndim(steps) == 0
        else np.asarray(steps)[-(rows.size - 1) :]
    )
    change = np.abs(np.diff(rows))
    for k in np.flatnonzero(
        change > limits.max_slew * seconds * (1.0 - 1e-12)
    ).tolist():
        most = Fraction(limits.max_slew) * Fraction(float(seconds[k]))
        digits = Fraction(ROUNDING) * max(
            abs(Fraction(float(rows[k]))), abs(Fraction(float(rows[k + 1])))
        )
        if abs(Fraction(float(rows[k + 1])) - Fraction(float(rows[k]))) > most + digits:
            return f"slew by {float(change[k] / (limits.max_slew * seconds[k])) - 1.0:.3g} of it"
    return ""


def planned(
    pick: Random, model: ActuatorModel, rate: float, tally: Counter[str]
) -> str:
    """Plan one short block from a random state, and let the gate look at it, too."""
    limits, step = random_limits(pick, model, rate), 1.0 / rate
    wanted = trajectory(pick, model, int(pick.integers(2, 30)), False)
    steps: Any = step
    if pick.random() < 0.3:
        steps = step * pick.choice([0.0, 0.5, 1.0, 1.0, 20.0], wanted.size)
    last = None
    if pick.random() < 0.5:
        drive = model.input.minimum + model.input.span * pick.random(4)
        state = model.simulate(
            drive, model.start(float(drive[0])), time_step=step
        ).state
        last = model.drive_of(state)
    else:
        state = model.start_compensation(
            float(wanted[0]), str(pick.choice(["auto", "empty", "full"])), limits
        )
    gate = DriveGate(limits, last)
    try:
        gate.require_start(float(np.ravel(steps)[0]))
    except LimitError:
        away = max(limits.v_min - (last or 0.0), (last or 0.0) - limits.v_max)
        assert limits.max_slew is not None and away > 0.999 * limits.max_slew * float(
            np.ravel(steps)[0]
        )
        tally["planner refused, outside by more than a step"] += 1
        return ""
    done = model.compensate(wanted, state, limits=limits, time_step=steps)
    found = broken(done.y, steps, limits, last)
    if not found and gate.violation(done.y, steps):
        found = "the gate refuses what is right"
    tally["planner written"] += 1
    return found


def asked(
    pick: Random, model: ActuatorModel, limits: DriveLimits, rate: float
) -> dict[str, Any]:
    """Return random options of a compensation."""
    options: dict[str, Any] = {
        "v_min": limits.v_min,
        "v_max": limits.v_max,
        "max_slew": limits.max_slew,
    }
    options["on_limit"] = str(pick.choice(["auto", "clip", "clip"]))
    options["extrapolate"] = bool(pick.random() < 0.5)
    kind = pick.random()
    if kind < 0.3:
        options |= {"periodic": True, "passes": int(pick.integers(0, 4))}
    elif kind < 0.5:
        options["condition"] = True
    if kind >= 0.3 and pick.random() < 0.3:
        options["return_"] = "auto"
    if kind >= 0.3 and pick.random() < 0.3:
        options["lead"] = "auto"
    if pick.random() < 0.4:
        options["from_"] = float(
            model.input.minimum + model.input.span * pick.uniform(-0.2, 1.2)
        )
        if pick.random() < 0.7:
            options["approach"] = "auto"
    elif not options.get("condition") and pick.random() < 0.5:
        options["state"] = str(pick.choice(["empty", "full", "settled"]))
    if pick.random() < 0.1:
        options["bandwidth"] = rate / 12.0
    return options


def through_the_api(
    pick: Random, model: ActuatorModel, rate: float, tally: Counter[str]
) -> str:
    """Ask the API for one drive, and look at its rows, joins and seam."""
    limits = random_limits(pick, model, rate)
    options = asked(pick, model, limits, rate)
    limits = what_holds(limits, model, options)
    loop = "periodic" in options
    count = int(pick.choice([5, 50, 300]))
    wanted = trajectory(pick, model, count, loop)
    clock: dict[str, Any] = {"sample_rate": rate}
    if (
        not loop
        and model.dynamics is None
        and "bandwidth" not in options
        and pick.random() < 0.3
    ):
        clock = {
            "time": np.cumsum(pick.choice([0.0, 0.5, 1.0, 1.0, 1.0, 20.0], count))
            / rate
        }
    kind = "loop" if loop else "sweep" if "condition" in options else "move"
    try:
        done = Model(model).compensate(wanted, details=True, **options, **clock)
    except (LimitError, InputError, UsageError) as refused:
        reason = "".join(c for c in str(refused) if not c.isdigit())[:60]
        tally[f"{kind} refused ({type(refused).__name__}): {reason}"] += 1
        return ""
    tally[f"{kind} written"] += 1
    last = options.get("from_")
    if last is not None and done.values[0] == last:
        drive, last = done.values[1:], last
    else:
        drive = done.values
    steps: Any = 1.0 / rate
    if "time" in clock:
        assert done.time is not None
        steps = np.diff(done.time)
        drive, last = done.values[1:], float(done.values[0])
    found = broken(drive, steps, limits, last)
    if found:
        return f"{kind}: {found}"
    own = done.values[-count:]
    if loop and limits.max_slew is not None:
        found = broken(own[:1], 1.0 / rate, limits, float(own[-1]))
        if found:
            return f"seam: {found}"
    assert done.time is not None
    begin = int(
        (done.time < (clock["time"][0] if "time" in clock else 0.0) - 0.1 / rate).sum()
    )
    allowed = abs(float(own[-1]) - float(own[0])) if loop else 0.0
    if limits.max_slew is not None and ("approach" in options or "return_" in options):
        allowed = (
            limits.max_slew * (1.0 if np.ndim(steps) == 0 else 20.0) / rate
        )  # as fast as the slew allows
    # A move that begins in motion kicks a mass that rests, where no lead was asked for;
    # the program says so. A delay puts that kick before the first row, and the limits
    # may hide the move's own steps behind it. So does a bandwidth, which rounds the
    # join with the move (1.77 times, once in 3,400).
    late = (
        model.dynamics is not None or model.delay is not None or "bandwidth" in options
    )
    # With a lead, too, where pieces are as short as the kick: 1.31 of five rows' own
    # steps, once in 400.
    kick = KICK if late and not loop else 1.0
    joins = [begin] if loop else [begin, begin + count]
    found = [
        text
        for join in joins
        if (text := unasked_step(done.values, join, allowed, kick))
    ]
    if found and not loop:
        # Limits hide how fast the move itself is: 7 times what is left of its steps,
        # once in 9,000. Its first step stands in the lead where a delay asks for one
        # (2.3 times, once in 30,000).
        free = {
            key: options[key] for key in ("bandwidth", "lead") if key in options
        } | clock
        own = Model(model).compensate(
            wanted, v_min=-WIDE, v_max=WIDE, extrapolate=True, state="empty", **free
        )
        allowed = KICK * float(np.abs(np.diff(own)).max())
        found = [
            text
            for join in joins
            if (text := unasked_step(done.values, join, allowed, kick))
        ]
    return found[0] if found else ""


def unasked_step(drive: Floats, join: int, allowed: float, kick: float) -> str:
    """Return the join of two pieces where it steps further than what is allowed and than both of them do."""
    if not 2 <= join < drive.size:
        return ""
    steps = np.abs(np.diff(drive))
    within = max(
        kick * float(steps[: join - 1].max()),
        kick * float(steps[join:].max(initial=0.0)),
        allowed,
    )
    return (
        ""
        if steps[join - 1] <= within * (1.0 + 1e-9)
        else f"join steps {steps[join - 1] / within:.3g} times"
    )


def converters(
    pick: Random, model: ActuatorModel, rate: float, tally: Counter[str]
) -> str:
    """Drive a converter live."""
    if (
        model.dynamics is not None
        or model.drive_lag is not None
        or model.delay is not None
    ):
        return ""
    limits, bits = random_limits(pick, model, rate), int(pick.integers(4, 21))
    if not np.isfinite(limits.v_max):
        return ""
    low, span = model.input.minimum, model.input.span
    curve = np.linspace(low - 0.3 * span, low + 1.3 * span, 2**bits)
    more: dict[str, Any] = {
        "v_min": limits.v_min,
        "v_max": limits.v_max,
        "max_slew": limits.max_slew,
    }
    more["extrapolate"] = bool(pick.random() < 0.5)
    limits = what_holds(limits, model, more)
    try:
        live = Model(model).controller(rate, dac=curve, **more)
    except UsageError:
        tally["converter refused: no code inside"] += int(
            not ((curve >= limits.v_min) & (curve <= limits.v_max)).any()
        )
        return ""
    volts = curve[
        [int(live.step(float(x))) for x in trajectory(pick, model, 60, False)]
    ]
    tally["converter written"] += 1
    if volts.min() < limits.v_min or volts.max() > limits.v_max:
        return "converter: range"
    if limits.max_slew is None:
        return ""
    held = [curve[int(live.step(1e9 * model.output.span))] for _ in range(500)]
    return converter_broken(
        volts, np.asarray(held), curve, limits, limits.max_slew / rate
    )


def converter_broken(
    volts: Floats, held: Floats, curve: Floats, limits: DriveLimits, most: float
) -> str:
    """Return what a converter's volts break, ``most`` a sample being allowed, and ``held`` asking for an end."""
    gap, change = float(curve[1] - curve[0]), np.abs(np.diff(volts))
    inside = curve[(curve >= limits.v_min) & (curve <= limits.v_max)]
    codes = most / gap  # a sample, in whole ones; below one, whole samples a code
    needed = inside.size / (
        np.floor(codes) if codes >= 1.0 else 1.0 / np.ceil(1.0 / max(codes, 1e-9))
    )
    if (
        needed < held.size - 2
        and np.abs(held[int(needed) + 1] - inside[[0, -1]]).min() > 0.5 * gap
    ):
        # it arrives, however little of a code the slew allows in a sample
        return "converter: stands still"
    if change.max(initial=0.0) > max(most, gap) * (1.0 + 1e-9):
        return "converter: slew of a sample"
    travelled = np.concatenate([[0.0], np.cumsum(change)])
    for begin, end in itertools.product((0, 10), (30, 59)):
        if travelled[end] - travelled[begin] > most * (end - begin) + gap * (
            1.0 + 1e-9
        ):
            return "converter: slew of many samples"
    return ""


def as_a_process(
    pick: Random, folder: Path, model: ActuatorModel, rate: float, tally: Counter[str]
) -> str:
    """Write files, run the program, and read what it left."""
    limits = random_limits(pick, model, rate)
    if not np.isfinite(limits.v_max):
        return ""
    options = asked(pick, model, limits, rate)
    limits = what_holds(limits, model, options)
    wanted = trajectory(pick, model, 60, "periodic" in options)
    Model(model).save(folder / "model.json")
    lines = "".join(f"{k / rate!r},{x!r}\n" for k, x in enumerate(wanted.tolist()))
    (folder / "wanted.csv").write_text("time_s,displacement_um\n" + lines)
    words = [
        str(folder / "model.json"),
        str(folder / "wanted.csv"),
        "-o",
        str(folder / "drive.csv"),
    ]
    for name, value in options.items():
        if value is not None and value is not False:
            option = "--" + name.rstrip("_").replace("_", "-")
            words += [option] if value is True else [f"{option}={value}"]
    (folder / "drive.csv").unlink(missing_ok=True)
    done = subprocess.run(
        [sys.executable, "-m", "dbo_cli", "compensate", *words],
        capture_output=True,
        text=True,
    )
    if done.returncode:
        tally[f"process refused with {done.returncode}"] += 1
        left = (folder / "drive.csv").exists()
        odd = (
            done.returncode not in (1, 2, 3)
            or "internal error" in done.stderr
            or "breaks its limits" in done.stderr
        )
        return f"process: {done.returncode} {done.stderr[-200:]}" if odd or left else ""
    tally["process written"] += 1
    checked = [
        "check",
        str(folder / "drive.csv"),
        f"--v-min={limits.v_min}",
        f"--v-max={limits.v_max}",
    ]
    if "from_" in options:
        return ""  # from outside the range it may begin there
    if limits.max_slew is not None:
        # the stamps' own digits
        checked.append(f"--max-slew={limits.max_slew * (1.0 + 1e-9)}")
    verdict = subprocess.run(
        [sys.executable, "-m", "dbo_cli", *checked], capture_output=True, text=True
    )
    return "" if verdict.returncode == 0 else f"process: {verdict.stderr[-300:]}"


def main() -> None:
    """Run the attack and exit 1 where something broke."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 10_000
    seed = int(sys.argv[2]) if len(sys.argv) > 2 else 1
    warnings.simplefilter("ignore", DboWarning)
    tally: Counter[str] = Counter()
    wrong: list[str] = []
    with tempfile.TemporaryDirectory() as name:
        for number in range(count):
            pick = np.random.default_rng([seed, number])
            rate = float(10 ** pick.uniform(2.0, 5.0))
            kinds = [planned]
            if number % 50 == 0:
                kinds += [through_the_api, converters]
            try:
                model = random_model(pick, rate)
                found = [kind(pick, model, rate, tally) for kind in kinds]
                if number % 1000 == 0:
                    found.append(as_a_process(pick, Path(name), model, rate, tally))
            except DboError as problem:
                found = [f"{type(problem).__name__}: {problem}"]
            except Exception as problem:
                found = [f"CRASH {type(problem).__name__}: {problem}"]
            wrong += [f"case {number}: {text}" for text in found if text]
    for text, times in sorted(tally.items()):
        print(f"{times:8,} {text}")
    written = sum(times for text, times in tally.items() if text.endswith("written"))
    share = written / max(sum(tally.values()), 1)
    print(
        f"{share:.1%} of what was asked is written; {len(wrong)} broken",
        *wrong[:40],
        sep="\n",
    )
    sys.exit(bool(wrong) or share < SMALLEST_SHARE)


if __name__ == "__main__":
    main()
