# ruff: noqa: E501  (a message of one line stands on one line here)
"""identify with a prior: gain, offset and lag from a short log, the shape of the loop kept or refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dbo_cli
from dbo_cli.errors import FitError, UsageError
from dbo_cli.hysteresis.identification import IdentificationOptions, Recording, identify
from dbo_cli.hysteresis.identification.evaluation import predict
from dbo_cli.hysteresis.model import (
    ActuatorModel,
    BacklashStage,
    DelayStage,
    PointStage,
    Quantity,
    ScaleStage,
)
from dbo_cli.hysteresis.model_file import model_to_bytes

RATE = 200.0


def known(delay: float = 0.01, wide: float = 1.0) -> ActuatorModel:
    """Return a model of 0 to 100 V and 0 to 20 um whose loop is ``wide`` times that of the prior."""
    slopes = 1.0 + wide * np.linspace(-0.35, 0.35, 200)
    stages: tuple[Any, ...] = (
        BacklashStage(np.full(200, 0.5), 0.5 * slopes / slopes.sum() * 2.0),
        PointStage([0.5, 0.5], [0.45, 0.55]),
        ScaleStage(20.0, 0.0),
    )
    return ActuatorModel(
        "forward",
        Quantity("voltage", "V", 0.0, 100.0),
        Quantity("displacement", "um", 0.0, 20.0),
        (*stages, DelayStage(delay)) if delay else stages,
        {"rmse": 0.01, "expected_rmse": 0.02, "gears": 200, "validation_rmse": 0.5},
    )


def short_log(
    model: ActuatorModel,
    gain: float = 1.0,
    offset: float = 0.0,
    noise: float = 0.01,
    top: float = 100.0,
) -> Recording:
    """Return ten seconds of five swings, seen by a sensor."""
    clock = np.arange(2000) / RATE
    drive = top * (0.5 - 0.5 * np.cos(np.pi * clock)) * np.where(clock < 4.0, 1.0, 0.6)
    made = Recording("short.csv", drive, np.zeros(2000), None, 1.0 / RATE, "V", "um")
    seen = (
        gain * predict(model, made)
        + offset
        + noise * np.random.default_rng(4).normal(size=2000)
    )
    return Recording("short.csv", drive, seen, None, 1.0 / RATE, "V", "um")


def test_gain_offset_and_lag_come_back_with_their_intervals() -> None:
    done = identify([short_log(known(0.014), 0.93, 1.5)], prior=known(0.01))
    moved: Any = done.fit["prior"]
    assert moved["gain"] == pytest.approx(0.93, abs=2e-4)
    assert moved["offset"] == pytest.approx(1.5, abs=3e-3)
    assert moved["delay_seconds"] == pytest.approx(0.004, abs=1e-4)
    for found, truth in (("gain", 0.93), ("delay", 0.004)):
        low, high = moved[
            f"{found}_interval" if found == "gain" else "delay_interval_seconds"
        ]
        assert low < truth < high
    assert list(done.model.backlash.dy) == list(known().backlash.dy)
    assert done.model.delay_seconds == pytest.approx(0.014, abs=1e-4)
    assert done.model.output.maximum == pytest.approx(0.93 * 20.0 + 1.5, abs=5e-3)
    assert done.fit["rmse"] == pytest.approx(0.01, rel=0.05)
    assert done.fit["expected_rmse"] == pytest.approx(0.93 * 0.02, abs=1e-4)
    assert done.fit["gears"] == 200
    assert "validation_rmse" not in done.fit
    assert done.warnings == []
    assert done.summary == [
        "the prior's shape was kept; moved: gain 0.9301 times the prior's (within 0.0018), offset +1.5 um, lag +4.007 ms (within 0.030)",
        "fit RMSE 0.0099 um (0.05 % of the model's range) on 1,809 rows from 0 to 100 V; the prior covers 0 to 100 V",
        "expected on new moves inside the range: 0.0186 um (0.10 % of the model's range), from the prior's expectation, or what is left on these logs where that is more",
    ]


def test_a_lag_that_did_not_change_is_left_alone() -> None:
    prior = known(0.01)
    done = identify([short_log(prior, 1.1)], prior=prior)
    assert done.model.stages[-1] == DelayStage(0.01)
    assert "lag as it was (within " in done.summary[0]


def test_an_unchanged_actuator_keeps_the_old_numbers() -> None:
    """A prior that errs by what it states: what a short log of one small loop would change is that error."""
    prior = known()
    near = short_log(known(wide=1.02), top=30.0)
    done = identify([near], prior=prior)
    moved: Any = done.fit["prior"]
    assert (moved["gain"], moved["offset"], moved["delay_seconds"]) == (1.0, 0.0, 0.0)
    assert done.model.stages == prior.stages
    other: Any = identify([short_log(known(), gain=0.99)], prior=prior).fit["prior"]
    assert other["gain"] == pytest.approx(0.99, abs=5e-4)


def test_a_changed_shape_is_refused_and_kept_by_force() -> None:
    log = short_log(known(wide=1.4))
    with pytest.raises(FitError, match=r"^short\.csv: the shape has changed: with gain, offset and lag found again the prior "
                       r"leaves 0\.\d+ um beside noise, where its own fit left 0\.01 um; identify again from a whole log, "
                       r"without `prior`, or begin with a sweep over the whole range: what was before the log may be to "
                       r"blame \(`force` keeps the shape\)$"):  # fmt: skip
        identify([log], prior=known())
    [warning] = identify(
        [log], IdentificationOptions(force=True), prior=known()
    ).warnings
    assert warning.startswith("short.csv: the shape has changed")


def test_noise_is_not_a_shape() -> None:
    done = identify([short_log(known(), noise=0.2)], prior=known())
    assert done.fit["expected_rmse"] == done.fit["rmse"] == pytest.approx(0.2, rel=0.05)
    assert done.warnings == []


def test_an_unknown_past_that_shifts_the_offset_is_said() -> None:
    prior = known()
    swings = short_log(prior)
    drive = 30.0 + 0.4 * swings.voltage
    inside = Recording("inside", drive, np.zeros(2000), None, 1.0 / RATE, "V", "um")
    log = Recording(
        "inside", drive, predict(prior, inside), None, 1.0 / RATE, "V", "um"
    )
    [warning] = identify([log], prior=prior).warnings
    assert warning.startswith(
        "what was before the logs can shift the offset by 1.21 um: begin with"
    )


def test_less_lag_than_none_is_said() -> None:
    late = short_log(known(0.03))
    early = Recording(
        "early", late.voltage[8:], late.displacement[8:], None, 1.0 / RATE, "V", "um"
    )
    led = Recording(
        "early", late.voltage[:-8], late.displacement[8:], None, 1.0 / RATE, "V", "um"
    )
    assert identify([early], prior=known(0.0)).warnings == []
    [warning] = identify([led], prior=known(0.0)).warnings
    assert warning.startswith(
        "the displacement comes 9.99 ms earlier than the prior's without any delay"
    )


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("gears", 64),
        ("points", 0),
        ("delay", 0.0),
        ("zero", "mean"),
        ("method", "paper"),
        ("dynamics", 1),
    ],
)
def test_what_the_prior_fixes_cannot_be_asked_for(name: str, value: Any) -> None:
    with pytest.raises(UsageError) as refused:
        identify(
            [short_log(known())], IdentificationOptions(**{name: value}), prior=known()
        )
    assert (
        str(refused.value)
        == f"`{name}` does not go with `prior`, whose shape is kept: leave one of them out"
    )


def test_a_lag_needs_a_clock_and_an_inverse_is_no_prior() -> None:
    log = short_log(known())
    bare = Recording("bare", log.voltage, log.displacement)
    with pytest.raises(UsageError, match="`prior` has a lag, which needs a clock"):
        identify([bare], prior=known())
    assert (
        "no clock, so the lag is the prior's"
        in identify(
            [bare], prior=known(0.0), options=IdentificationOptions(force=True)
        ).summary[0]
    )
    with pytest.raises(
        Exception, match="the prior: is an inverse model where a forward one is needed"
    ):
        identify([log], prior=known().inverse())
    against = Recording(
        "against", log.voltage, -log.displacement, None, 1.0 / RATE, "V", "um"
    )
    with pytest.raises(
        FitError, match=r"the displacement runs against the prior's \(gain -1\)"
    ):
        identify([against], prior=known())


def test_shell_and_python_refresh_alike_in_the_priors_units(dbo: Any) -> None:
    Path("prior.json").write_bytes(model_to_bytes(known()))
    log = short_log(known(0.014), 0.93, 1.5)
    rows = zip(
        (np.arange(2000) / RATE).tolist(),
        log.voltage / 1e3,
        log.displacement * 1e3,
        strict=True,
    )
    Path("short.csv").write_text(
        "time_s,voltage_kV,displacement_nm\n"
        + "\n".join(f"{a!r},{float(b)!r},{float(c)!r}" for a, b, c in rows)
        + "\n"
    )
    done = dbo("identify", "short.csv", "--prior", "prior.json", "-o", "model.json")
    assert done.code == 0, done.err
    assert "the prior's shape was kept; moved: gain 0.9301 times" in done.err
    model = json.loads(Path("model.json").read_text())
    assert (model["input"]["unit"], model["output"]["unit"]) == ("V", "um")
    assert model["provenance"]["arguments"] == [
        "identify",
        "short.csv",
        "--prior",
        "prior.json",
    ]
    assert model["provenance"]["prior"] == {}
    again = dbo_cli.identify("short.csv", prior="prior.json")
    known_by_shell = json.loads(Path("model.json").read_text())["stages"]
    assert json.loads(model_to_bytes(again.actuator))["stages"] == known_by_shell
    assert dbo(
        "identify",
        "short.csv",
        "--prior",
        "prior.json",
        "--gears",
        "9",
        "-o",
        "no.json",
    ).err.endswith(
        "--gears does not go with --prior, whose shape is kept: leave one of them out\n"
    )
