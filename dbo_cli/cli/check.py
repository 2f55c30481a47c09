"""``dbo check``."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

from typer import Argument, Option

from dbo_cli.cli.options import (
    From,
    MaxSlew,
    Output,
    Text,
    TextOrJson,
    Time,
    VMax,
    VMin,
    Voltage,
    number,
    reads_logs,
)
from dbo_cli.cli.say import detail
from dbo_cli.errors import InputError, LimitError, UsageError

if TYPE_CHECKING:
    from dbo_cli.drive.limits import Limits
    from dbo_cli.logs import Reading


class Signal(NamedTuple):
    """A drive that was read whole: its unit, time (s), step (s), and what its reader doubts."""

    voltage: Any
    unit: str | None
    time: Any
    step: float | None
    doubts: list[str]


@reads_logs
def check(
    drive: Annotated[
        str, Argument(metavar="DRIVE", help="The drive, of any program; - is stdin.")
    ],
    reading: Reading,
    output: Output = "-",
    form: TextOrJson = None,
    v_min: VMin = None,
    v_max: VMax = None,
    max_slew: MaxSlew = None,
    start: From = None,
    loop: Annotated[
        bool, Option("--loop", help="The drive repeats: its seam counts, too.")
    ] = False,
    against: Annotated[
        Text,
        Option(
            metavar="FILE",
            help="The drive is a recording; was this file what was played?",
        ),
    ] = None,
    gain: Annotated[
        str,
        Option(
            metavar="FACTOR",
            help="With --against: gain of an amplifier behind the recording.",
            hidden=True,
        ),
    ] = "1",
    tolerance: Annotated[
        Text,
        Option(
            metavar="VOLT",
            help="With --against: largest difference; 0.1 % of the range, or the noise.",
        ),
    ] = None,
    time: Time = None,
    voltage: Voltage = None,
) -> None:
    """Check a drive of any program against the limits of an amplifier, before it is played.

    The exit code is 3 where a limit is broken, a row holds no number, or what was played
    is another drive.

    Examples: dbo check drive.csv --v-min 0 --v-max 100 --max-slew 2000 --from 0;
    dbo check played.csv --against drive.csv --v-min 0 --v-max 100
    """
    from dbo_cli.drive.check import check_drive, check_played, tolerance_of
    from dbo_cli.logs import write_text

    factor = number("gain", gain) or 0.0
    if not factor or (factor != 1.0 and against is None):
        raise UsageError(
            f"`gain` {gain}: give a number other than 0, together with `against` FILE"
        )
    columns = {"time": time, "voltage": voltage}
    signal = read_drive(drive, reading, columns, None)
    limits = limits_in(signal.unit, v_min, v_max, max_slew)
    allowed, slack, meant = None, 0.0, None
    if against is not None:
        meant = read_drive(
            against, reading_of_drive(), {"time": None, "voltage": None}, signal.unit
        )
        allowed = (
            None if tolerance is None else in_unit("tolerance", tolerance, signal.unit)
        )
        slack = tolerance_of(meant.voltage, signal.voltage * factor, allowed) / abs(
            factor
        )
    checked = check_drive(
        signal.voltage,
        signal.time,
        limits,
        name=drive,
        start=None if start is None else in_unit("from", start, signal.unit),
        loop=loop,
        tolerance=slack,
        doubts=signal.doubts,
    )
    if meant is not None:
        check_played(
            checked,
            meant.voltage,
            signal.voltage * factor,
            (meant.step, signal.step),
            allowed,
        )
    as_json = form == "json" or (form is None and output.endswith(".json"))
    write_text(output, checked.json() if as_json else checked.text())
    detail(*signal.doubts)
    checked.require_passed()


def read_drive(
    path: str, reading: Reading, columns: dict[str, str | None], unit: str | None
) -> Signal:
    """Read a drive whole, as strictly as it was written.

    Raises
    ------
    LimitError
        A row holds no number: an amplifier cannot play it.
    UsageError
        The drive is in another file than its time.
    """
    from dbo_cli.logs import open_log

    typed = columns["voltage"]
    if typed is not None and "::" in typed:
        file, _, name = typed.rpartition("::")
        raise UsageError(
            f"`voltage` {typed}: a drive is checked in its own file (dbo check {file} --voltage {name})"
        )
    units = {} if unit is None else {"voltage": unit}
    with open_log(path, columns, reading, units) as log:
        try:
            table = log.read()
        except InputError as problem:
            raise LimitError(str(problem)) from problem
        step = table.dt if isinstance(table.dt, float) else None
        return Signal(
            table["voltage"],
            log.columns["voltage"].unit,
            table.time,
            step,
            list(log.doubtful),
        )


def reading_of_drive() -> Reading:
    """Return how the drive is read that was to be played: as this program wrote it."""
    from dbo_cli.logs import Reading

    return Reading()


def limits_in(
    unit: str | None, v_min: str | None, v_max: str | None, max_slew: str | None
) -> Limits:
    """Return the limits in the unit of the drive; infinite where not given."""
    from dbo_cli.drive.limits import Limits

    low = -math.inf if v_min is None else in_unit("v_min", v_min, unit)
    high = math.inf if v_max is None else in_unit("v_max", v_max, unit)
    if not low < high:
        raise UsageError(f"`v_min` {v_min} must be below `v_max` {v_max}")
    slew = None if max_slew is None else in_unit("max_slew", max_slew, unit, "/s")
    if slew is not None and not slew > 0.0:
        raise UsageError(f"`max_slew` {max_slew}: give a number above 0")
    return Limits((low, high), (low, high), (low, high), slew, unit)


def in_unit(name: str, typed: str, unit: str | None, per: str = "") -> float:
    """Return a limit in the unit of a drive; a unit with a prefix has to be typed."""
    from dbo_cli.units import parse_quantity, parse_unit

    known = parse_unit(unit)
    prefixed = known is not None and known.base != known.text
    if prefixed and number_like(typed):
        raise UsageError(
            f"`{name}` {typed}: the drive is in {unit}; give the unit ({typed}{unit}{per})"
        )
    return parse_quantity(typed, None if unit is None else unit + per, name)


def number_like(text: str) -> bool:
    """Return whether a text is a number without a unit."""
    try:
        float(text)
    except ValueError:
        return False
    return True
