"""Identification of dynamics: found where a sweep shows them, not elsewhere, slow logs untouched."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from trials import Floats

from dbo_cli.errors import FitError, UsageError
from dbo_cli.hysteresis.cascade import slow_output_range
from dbo_cli.hysteresis.dynamics import (
    Antiresonance,
    DynamicsStage,
    Lag,
    Resonance,
    Section,
)
from dbo_cli.hysteresis.excitation import Excitation, sweep
from dbo_cli.hysteresis.identification import (
    IdentificationOptions,
    Recording,
    dynamics,
    identify,
)
from dbo_cli.hysteresis.identification.evaluation import outward
from dbo_cli.hysteresis.identification.recordings import split
from dbo_cli.hysteresis.model import (
    ActuatorModel,
    BacklashStage,
    Quantity,
    ScaleStage,
    Stage,
)
from dbo_cli.hysteresis.model_file import model_to_bytes

RATE = 2_000.0
FEW = IdentificationOptions(gears=24, points=0, relaxation=(), delay=0.0)


def plant(*sections: Section) -> ActuatorModel:
    """Return an actuator of 80 gears with dynamics."""
    slopes = np.linspace(0.6, 1.4, 80)
    widths = np.full(80, 100.0 / 80.0)
    stages: list[Stage] = [
        BacklashStage(widths, 0.1 * widths * slopes),
        ScaleStage(1.0, 0.5),
    ]
    low, high = slow_output_range(stages, 0.0, 100.0)
    if sections:
        stages.append(DynamicsStage(sections))
    return ActuatorModel(
        "forward",
        Quantity("voltage", "V", 0.0, 100.0),
        Quantity("x", "um", low, high),
        tuple(stages),
    )


def recorded(
    model: ActuatorModel,
    drive: Floats,
    seed: int = 1,
    noise: float = 0.002,
    rate: float = RATE,
) -> Recording:
    x = model.simulate(
        drive, model.start(float(drive[0]), "empty"), time_step=1.0 / rate
    ).y
    noisy = x + np.random.default_rng(seed).normal(0.0, noise, x.size)
    return Recording("log.csv", drive, noisy, sample_period=1.0 / rate)


def swept(seconds: float = 6.0) -> Floats:
    return Excitation(0.0, 100.0, RATE, seconds, 1.0, sweep_to=200.0).drive()[1]


@pytest.mark.parametrize(
    ("frequency", "damping", "lag"),
    [(60.0, 0.02, 5e-4), (110.0, 0.005, 2e-3), (35.0, 0.3, 1e-4)],
)
def test_a_resonance_is_found(frequency: float, damping: float, lag: float) -> None:
    log = recorded(plant(Lag(lag), Resonance(frequency, damping)), swept())
    found = identify([log], FEW)
    (resonance,) = found.model.dynamics.resonances if found.model.dynamics else ()
    assert resonance.frequency == pytest.approx(frequency, rel=0.005)
    assert resonance.damping == pytest.approx(damping, rel=0.2)
    told = found.fit["dynamics"]
    assert isinstance(told, dict)
    low, high = told["resonances"][0]["frequency_interval"]
    assert low < resonance.frequency < high
    assert any(line.startswith("dynamics: resonance at") for line in found.summary)
    assert any(line.startswith("trust the model to") for line in found.summary)
    # of the slow rows alone
    assert not any(line.startswith("lag ") for line in found.summary)
    assert found.fit["lag_seconds"] == pytest.approx(
        lag + damping / (np.pi * frequency), rel=0.2, abs=2e-4
    )


def test_dynamics_do_not_depend_on_the_unit_of_displacement() -> None:
    log = recorded(plant(Resonance(60.0, 0.03)), swept())
    metres = replace(log, displacement=1e-6 * log.displacement)
    ours, same = (
        identify([one], replace(FEW, dynamics=1)).model.dynamics
        for one in (log, metres)
    )
    assert ours is not None and same is not None
    (one,), (other,) = ours.resonances, same.resonances
    assert (other.frequency, other.damping) == pytest.approx(
        (one.frequency, one.damping), rel=1e-6
    )


def test_lost_samples_hide_no_sweep() -> None:
    log = recorded(plant(Resonance(60.0, 0.03)), swept())
    (whole,) = split([log])[1]
    begin = whole.rows.start
    kept = np.delete(
        np.arange(log.voltage.size), [500, 501, 502, *range(begin - 300, begin + 40)]
    )
    time = kept / RATE
    lost = replace(
        log, voltage=log.voltage[kept], displacement=log.displacement[kept], time=time
    )
    ((found,),) = split([lost])[1:]
    assert found.time_step == pytest.approx(1.0 / RATE)
    rows = kept[found.rows]
    assert (
        rows[0] == begin + 40
        and rows[-1] >= whole.rows.stop - 1
        and (np.diff(rows) == 1).all()
    )
    dynamics = identify([lost], FEW).model.dynamics
    assert dynamics is not None
    assert dynamics.resonances[0].frequency == pytest.approx(60.0, rel=0.005)


def test_two_resonances_are_found() -> None:
    log = recorded(plant(Resonance(50.0, 0.02), Resonance(130.0, 0.02)), swept())
    found = identify([log], FEW)
    assert found.model.dynamics is not None
    first, second = found.model.dynamics.resonances
    assert (first.frequency, second.frequency) == pytest.approx(
        (50.0, 130.0), rel=0.005
    )


def test_a_weak_second_mode_is_found_below_the_noise() -> None:
    """5 % of the displacement, behind an amplifier that passes a seventh of it, in as much noise."""
    first, second, share = Resonance(64.0, 0.03), Resonance(185.0, 0.02), 0.05
    square = (1.0 - share) / second.frequency**2 + share / first.frequency**2
    linear = 2.0 * (1.0 - share) * second.damping / second.frequency
    linear += 2.0 * share * first.damping / first.frequency
    beside = Antiresonance(square**-0.5, 0.5 * linear * square**-0.5)
    known = plant(first, Resonance(second.frequency, second.damping, beside))
    widths = np.full(2000, 0.05)
    gears = BacklashStage(widths, 0.1 * widths * np.linspace(0.6, 1.4, 2000))
    model = replace(
        known, stages=(DynamicsStage((Lag(6e-3),)), gears, *known.stages[1:])
    )
    found = identify([recorded(model, swept())])
    assert found.model.dynamics is not None
    one, two = found.model.dynamics.resonances
    assert one.frequency == pytest.approx(
        64.0, rel=0.001
    ) and one.damping == pytest.approx(0.03, rel=0.02)
    assert (
        two.frequency == pytest.approx(185.0, rel=0.05)
        and two.antiresonance is not None
    )


def test_a_slow_and_a_fast_log_together_show_a_resonance() -> None:
    model = plant(Resonance(60.0, 0.03))
    slow = recorded(model, Excitation(0.0, 100.0, RATE, 6.0, 1.0).drive()[1])
    fast = recorded(model, sweep(0.0, 100.0, RATE, 200.0), seed=2)
    found = identify([slow, fast], FEW)
    assert found.model.dynamics is not None
    assert found.model.dynamics.resonances[0].frequency == pytest.approx(
        60.0, rel=0.005
    )


def test_a_sweep_stays_a_sweep_beside_a_log_of_loops() -> None:
    model = plant(Lag(1e-3), Resonance(60.0, 0.03))
    alone = recorded(model, swept())
    loops = recorded(
        model, Excitation(0.0, 100.0, RATE, 8.0, 1.0, seed=3).drive()[1], seed=2
    )
    (part,), (same,) = split([alone])[1], split([alone, loops])[1]
    assert (part.rows, part.lowest, part.highest) == (
        same.rows,
        same.lowest,
        same.highest,
    )


def test_a_resonance_below_the_sweep_is_not_found_at_its_edge() -> None:
    log = recorded(plant(Lag(1e-3), Resonance(6.0, 0.1)), swept())
    assert identify([log], FEW).model.dynamics is None


def test_without_a_resonance_none_is_found_and_nothing_changes() -> None:
    log = recorded(plant(), swept())
    auto, none = (identify([log], options) for options in (FEW, IdentificationOptions(
        gears=24, points=0, relaxation=(), delay=0.0, dynamics=0)))  # fmt: skip
    assert auto.model.dynamics is None
    assert model_to_bytes(auto.model) == model_to_bytes(none.model)


def test_a_slow_log_has_no_fast_part() -> None:
    for seed in range(12):
        drive = Excitation(0.0, 100.0, RATE, 8.0, 1.0, seed=seed).drive()[1]
        assert (
            split([Recording("slow", drive, drive, sample_period=1.0 / RATE)])[1] == []
        )


def test_dynamics_asked_for_without_a_sweep_are_refused() -> None:
    log = recorded(
        plant(Resonance(60.0, 0.03)), Excitation(0.0, 100.0, RATE, 6.0, 1.0).drive()[1]
    )
    with pytest.raises(
        FitError, match=r"`dynamics` 1: no log has a small sweep, nor is one ten times"
    ):
        identify([log], IdentificationOptions(dynamics=1))
    with pytest.raises(
        UsageError, match=r"`dynamics` 3: at most two resonances are looked for"
    ):
        IdentificationOptions(dynamics=3)


def test_the_sweep_is_small_ends_at_rest_and_is_refused_where_it_cannot_be() -> None:
    drive = Excitation(
        0.0, 100.0, RATE, 6.0, 1.0, sweep_to=200.0, sweep_amplitude=2.0
    ).drive()[1]
    plain = Excitation(0.0, 100.0, RATE, 6.0, 1.0).drive()[1]
    assert np.array_equal(drive[: plain.size], plain)
    middle = drive[plain.size :]
    assert middle.max() == pytest.approx(51.86, abs=0.05) and drive[-1] == 0.0
    for more, text in (
        (
            {"sweep_to": 300.0},
            r"`sweep_to` 300: 2000 rows a second do not resolve it \(`sample_rate` 3000",
        ),
        (
            {"sweep_to": 200.0, "sweep_amplitude": 60.0},
            "`sweep_amplitude` 60V: give one above 0, at most 50V",
        ),
        ({"sweep_amplitude": 1.0}, "`sweep_amplitude` is that of a sweep"),
        ({"sweep_to": 4.0}, "or `frequency` 0.4 and `duration` 15"),
        (
            {"sweep_to": 200.0, "max_slew": 320.0},
            "`sweep_amplitude` 1: at 200 Hz it needs 314",
        ),
    ):
        if "max_slew" in more:
            more["max_slew"] = 315.0
            more["sweep_amplitude"] = 2.0
            text = r"`sweep_amplitude` 2V: at 200 Hz it needs 628.319 V/s, `max_slew` allows 315"
        with pytest.raises(UsageError, match=text):
            Excitation(0.0, 100.0, RATE, 6.0, 1.0, **more).drive()


def test_a_slow_resonance_is_found() -> None:
    model = plant(Lag(2e-3), Resonance(12.0, 0.03))
    drive = Excitation(0.0, 100.0, 0.25 * RATE, 12.0, 0.5, sweep_to=20.0).drive()[1]
    found = identify([recorded(model, drive, rate=0.25 * RATE)], FEW)
    assert found.model.dynamics is not None
    (resonance,) = found.model.dynamics.resonances
    assert resonance.frequency == pytest.approx(12.0, rel=0.01)


def test_an_antiresonance_is_a_section_of_the_model_file() -> None:
    notched = Resonance(60.0, 0.02, Antiresonance(80.0, 0.02))
    assert b'"antiresonance": {"frequency": 80.0, "damping": 0.02}' in model_to_bytes(
        plant(notched)
    )


def test_a_lag_before_the_gears_is_put_there_and_an_antiresonance_found() -> None:
    behind = plant(
        Resonance(50.0, 0.02), Resonance(120.0, 0.02, Antiresonance(95.0, 0.02))
    )
    model = ActuatorModel(
        "forward",
        behind.input,
        behind.output,
        (DynamicsStage((Lag(1e-3),)), *behind.stages),
    )
    found = identify([recorded(model, swept())], FEW)
    assert found.model.drive_lag is not None and found.model.dynamics is not None
    (lag,) = found.model.drive_lag.sections
    assert isinstance(lag, Lag) and lag.seconds == pytest.approx(1e-3, rel=0.05)
    first, second = found.model.dynamics.resonances
    assert (first.frequency, second.frequency) == pytest.approx(
        (50.0, 120.0), rel=0.005
    )
    assert second.antiresonance is not None
    assert second.antiresonance.frequency == pytest.approx(95.0, rel=0.01)
    assert any("ms before the gears" in line for line in found.summary)


def test_creep_is_a_product_of_sections() -> None:
    taus, shares = np.array([0.5, 8.0, 2.0]), np.array([0.006, 0.010, 0.0])
    sections = dynamics._sections(taus, shares)
    assert [section.seconds for section in sections] == [0.5, 8.0]
    frequency = np.geomspace(1e-3, 10.0, 30)
    expected = (
        1.0
        - shares.sum()
        + sum(
            c / (1.0 + 2j * np.pi * frequency * t)
            for c, t in zip(shares, taus, strict=True)
        )
    )
    assert np.allclose(
        DynamicsStage(sections).response(frequency), expected, rtol=1e-12
    )
    assert dynamics._sections(taus, np.zeros(3)) == ()


def test_creep_of_the_displacement_is_found_behind_the_gears() -> None:
    model = plant(Lag(0.5, 0.475), Resonance(60.0, 0.03))
    options = IdentificationOptions(gears=80, points=0, delay=0.0)
    found = identify([recorded(model, swept(8.0))], options)
    assert found.model.backlash.relaxation is None and found.model.dynamics is not None
    crept = [
        one
        for one in found.model.dynamics.sections
        if isinstance(one, Lag) and one.lead
    ]
    late = 1.0 - np.prod([one.lead / one.seconds for one in crept])
    assert late == pytest.approx(0.05, rel=0.2)
    assert any(
        line.startswith("creep of the displacement, behind the gears")
        for line in found.summary
    )


def late(log: Recording, samples: int) -> Recording:
    """Return a log whose sensor is late by whole samples."""
    x = np.concatenate(
        (np.full(samples, log.displacement[0]), log.displacement[:-samples])
    )
    return replace(log, displacement=x)


def test_a_sensor_s_delay_does_not_hide_a_resonance() -> None:
    """8 ms turn the phase of 60 Hz around by half a period."""
    log = late(recorded(plant(Lag(5e-4), Resonance(60.0, 0.02)), swept()), 16)
    found = identify([log], FEW)
    assert found.model.dynamics is not None
    (resonance,) = found.model.dynamics.resonances
    assert resonance.frequency == pytest.approx(60.0, rel=0.002)
    assert resonance.damping == pytest.approx(0.02, rel=0.05)
    assert found.model.delay_seconds == pytest.approx(8e-3, rel=0.02)
    assert found.fit["delay_seconds"] == found.model.delay_seconds


def test_a_resonance_too_many_that_was_asked_for_is_doubted() -> None:
    found = identify(
        [recorded(plant(Resonance(60.0, 0.02)), swept())], replace(FEW, dynamics=2)
    )
    assert (
        found.model.dynamics is not None and len(found.model.dynamics.resonances) == 2
    )
    (doubt,) = found.warnings
    assert doubt.startswith(
        "`dynamics` 2: the logs speak against 2 resonances: the last one lowers the "
    )


def test_a_sweep_that_nothing_explains_is_said() -> None:
    log = recorded(plant(), swept())
    part = split([log])[1][0]
    shaken = np.zeros(log.voltage.size)
    random = np.random.default_rng(4).normal(size=part.rows.stop - part.rows.start + 19)
    shaken[part.rows] = 0.5 * np.convolve(random, np.ones(20) / 20.0, "valid")
    found = identify([replace(log, displacement=log.displacement + shaken)], FEW)
    assert found.model.dynamics is None
    (warning,) = [
        line
        for line in found.warnings
        if "is not explained: no resonance fits them" in line
    ]
    assert warning.startswith(
        f"log.csv: rows {part.rows.start + 1} to {part.rows.stop} move at "
    )


def test_a_log_that_is_one_sweep_from_end_to_end_is_read_whole() -> None:
    log = recorded(
        plant(Lag(5e-4), Resonance(100.0, 0.02)), sweep(0.0, 100.0, RATE, 200.0)
    )
    rows = split([log])[1][0].rows
    swept_only = replace(
        log, voltage=log.voltage[rows], displacement=log.displacement[rows]
    )
    (whole,), parts = split([swept_only])
    assert whole is swept_only and parts == []


@pytest.mark.parametrize(
    ("interval", "digits", "text"),
    [
        ([99.99949, 100.00051], 5, "99.999 to 100.01"),
        ([0.02996, 0.03004], 3, "0.0299 to 0.0301"),
        ([0.03, 0.031], 3, "0.03 to 0.031"),
        ([1234567.0, 1234568.0], 5, "1.2345e+06 to 1.2346e+06"),
        ([0.0, 0.0], 3, "0 to 0"),
    ],
)
def test_an_interval_is_printed_no_narrower_than_it_is(
    interval: list[float], digits: int, text: str
) -> None:
    assert outward(interval, digits) == text
    low, high = (float(part) for part in text.split(" to "))
    assert low <= interval[0] and interval[1] <= high
