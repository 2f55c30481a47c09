"""``dbo compare``."""

from __future__ import annotations

from typing import Annotated

from dbo_cli.cli import options as opt
from dbo_cli.cli.options import option
from dbo_cli.cli.say import say_logs, working


def compare(
    logs: opt.LogFiles,
    reading: opt.Reading,
    output: opt.Output = "-",
    form: opt.TextOrJson = None,
    time: opt.Time = None,
    voltage: opt.Voltage = None,
    displacement: opt.Displacement = None,
    validate: Annotated[
        list[str] | None, option("LOG", "Log to test each operator on; repeatable.")
    ] = None,
    skip: opt.Skip = "0",
) -> None:
    """Compare the DBO with other hysteresis operators.

    Each is fitted to the same logs: error, parameters, and the cost of a step, forward
    and inverse.

    Example: dbo compare recorded.csv --validate other.csv
    """
    from dbo_cli.compare import compare as compare_operators
    from dbo_cli.files import check_outputs, write_text
    from dbo_cli.recordings import recordings_of

    check_outputs(output)
    columns = {"time": time, "voltage": voltage, "displacement": displacement}
    every, opened = recordings_of([*logs, *(validate or [])], columns, reading)
    recordings, tests = every[: len(logs)], every[len(logs) :]
    say_logs(opened[: len(logs)], sum(len(log.voltage) for log in recordings))
    working("fitting")
    seconds = opt.quantity("skip", skip, "s")
    result = compare_operators(recordings, tests, seconds)
    is_json = opt.form_of(form, output) == "json"
    write_text(output, result.json() if is_json else result.text())
