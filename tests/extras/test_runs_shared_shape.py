# ruff: noqa: E501  (a message of one line stands on one line here)
"""One loop shape for all channels: better where they are noisy, refused where there is none."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import SMALL_MODEL

from dbo_cli.extras.channels.model_set import read_set
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.hysteresis.model_file import Node, model_of

CHANNELS = [str(k) for k in range(1, 9)]
GEARS = 64
QUICK = (
    "--gears",
    GEARS,
    "--points",
    0,
    "--relaxation",
    0,
    "--delay",
    0,
    "--dynamics",
    0,
)
WORDS = ("--voltage", "V{}", "--displacement", "D{}")


def actuator(gain: float, bend: float = 1.0) -> ActuatorModel:
    """Return the small model with a gain, its gears growing by ``bend``."""
    model = json.loads(json.dumps(SMALL_MODEL))
    heights = 0.6 + 0.8 * bend * np.arange(GEARS) / GEARS
    model["stages"][0]["dx"] = [10.0 / GEARS] * GEARS
    model["stages"][0]["dy"] = (5.0 * heights / heights.sum()).tolist()
    model["stages"][1]["gain"] = gain
    model["output"]["max"] = 1.0 + 5.0 * gain
    return model_of(Node("", "", model))


def drive() -> np.ndarray:
    """Return triangles of four amplitudes, each twice."""
    parts = []
    for top in (10.0, 10.0, 7.0, 7.0, 4.0, 4.0, 9.0, 9.0):
        up = np.linspace(0.0, top, 25)
        parts += [up, up[::-1]]
    return np.concatenate(parts)


def write_log(
    models: dict[str, ActuatorModel],
    noise: float,
    seed: int = 1,
    drives: dict[str, np.ndarray] | None = None,
) -> None:
    """Write a log of all channels, driven alike where nothing else is said."""
    rng = np.random.default_rng(seed)
    columns: dict[str, Any] = {"time_s": np.arange(drive().size) * 0.01}
    for channel, model in models.items():
        volts = drive() if drives is None else drives[channel]
        moved = model.simulate(volts, model.start(0.0, "empty")).y
        columns |= {
            f"V{channel}_V": volts,
            f"D{channel}_um": moved + noise * rng.normal(size=volts.size),
        }
    lines = [
        ",".join(columns),
        *(
            ",".join(map(repr, row))
            for row in zip(*(c.tolist() for c in columns.values()), strict=True)
        ),
    ]
    Path("log.csv").write_text("\n".join(lines) + "\n")


def error_of(made: ActuatorModel, true: ActuatorModel) -> float:
    """Return the RMS difference of two models on a move that no log holds, offset aside, in % of the range."""
    volts = 5.0 + 4.0 * np.sin(0.07 * np.arange(600)) * np.linspace(1.0, 0.2, 600)
    left = (
        made.simulate(volts, made.start(5.0, "settled")).y
        - true.simulate(volts, true.start(5.0, "settled")).y
    )
    return float(100.0 * np.std(left[100:]) / true.output.span)


def test_noisy_channels_are_followed_better_with_one_shape(dbo: Any) -> None:
    true = {c: actuator(1.0 + 0.1 * k) for k, c in enumerate(CHANNELS)}
    write_log(true, noise=0.25)
    said = dbo(
        "identify", "log.csv", *QUICK, *WORDS, "--shared-shape", "-o", "one.json"
    )
    assert said.code == 0, said.err
    assert (
        "dbo: one shape, the mean of 6 channels: on 3, 7, left out of it, it leaves "
        in said.err
    )
    assert dbo("identify", "log.csv", *QUICK, *WORDS, "-q", "-o", "own.json").code == 0
    shared, own = (
        np.median([error_of(read_set(name)[c], true[c]) for c in CHANNELS])
        for name in ("one.json", "own.json")
    )
    assert shared < 0.8 * own
    again = dbo(
        "identify",
        "log.csv",
        *QUICK,
        *WORDS,
        "--shared-shape",
        "-j",
        2,
        "-q",
        "-o",
        "two.json",
    )
    assert again.code == 0
    assert Path("one.json").read_bytes() == Path("two.json").read_bytes()


def test_gains_come_back(dbo: Any) -> None:
    true = {c: actuator(1.0 + 0.1 * k) for k, c in enumerate(CHANNELS)}
    write_log(true, noise=0.02)
    assert (
        dbo(
            "identify",
            "log.csv",
            *QUICK,
            *WORDS,
            "--shared-shape",
            "-q",
            "-o",
            "one.json",
        ).code
        == 0
    )
    spans = np.array([model.output.span for model in read_set("one.json").values()])
    assert spans / spans[0] == pytest.approx(1.0 + 0.1 * np.arange(8), rel=2e-3)


def test_channels_without_a_common_shape_are_refused(dbo: Any) -> None:
    write_log(
        {c: actuator(1.0, 0.1 + 0.5 * k) for k, c in enumerate(CHANNELS)}, noise=0.01
    )
    words = ("identify", "log.csv", *QUICK, *WORDS, "--shared-shape", "-o", "one.json")
    said = dbo(*words)
    assert said.code == 1
    assert said.err.startswith(
        "dbo: error: the channels have no common shape: on channels left out of it (3, 7) one shape for all leaves "
    )
    assert not Path("one.json").exists()


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        ((*WORDS, "--prior", "m.json"), 2, "--shared-shape and --prior exclude each other: each is where the shape comes from"),
        (("--voltage", "V1", "--displacement", "D1"), 2, "--shared-shape is for channels: name their columns by patterns, 'V{}' and 'D{}'"),
    ],
)  # fmt: skip
def test_what_is_refused(
    dbo: Any, words: tuple[str, ...], code: int, message: str
) -> None:
    write_log({c: actuator(1.0) for c in CHANNELS[:2]}, 0.01)
    said = dbo("identify", "log.csv", "--shared-shape", *words)
    assert (said.code, said.err) == (code, f"dbo: error: {message}\n")


def test_few_channels_are_refused(dbo: Any) -> None:
    write_log({c: actuator(1.0) for c in CHANNELS[:2]}, 0.01)
    assert (
        dbo("identify", "log.csv", *WORDS, "--shared-shape").err
        == "dbo: error: --shared-shape needs 4 channels or more, and there are 2\n"
    )


def test_channels_that_are_driven_differently_are_fitted_together(dbo: Any) -> None:
    true = {c: actuator(1.0 + 0.1 * k) for k, c in enumerate(CHANNELS)}
    drives = {
        c: np.concatenate([drive()[:100], np.roll(drive()[100:], 50 * k)])
        for k, c in enumerate(CHANNELS)
    }
    write_log(true, 0.25, drives=drives)
    said = dbo(
        "identify", "log.csv", *QUICK, *WORDS, "--shared-shape", "-o", "one.json"
    )
    assert said.code == 0, said.err
    assert (
        "dbo: one shape, fitted to the logs of 6 channels: on 3, 7, left out of it, it leaves "
        in said.err
    )
    assert dbo("identify", "log.csv", *QUICK, *WORDS, "-q", "-o", "own.json").code == 0
    shared, own = (
        np.median([error_of(read_set(name)[c], true[c]) for c in CHANNELS])
        for name in ("one.json", "own.json")
    )
    assert shared < 0.8 * own
