"""Check a drive in a file against limits, and against what was to be played."""

from __future__ import annotations

import dataclasses
import json
import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from dbo_cli.drives.check import (
    CheckedDrive,
    check_drive,
    check_played,
    played_tolerance,
    require_voltages,
)
from dbo_cli.drives.gate import Floats
from dbo_cli.drives.options import Figure, check_gain, limits_in, plain_in
from dbo_cli.errors import (
    LimitError,
    Remarks,
    UsageError,
    cleaned,
    counted,
    plain,
    suffix_of,
)
from dbo_cli.hysteresis.model_state import DriveLimits
from dbo_cli.logs.columns import column_wish
from dbo_cli.logs.request import (
    ALL_ROWS,
    Address,
    Given,
    ReadingOptions,
    check_document,
    other_file,
    selected_files,
)
from dbo_cli.logs.sample_block import DroppedRows, SampleBlock, even_step, joined
from dbo_cli.logs.signal_log import open_log, remarks_of
from dbo_cli.logs.units import in_unit, require_unit
from dbo_cli.logs.whole_output import check_output, write_whole


@dataclass(frozen=True)
class CheckOptions:
    """What a drive is checked for.

    Limits are infinite where not given; numbers are in the unit of the drive's file,
    which may then have no prefix (100 may mean volts where the file has kV), and texts
    have their own (``"1.2kV"``). With ``against``, the drive is a recording of what was
    played, and ``against`` the file of what was to be; ``gain`` is that of an amplifier
    between the two places. ``voltage`` is the drive's column.
    """

    v_min: Figure = None
    v_max: Figure = None
    max_slew: Figure = None
    from_: Figure = None
    loop: bool = False
    against: Address | None = None
    tolerance: Figure = None
    gain: float = 1.0
    voltage: str | None = None

    def __post_init__(self) -> None:
        """Refuse a gain of nothing, and one of no recording."""
        check_gain(self.gain)
        if self.gain != 1.0 and self.against is None:
            raise UsageError(
                "`gain` is that behind a recording (`against` FILE is the drive it is of)"
            )

    def limits_in(self, unit: str | None) -> DriveLimits:
        """Return the limits in the unit of the drive.

        Raises
        ------
        UsageError
            A limit is in another unit, or in none where the drive's has a prefix.
        """
        for name in ("v_min", "v_max", "from_", "tolerance"):
            require_unit(name, getattr(self, name), unit)
        require_unit("max_slew", self.max_slew, unit, "s")
        return limits_in(unit, self.v_min, self.v_max, self.max_slew)

    @property
    def figures(self) -> tuple[Figure, ...]:
        """All that is in the unit of the drive."""
        return self.v_min, self.v_max, self.max_slew, self.from_, self.tolerance

    @property
    def has_plain_limits(self) -> bool:
        """Whether any limit is a number without a unit."""
        return any(
            limit is not None and not isinstance(limit, str) for limit in self.figures
        )


def check_file(
    drive: Address,
    output: Address,
    form: str | None,
    reading: ReadingOptions,
    options: CheckOptions,
) -> Remarks:
    """Write what is wrong with a drive, as text or JSON (``dbo-check``).

    Raises
    ------
    LimitError
        A limit is broken, or something else was played; the report is written all the
        same.
    """
    against = options.against
    chosen = form or ("json" if output.text.lower().endswith(".json") else "text")
    check_document(output, "a check", chosen)
    inputs: list[Given] = [drive]
    if against is not None:
        inputs.append(against)
    inputs += selected_files(options.voltage, reading.time)
    check_output(output, inputs)
    read = _read(drive, options.voltage, reading)
    remarks = read.remarks
    limits = options.limits_in(read.unit)
    meant = None
    if against is not None:
        # The drive was written in the voltages that are meant: a scale belongs to the
        # recording.
        whole = dataclasses.replace(reading, rows=ALL_ROWS, time=None, scale=())
        meant = _read(against, None, whole, read.unit)
        remarks.add(meant.remarks)
    checked = _checked(read, meant, limits, options)
    name = cleaned(drive.name)
    note = _note_of_unit(read, options)
    if note:
        remarks.notes.append(f"{name}: {note}")
    if checked.outside:
        rows_outside = counted(checked.outside, "row")
        remarks.warn(
            f"{name}: the first {rows_outside} outside the limits, on the way inwards from where the "
            "amplifier stands (`from_`)"
        )
    report = _report(name, checked, read.unit, chosen)
    write_whole(output, report.encode(), protect=inputs)
    _require_passed(name, checked)
    return remarks


