"""What a drive cannot do: what limits cut off, a delay beyond the move, and what stands before time 0."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import SMALL_MODEL
from trials import Floats

from dbo_cli.errors import LimitError
from dbo_cli.runs.api import Model, read_model

RATE = 1000.0
TIME = np.arange(400) / RATE
REACH, SPAN = 9.0, 8.0  # um, of the small model


def write(name: str, wanted: Floats, rate: float = RATE) -> None:
    """Write a trajectory."""
    rows = [
        f"{k / rate!r},{value!r}" for k, value in enumerate(np.asarray(wanted).tolist())
    ]
    Path(name).write_text("\n".join(["time_s,displacement_um", *rows]) + "\n")


def sine(top: float) -> Floats:
    """Return a move between 2 um and ``top``."""
    half = 0.5 * (top - 2.0)
    wanted: Floats = 2.0 + half * (1.0 - np.cos(2.0 * np.pi * 5.0 * TIME))
    return wanted


@pytest.fixture
def bench(dbo: Any) -> Any:
    Path("model.json").write_text(json.dumps(SMALL_MODEL))
    write("small.csv", sine(REACH + 0.1))
    write("large.csv", sine(REACH + 2.0))
    return dbo


def delayed(seconds: float) -> None:
    """Write the small model with a delay."""
    stages = [*SMALL_MODEL["stages"], {"type": "delay", "seconds": seconds}]
    Path("late.json").write_text(json.dumps(SMALL_MODEL | {"stages": stages}))


# --- how much is cut off ---


def test_what_costs_little_is_cut_off_and_said(bench: Any) -> None:
    done = bench("compensate", "model.json", "small.csv", "-o", "drive.csv")
    assert done.code == 0 and "clipped, by which the move misses 0.0" in done.err
    assert np.loadtxt("drive.csv", delimiter=",", skiprows=1)[:, 2].max() == 10.0
    again = bench(
        "compensate",
        "model.json",
        "small.csv",
        "-o",
        "clipped.csv",
        "--on-limit",
        "clip",
    )
    assert again.err == done.err
    assert Path("clipped.csv").read_bytes() == Path("drive.csv").read_bytes()


def test_what_costs_much_is_not_written_unless_asked_for(bench: Any) -> None:
    done = bench(
        "compensate",
        "model.json",
        "large.csv",
        "-o",
        "drive.csv",
        "--summary",
        "s.json",
    )
    missed = np.maximum(sine(REACH + 2.0) - REACH, 0.0)
    lost = float(np.sqrt(np.mean(missed**2)))
    assert done.code == 3 and done.out == ""
    assert (
        f"the move would miss {lost:.3g} um RMS ({100.0 * lost / REACH:.2g} % of the move), "
        in done.err
    )
    assert done.err.endswith(
        "2 um at worst; more than 1 % is not written (--on-limit clip writes it)\n"
    )
    assert not Path("drive.csv").exists() and not Path("s.json").exists()
    written = bench(
        "compensate", "model.json", "large.csv", "-o", "drive.csv", "--on-limit", "clip"
    )
    assert (
        written.code == 0
        and f"by which the move misses {lost:.3g} um RMS" in written.err
    )


def test_in_python_a_limit_error_is_raised() -> None:
    model = Model(read_model_of(SMALL_MODEL))
    with pytest.raises(
        LimitError, match=r"more than 1 % is not written \(`on_limit` clip writes it\)"
    ):
        model.compensate(sine(REACH + 2.0), sample_rate=RATE)
    drive = model.compensate(
        sine(REACH + 2.0), sample_rate=RATE, on_limit="clip", details=True
    )
    assert drive.clipped > 0 and drive.values.max() == 10.0


def read_model_of(values: dict[str, Any]) -> Any:
    """Return the model that a file's values describe."""
    path = Path("model-of-values.json")
    path.write_text(json.dumps(values))
    model = read_model(path).actuator
    path.unlink()
    return model


def test_a_hold_out_of_reach_is_measured_by_the_model_s_range(bench: Any) -> None:
    held = np.full(50, REACH + 0.07)
    write("near.csv", held)
    held[0] = REACH - 0.5
    write("moving.csv", held)
    words = ["--state", "empty", "-o", "drive.csv"]
    assert bench("compensate", "model.json", "near.csv", *words).code == 0
    # 12 % of how far it moves
    assert bench("compensate", "model.json", "moving.csv", *words).code == 3


