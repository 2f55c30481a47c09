"""A run cut anywhere, at any block size, on any clock, goes on with the bytes of one run."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import SMALL_MODEL
from test_cli_signals import lagging_model

SAMPLES = 240


def clock(kind: str, rng: np.random.Generator) -> np.ndarray[Any, Any]:
    """Return time stamps: even, jittered, or even with pauses."""
    steps = np.full(SAMPLES, 0.02)
    if kind == "jittered":
        steps = rng.uniform(0.001, 0.06, SAMPLES)
    if kind == "paused":
        steps[rng.integers(1, SAMPLES, 8)] += rng.uniform(0.5, 30.0, 8)
    return np.round(1.5 + np.cumsum(steps), 6)


def write_signal(name: str, kind: str, rng: np.random.Generator) -> None:
    moves = 5.0 + 3.8 * np.sin(np.cumsum(rng.normal(0.0, 0.3, SAMPLES)))
    header = f"time_s,{name}" if kind != "rate" else name
    columns = [moves] if kind == "rate" else [clock(kind, rng), moves]
    lines = [",".join(map(repr, row)) for row in np.column_stack(columns).tolist()]
    Path("in.csv").write_text("\n".join([header, *lines]) + "\n")


def body(text: str) -> list[str]:
    return text.splitlines()[1:]


@pytest.mark.parametrize("kind", ["even", "jittered", "paused", "rate"])
@pytest.mark.parametrize("command", ["simulate", "compensate"])
def test_a_run_cut_anywhere_gives_the_bytes_of_one_run(
    dbo: Any, command: str, kind: str
) -> None:
    rng = np.random.default_rng(
        ["even", "jittered", "paused", "rate"].index(kind) + 10 * len(command)
    )
    Path("model.json").write_text(json.dumps(lagging_model()))
    write_signal("voltage_V" if command == "simulate" else "displacement_um", kind, rng)
    more = ["--sample-rate", "50"] if kind == "rate" else []
    if command == "compensate":
        more += ["--max-slew", "60", "--v-max", "9", "--on-limit", "clip"]
    whole = dbo(command, "model.json", "in.csv", "-q", *more)
    assert whole.code == 0
    for _ in range(4):
        cuts = np.sort(rng.choice(np.arange(1, SAMPLES), 3, replace=False)).tolist()
        ends = [*cuts, SAMPLES]
        joined, state = [], "auto"
        for first, last in zip([0, *cuts], ends, strict=True):
            block = ["--block-rows", str(rng.integers(1, 90))]
            rows = [
                "--rows",
                f"{first + 1}:{last}",
                "--state",
                state,
                "--save-state",
                f"s{last}.json",
            ]
            part = dbo(command, "model.json", "in.csv", "-q", *more, *block, *rows)
            assert part.code == 0, part.err
            joined += body(part.out)
            state = f"s{last}.json"
        assert joined == body(whole.out), cuts


def test_a_state_knows_its_time(dbo: Any) -> None:
    Path("model.json").write_text(json.dumps(lagging_model()))
    Path("in.csv").write_text("time_s,voltage_V\n3.5,1\n3.75,2\n")
    dbo("simulate", "model.json", "in.csv", "-o", "out.csv", "--save-state", "s.json")
    state = json.loads(Path("s.json").read_text())
    assert (state["format"], state["version"], state["time"]) == ("dbo-state", 2, 3.75)


def test_a_clock_that_began_anew_goes_on_one_step_later(dbo: Any) -> None:
    Path("model.json").write_text(json.dumps(lagging_model()))
    Path("first.csv").write_text("time_s,voltage_V\n10,1\n10.1,2\n10.2,3\n")
    Path("second.csv").write_text("time_s,voltage_V\n0,4\n0.1,5\n")
    Path("all.csv").write_text(
        "time_s,voltage_V\n10,1\n10.1,2\n10.2,3\n10.3,4\n10.4,5\n"
    )
    dbo(
        "simulate", "model.json", "first.csv", "-o", "out.csv", "--save-state", "s.json"
    )
    rest = dbo(
        "simulate", "model.json", "second.csv", "--state", "s.json"
    ).out.splitlines()[1:]
    whole = dbo("simulate", "model.json", "all.csv").out.splitlines()[4:]
    got = [float(line.split(",")[2]) for line in rest]
    assert got == pytest.approx(
        [float(line.split(",")[2]) for line in whole], abs=1e-12
    )


def outputs(text: str) -> list[float]:
    """Return the last column of a table."""
    return [float(line.split(",")[-1]) for line in body(text)]


def test_a_rate_that_begins_at_the_stamp_of_the_state_goes_on_one_step_later(
    dbo: Any,
) -> None:
    Path("model.json").write_text(json.dumps(lagging_model()))
    # the delay holds 8 rows back
    volts = [1.0, *(5.0 + 4.0 * np.sin(np.arange(30) / 3.0)).tolist()]
    for name, part in (("first", volts[:1]), ("second", volts[1:]), ("all", volts)):
        Path(f"{name}.csv").write_text(
            "\n".join(["voltage_V", *map(repr, part)]) + "\n"
        )
    words = ("--sample-rate", "50", "-q")
    whole = outputs(dbo("simulate", "model.json", "all.csv", *words).out)
    dbo(
        "simulate",
        "model.json",
        "first.csv",
        *words,
        "-o",
        "out.csv",
        "--save-state",
        "s.json",
    )
    assert json.loads(Path("s.json").read_text())["time"] == 0.0
    rest = outputs(
        dbo("simulate", "model.json", "second.csv", *words, "--state", "s.json").out
    )
    assert rest == pytest.approx(whole[1:], abs=1e-12)


def test_rows_left_out_of_a_rate_are_a_pause(dbo: Any) -> None:
    """What creeps and lags settles meanwhile, as after the same pause of a clock of stamps."""
    Path("model.json").write_text(json.dumps(lagging_model()))
    volts = 5.0 + 4.0 * np.sin(np.arange(150) / 7.0)
    Path("rate.csv").write_text(
        "\n".join(["voltage_V", *map(repr, volts.tolist())]) + "\n"
    )
    kept = [k for k in range(150) if not 50 <= k < 100]
    stamped = [f"{0.02 * k:.6f},{float(volts[k])!r}" for k in kept]
    Path("stamps.csv").write_text("\n".join(["time_s,voltage_V", *stamped]) + "\n")
    words = ("simulate", "model.json", "rate.csv", "--sample-rate", "50", "-q")
    dbo(*words, "--rows", "1:50", "-o", "out.csv", "--save-state", "s.json")
    rest = outputs(dbo(*words, "--rows", "101:", "--state", "s.json").out)
    stamps = outputs(dbo("simulate", "model.json", "stamps.csv", "-q").out)
    assert rest == pytest.approx(stamps[50:], abs=1e-9)


@pytest.mark.parametrize("kind", ["even", "rate"])
@pytest.mark.parametrize("command", ["simulate", "compensate"])
def test_a_model_with_dynamics_goes_on_as_one_run(
    dbo: Any, command: str, kind: str
) -> None:
    rng = np.random.default_rng(["even", "rate"].index(kind) + 20 * len(command))
    model = lagging_model()
    sections = [{"lag": 0.01}, {"frequency": 4.0, "damping": 0.05}]
    model["stages"].insert(-1 if model["stages"][-1]["type"] == "delay" else len(model["stages"]),
                           {"type": "dynamics", "sections": sections})  # fmt: skip
    Path("model.json").write_text(json.dumps(model))
    write_signal("voltage_V" if command == "simulate" else "displacement_um", kind, rng)
    more = ["--sample-rate", "50"] if kind == "rate" else []
    if command == "compensate":
        more += ["--max-slew", "60", "--v-max", "9", "--on-limit", "clip"]
    whole = dbo(command, "model.json", "in.csv", "-q", *more)
    assert whole.code == 0, whole.err
    for cut in (2, 101, 130, SAMPLES - 1):
        joined, state = [], "auto"
        for rows in (f"1:{cut}", f"{cut + 1}:"):
            state_out = f"s{rows.replace(':', '_')}.json"
            block = ["--block-rows", str(rng.integers(1, 90))]
            words = [
                "--rows",
                rows,
                "--state",
                state,
                "--save-state",
                state_out,
                *block,
            ]
            part = dbo(command, "model.json", "in.csv", "-q", *more, *words)
            assert part.code == 0, part.err
            joined += body(part.out)
            state = state_out
        assert joined == body(whole.out), cut


@pytest.mark.parametrize("begin", ["full", "empty"])
def test_a_log_that_was_identified_from_is_simulated_as_the_fit_began(
    dbo: Any, begin: str
) -> None:
    heights = (0.3, 0.5, 0.8, 1.0)
    away = 5.0 if begin == "empty" else -5.0
    turns = np.concatenate(
        [5.0 + away * h * np.sin(np.arange(150) / 75.0 * np.pi) for h in heights]
    )
    heights_of_gears = (0.1 + 0.3 * np.sqrt(np.arange(40) / 39.0)).tolist()
    gears = {
        "type": "backlash",
        "x0": 0.0,
        "y0": 0.0,
        "dx": [0.25] * 40,
        "dy": heights_of_gears,
    }
    Path("model.json").write_text(json.dumps(SMALL_MODEL | {"stages": [gears]}))
    table = ["voltage_V", *map(repr, turns.tolist())]
    Path("drive.csv").write_text("\n".join(table) + "\n")
    assert (
        dbo(
            "simulate", "model.json", "drive.csv", "--state", begin, "-o", "grow.csv"
        ).code
        == 0
    )
    found = ["--gears", "40", "--points", "0", "-o", "found.json"]
    assert dbo("identify", "grow.csv", *found).code == 0
    note = f"grow.csv: starts {begin}, as the identification found\n"
    for asked in ("auto", begin):
        done = dbo(
            "simulate", "found.json", "grow.csv", "--state", asked, "-o", f"{asked}.csv"
        )
        assert (done.code, note in done.err) == (0, asked == "auto")
    assert Path("auto.csv").read_bytes() == Path(f"{begin}.csv").read_bytes()
    assert note not in dbo("simulate", "found.json", "drive.csv", "-o", "other.csv").err
    again, log = (
        np.loadtxt(f"{name}.csv", delimiter=",", skiprows=1)[:, 1]
        for name in ("auto", "grow")
    )
    assert np.abs(again - log).max() < 0.02 * np.ptp(log)
