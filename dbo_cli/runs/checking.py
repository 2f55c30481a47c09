"""Check a drive in a file against limits, and against what was to be played."""

from __future__ import annotations

import dataclasses
import json

import numpy as np

from dbo_cli.drives.check import CheckedDrive, check_drive, check_played, played_tolerance
from dbo_cli.drives.options import Figure, check_gain, limits_in, plain_in
from dbo_cli.errors import LimitError, Remarks, UsageError, plain
from dbo_cli.logs.columns import wish
from dbo_cli.logs.request import ALL_ROWS, Address, Given, ReadingOptions, check_document, selected_files
from dbo_cli.logs.sample_block import SampleBlock, even_step, joined
from dbo_cli.logs.signal_log import open_log
from dbo_cli.logs.sources import remarks_of
from dbo_cli.logs.units import in_unit
from dbo_cli.logs.whole_output import check_output, write_whole
from dbo_cli.records import dataclass


@dataclass(frozen=True)
class CheckOptions:
    """What a drive is checked for.

    Limits are infinite where not given; numbers are in the unit of the drive's file, texts have their own
    (``"1.2kV"``). With ``against``, the drive is a recording of what was played, and ``against`` the file of
    what was to be; ``gain`` is that of an amplifier between the two places.
    ``voltage`` is the drive's column.
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
            raise UsageError("`gain` is that behind a recording (`against` FILE is the drive it is of)")


def check_file(
    drive: Address, output: Address, form: str | None, reading: ReadingOptions, options: CheckOptions
) -> Remarks:
    """Write what is wrong with a drive, as text or JSON (``dbo-check``).

    Raises
    ------
    LimitError
        A limit is broken, or something else was played; the report is written all the same.
    """
    against = options.against
    chosen = form or ("json" if output.text.lower().endswith(".json") else "text")
    check_document(output, "a check", chosen)
    inputs: list[Given] = [drive, *([] if against is None else [against])]
    inputs += selected_files(options.voltage, reading.time)
    check_output(output, inputs)
    block, unit, step, remarks = _read(drive, options.voltage, reading)
    values, rows = block.values["voltage"], np.asarray(block.rows)
    if against is not None:
        other, _, own, more = _read(
            against, None, dataclasses.replace(reading, rows=ALL_ROWS, time=None), unit
        )
        remarks.add(more)
        most = None if options.tolerance is None else in_unit("tolerance", options.tolerance, unit)
        slack = played_tolerance(other.values["voltage"], most) / abs(options.gain)
    suffix = f" {unit}" if unit else ""
    checked = check_drive(
        values,
        block.time,
        limits_in(unit, options.v_min, options.v_max, options.max_slew),
        from_=None if options.from_ is None else in_unit("from_", options.from_, unit),
        loop=options.loop,
        tolerance=0.0 if against is None else slack,
        place=lambda row: f"row {int(rows[row]):,}",
        suffix=suffix,
    )
    missing = np.diff(rows) > 1
    if missing.any():
        checked.problems.insert(0, f"row {int(rows[np.argmax(missing)]) + 1:,}: holds no number")
    if against is not None:
        check_played(checked, other.values["voltage"], values, (own, step), most, options.gain, suffix)
    name = drive.name
    if read := plain_in(
        unit, options.v_min, options.v_max, options.max_slew, options.from_, options.tolerance
    ):
        remarks.note([f"{name}: {read}"])
    lines = _lines(name, checked, unit)
    found = {"format": "dbo-check", "version": 1, "name": name, "unit": unit, "passed": not checked.problems,
             **dataclasses.asdict(checked.figures), "played": checked.played or None,
             "problems": [plain(text) for text in checked.problems]}  # fmt: skip
    text = json.dumps(found, indent=2, ensure_ascii=False) if chosen == "json" else "\n".join(lines)
    write_whole(output, (text + "\n").encode(), protect=inputs)
    if checked.problems:
        more_of = f" (and {len(checked.problems) - 1} more)" if len(checked.problems) > 1 else ""
        raise LimitError(f"{name}: {checked.problems[0]}{more_of}")
    return remarks


def _read(
    address: Address, voltage: str | None, reading: ReadingOptions, wanted: str | None = None
) -> tuple[SampleBlock, str | None, float | None, Remarks]:
    """Return a drive read whole (in ``wanted``, where both units are known), its unit and its even step (s).

    Rows that hold no number are dropped.
    """
    options = dataclasses.replace(reading, skip_bad=True)
    with open_log(address, {"voltage": wish("voltage", voltage, option="voltage")}, options) as log:
        if wanted is not None and log.columns["voltage"].unit is not None:
            log.convert("voltage", wanted, "the recording is")
        block = joined(list(log.blocks()))
        step = 1.0 / log.stated_rate if log.stated_rate else None
        if step is None and block.time is not None:
            step = even_step(block.time)
        return block, log.columns["voltage"].unit, step, remarks_of(log)


def _lines(name: str, checked: CheckedDrive, unit: str | None) -> list[str]:
    """Return the check as lines for a terminal."""
    figures, u = checked.figures, f" {unit}" if unit else ""
    speed = f", at most {figures.fastest:.6g}{u}/s" if figures.seconds else ""
    lines = [
        f"{name}: {'passed' if not checked.problems else 'NOT PASSED'}",
        f"  {figures.rows:,} rows, {figures.low:.6g} to {figures.high:.6g}{u}, largest step "
        f"{figures.largest_step:.6g}{u}{speed}; first row {figures.first:.6g}{u}, last row "
        f"{figures.last:.6g}{u}",
    ]
    if checked.played:
        one = checked.played
        late = f" ({one['lag_seconds'] * 1e3:.4g} ms)" if one["lag_seconds"] else ""
        gain, after = one["amplifier_gain"], ", at another rate" if one["resampled"] else ""
        after += f", times the amplifier's {gain:g}" if gain != 1.0 else ""
        lines.append(
            f"  played: {one['rows']:,} rows, {one['lag_rows']} later{late}, gain {one['gain']:.6g}, offset "
            f"{one['offset']:.3g}{u}, largest difference {one['largest_difference']:.3g}{u}{after}"
        )
    return lines + [f"  {text}" for text in checked.problems]
