"""The use case ``fringes``: a log of intensities becomes a log of displacements with standard deviations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from dbo_cli.errors import SILENT, InputError, Listener, Remarks, UsageError
from dbo_cli.extras.fringes import assessment
from dbo_cli.extras.fringes.branches import TURN
from dbo_cli.extras.fringes.breaks import Break, record_breaks, rest_breaks
from dbo_cli.extras.fringes.figures import plots_of_track
from dbo_cli.extras.fringes.one_signal import track_one_signal
from dbo_cli.extras.fringes.quadrature import track_quadrature
from dbo_cli.extras.fringes.swings import Floats
from dbo_cli.extras.fringes.track import Track, joined
from dbo_cli.logs.columns import ColumnWish, column_wish
from dbo_cli.logs.request import Address, ReadingOptions, check_format, parse_address
from dbo_cli.logs.sample_block import Column
from dbo_cli.logs.signal_log import SignalLog, open_log
from dbo_cli.logs.signal_writer import signal_writer
from dbo_cli.logs.units import in_unit
from dbo_cli.logs.whole_output import all_or_none
from dbo_cli.reports.drawing import check_folder, file_stems, save
from dbo_cli.runs.files import (
    Destination,
    read_record,
    summary_of_values,
    write_summary,
)

PART = "{part}"
"""What an output's name has where each part of an interrupted log gets a file."""
LIGHT_DEVIATION = 0.02
"""rad, 1 nm of 632.8 nm: what drifting offset and contrast add to the noise (benchmarks/fringes.py)."""
SIGNAL_NAMES = ("signal", "photodiode", "intensity", "fringes", "detector", "pd", "pd1")


@dataclass(frozen=True)
class FringeOptions:
    """What is asked of ``fringes``.

    Attributes
    ----------
    voltage, signal, quadrature
        Columns: the drive, the photodiode, a second one in quadrature.
    wavelength, per_fringe
        One of them, in um or as a text with a unit. A fringe is half a wavelength of
        displacement where the light goes to the mirror and back.
    sign
        ``rising`` or ``falling``: how the displacement runs with the voltage. None:
        rising for one photodiode, the interferometer's for two.
    scale_uncertainty
        Of the wavelength, in %: common to all rows, so that it is said and no row's
        deviation has it.
    splice
        Where fringes could not be counted for a while, go on where the displacement
        was; else each part has its own zero.
    figures
        A folder for figures.
    """

    voltage: str | None = None
    signal: str | None = None
    quadrature: str | None = None
    wavelength: float | str | None = None
    per_fringe: float | str | None = None
    sign: str | None = None
    scale_uncertainty: float = 0.0
    splice: bool = False
    figures: str | None = None

    def fringe(self) -> float:
        """Return the displacement of a fringe, um (UsageError where neither or both are there)."""
        if (self.wavelength is None) == (self.per_fringe is None):
            raise UsageError(
                "give the light's `wavelength` (632.8nm; a fringe is half of it) or the displacement "
                "`per_fringe` (316.4nm)"
            )
        if self.wavelength is not None:
            return 0.5 * in_unit("wavelength", self.wavelength, "um")
        assert self.per_fringe is not None
        return in_unit("per_fringe", self.per_fringe, "um")


@dataclass(frozen=True)
class Signals:
    """A log's columns: seconds, drive, photodiode and perhaps a second one; ``first_row`` counts from 1."""

    time: Floats
    drive: Floats
    signal: Floats
    quadrature: Floats | None
    first_row: int

    def part(self, begin: int, end: int) -> Signals:
        """Return some rows."""
        second = None if self.quadrature is None else self.quadrature[begin:end]
        rows = slice(begin, end)
        return Signals(
            self.time[rows],
            self.drive[rows],
            self.signal[rows],
            second,
            self.first_row + begin,
        )


@dataclass(frozen=True)
class Displacement:
    """What comes out: um and their standard deviation, um; and the phase that it was made of."""

    signals: Signals
    values: Floats
    deviation: Floats
    track: Track


