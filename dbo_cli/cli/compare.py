"""``dbo compare``."""

from dbo_cli.cli import options as opt
from dbo_cli.cli.options import Text, Texts, option
from dbo_cli.cli.say import say_logs, working
from dbo_cli.units import quantity


def compare(
    reading: opt.Reading,
    logs: list[str] = opt.LOGS,
    output: str = opt.OUTPUT_FILE,
    form: opt.TextOrJson = opt.FORM,
    time: Text = opt.TIME,
    voltage: Text = opt.VOLTAGE,
    displacement: Text = opt.DISPLACEMENT,
    validate: Texts = option("LOG", "Log to test each operator on; repeatable."),
    skip: str = opt.SKIP,
) -> None:
    """Compare the Discrete Backlash Operator (DBO) with other operators.

    Each is fitted to the same logs: error, parameters, and the cost of a step, forward
    and inverse.

    Example: dbo compare recorded.csv --validate other.csv
    """
    from dbo_cli.compare import compare_operators, compared_text
    from dbo_cli.files import check_outputs, write_text
    from dbo_cli.recordings import recordings_of
    from dbo_cli.reports.words import json_text

    check_outputs(output)
    columns = {"time": time, "voltage": voltage, "displacement": displacement}
    every, opened = recordings_of([*logs, *(validate or [])], columns, reading)
    recordings, tests = every[: len(logs)], every[len(logs) :]
    say_logs(opened[: len(logs)])
    working("fitting")
    seconds = quantity("skip", skip, "s")
    result = compare_operators(recordings, tests, seconds)
    is_json = opt.form_of(form, output) == "json"
    write_text(output, json_text(result) if is_json else compared_text(result))