@pytest.mark.parametrize("rows", [1, 7, 400])
def test_a_stream_ends_where_it_has_lost_too_much(bench: Any, rows: int) -> None:
    whole = bench(
        "compensate", "model.json", "large.csv", "--on-limit", "clip"
    ).out.splitlines()
    done = bench("compensate", "model.json", "large.csv", "--block-rows", rows)
    left = done.out.splitlines()
    missed = np.maximum(sine(REACH + 2.0) - REACH, 0.0)
    counted = np.maximum(np.arange(1.0, 401.0), 100.0)
    passes = int(np.argmax(np.cumsum(missed**2) > (0.01 * SPAN) ** 2 * counted))
    assert left == whole[: passes + 1]  # a header, and the rows before
    clipped = int(np.count_nonzero(missed[: passes + 1]))
    assert done.code == 3
    assert done.err.startswith(
        f"dbo: error: large.csv: {clipped:,} of {passes + 1:,} samples (first in row "
    )
    assert done.err.endswith(
        "the move misses more than 0.08 um RMS, 1 % of the model's range; the stream ends (--on-limit clip "
        "goes on)\n"
    )


def test_a_stream_that_loses_little_is_clipped_counted_and_said(bench: Any) -> None:
    done = bench("compensate", "model.json", "small.csv")
    clip = bench("compensate", "model.json", "small.csv", "--on-limit", "clip")
    assert (
        done == clip
        and done.code == 0
        and "clipped, by which the move misses" in done.err
    )


def test_a_slew_limit_in_another_unit_is_refused(bench: Any) -> None:
    done = bench(
        "compensate", "model.json", "small.csv", "--max-slew", "2", "-o", "drive.csv"
    )
    assert (
        done.code == 3
        and "399 of 400 samples" in done.err
        and not Path("drive.csv").exists()
    )


# --- a delay beyond the move ---


def test_a_delay_longer_than_the_move_is_refused(bench: Any) -> None:
    delayed(2.5)
    write("move.csv", sine(8.0)[:50])
    done = bench("compensate", "late.json", "move.csv", "-o", "drive.csv")
    assert done == (
        3,
        "",
        "dbo: error: move.csv: the model's delay, 2.5 s, is longer than the move, 0.049 s, so that the drive "
        "would hold its last value (--lead auto lets it begin before; --on-limit clip writes it all the "
        "same)\n",
    )
    assert not Path("drive.csv").exists()
    assert (
        bench(
            "compensate", "late.json", "move.csv", "-o", "d.csv", "--on-limit", "clip"
        ).code
        == 0
    )
    led = bench(
        "compensate",
        "late.json",
        "move.csv",
        "-o",
        "led.csv",
        "--lead",
        "auto",
        "--state",
        "empty",
    )
    assert led.code == 0, led.err
    delayed(0.04)
    assert bench("compensate", "late.json", "move.csv", "-o", "d.csv").code == 0


# --- a long job in pieces ---


def test_a_piece_that_lies_out_of_reach_is_clipped_as_in_the_whole_run(
    bench: Any,
) -> None:
    write(
        "job.csv",
        np.concatenate(
            [np.linspace(3.0, 8.0, 60), np.full(40, 12.0), np.full(50, 4.0)]
        ),
    )
    clip = ["--on-limit", "clip"]
    whole = bench("compensate", "model.json", "job.csv", *clip).out.splitlines()
    pieces, state = [], "auto"
    for rows in ("1:60", "61:100", "101:150"):
        words = ["--rows", rows, "--state", state, "--save-state", f"s{rows[:2]}.json"]
        done = bench("compensate", "model.json", "job.csv", *words, *clip)
        assert done.code == 0, done.err
        pieces += done.out.splitlines()[1:]
        state = f"s{rows[:2]}.json"
    assert pieces == whole[1:]
    words = ["--rows", "61:100", "--state", "s1:.json", "-o", "piece.csv"]
    done = bench("compensate", "model.json", "job.csv", *words)
    assert done.code == 3 and "(--on-limit clip writes it)" in done.err
    alone = bench("compensate", "model.json", "job.csv", "--rows", "61:100", *clip)
    assert (
        alone.code == 1 and "check unit, column and zero of the trajectory" in alone.err
    )


# --- before time 0 ---


def flat_model() -> dict[str, Any]:
    """Return a wide loop whose curve is flat near its lower end."""
    heights = [1e-9] * 4 + np.linspace(0.05, 0.8, 21).tolist()
    span = {"min": 0.0, "max": sum(heights)}
    return SMALL_MODEL | {
        "input": {"quantity": "voltage", "unit": "V", "min": 0.0, "max": 1000.0},
        "output": {"quantity": "displacement", "unit": "um", **span},
        "stages": [
            {"type": "backlash", "x0": 0.0, "y0": 0.0, "dx": [40.0] * 25, "dy": heights}
        ],
    }