def displacement_of(
    signals: Signals, options: FringeOptions, name: str, remarks: Remarks
) -> Displacement:
    """Return the displacement of one uninterrupted log.

    Raises
    ------
    InputError
        There are too few fringes, or too few rows in one, or too many turns are in
        doubt.
    """
    assessment.refuse_swapped(signals.drive, signals.signal, name)
    assessment.refuse_fast(signals.time, signals.signal, name)
    try:
        if signals.quadrature is None:
            track = track_one_signal(signals.time, signals.drive, signals.signal)
        else:
            track = track_quadrature(
                signals.time, signals.drive, signals.signal, signals.quadrature
            )
    except InputError as problem:
        raise InputError(f"{name}: {problem}") from None
    track = _with_sign(track, signals, options, remarks)
    assessment.refuse_rate(signals.time, track, name)
    assessment.refuse_noise(track, name)
    if signals.quadrature is None:
        assessment.refuse_miscounted(signals.time, track, name)
    scale = options.fringe() / TURN
    values = scale * (track.phase - track.phase[0])
    deviation = np.abs(scale) * np.hypot(track.deviation, LIGHT_DEVIATION)
    made = Displacement(signals, values, deviation, track)
    assessment.refuse_doubtful(signals.time, track, name)
    for text in assessment.doubtful_turns(
        signals.time, signals.drive, track, options.fringe()
    ):
        remarks.warn(f"{name}: {text}")
    remarks.note(
        [
            f"{name}: {text}"
            for text in assessment.headline(made.values, deviation, track)
        ]
    )
    return made


def _with_sign(
    track: Track, signals: Signals, options: FringeOptions, remarks: Remarks
) -> Track:
    """Return the track in the direction that was asked for."""
    drive = signals.drive - float(np.mean(signals.drive))
    rises = float(drive @ (track.phase - float(np.mean(track.phase)))) > 0.0
    if options.sign is None:
        if not rises:
            remarks.note(
                [
                    "the displacement falls as the voltage rises: the interferometer's sign"
                ]
            )
        return track
    if rises == (options.sign == "rising"):
        return track
    return replace(track, phase=-track.phase)


def parts_between(signals: Signals, breaks: Sequence[Break]) -> list[Signals]:
    """Return the parts of a log between breaks; those that are too short to count are left out."""
    parts = []
    begin = 0
    for gap in [*breaks, Break(signals.time.size, signals.time.size, "")]:
        if gap.first - begin >= assessment.FEWEST_ROWS:
            parts.append(signals.part(begin, gap.first))
        begin = max(begin, gap.behind)
    return parts


def displacements(
    signals: Signals, options: FringeOptions, name: str, remarks: Remarks
) -> tuple[list[Displacement], list[str]]:
    """Return the displacement of each part of a log between breaks, and why there are breaks.

    Rests in which the mirror moved by itself are breaks only where the count fails with
    them: a creep that the model follows is counted like any other move.

    Raises
    ------
    InputError
        A part cannot be counted, or none is long enough.
    """
    both = (
        [signals.signal]
        if signals.quadrature is None
        else [signals.signal, signals.quadrature]
    )
    breaks = record_breaks(signals.time, both)
    why = [gap.why for gap in breaks]
    made: list[Displacement] = []
    for part in parts_between(signals, breaks):
        counted, rests = _counted(
            part, options, name, part.time.size == signals.time.size, remarks
        )
        made += counted
        why += [gap.why for gap in rests]
    if not made:
        raise InputError(f"{name}: {'; '.join(why)}, and no part is long enough")
    return made, why


def _counted(
    part: Signals, options: FringeOptions, name: str, whole: bool, remarks: Remarks
) -> tuple[list[Displacement], list[Break]]:
    """Return the displacement of a part, or of what is between its rests where it fails with them."""
    try:
        made = displacement_of(
            part, options, name if whole else f"{name} ({rows_of(part)})", remarks
        )
        return [made], []
    except InputError:
        rests = rest_breaks(part.time, part.drive, part.signal)
        if part.quadrature is not None or not rests:
            raise
        of_pieces = Remarks()
        pieces = []
        try:
            for piece in parts_between(part, rests):
                pieces.append(
                    displacement_of(
                        piece, options, f"{name} ({rows_of(piece)})", of_pieces
                    )
                )
        except InputError:
            pieces = []
        if not pieces:
            raise
        remarks.add(of_pieces)
        return pieces, rests


def rows_of(part: Signals) -> str:
    """Return the rows of a part in words."""
    return f"rows {part.first_row}:{part.first_row + part.time.size - 1}"