def _checked(
    read: _Drive, meant: _Drive | None, limits: DriveLimits, options: CheckOptions
) -> CheckedDrive:
    """Return what is wrong with a drive, or with a recording of the drive that was ``meant``."""
    values, rows, unit = read.values, np.asarray(read.block.rows), read.unit
    problems = read.problems
    tolerance, slack = None, 0.0
    if meant is not None and options.against is not None:
        name, meant_rows = options.against.name, meant.block.rows
        problems = list(read.dropped)
        for problem in meant.problems:
            problems.append(f"{name}: {problem}")
        if options.tolerance is not None:
            tolerance = in_unit("tolerance", options.tolerance, unit)
        most = played_tolerance(meant.values, values * options.gain, tolerance)
        slack = most / abs(options.gain)
        require_voltages(meant.values, lambda row: f"{name}: row {meant_rows[row]:,}")
    from_ = None
    if options.from_ is not None:
        from_ = in_unit("from_", options.from_, unit)
    suffix = suffix_of(unit)
    checked = check_drive(
        values,
        read.block.time,
        limits,
        from_=from_,
        loop=options.loop,
        tolerance=slack,
        place=lambda row: f"row {int(rows[row]):,}",
        suffix=suffix,
    )
    checked.problems[:0] = map(cleaned, problems)
    if meant is not None:
        steps = meant.step, read.step
        check_played(
            checked, meant.values, values, steps, tolerance, options.gain, suffix
        )
    return checked


def _note_of_unit(read: _Drive, options: CheckOptions) -> str:
    """Say in which unit plain limits are taken, where that is not volts."""
    if read.unit is None and options.has_plain_limits:
        column = cleaned(read.column)
        return (
            f"column '{column}' has no unit: limits are taken in what its figures count"
        )
    return plain_in(read.unit, *options.figures)


def _require_passed(name: str, checked: CheckedDrive) -> None:
    """Refuse a drive with problems, naming the first (LimitError)."""
    if not checked.problems:
        return
    text = f"{name}: {checked.problems[0]}"
    if len(checked.problems) > 1:
        text += f" (and {len(checked.problems) - 1} more)"
    raise LimitError(text)


def _report(name: str, checked: CheckedDrive, unit: str | None, form: str) -> str:
    """Return the check as text or JSON."""
    if form != "json":
        return "\n".join(_lines(name, checked, unit)) + "\n"
    content = {
        "format": "dbo-check",
        "version": 1,
        "name": name,
        "unit": unit,
        "passed": not checked.problems,
        **_finite(dataclasses.asdict(checked.figures)),
        "played": checked.played or None,
        "problems": [plain(text) for text in checked.problems],
    }
    return json.dumps(content, indent=2, ensure_ascii=False) + "\n"


def _finite(figures: dict[str, Any]) -> dict[str, Any]:
    """Return figures as JSON has them: there is no infinity in it."""
    finite = dict(figures)
    for key, value in figures.items():
        if value is not None and math.isinf(value):
            finite[key] = None
    return finite


class _Drive(NamedTuple):
    """A drive read whole.

    Attributes
    ----------
    block
        Its good rows.
    unit, column
        Of its column.
    step
        Its even step (s), where it has one.
    dropped
        Rows that hold no number, named.
    doubtful
        What the reader passed over in silence.
    remarks
        What is said of the reading.
    """

    block: SampleBlock
    unit: str | None
    column: str
    step: float | None
    dropped: list[str]
    doubtful: list[str]
    remarks: Remarks

    @property
    def values(self) -> Floats:
        """The good rows' figures."""
        return self.block.values["voltage"]

    @property
    def problems(self) -> list[str]:
        """What a program that plays the file would have to drop or to guess."""
        return self.dropped + self.doubtful


