"""``dbo check``."""

import math

from dbo_cli.cli import options as opt
from dbo_cli.cli.options import Text, Texts, column, flag, option, rare
from dbo_cli.cli.say import detail, with_options
from dbo_cli.errors import UsageError, warn
from dbo_cli.units import quantity


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
    from dbo_cli.drive import Limits
    from dbo_cli.drive.check import check_drive, check_played, tolerance_of
    from dbo_cli.files import write_text
    from dbo_cli.recordings import read_drive, read_meant

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
        log, signal = read_drive(drive, roles, reading)
        unit = log.columns["voltage"].unit
        if max_slew and log.clock.assumption:
            warn(f"{drive}: {log.clock.assumption}")
        begin = quantity("from", typed[channel].pop("from"), unit, largest=0.0)
        recorded, slack = signal["voltage"] * gain, 0.0
        allowed = quantity("tolerance", tolerance, unit, largest=0.0)
        if against is not None:
            column = roles["voltage"] if channel else None
            meant = read_meant(against, column, unit)
            slack = tolerance_of(meant["voltage"], recorded, allowed)
        result = checks[channel] = check_drive(
            recorded,  # limits are those of the amplifier's output
            signal.time,
            Limits.in_unit(unit, **typed[channel]),
            name=f"{drive}: channel {channel}" if channel else drive,
            start=begin,
            loop=loop,
            tolerance=slack,
            doubts=log.doubtful,
        )
        if against is not None:
            times = meant.time, signal.time
            check_played(result, meant["voltage"], recorded, times, slack)
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