def spliced(made: Sequence[Displacement]) -> Displacement:
    """Return parts as one: each begins a row later where the one before it ended."""
    step = float(np.median(np.diff(made[0].signals.time)))
    times, values = [], []
    clock = float(made[0].signals.time[0])
    level = 0.0
    for part in made:
        times.append(part.signals.time - part.signals.time[0] + clock)
        values.append(part.values - part.values[0] + level)
        clock, level = float(times[-1][-1]) + step, float(values[-1][-1])
    first = made[0].signals
    quadrature = [
        part.signals.quadrature for part in made if part.signals.quadrature is not None
    ]
    signals = Signals(
        np.concatenate(times),
        np.concatenate([part.signals.drive for part in made]),
        np.concatenate([part.signals.signal for part in made]),
        np.concatenate(quadrature) if quadrature else None,
        first.first_row,
    )
    deviation = np.concatenate([part.deviation for part in made])
    return Displacement(
        signals,
        np.concatenate(values),
        deviation,
        joined([part.track for part in made]),
    )


def read_signals(log: SignalLog) -> Signals:
    """Read a log whole (InputError where its clock does not rise)."""
    block = log.read()
    count = len(block)
    if count < assessment.FEWEST_ROWS:
        raise InputError(f"{log.name}: {count} rows are too few for fringes")
    if block.time is not None:
        time = np.asarray(block.time, dtype=np.float64)
    else:
        time = np.arange(count) / (log.even_rate or 1.0)
    backwards = np.flatnonzero(np.diff(time) < 0.0)
    if backwards.size:
        place = block.place(log.name, int(backwards[0]) + 1)
        raise InputError(
            f"{place}: time runs backwards (one log of one clock; `rows` takes a part)"
        )
    values = block.values
    return Signals(
        time,
        values["voltage"],
        values["signal"],
        values.get("quadrature"),
        int(block.rows[0]),
    )


def wishes(options: FringeOptions) -> dict[str, ColumnWish]:
    """Return the columns that are read."""
    want = {
        "voltage": column_wish("voltage", options.voltage, option="voltage"),
        "signal": ColumnWish(options.signal, SIGNAL_NAMES, option="signal"),
    }
    if options.quadrature is not None:
        want["quadrature"] = ColumnWish(options.quadrature, option="quadrature")
    return want


@all_or_none()
def write_displacement(
    address: Address,
    destination: Destination,
    reading: ReadingOptions,
    options: FringeOptions,
    listener: Listener = SILENT,
) -> Remarks:
    """Read a log of fringes and write time, voltage, displacement and its standard deviation.

    Raises
    ------
    InputError
        The log cannot be counted, or its beam was interrupted and the output's name has
        no ``{part}``.
    UsageError
        The options contradict each other.
    """
    fringe = options.fringe()
    if not fringe > 0.0:
        raise UsageError("`wavelength` and `per_fringe` must be above 0")
    destination = destination.beside(
        options.voltage, options.signal, options.quadrature, reading.time
    )
    check_format(reading.format, [address, destination.output])
    first = _output_of(destination, 1)
    destination._replace(output=first).check()
    if options.figures is not None:
        check_folder(options.figures)
    remarks = Remarks()
    with open_log(address, wishes(options), reading) as log:
        listener.opened(log.describe())
        signals = read_signals(log)
        unit = log.columns["voltage"].unit
        read = read_record(log.name, log.reading_record())
        name = log.name
        remarks.read.append(log.reading_line())
        remarks.note(log.notes)
        for text in log.warnings:
            remarks.warn(text)
    listener.working(f"counting the fringes of {signals.time.size:,} rows")
    try:
        made, why = displacements(signals, options, name, remarks)
    finally:
        listener.finished()
    if options.splice:
        _refuse_moved_drive(signals, made, options, name)
    outputs = _as_asked(made, why, destination, options, name, remarks)
    for number, part in enumerate(outputs, start=1):
        _write(_output_of(destination, number), part, unit, destination, reading)
    if destination.summary is not None:
        write_summary(
            destination.summary,
            [_summary(part, destination, read, remarks) for part in outputs],
        )
    if options.figures is not None:
        stem = file_stems([name])[0]
        for number, part in enumerate(outputs, start=1):
            plots = plots_of_track(
                part.signals, part.values, part.deviation, part.track
            )
            save(
                plots,
                Path(options.figures),
                stem if len(outputs) == 1 else f"{stem}-{number}",
            )
    if options.scale_uncertainty > 0.0:
        known = f"a fringe of {1000.0 * fringe:.6g} nm is known to {options.scale_uncertainty:g} %"
        remedy = f"identify --scale-uncertainty {options.scale_uncertainty:g} states it with the gain"
        remarks.note([f"{known}, which no row's standard deviation contains: {remedy}"])
    return remarks


