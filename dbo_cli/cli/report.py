"""``dbo report``."""

from __future__ import annotations

import dataclasses
import os
import shlex
import sys
from typing import TYPE_CHECKING, Any, Literal

from dbo_cli.cli import options as opt
from dbo_cli.cli.options import Text, column, flag, option, rare
from dbo_cli.cli.say import detail, say, with_options
from dbo_cli.errors import UsageError, warn
from dbo_cli.units import quantity

if TYPE_CHECKING:
    from dbo_cli.reports import Report

COMPARED, BOUNDS = "Comparison", "Bounds (exit 3)"


def report(
    reading: opt.Reading,
    logs: list[str] = opt.LOGS,
    output: str = opt.OUTPUT_FILE,
    form: Literal["text", "json", "csv", "html"] | None = opt.FORM,
    figures: Text = opt.FIGURES_DIR,
    desired: Text = column("Desired displacement."),
    measured: Text = column("Measured displacement."),
    voltage: Text = column("The drive, for --model and the figures."),
    time: Text = opt.TIME,
    trajectory: Text = option("FILE", "The file of the desired values.", COMPARED),
    match: Literal["auto", "time", "rows"] = rare(
        None, "How rows of log and --trajectory match.", COMPARED, default="auto"
    ),
    model: Text = option("MODEL", "Compare with the prediction of a model.", COMPARED),
    state: str = option(
        "NAME|FILE", "With --model: where the model starts.", COMPARED, default="auto"
    ),
    expected: Text = option(
        "SUMMARY", "Summary of the drive: its stated error.", COMPARED
    ),
    lag: int = rare("N", "Rows by which measured is taken later.", COMPARED, default=0),
    remove_offset: bool = flag("--remove-offset", "Subtract the mean error.", COMPARED),
    max_rmse: Text = option("VALUE", "Largest RMS error, such as 10nm.", BOUNDS),
    max_nrmse_percent: Text = option("PERCENT", "RMS error in % of the move.", BOUNDS),
) -> None:
    """Report how well a displacement follows the desired one.

    Several logs are put side by side.

    Examples: dbo report uncompensated.csv compensated.csv -o report.html;
    dbo report tracked.csv --trajectory drive.csv --max-nrmse-percent 1
    """
    from dbo_cli import channels
    from dbo_cli.logs import parse_rows
    from dbo_cli.recordings import matched, pairs_of
    from dbo_cli.reports import Report, expected_in

    if model is not None and trajectory is not None:
        raise UsageError("give either `model` or `trajectory`")
    opt.require("model", model, {"state": state != "auto"})
    opt.require("trajectory", trajectory, {"match": match != "auto"})
    # a lag, a model and a match by rows need the rows around those that count
    rows = None if reading.rows is None else parse_rows(reading.rows)
    reading = dataclasses.replace(reading, rows=None)
    columns = {"time": time, "measured": measured, "voltage": voltage}
    if model is None and trajectory is None:
        columns["desired"] = desired
    columns_of = channels.columns_of(logs, reading, columns)
    models = {} if model is None else channels.models_of(model, columns_of, columns)
    starts = channels.states_of(state, models)
    summaries: dict[str, tuple[str, Any]] = dict.fromkeys(columns_of, ("", None))
    if expected is not None:
        summaries = channels.members_of(expected, "summary", columns_of)
    results = {}
    for channel, roles in columns_of.items():
        actuator = models.get(channel)
        with channels.naming(channel):
            if trajectory is not None:
                column = channels.columns_for({"desired": desired}, channel)["desired"]
                has_summary = expected is not None
                pairs, units, opened = matched(
                    logs, roles, reading, trajectory, column, match, has_summary
                )
            else:
                start = starts.get(channel, "auto")
                pairs, units, opened = pairs_of(
                    logs, roles, reading, actuator, start, model or ""
                )
            counted = []
            for pair, name in zip(pairs, short_names(logs), strict=True):
                counted.append(dataclasses.replace(pair, rows=rows, name=name))
            unit = units.get("measured")
            label, summary = summaries[channel]
            results[channel] = Report(
                counted,
                unit=unit,
                voltage_unit=units.get("voltage"),
                lag=lag,
                remove_offset=remove_offset,
                expected=expected_in(summary, unit, label),
                max_rmse=quantity("max_rmse", max_rmse, unit),
                max_nrmse_percent=quantity("max_nrmse_percent", max_nrmse_percent, "%"),
                model=actuator,
                command=shlex.join(["dbo", *sys.argv[1:]]),
            )
        for log in opened:
            detail(*log.remarks)
    publish(results, output, opt.form_of(form, output), figures)


def publish(
    results: dict[str, Report], output: str, form: str, figures: str | None
) -> None:
    """Write reports and figures, say what came out, and refuse a bound that is missed.

    Of channels, text and JSON stand in one file, other forms in a file a channel.
    """
    from dbo_cli import channels
    from dbo_cli.files import Outputs

    texts = {}
    for name, result in results.items():
        text: str = getattr(result, f"to_{form}")()
        # what people read names options as they are typed
        texts[name] = with_options(text) if form in ("text", "html") else text
    files = _files_of(texts, output, form)
    with Outputs() as outputs:
        if figures is not None:
            for name, result in results.items():
                outputs.write_all(os.path.join(figures, name), result.drawn())
        for path, text in files.items():
            outputs.write_text(path, text)
    for name, result in results.items():
        label = f"{name}: " if name else ""
        if output != "-":
            say(label + result.line())
        detail(*result.notes)
        for text in result.warnings:
            warn(label + text)
    for name, result in results.items():
        with channels.naming(name):
            result.require_passed()


def _files_of(texts: dict[str, str], output: str, form: str) -> dict[str, str]:
    """Return the text of each file, of the texts of the channels."""
    from dbo_cli import channels

    if form == "json":
        return {output: channels.dumps_files("report", texts)}
    if form == "text":
        pages = [f"channel {name}\n" * bool(name) + texts[name] for name in texts]
        return {output: "\n".join(pages)}
    paths = channels.paths_of(output, texts)
    return {path: texts[name] for name, path in paths.items()}


def short_names(logs: list[str]) -> list[str]:
    """Return the names of files without their folders, where they all differ then."""
    names = [os.path.basename(path) or path for path in logs]
    return names if len(set(names)) == len(logs) else logs
