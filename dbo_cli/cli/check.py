"""``dbo check``."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from dbo_cli.cli import options as opt
from dbo_cli.cli.options import Text, Texts, column, flag, option, rare
from dbo_cli.cli.say import detail, with_options
from dbo_cli.errors import InputError, LimitError, UsageError, warn

if TYPE_CHECKING:
    from dbo_cli.drive.limits import Limits
    from dbo_cli.logs import Block, Log


def check(
    reading: opt.Reading,
    drive: str = opt.DRIVE,
    output: str = opt.OUTPUT_FILE,
    form: opt.TextOrJson = opt.FORM,
    v_min: Texts = opt.V_MIN,
    v_max: Texts = opt.V_MAX,
    max_slew: Texts = opt.MAX_SLEW,
    start: Texts = opt.FROM,
    loop: bool = flag("--loop", "Also check the step from the last row to the first."),
    against: Text = option("FILE", "The file to play; DRIVE is a recording of it."),
    gain: float = rare(
        "FACTOR",
        "With --against: multiplies DRIVE; limits hold behind it.",
        default=1.0,
    ),
    tolerance: Text = option("VOLT", "With --against: largest difference allowed."),
    time: Text = opt.TIME,
    voltage: Text = column("The drive voltage: name or number."),
) -> None:
    """Check a drive against the limits of an amplifier.

    Exit code 3: a limit is broken, a row holds no number, or another drive was played.

    Examples: dbo check drive.csv --v-min 0 --v-max 100 --max-slew 2000 --from 0;
    dbo check played.csv --against drive.csv
    """
    from dbo_cli import channels
    from dbo_cli.drive.check import check_drive, check_played, tolerance_of
    from dbo_cli.files import write_text
    from dbo_cli.units import parse_quantity

    if not math.isfinite(gain) or not gain or (gain != 1.0 and against is None):
        raise UsageError(f"`gain` {gain:g}: give a factor, together with `against`")
    opt.require("against", against, {"tolerance": tolerance})
    if not (v_min or v_max or max_slew or loop or against):
        raise UsageError(
            "nothing to check: add `v_min`, `v_max`, `max_slew`, `loop` or `against`"
        )
    columns = {"time": time, "voltage": voltage}
    columns_of = channels.columns_of([drive], reading, columns)
    ranges = {"v_min": v_min, "v_max": v_max, "max_slew": max_slew, "from": start}
    typed = channels.values_for(ranges, columns_of)
    checks = {}
    for channel, roles in columns_of.items():
        signal, log = read_drive(drive, reading, roles)
        unit = log.columns["voltage"].unit
        if max_slew and log.clock.assumption:
            warn(f"{drive}: {log.clock.assumption}")
        stands = typed[channel].pop("from")
        recorded, slack = signal["voltage"] * gain, 0.0
        allowed = None
        if tolerance is not None:
            allowed = parse_quantity(tolerance, unit, "tolerance", 0.0)
        if against is not None:
            column = roles["voltage"] if channel else None
            meant = read_meant(against, column, unit)
            slack = tolerance_of(meant["voltage"], recorded, allowed)
        result = checks[channel] = check_drive(
            recorded,  # limits are those of the amplifier's output
            signal.time,
            limits_in(unit, **typed[channel]),
            name=f"{drive}: channel {channel}" if channel else drive,
            start=None if stands is None else parse_quantity(stands, unit, "from", 0.0),
            loop=loop,
            tolerance=slack,
            doubts=log.doubtful,
        )
        if against is not None:
            steps = step_between(meant), step_between(signal)
            check_played(result, meant["voltage"], recorded, steps, slack)
        detail(*log.doubtful)
    is_json = opt.form_of(form, output) == "json"
    if is_json:
        pages = {name: result.json() for name, result in checks.items()}
        write_text(output, channels.dumps_files("check", pages))
    else:
        texts = [with_options(result.text()) for result in checks.values()]
        write_text(output, "".join(texts))
    for result in checks.values():
        result.require_passed()


def read_drive(
    path: str,
    reading: opt.Reading,
    columns: dict[str, str | None],
    unit: str | None = None,
) -> tuple[Block, Log]:
    """Read a drive whole, as strictly as it was written.

    Raises
    ------
    LimitError
        A row holds no number: an amplifier cannot play it.
    UsageError
        The drive is in another file than its time: interpolated, it is not the drive.
    """
    from dbo_cli.logs import open_log
    from dbo_cli.recordings import warn_of_assumed

    if "::" in (columns["voltage"] or ""):
        raise UsageError(f"`voltage` {columns['voltage']}: name that file as DRIVE")
    units = {} if unit is None else {"voltage": unit}
    with open_log(path, columns, reading, units) as log:
        try:
            table = log.read()
        except InputError as problem:
            raise LimitError(str(problem)) from problem
        warn_of_assumed(log)
    return table, log


def read_meant(path: str, column: str | None, unit: str | None) -> Block:
    """Read the drive that was meant to be played (InputError): the only one of its file."""
    from dbo_cli.logs import Reading

    try:
        return read_drive(path, Reading(), {"time": None, "voltage": column}, unit)[0]
    except InputError as problem:
        raise InputError(
            f"`against` takes the only drive of its file: call its column voltage_V there ({problem})"
        ) from None


def step_between(table: Block) -> float | None:
    """Return the seconds from row to row; None where they are uneven, or no clock is known."""
    return table.dt if isinstance(table.dt, float) else None


def limits_in(
    unit: str | None, v_min: str | None, v_max: str | None, max_slew: str | None
) -> Limits:
    """Return the limits in the unit of the drive; infinite where not given."""
    from dbo_cli.drive import Limits
    from dbo_cli.model import Quantity

    anything = Quantity("voltage", unit, -math.inf, math.inf)
    return Limits.within(anything, v_min, v_max, max_slew)