def _refuse_moved_drive(
    signals: Signals, made: Sequence[Displacement], options: FringeOptions, name: str
) -> None:
    """Refuse to splice parts between which the drive went as far as half a fringe takes (InputError)."""
    um_a_volt = max(
        float(np.ptp(part.values) / np.ptp(part.signals.drive)) for part in made
    )
    for before, behind in pairwise(made):
        last = (
            before.signals.first_row + before.signals.time.size - 1 - signals.first_row
        )
        first = behind.signals.first_row - signals.first_row
        between = signals.drive[last : first + 1]
        if um_a_volt * float(np.ptp(between)) > 0.5 * options.fringe():
            when = f"from {signals.time[last]:.6g} s to {signals.time[first]:.6g} s"
            moved = f"between {between.min():.6g} V and {between.max():.6g} V"
            raise InputError(
                f"{name}: while nobody counted, {when}, the drive moved {moved}: `splice` takes it for still "
                f"(-o 'recorded-{PART}.csv' writes a log of each part)"
            )


def _as_asked(
    made: Sequence[Displacement],
    why: Sequence[str],
    destination: Destination,
    options: FringeOptions,
    name: str,
    remarks: Remarks,
) -> Sequence[Displacement]:
    """Return the parts of a log as they are to be written, each with its own zero or spliced to one.

    Raises
    ------
    InputError
        There are several, and neither a name for each nor a splice was asked for.
    """
    if not why:
        return made
    breaks = "; ".join(why)
    if len(made) == 1:
        remarks.warn(f"{name}: {breaks}: only {rows_of(made[0].signals)} are read")
        return made
    if options.splice:
        remarks.warn(
            f"{name}: {breaks}: the {len(made)} parts are spliced, as if neither drive nor mirror had moved "
            "meanwhile, and the pauses are cut out of the time"
        )
        return [spliced(made)]
    if PART not in destination.output.text:
        rows = " or ".join(rows_of(part.signals).removeprefix("rows ") for part in made)
        raise InputError(
            f"{name}: {breaks}, and nobody counted the fringes meanwhile: each part has a zero of its own "
            f"(-o 'recorded-{PART}.csv' writes a log of each, `splice` takes them for one, or `rows` {rows})"
        )
    remarks.warn(f"{name}: {breaks}: each of the {len(made)} parts has its own zero")
    return made


def _output_of(destination: Destination, number: int) -> Address:
    """Return the output of a part."""
    output = destination.output
    if PART not in output.text:
        return output
    return parse_address(output.text.replace(PART, str(number)), output.format)


def _write(
    output: Address,
    made: Displacement,
    unit: str | None,
    destination: Destination,
    reading: ReadingOptions,
) -> None:
    """Write the rows of one part."""
    columns = [
        Column("time", "s"),
        Column("voltage", unit),
        Column("displacement", "um"),
        Column("standard_deviation", "um"),
    ]
    with signal_writer(
        output.or_format(reading.format),
        columns,
        attributes=lambda: {"command": destination.command},
        protect=destination.protect,
        commented=destination.commented,
    ) as writer:
        writer.write(made.signals.time, made.signals.drive, made.values, made.deviation)


def _summary(
    made: Displacement, destination: Destination, read: dict[str, Any], remarks: Remarks
) -> dict[str, Any]:
    """Return what was done as plain values."""
    signals = made.signals
    turns = [
        {
            "time": float(signals.time[turn.row]),
            "voltage": float(signals.drive[turn.row]),
            "odds": turn.odds,
            "other_fringes": turn.other,
        }
        for turn in made.track.turns
    ]
    summary = summary_of_values(signals.drive, destination.command, read, remarks)
    return summary | {
        "fringes": float(np.ptp(made.track.phase)) / TURN,
        "noise": made.track.noise,
        "largest_deviation": float(made.deviation.max()),
        "turns": turns,
    }