def _read(
    address: Address,
    voltage: str | None,
    reading: ReadingOptions,
    wanted: str | None = None,
) -> _Drive:
    """Return a drive read whole (in ``wanted``, where both units are known)."""
    options = dataclasses.replace(reading, skip_bad=True)
    want = {"voltage": column_wish("voltage", voltage, option="voltage")}
    with open_log(address, want, options) as log:
        _require_own_file(address, log.columns["voltage"].name)
        if wanted is not None and log.columns["voltage"].unit is not None:
            log.convert("voltage", wanted, "the recording is")
        block = joined(list(log.blocks()))
        step = 1.0 / log.stated_rate if log.stated_rate else None
        if step is None and block.time is not None:
            step = even_step(block.time)
        column = log.columns["voltage"]
        remarks = remarks_of(log)
        return _Drive(
            block,
            column.unit,
            column.name,
            step,
            _named(log.dropped),
            log.doubtful,
            remarks,
        )


def _require_own_file(address: Address, column: str) -> None:
    """Refuse a drive from another file (UsageError): between this file's rows nobody would look."""
    elsewhere = other_file(column)
    if elsewhere is None or elsewhere[0] == address.text:
        return
    file, name = elsewhere
    raise UsageError(
        f"`voltage`: a drive is checked in its own file, not on the rows of {cleaned(address.name)}: check "
        f"{cleaned(file)} (`voltage` {cleaned(name)})"
    )


def _named(dropped: DroppedRows) -> list[str]:
    """Return a line for each row that was dropped, and one for those beyond the first ones."""
    lines = []
    for bad in sorted(dropped.named):
        lines.append(f"row {bad.row:,}: {cleaned(bad.problem)}")
    rest = dropped.count - len(lines)
    if rest:
        lines.append(f"{rest:,} more rows hold no number")
    return lines


def _lines(name: str, checked: CheckedDrive, unit: str | None) -> list[str]:
    """Return the check as lines for a terminal."""
    figures = checked.figures
    suffix = suffix_of(unit)
    verdict = "NOT PASSED" if checked.problems else "passed"
    speed = ""
    if figures.seconds:
        speed = f", at most {figures.fastest:.6g}{suffix}/s"
    lines = [
        f"{name}: {verdict}",
        f"  {figures.rows:,} rows, {figures.low:.6g} to {figures.high:.6g}{suffix}, largest step "
        f"{figures.largest_step:.6g}{suffix}{speed}; first row {figures.first:.6g}{suffix}, last row "
        f"{figures.last:.6g}{suffix}",
    ]
    if checked.played:
        lines.append(_played_line(checked.played, suffix))
    return lines + [f"  {text}" for text in checked.problems]


def _played_line(played: dict[str, Any], suffix: str) -> str:
    """Return how what was played compares with the drive."""
    rows = f"{played['rows']:,} rows, {played['lag_rows']} later"
    if played["lag_seconds"]:
        rows += f" ({played['lag_seconds'] * 1e3:.4g} ms)"
    line = (
        f"  played: {rows}, gain {played['gain']:.6g}, "
        f"offset {played['offset']:.3g}{suffix}, "
        f"largest difference {played['largest_difference']:.3g}{suffix}"
    )
    if played["resampled"]:
        line += ", at another rate"
    if played["amplifier_gain"] != 1.0:
        line += f", times the amplifier's {played['amplifier_gain']:g}"
    if played["read_back_noise"]:
        noise, tolerance = played["read_back_noise"], played["tolerance"]
        line += f"; read back with noise of {noise:.2g}{suffix} (up to {tolerance:.2g}{suffix})"
    return line
