"""``dbo compare``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from typer import Option

from dbo_cli.cli.identify import units_of
from dbo_cli.cli.options import (
    Displacement,
    LogFiles,
    Output,
    TextOrJson,
    Time,
    Voltage,
    quantity,
    reads_logs,
)
from dbo_cli.cli.say import detail, say, working

if TYPE_CHECKING:
    from dbo_cli.logs import Reading


@reads_logs
def compare(
    logs: LogFiles,
    reading: Reading,
    output: Output = "-",
    form: TextOrJson = None,
    time: Time = None,
    voltage: Voltage = None,
    displacement: Displacement = None,
    validate: Annotated[
        list[str] | None,
        Option(
            metavar="LOG",
            help="Another log, to say how well each predicts it; repeatable.",
        ),
    ] = None,
    skip: Annotated[
        str, Option(metavar="SECONDS", help="Leave out the beginning of every log.")
    ] = "0",
) -> None:
    """Compare the DBO with the operators that its publication names.

    Each is fitted to the same logs: error, parameters, and what a step forward and
    inverse costs.

    Example: dbo compare recorded.csv --validate other.csv
    """
    from dbo_cli.compare import compare as compare_operators
    from dbo_cli.logs import write_text
    from dbo_cli.recordings import read_recordings

    columns = {"time": time, "voltage": voltage, "displacement": displacement}
    recordings, opened = read_recordings(logs, reading, columns)
    others, _ = read_recordings(validate or [], reading, columns, units_of(recordings))
    for log in opened:
        say(log.line())
        detail(*log.remarks)
    working("fitting")
    found = compare_operators(
        recordings, others, options={"skip": quantity("skip", skip, "s") or 0.0}
    )
    as_json = form == "json" or (form is None and output.endswith(".json"))
    write_text(output, found.json() if as_json else found.text())