@pytest.mark.parametrize(("words", "rows"), [((), 51), (("--condition",), 1051)])
def test_the_way_out_of_a_flat_curve_takes_what_the_slew_needs(
    bench: Any, words: Any, rows: int
) -> None:
    """In displacement it took 22,926 and 390,258 rows: 46 and 781 s before a move of 13 s."""
    Path("flat.json").write_text(json.dumps(flat_model()))
    top = float(flat_model()["output"]["max"])
    write(
        "move.csv",
        top * (0.5 + 0.3 * np.sin(2.0 * np.pi * 0.2 * np.arange(6500) / 500.0)),
        500.0,
    )
    limits = ["--from", "0", "--approach", "auto", "--max-slew", "20kV/s", *words]
    done = bench(
        "compensate",
        "flat.json",
        "move.csv",
        *limits,
        "-o",
        "drive.csv",
        "--summary",
        "s.json",
    )
    assert done.code == 0, done.err
    before = json.loads(Path("s.json").read_text())["before"]
    table = np.loadtxt("drive.csv", delimiter=",", skiprows=1)
    assert before["rows"] == rows == np.count_nonzero(table[:, 0] < -1e-9)
    assert before["seconds"] == pytest.approx(rows / 500.0)
    assert before["range"] == [table[:rows, 2].min(), table[:rows, 2].max()]
    reach = f"from 0 to {before['range'][1]:.6g} V"
    said = f"before the first row stand {rows:,} rows, {rows / 500.0:.4g} s, {reach}"
    assert f"dbo: move.csv: {said}\n" in done.err
    limits = ["--v-min", "0V", "--v-max", "1kV", "--max-slew", "20.001kV/s"]
    assert bench("check", "drive.csv", *limits).code == 0


def test_what_the_program_chooses_is_not_minutes_long(bench: Any) -> None:
    write("slow.csv", 5.0 + np.sin(2.0 * np.pi * TIME / TIME[-1]))
    words = ["--condition", "--max-slew", "0.5", "--on-limit", "clip"]
    done = bench("compensate", "model.json", "slow.csv", *words, "-o", "drive.csv")
    assert done.code == 3 and not Path("drive.csv").exists()
    start = "dbo: error: slow.csv: before the move, of 0.4 s, would stand "
    assert (
        done.err.startswith(start)
        and "s that nobody asked for, the sweep the longest, " in done.err
    )
    assert done.err.endswith(
        "at most a minute, or ten times the move, is chosen (a larger --max-slew, or --state instead of "
        "--condition)\n"
    )
    words = [
        "--from",
        "0",
        "--approach",
        "auto",
        "--max-slew",
        "0.1",
        "--on-limit",
        "clip",
    ]
    done = bench("compensate", "model.json", "slow.csv", *words, "-o", "drive.csv")
    assert done.code == 3 and done.err.endswith(
        "ten times the move, is chosen (--approach SECONDS)\n"
    )
    words[3] = "200"
    done = bench("compensate", "model.json", "slow.csv", *words, "-o", "drive.csv")
    assert done.code == 0 and "before the first row stand 200," in done.err


def test_beside_a_long_move_a_long_sweep_is_in_order(bench: Any) -> None:
    # 10 s
    write("long.csv", 5.0 + np.sin(2.0 * np.pi * np.arange(400) / 400.0), rate=40.0)
    words = [
        "--condition",
        "--max-slew",
        "0.5",
        "--on-limit",
        "clip",
        "-o",
        "drive.csv",
    ]
    assert bench("compensate", "model.json", "long.csv", *words).code == 0


# --- limits in sets, live and in moves ---


