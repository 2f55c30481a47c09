"""``dbo check``: any program's drive against limits, and what was played against what was to be."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dbo_cli.cli import options
from dbo_cli.cli.messages import Voice

if TYPE_CHECKING:
    from dbo_cli.logs.reading_options import ReadingOptions


def check(
    *,
    drive: options.Drive,
    log_reading: ReadingOptions,
    voice: Voice,
    v_min: options.CheckMin,
    v_max: options.CheckMax,
    max_slew: options.MaxSlew,
    from_: options.From,
    loop: options.Loop,
    against: options.Against,
    tolerance: options.Tolerance,
    form: options.ShowFormat,
    voltage: options.DriveColumn,
    output: options.Output,
) -> None:
    """Check a drive of any program against the limits of an amplifier, before it is played.

    Range, slew, the first row (--from), the seam of a loop (--loop), gaps, repeated times and rows without a
    number: what breaks a limit is named with its row, and the exit code is 3. With --against, the first file
    is a recording of what was played, and the question is whether it was that drive: rows, lag, gain, offset.

    Example: dbo check played.csv --against drive.csv --v-min 0 --v-max 100 --max-slew 2000
    """
    from dbo_cli.runs.checking import CheckOptions, check_file

    asked = CheckOptions(v_min, v_max, max_slew, from_, loop, tolerance)
    voice.remarks(
        check_file(drive, output, form, log_reading, asked, voltage=voltage, against=against)
    )
