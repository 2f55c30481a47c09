# ruff: noqa: E501  (a sentence stands on one line here)
"""The table of sentences: when each is printed, that what it claims is true there, and that it is silent else.

Each row of ``TABLE`` is a note, a warning or a line of a summary: how it begins, the
condition under which it is printed, a simulated case in which it must appear, and what
its figures must be there. ``test_silent`` holds that none of them appears in the log,
or the move, of an actuator that has nothing of the kind.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import re
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import pytest
from test_hysteresis_identification_dynamics import plant, recorded

import dbo_cli
from dbo_cli.errors import plain
from dbo_cli.hysteresis.dynamics import Lag, Resonance
from dbo_cli.hysteresis.excitation import Excitation
from dbo_cli.hysteresis.identification import IdentificationOptions, Recording, identify
from dbo_cli.hysteresis.identification.evaluation import predict
from dbo_cli.hysteresis.model import ActuatorModel, BacklashStage, Quantity, ScaleStage
from dbo_cli.hysteresis.move_error import move_error
from dbo_cli.logs.sample_block import SampleBlock
from dbo_cli.reports.report import ReportOptions, evaluate
from dbo_cli.runs.api import Model

RATE = 200.0
NOISE = 0.005  # um, of a range of 20
OPTIONS = IdentificationOptions(gears=64, points=0, relaxation=(), delay=0.0)
Floats = Any


# --- the actuator, and what a logger writes of it ---


def actuator(**fit: Any) -> ActuatorModel:
    """Return an actuator of 0 to 100 V and 20 um whose loops are a tenth of that wide."""
    slopes = np.linspace(0.7, 1.3, 64)
    stages = (
        BacklashStage(np.full(64, 100.0 / 64), slopes / slopes.sum()),
        ScaleStage(20.0, 0.0),
    )
    ends = (
        Quantity("voltage", "V", 0.0, 100.0),
        Quantity("displacement", "um", 0.0, 20.0),
    )
    return ActuatorModel("forward", *ends, stages, fit)


def swings(turns: Sequence[float], seconds: float = 0.5) -> Floats:
    """Return a drive of soft swings between turns, in volts."""
    rows = int(seconds * RATE)
    rise = 0.5 - 0.5 * np.cos(np.pi * np.arange(rows) / rows)
    parts = [begin + (end - begin) * rise for begin, end in itertools.pairwise(turns)]
    return np.concatenate([*parts, [turns[-1]]])


TURNS = (0, 100, 0, 80, 20, 90, 30, 60, 10, 70, 0, 100, 40, 75, 5, 55, 25, 95, 0)


def logged(
    drive: Floats, moved: Floats | None = None, seed: int = 1, **other: Any
) -> Recording:
    """Return a log of a drive; of the actuator's own displacement, where no other is given."""
    clock = np.arange(len(drive)) / RATE
    log = Recording("log.csv", drive, np.zeros(len(drive)), clock, None, "V", "um")
    if moved is None:
        moved = predict(actuator(), log)
    seen = moved + NOISE * np.random.default_rng(seed).normal(size=len(drive))
    return dataclasses.replace(log, displacement=seen, **other)


def clean() -> list[Recording]:
    """Return a log with nothing the matter."""
    return [logged(swings(TURNS))]


def changed(change: Callable[[Floats, Floats], None]) -> list[Recording]:
    """Return the clean log, its voltage and displacement changed in place."""
    log = clean()[0]
    voltage, displacement = log.voltage.copy(), log.displacement.copy()
    change(voltage, displacement)
    return [dataclasses.replace(log, voltage=voltage, displacement=displacement)]


CLOCK = np.arange(len(swings(TURNS))) / RATE


def hum() -> list[Recording]:
    def add(_: Floats, displacement: Floats) -> None:
        displacement += 0.2 * np.sin(2.0 * np.pi * 50.0 * CLOCK)

    return changed(add)


def glitch() -> list[Recording]:
    def add(voltage: Floats, _: Floats) -> None:
        voltage[[500, 900, 1300]] += 40.0

    return changed(add)


def spikes() -> list[Recording]:
    def add(_: Floats, displacement: Floats) -> None:
        displacement[[400, 777]] += 5.0

    return changed(add)


def stuck() -> list[Recording]:
    def add(_: Floats, displacement: Floats) -> None:
        displacement[820:860] = displacement[820]

    return changed(add)


def clipped() -> list[Recording]:
    def clip(_: Floats, displacement: Floats) -> None:
        displacement[:] = np.minimum(displacement, 17.0)

    return changed(clip)