@pytest.mark.whole
def test_a_plain_limit_of_channels_in_different_units_is_refused(bench: Any) -> None:
    kilo = SMALL_MODEL | {
        "input": {"quantity": "voltage", "unit": "kV", "min": 0.0, "max": 0.01},
        "stages": [
            SMALL_MODEL["stages"][0] | {"dx": [0.001, 0.002, 0.003, 0.004]},
            SMALL_MODEL["stages"][1],
        ],
    }
    models = {"a": SMALL_MODEL, "b": kilo}
    Path("set.json").write_text(
        json.dumps({"format": "dbo-model-set", "version": 1, "models": models})
    )
    rows = [f"{k / 100},{v},{v}" for k, v in enumerate((3.0, 4.0, 5.0, 4.0))]
    Path("both.csv").write_text("\n".join(["time_s,R_a (um),R_b (um)", *rows]) + "\n")
    words = [
        "compensate",
        "set.json",
        "both.csv",
        "--displacement",
        "R_{}",
        "-o",
        "drive.csv",
    ]
    done = bench(*words, "--v-max", "15")
    assert (done.code, done.err) == (
        2,
        "dbo: error: --v-max 15: channel a is driven in V and channel b in kV: give the limit's unit\n",
    )
    assert not Path("drive.csv").exists()
    done = bench(*words, "--v-max", "15V")
    assert done.code == 0, done.err
    drives = np.loadtxt("drive.csv", delimiter=",", skiprows=1)
    assert drives[:, 2].max() <= 10.0 and drives[:, 4].max() <= 0.01


@pytest.mark.whole
def test_a_limit_never_widens_a_channel(bench: Any) -> None:
    small = SMALL_MODEL | {"input": SMALL_MODEL["input"] | {"max": 8.0}}
    models = {"a": SMALL_MODEL, "b": small}
    Path("set.json").write_text(
        json.dumps({"format": "dbo-model-set", "version": 1, "models": models})
    )
    rows = [f"{k / 100},{v},{v}" for k, v in enumerate((3.0, 9.0, 5.0, 4.0))]
    Path("both.csv").write_text("\n".join(["time_s,R_a (um),R_b (um)", *rows]) + "\n")
    words = [
        "compensate",
        "set.json",
        "both.csv",
        "--displacement",
        "R_{}",
        "--on-limit",
        "clip",
    ]
    done = bench(*words, "--v-max", "50", "-o", "drive.csv")
    assert done.code == 0, done.err
    drives = np.loadtxt("drive.csv", delimiter=",", skiprows=1)
    assert (drives[:, 2].max(), drives[:, 4].max()) == (10.0, 8.0)


@pytest.mark.whole
def test_a_controller_stays_in_the_range_unless_asked_to_extrapolate() -> None:
    model = Model(read_model_of(SMALL_MODEL))
    narrow = model.controller(v_max=50.0, state="empty")
    assert [narrow.step(x) for x in (5.0, 11.0)][1] == 10.0
    wide = model.controller(v_max=50.0, extrapolate=True, state="empty")
    assert 10.0 < [wide.step(x) for x in (5.0, 11.0)][1] < 50.0


@pytest.mark.whole
def test_a_move_is_held_to_what_the_limits_leave(bench: Any) -> None:
    words = [
        "trajectory",
        "sine",
        "--rate",
        "100",
        "--range",
        "2:8",
        "--frequency",
        "1",
        "-o",
        "move.csv",
    ]
    assert bench(*words, "--model", "model.json").code == 0
    done = bench(*words, "--model", "model.json", "--v-max", "5")
    assert done.code == 2 and "model.json reaches 1 to 4.2 (another --range" in done.err
    done = bench(*words, "--unit", "um", "--v-max", "5")
    assert done.code == 2 and "are limits of a drive: give its --model\n" in done.err


def test_an_amplifier_outside_the_limits_is_said_before_and_after_the_move(
    bench: Any,
) -> None:
    words = (
        "--v-min",
        "1",
        "--from",
        "0",
        "--approach",
        "0.1",
        "--return",
        "0.1",
        "--on-limit",
        "clip",
    )
    done = bench("compensate", "model.json", "small.csv", *words, "-o", "d.csv")
    assert done.code == 0
    voltage = [
        float(line.split(",")[2]) for line in Path("d.csv").read_text().splitlines()[1:]
    ]
    outside = next(k for k, value in enumerate(voltage) if value >= 1.0)
    assert outside > 1 and min(voltage[outside:]) == 1.0 == voltage[-1]
    assert (
        "dbo: warning: small.csv: the drive comes from 0 V, outside its limits, 1 to 10 V: the first "
        f"{outside} rows on the way inwards outside them, too\n"
    ) in done.err
    assert (
        "dbo: warning: small.csv: the drive returns to 1 V alone: 0 V, where the drive came from, is outside "
        "its limits, 1 to 10 V\n"
    ) in done.err
    assert (
        bench("check", "d.csv", "--v-min", "1", "--v-max", "10", "--from", "0").code
        == 0
    )
    assert bench("check", "d.csv", "--v-min", "1", "--v-max", "10").code == 3
    inside = bench(
        "compensate", "model.json", "small.csv", *words[2:], "-o", "inside.csv"
    )
    assert "outside its limits" not in inside.err