def held() -> list[Recording]:
    def hold(_: Floats, displacement: Floats) -> None:
        displacement[:] = displacement[np.arange(len(displacement)) // 4 * 4]

    return changed(hold)


def stepped_drive() -> list[Recording]:
    drive = swings(TURNS)
    return [logged(drive[np.arange(len(drive)) // 5 * 5])]


def backwards() -> list[Recording]:
    clock = CLOCK.copy()
    clock[1000:] -= 0.1
    return [dataclasses.replace(clean()[0], time=clock)]


def repeated_stamps() -> list[Recording]:
    return [dataclasses.replace(clean()[0], time=np.round(CLOCK, 2))]


def one_amplitude() -> list[Recording]:
    return [logged(swings([0, 100] * 8 + [0]))]


def one_cycle() -> list[Recording]:
    return [logged(swings([0, 100, 0]))]


def staircase() -> list[Recording]:
    levels = np.repeat(
        np.concatenate([np.arange(0, 101, 10), np.arange(90, -1, -10)] * 4).astype(
            float
        ),
        20,
    )
    return [logged(levels)]


def clockwise() -> list[Recording]:
    """A loop that leads: springs that slip."""
    drive, slips = swings(TURNS), np.array([4.0, 10.0, 20.0])
    held_by, moved = np.zeros(3), np.empty(len(drive))
    last = 0.0
    for k, value in enumerate(drive.tolist()):
        held_by = np.clip(held_by + value - last, -slips, slips)
        last = value
        moved[k] = 0.1 * value + 0.08 * held_by.sum()
    return [logged(drive, moved)]


def duhem(drive: Floats) -> Floats:
    """Coleman and Hodgdon's actuator: y' = 0.06 |u'| (0.2 u - y) + 0.07 u', whose small loops do not close."""
    moved, y, last = np.empty(len(drive)), 0.0, float(drive[0])
    for k, value in enumerate(drive.tolist()):
        step = value - last
        y += 0.06 * abs(step) * (0.2 * (last + 0.5 * step) - y) + 0.07 * step
        moved[k], last = y, value
    return moved


def duhem_log(drive: Floats) -> Recording:
    return logged(drive, duhem(drive))


def forgets() -> list[Recording]:
    return [duhem_log(swings(TURNS))]


def warming() -> list[Recording]:
    log = logged(swings(TURNS))
    grown = 1.0 + 0.02 * CLOCK / CLOCK[-1]
    return [logged(swings(TURNS), predict(actuator(), log) * grown)]


def drifting() -> list[Recording]:
    log = logged(swings([0, 100] * 8 + [0]))
    clock = np.arange(len(log.voltage)) / RATE
    return [logged(log.voltage, predict(actuator(), log) + 0.3 * clock / clock[-1])]


def far_drifting() -> list[Recording]:
    log = logged(swings([0, 100] * 8 + [0]))
    clock = np.arange(len(log.voltage)) / RATE
    return [logged(log.voltage, predict(actuator(), log) + 2.0 * clock / clock[-1])]


def two_gains() -> list[Recording]:
    log = clean()[0]
    other = logged(
        log.voltage, 1.05 * predict(actuator(), log), seed=2, name="other.csv"
    )
    return [log, other]


def saturating() -> list[Recording]:
    log = clean()[0]
    moved = predict(actuator(), log)
    return [
        logged(log.voltage, np.where(moved < 13.0, moved, 13.0 + 0.02 * (moved - 13.0)))
    ]


def butterfly() -> list[Recording]:
    log = clean()[0]
    return [logged(log.voltage, (predict(actuator(), log) - 7.0) ** 2 / 10.0)]


def late_start() -> list[Recording]:
    return [logged(swings((30, 60, 40, 100, 0, *TURNS[1:])))]


def without_clock() -> list[Recording]:
    return [dataclasses.replace(clean()[0], time=None)]


def narrow() -> list[Recording]:
    return [logged(0.5 * swings(TURNS))]


def noisy_read_back() -> list[Recording]:
    def add(voltage: Floats, _: Floats) -> None:
        voltage += 0.4 * np.random.default_rng(3).normal(size=len(voltage))

    return changed(add)


def hum_beside_noisy_read_back() -> list[Recording]:
    log = noisy_read_back()[0]
    return [dataclasses.replace(log, displacement=hum()[0].displacement)]


LATE = 6  # rows, 30 ms


def late() -> list[Recording]:
    moved = predict(actuator(), clean()[0])
    return [
        logged(swings(TURNS), np.concatenate([np.full(LATE, moved[0]), moved[:-LATE]]))
    ]


def cost_of_lateness() -> float:
    """Return the error, RMS in % of the range, of a displacement that is 30 ms late."""
    log = late()[0]
    return 100.0 * float(np.std(log.displacement - clean()[0].displacement)) / 20.0


def wider_with_speed() -> list[Recording]:
    drive = swings(TURNS)
    speed = RATE * np.gradient(drive)
    moved = predict(actuator(), clean()[0])
    return [
        logged(drive, moved - 0.8 * np.sign(speed) * np.log1p(np.abs(speed) / 30.0))
    ]


def uncertain() -> list[Recording]:
    log = clean()[0]
    return [
        dataclasses.replace(
            log, uncertainty=np.where(np.arange(len(log.voltage)) % 2, 0.005, 0.02)
        )
    ]


def with_gap() -> list[Recording]:
    log = clean()[0]
    keep = np.concatenate([np.arange(820), np.arange(980, len(log.voltage))])
    kept = {
        "voltage": log.voltage[keep],
        "displacement": log.displacement[keep],
        "time": CLOCK[keep],
    }
    return [dataclasses.replace(log, **kept)]


FOREIGN = 1.8  # um, of an oscillation that the drive has not


def shaken() -> list[Recording]:
    drive = swings(TURNS)
    moved = predict(actuator(), clean()[0])
    return [logged(drive, moved + FOREIGN * np.sin(2.0 * np.pi * 1.37 * CLOCK))]


def straight() -> list[Recording]:
    drive = swings(TURNS)
    return [logged(drive, 0.2 * drive)]


def two_scales() -> list[Recording]:
    log = clean()[0]
    return [
        log,
        dataclasses.replace(
            log, displacement=0.001 * log.displacement, name="other.csv"
        ),
    ]


def slewed() -> list[Recording]:
    """An amplifier that falls by 100 V a second at most."""
    drive = swings(TURNS, 0.25)
    followed, at = np.empty(len(drive)), 0.0
    for k, value in enumerate(drive.tolist()):
        at = max(value, at - 100.0 / RATE)
        followed[k] = at
    return [logged(drive, predict(actuator(), logged(followed, np.zeros(len(drive)))))]


@functools.cache
def said(
    case: Callable[[], list[Recording]], options: tuple[tuple[str, Any], ...] = ()
) -> tuple[str, ...]:
    """Return all that identification says of a case."""
    done = identify(case(), dataclasses.replace(OPTIONS, force=True, **dict(options)))
    return tuple([*done.summary, *done.warnings])


class Sentence(NamedTuple):
    """How a sentence begins (a pattern), when it is printed, the case, and what its groups must say there."""

    pattern: str
    condition: str
    case: Callable[[], list[Recording]]
    true: Sequence[Any] = ()
    options: tuple[tuple[str, Any], ...] = ()


def near(value: float, part: float = 0.1) -> Any:
    return pytest.approx(value, rel=part)


TABLE = [
    Sentence(
        r"log\.csv: hum of (\S+) um at (\S+) Hz",
        "a line of the displacement's spectrum that the drive has not",
        hum,
        (near(0.2, 0.5), near(50.0, 0.01)),
    ),
    Sentence(
        r"log\.csv: (\d+) single voltages that jump away and back .*first at row (\d+)",
        "single voltages between equal neighbours",
        glitch,
        (3, 501),
    ),
    Sentence(
        r"log\.csv: (\d+) outlying rows left out \(spikes of the displacement; first at row (\d+)\)",
        "displacements that leave their neighbours",
        spikes,
        (2, 401),
    ),
    Sentence(
        r"log\.csv: (\d+) rows left out: the displacement stands still while the drive moves \(first at row (\d+)\)",
        "a sensor that stands still",
        stuck,
        (near(39, 0.1), near(821, 0.01)),
    ),
    Sentence(
        r"log\.csv: (\d+) rows left out: the sensor stands at the end of its range",
        "a sensor cut off in full motion",
        clipped,
    ),
    Sentence(
        r"log\.csv: (\d+) % of the displacements repeat the one before while the drive moves",
        "sample-and-hold",
        held,
        (near(75, 0.05),),
    ),
    Sentence(
        r"log\.csv: the voltage changes only once in (\d+) rows",
        "a drive in even steps",
        stepped_drive,
        (5,),
    ),
    Sentence(
        r"log\.csv: time runs backwards (\d+) times \(first at row (\d+)\)",
        "a clock that steps back",
        backwards,
        (1, 1001),
    ),
    Sentence(
        r"log\.csv: (\d+) repeated time stamps \(first at row (\d+)\)",
        "stamps with too few digits",
        repeated_stamps,
        (near(0.5 * len(CLOCK), 0.01), near(2, 0.6)),
    ),
    Sentence(
        r"all cycles go over one and the same range", "one amplitude", one_amplitude
    ),
    Sentence(r"less than two whole cycles", "fewer than four swings", one_cycle),
    Sentence(
        r"what error to expect on new moves cannot be told",
        "fewer than four swings",
        one_cycle,
    ),
    Sentence(
        r"the log's samples stand at (\d+) levels of the drive alone",
        "fewer than 20 levels",
        staircase,
        (11,),
    ),
    Sentence(
        r"the loop runs clockwise: the displacement leads the voltage",
        "falling slopes fit better",
        clockwise,
    ),
    Sentence(
        r"loops may not close: in the logs the displacement forgets its past as the drive moves",
        "memories of the distance explain a fifth more of the error",
        forgets,
    ),
    Sentence(
        r"the gain changes by ([+-][\d.]+) % along the log",
        "a gain that drifts makes most of the error",
        warming,
        (near(2.0, 0.25),),
    ),
    Sentence(
        r"log\.csv: sensor drift of (\S+) um fitted beside the model",
        "a drift above 0.2 % of the range",
        drifting,
        (near(0.3, 0.1),),
    ),
    Sentence(
        r"log\.csv: (\S+) um of the displacement \((\d+) % of the range\) was taken for a drift",
        "a drift above 5 % of the range",
        far_drifting,
        (near(2.0, 0.1), near(10, 0.1)),
    ),
    Sentence(
        r"in parts: \S+ um shape .* (\S+) um zero \(that mean; it moved by (\S+) um along a log",
        "a zero that moved by more than the model errs",
        drifting,
        (near(0.3, 0.2), near(0.3, 0.1)),
    ),
    Sentence(
        r"the logs' gains differ \(over the model's: log\.csv (\S+), other\.csv (\S+)\)",
        "gains 1 % apart that make most of the error",
        two_gains,
        (near(0.976, 0.01), near(1.025, 0.01)),
    ),
    Sentence(
        r"log\.csv: the displacement hardly moves at an end of the drive's range",
        "a slope below 0.15 of the usual at an end",
        saturating,
    ),
    Sentence(
        r"log\.csv: the displacement rises and falls again as the voltage rises",
        "a mean curve that turns",
        butterfly,
    ),
    Sentence(
        r"log\.csv: rows 1 to (\d+) left out: before the drive had been at both ends",
        "an unknown past",
        late_start,
        (near(401, 0.02),),
    ),
    Sentence(
        r"no clock, so neither lag nor delay could be looked for",
        "no time",
        without_clock,
    ),
    Sentence(
        r"the logs cover (\S+) to (\S+), (\d+) % of the rated range",
        "less than 95 % of the rating",
        narrow,
        (near(0.0, 0.1), near(50.0, 0.01), 50),
        (("rated", (0.0, 100.0)),),
    ),
    Sentence(
        r"the logs go from (\S+) to (\S+), beyond the rated range",
        "more than the rating",
        clean,
        (near(0.0, 0.1), near(100.0, 0.01)),
        (("rated", (0.0, 60.0)),),
    ),
    Sentence(
        r"log\.csv: the voltage's read-back is noisy \((\S+) % of its range\)",
        "white noise on the voltage",
        noisy_read_back,
        (near(0.4, 0.2),),
    ),
    Sentence(
        r"log\.csv: hum of (\S+) um at (\S+) Hz",
        "hum beside a noisy read-back",
        hum_beside_noisy_read_back,
        (near(0.2, 0.2), near(50.0, 0.01)),
    ),
    Sentence(
        r"late by a pure delay of (\S+) ms, .* compensating it costs (\S+) % of a move at the logs' speed",
        "a delay that may be the sensor's",
        late,
        (near(30.0, 0.05), near(cost_of_lateness(), 0.15)),
        (("delay", None),),
    ),
    Sentence(
        r"^lag (\S+) ms, compensated too",
        "a lag that is the model's",
        late,
        (near(30.0, 0.05),),
        (("delay", None),),
    ),
    Sentence(
        r"the sensor's delay of (\S+) ms and lag of (\S+) ms were taken off before and are not compensated",
        "a delay that is said to be the sensor's",
        late,
        (30, 0),
        (("delay", None), ("sensor_delay", 0.03)),
    ),
    Sentence(
        r"what is left over follows the drive's speed \(correlation -",
        "loops that widen with the speed",
        wider_with_speed,
    ),
    Sentence(
        r"rows weighted by their uncertainty, which differs by up to (\S+) times: they tell as much as (\S+) of",
        "rows of two uncertainties",
        uncertain,
        (
            4,
            near(
                0.5 * (len(CLOCK) - 96) * (1.0 + 1.0 / 16.0) ** 2 / (1.0 + 1.0 / 256.0),
                0.01,
            ),
        ),
    ),
    Sentence(
        r"log\.csv: a gap before row (\d+), in which the drive may have turned: (\d+) rows left out",
        "a pause in the log",
        with_gap,
        (
            821,
            near(116, 0.1),
        ),  # until the drive has been at 0 and, with the pause over, at 100
    ),
    Sentence(
        r"the model leaves (\S+) % of its range unexplained",
        "more than 5 % of the range is left over",
        shaken,
        (near(100.0 * FOREIGN / np.sqrt(2.0) / 20.0, 0.15),),
    ),
    Sentence(
        r"is no better than a straight line \(RMSE (\S+)\): the log shows no loop",
        "no loop",
        straight,
        (near(NOISE, 0.1),),
    ),
    Sentence(
        r"the gain of other\.csv is (\S+) of that of log\.csv: bring the logs to one scale",
        "gains a thousand times apart",
        two_scales,
        (near(0.001, 0.01),),
    ),
    Sentence(
        r"log\.csv: the displacement falls at one greatest speed",
        "an amplifier that slews",
        slewed,
    ),
]


@pytest.mark.parametrize("row", TABLE, ids=[row.pattern[:48] for row in TABLE])
def test_what_a_sentence_claims_is_so(row: Sentence) -> None:
    matches = [
        found
        for text in said(row.case, row.options)
        if (found := re.search(row.pattern, text))
    ]
    assert matches, (row.condition, said(row.case, row.options))
    figures = [
        float(text.replace(",", "")) for text in matches[0].groups()[: len(row.true)]
    ]
    assert figures == list(row.true)


@pytest.mark.parametrize("row", TABLE, ids=[row.pattern[:48] for row in TABLE])
def test_silent_where_there_is_nothing_of_the_kind(row: Sentence) -> None:
    if row.case is late_start:
        pytest.skip(
            "of every log rows are left out until the drive has been at both ends"
        )
    lines = said(clean)
    assert not [text for text in lines if re.search(row.pattern, text)]


def test_the_clean_log_has_no_warning_and_its_figures_are_true() -> None:
    done = identify(clean(), OPTIONS)
    assert done.warnings == []
    log = clean()[0]
    truth = predict(actuator(), log)
    fitted = float(np.std(predict(done.model, log) - truth))
    assert fitted < done.fit["rmse"] == near(NOISE, 0.15)  # type: ignore[operator]
    line = np.polyval(np.polyfit(log.voltage, truth, 1), log.voltage) - truth
    [stated] = [
        found
        for text in done.summary
        if (found := re.search(r"a straight line's (\S+) um", text))
    ]
    assert float(stated[1]) == near(float(np.std(line)), 0.05)
    [width] = [
        found
        for text in done.summary
        if (found := re.search(r"^loop (\S+) % of the model's range", text))
    ]
    slow = np.concatenate([np.linspace(0.0, 100.0, 501), np.linspace(100.0, 0.0, 501)])
    walked = predict(actuator(), logged(slow, np.zeros(1002)))
    assert float(width[1]) == near(
        100.0 * float(np.max(walked[501:][::-1] - walked[:501])) / 20.0, 0.05
    )


def test_a_displacement_of_another_drive_is_no_butterfly() -> None:
    other = swings(np.random.default_rng(3).permutation(TURNS))
    moved = predict(actuator(), logged(other, np.zeros(len(other))))
    done = identify(
        [logged(swings(TURNS), moved)], dataclasses.replace(OPTIONS, force=True)
    )
    assert any("of its range unexplained" in text for text in done.warnings)
    assert not any("rises and falls again" in text for text in done.warnings)


def test_another_log_is_predicted_to_what_its_sensor_hides() -> None:
    other = logged(swings(TURNS[::-1]), seed=5, name="other.csv")
    done = identify(clean(), OPTIONS, validation=[other])
    [stated] = [
        found
        for text in done.summary
        if (found := re.search(r"^other\.csv: predicts it to (\S+) um", text))
    ]
    assert float(stated[1]) == near(NOISE, 0.1)
    wider = dataclasses.replace(other, displacement=1.02 * other.displacement)
    worse = identify(clean(), OPTIONS, validation=[wider])
    [stated] = [
        found
        for text in worse.summary
        if (found := re.search(r"^other\.csv: predicts it to (\S+) um", text))
    ]
    assert float(stated[1]) == near(0.02 * float(np.std(other.displacement)), 0.1)


def test_what_has_moved_since_the_prior_lies_within_what_is_printed() -> None:
    prior = identify(clean(), OPTIONS).model
    later = logged(swings(TURNS), seed=8)
    later = dataclasses.replace(later, displacement=1.03 * later.displacement + 0.7)
    [line] = [
        text for text in identify([later], prior=prior).summary if "moved: gain" in text
    ]
    found = re.search(
        r"gain (\S+) times the prior's \(within (\S+)\), offset (\S+) um, lag as it was \(within (\S+) ms",
        line,
    )
    assert found is not None, line
    gain, within, offset = (float(text) for text in found.groups()[:3])
    assert abs(gain - 1.03) <= within < 0.01
    assert offset == pytest.approx(0.7, abs=20.0 * within)
    [same] = [
        text
        for text in identify([logged(swings(TURNS), seed=9)], prior=prior).summary
        if "moved" in text
    ]
    assert "gain 1.000" in same and "offset +0 um" in same


def test_a_resonance_lies_in_the_interval_that_is_printed() -> None:
    drive = Excitation(0.0, 100.0, 2_000.0, 6.0, 1.0, sweep_to=200.0).drive()[1]
    few = IdentificationOptions(gears=24, points=0, relaxation=(), delay=0.0)
    shown = re.compile(
        r"resonance at \S+ Hz \((\S+) to (\S+)\), damping \S+ \((\S+) to (\S+)\)"
    )
    whole = identify([recorded(plant(Lag(0.001), Resonance(61.0, 0.03)), drive)], few)
    [found] = [found for text in whole.summary if (found := shown.search(text))]
    low, high, thin, wide = (float(text) for text in found.groups())
    assert low <= 61.0 <= high <= 1.01 * low
    assert thin <= 0.03 <= wide <= 1.2 * thin
    [trusted] = [
        found
        for text in whole.summary
        if (found := re.match(r"trust the model to (\S+) Hz", text))
    ]
    phase = 2.0 * np.pi * float(trusted[1]) * np.arange(4_000) / 2_000.0
    fast = 50.0 - 20.0 * np.cos(phase)
    moved = [
        model.simulate(fast, model.start(30.0), time_step=0.0005).y[2_000:]
        for model in (plant(Lag(0.001), Resonance(61.0, 0.03)), whole.model)
    ]
    assert float(np.std(moved[1] - moved[0])) < 0.1 * float(np.std(moved[0]))
    assert not [
        text
        for text in said(clean)
        if "resonance at" in text or "trust the model" in text
    ]


# --- what is said of a move ---


def compensated(wanted: Floats, **options: Any) -> Any:
    model = Model(actuator(expected_rmse=0.05, left_out_rmse=0.03, fastest_drive=400.0))
    return model.compensate(wanted, sample_rate=RATE, details=True, **options)


def move(low: float = 6.0, high: float = 14.0, seconds: float = 2.0) -> Floats:
    """Return a move in um that begins and ends at rest."""
    clock = np.arange(int(seconds * RATE)) / RATE
    return low + (high - low) * (0.5 - 0.5 * np.cos(2.0 * np.pi * clock / seconds))


def texts_of(done: Any) -> str:
    return "\n".join(plain(text) for text in [*done.notes, *done.warnings])


def truth_of(done: Any, wanted: Floats, start: str) -> float:
    """Return the RMS by which the actuator misses a move, when it came from a start."""
    model = actuator()
    y = model.simulate(
        done.values, model.start(float(done.values[0]), start), time_step=1.0 / RATE
    ).y  # type: ignore[arg-type]
    left = y[-len(wanted) :] - wanted
    return float(np.sqrt(np.mean(left**2)))


def test_the_error_from_an_unknown_past_holds_from_every_one() -> None:
    done = compensated(move())
    found = re.search(
        r"that is from the start assumed \(settled at the first row\) or after .*, from an unknown past (\S+) um",
        texts_of(done),
    )
    assert found is not None
    errors = [truth_of(done, move(), start) for start in ("settled", "empty", "full")]
    assert errors[0] < 1e-9
    assert 0.5 * float(found[1]) < max(errors) <= float(found[1])


def test_an_actuator_that_never_moved_errs_more_until_it_is_swept() -> None:
    """Domains that switch for good where the drive goes for the first time."""
    never_moved = "; an actuator that never went over its range may err more (`condition` sweeps it)"
    wanted = move(0.0, 8.0)
    for condition in (False, True):
        done = compensated(wanted, condition=condition)
        assert (never_moved in "\n".join(done.notes)) is not condition
        drive = done.values
        unswitched = 0.008 * (100.0 - np.maximum.accumulate(drive))
        y = (
            actuator().simulate(drive, actuator().start(float(drive[0]), "empty")).y
            - unswitched
        )
        error = float(np.sqrt(np.mean((y[-len(wanted) :] - wanted) ** 2)))
        stated = re.search(r"expected error of the move (\S+) um", texts_of(done))
        assert stated is not None
        assert (error > 3.0 * float(stated[1])) is not condition
    assert never_moved not in "\n".join(compensated(wanted, state="empty").notes)


def test_small_swings_of_a_loop_that_forgets_leave_the_stated_zero() -> None:
    """Duhem's actuator: a small swing that repeats wanders towards the middle of the loop."""
    model = Model(identify([duhem_log(swings(TURNS))], OPTIONS).model)
    small = swings((0, 100, 0, 45, *[55, 45] * 8))
    wander = "small swings that repeat may wander towards the middle of the loop"
    for drive, repeats in ((small, True), (swings((0, 100, 0, *TURNS[3:])), False)):
        wanted = model.simulate(drive, sample_rate=RATE)[-len(drive) + 301 :]
        done = model.compensate(wanted, sample_rate=RATE, condition=True, details=True)
        assert (wander in texts_of(done)) is repeats
    left = (duhem(small) - model.simulate(small, sample_rate=RATE))[400:]
    stated = move_error(model.actuator, small, 1.0 / RATE, 400)
    assert stated is not None and stated.zero is not None
    assert abs(float(left.mean())) > stated.zero


def test_after_a_sweep_the_past_is_no_longer_said_and_no_longer_matters() -> None:
    done = compensated(move(), condition=True)
    assert "unknown past" not in texts_of(done)
    assert "depends on the past" not in texts_of(done)
    assert max(truth_of(done, move(), start) for start in ("empty", "full")) < 1e-9


def test_by_how_much_the_start_depends_on_the_past() -> None:
    done = compensated(move())
    found = re.search(
        r"where it starts, the displacement depends on the past by up to (\S+) um",
        texts_of(done),
    )
    assert found is not None
    model = actuator()
    first = float(done.values[0])
    ends = [
        float(model.simulate(np.array([first]), model.start(first, start)).y[0])
        for start in ("empty", "full")
    ]  # type: ignore[arg-type]
    assert float(found[1]) == near(abs(ends[1] - ends[0]), 0.02)
    from_the_end = compensated(move(0.0, 8.0), state="empty")
    assert "depends on the past" not in texts_of(from_the_end)


def test_what_clipping_loses_is_what_the_actuator_misses() -> None:
    wanted = move(6.0, 16.0)
    done = compensated(
        wanted, v_max=70.0, on_limit="clip", state="empty", from_=0.0, approach=1.0
    )
    found = re.search(
        r"samples .*: clipped, by which the move misses (\S+) um RMS, (\S+) um at worst",
        texts_of(done),
    )
    assert found is not None
    assert float(found[1]) == near(truth_of(done, wanted, "empty"), 0.02)
    within = compensated(
        move(6.0, 10.0), v_max=70.0, state="empty", from_=0.0, approach=1.0
    )
    assert "clipped" not in texts_of(within)


def test_a_first_row_that_steps_is_said_with_both_voltages() -> None:
    done = compensated(move(), from_=0.0)
    found = re.search(r"the first row steps from (\S+) to (\S+) V", texts_of(done))
    assert found is not None
    assert (float(found[1]), float(found[2])) == (
        0.0,
        near(float(done.values[0]), 1e-4),
    )
    ramped = compensated(move(), from_=0.0, approach=1.0)
    assert "the first row steps" not in texts_of(ramped)
    assert abs(float(np.diff(ramped.values, prepend=0.0).max())) < 3.0


def test_a_first_value_at_which_nothing_settles_is_missed_by_what_is_said() -> None:
    """Four gears: where the drive settles, the displacement goes by steps."""
    gears = BacklashStage(np.full(4, 25.0), np.array([0.1, 0.2, 0.3, 0.4]))
    few = dataclasses.replace(actuator(), stages=(gears, ScaleStage(20.0, 0.0)))
    missed = re.compile(r"the displacement starts (\S+) um off its first value")
    seen = 0
    for first in np.linspace(4.0, 16.0, 13).tolist():
        done = Model(few).compensate(
            move(first, first + 2.0), sample_rate=RATE, details=True
        )
        start = float(done.values[0])
        reached = float(few.simulate(np.array([start]), few.start(start)).y[0])
        found = missed.search(texts_of(done))
        if found is None:
            assert reached == pytest.approx(first, abs=1e-6)
            continue
        seen += 1
        assert float(found[1]) == near(abs(reached - first), 0.01)
    assert 0 < seen < 13
    assert not missed.search(texts_of(compensated(move())))


def test_rows_faster_than_the_logs_are_counted() -> None:
    fast = compensated(move(6.0, 14.0, 0.05 * 4))
    found = re.search(
        r": (\d+) of (\d+) samples .* move the drive more than 2 times as fast",
        texts_of(fast),
    )
    speeds = np.abs(np.diff(fast.values, prepend=fast.values[0])) * RATE
    count = int(np.count_nonzero(speeds > 2.0 * 400.0))
    assert (found is not None) == (count > 0)
    if found is not None:
        assert (int(found[1]), int(found[2])) == (count, len(fast.values))
    assert "times as fast" not in texts_of(compensated(move()))


def test_the_charge_that_a_drive_takes() -> None:
    done = compensated(move(), capacitance=1e-6, max_current=1.0)
    found = re.search(
        r"into 1e-06 F the drive takes (\S+) A at most, (\S+) A and", texts_of(done)
    )
    assert found is not None
    rates = np.abs(np.diff(done.values)) * RATE
    assert float(found[1]) == near(1e-6 * float(rates.max()), 0.01)
    assert float(found[2]) == near(1e-6 * float(rates.mean()), 0.02)


def test_a_move_no_model_of_these_logs_knows_is_no_better_than_a_line() -> None:
    model = Model(actuator(expected_rmse=2.0, left_out_rmse=2.0))
    done = model.compensate(move(), sample_rate=RATE, details=True)
    assert "is no better than that of a straight line" in texts_of(done)
    assert "is no better than" not in texts_of(compensated(move()))


# --- what a report says ---


def noted(measured: Floats, wanted: Floats | None = None, **options: Any) -> str:
    wanted = move() if wanted is None else wanted
    return "\n".join(
        dbo_cli.report(
            wanted, measured, sample_rate=RATE, unit="um", **options
        ).report.notes
    )


def test_what_is_left_without_the_mean() -> None:
    wave = 0.01 * np.sin(np.arange(len(move())))
    found = re.search(
        r"without the mean error (\d+) % of the RMSE is left",
        noted(move() + 0.1 + wave),
    )
    assert found is not None
    left = float(np.std(0.1 + wave)) / float(np.sqrt(np.mean((0.1 + wave) ** 2)))
    assert float(found[1]) == pytest.approx(100.0 * left, abs=0.5)
    assert "without the mean" not in noted(move() + wave)


def test_the_lag_that_auto_takes_out_is_the_one_that_was_put_in() -> None:
    late = np.concatenate([np.full(7, move()[0]), move()[:-7]])
    assert "measured follows best at a lag of 7 samples" in noted(late, lag="auto")
    assert "follows best" not in noted(late)


def test_samples_that_are_no_numbers_are_counted() -> None:
    for rows, text in (
        ([3, 9], "log: 2 samples without a number in desired or measured left out"),
        ([], ""),
    ):
        measured = move() + 0.01 * np.sin(np.arange(400))
        measured[rows] = np.nan
        block = SampleBlock(
            range(1, 401), None, None, {"desired": move(), "measured": measured}
        )
        notes = "".join(evaluate("log", [block], ReportOptions()).notes)
        assert notes == text


def test_what_never_changes_has_no_loop() -> None:
    still = np.full(400, 5.0)
    assert "desired never changes, so NRMSE, loop width and lag are undefined" in noted(
        still + 0.1, still
    )
    assert "never changes" not in noted(move() + 0.1)
