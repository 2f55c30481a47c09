"""Which way a use case goes: over one log, over the channels that a pattern names, or over many files."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from dbo_cli import extensions
from dbo_cli.errors import InputError, Listener, Remarks, UsageError, as_options
from dbo_cli.logs.columns import is_pattern
from dbo_cli.logs.request import Address, check_document, parse_address
from dbo_cli.logs.whole_output import check_outputs, make_folder
from dbo_cli.runs.files import Destination, SignalRun, write_json
from dbo_cli.runs.jobs import (
    FILE,
    Outcome,
    Work,
    check_names,
    each_file,
    of_file,
    spread_line,
    sum_up,
    summed_up,
)

if TYPE_CHECKING:
    from dbo_cli.runs.identifying import IdentifyResult, IdentifyRun
    from dbo_cli.runs.reporting import ReportRun

CHANNEL = "{channel}"
"""In the name of an output: the channel's name."""

_PLACES = ("{}", CHANNEL, FILE)
# files of 1,000 rows: importing polars (0.1 s) costs less than formatting them in
# Python
_WORTH_POLARS = 32


def run_signals(
    run: SignalRun, logs: Sequence[Address], work: Work, listener: Listener
) -> Outcome:
    """Run ``simulate`` or ``compensate`` over one log, the channels that a pattern names, or many files.

    Raises
    ------
    UsageError
        Patterns, names of files and logs contradict each other.
    """
    output = run.destination.output
    if not _are_many(logs, output, run.column):
        return Outcome(run.run(listener))
    run.refuse_many()
    if wants_channels(output, run.column):
        if len(logs) > 1:
            raise UsageError(
                f"{len(logs)} logs, and a pattern of columns of one: give one log"
            )
        outcome: Outcome = extensions.find("run", "signals of channels")(
            run, work, listener
        )
        return outcome
    return _signals_of_files(run, logs, work, listener)


def _signals_of_files(
    run: SignalRun, logs: Sequence[Address], work: Work, listener: Listener
) -> Outcome:
    """Run ``simulate`` or ``compensate`` over each log."""
    if FILE not in run.destination.output.text and len(logs) > 1:
        raise UsageError(
            f"{len(logs)} logs and one output, {run.destination.output.text}: put {FILE} into its name "
            f"(-o 'out/{FILE}.csv')"
        )
    places = _of_files(run.destination, logs)
    if len(logs) >= _WORTH_POLARS and work.processes == 1:
        import polars  # noqa: F401 - text of small files, too, is then written by it, the same bytes
    calls = [
        (log, dataclasses.replace(run, log=log, destination=place).run)
        for log, place in zip(logs, places, strict=True)
    ]
    remarks, outcome = each_file(calls, work, listener)
    read = {name: of_log.read for name, of_log in remarks.items()}
    outcome.remarks.read += summed_up(read, "file")
    sum_up(outcome.remarks, remarks, "file")
    return outcome


def _of_files(destination: Destination, logs: Sequence[Address]) -> list[Destination]:
    """Return where the outputs of each log go; their folders are made.

    Raises
    ------
    UsageError
        Two logs have one name, or an output that every log would write lacks
        ``{file}``.
    OutputError
        An output cannot be written.
    """
    if destination.live:
        raise UsageError("`flush` follows one log row by row: give one")
    for option in ("save_state", "summary"):
        address = getattr(destination, option)
        if address is not None and FILE not in address.text:
            raise UsageError(
                f"`{option}` {address.text}: each log has its own (put {FILE} into its name)"
            )
    check_names(destination.output, logs)
    protected = [log for log in destination.protect if log not in set(logs)]
    places = [
        destination._replace(protect=[*protected, log]).placed(
            functools.partial(of_file, log=log)
        )
        for log in logs
    ]
    check_outputs([place.output for place in places], destination.protect)
    return places


def identify_one_or_many(
    run: IdentifyRun, output: Address, work: Work, listener: Listener
) -> Outcome:
    """Identify one model of all logs, one of each channel, or one of each log (``{file}``)."""
    if _are_many(run.logs[:1], output, run.voltage, run.displacement):
        if wants_channels(output, run.voltage, run.displacement):
            outcome: Outcome = extensions.find("run", "identify channels")(
                run, output, work, listener
            )
            return outcome
        if not run.brought:
            return identify_files(run, output, work, listener)
    run.refuse_channels_options()
    result = run.run(output, listener)
    read, remarks = result.remarks.read, result.remarks
    return Outcome(Remarks([*remarks.notes, *result.summary], remarks.warnings, read))


def run_report(run: ReportRun, work: Work, listener: Listener) -> Outcome:
    """Report on logs side by side, or on the channels that a pattern names."""
    from dbo_cli.runs.reporting import report_logs

    columns = (run.options.desired, run.options.measured, run.options.voltage)
    if _are_many([], run.output, *columns):
        outcome: Outcome = extensions.find("run", "report channels")(
            run, work, listener
        )
        return outcome
    return report_logs(run, listener)


def _are_many(logs: Sequence[Address], output: Address, *selectors: str | None) -> bool:
    """Tell whether there is more than one run, or a name that asks for more."""
    if len(logs) > 1:
        return True
    for text in (output.text, *selectors):
        if text is not None and any(place in text for place in _PLACES):
            return True
    return False


def wants_channels(output: Address, *selectors: str | None) -> bool:
    """Tell whether columns are named by a pattern.

    Raises
    ------
    UsageError
        An output is to be written for each channel, and there is no pattern.
    """
    if any(map(is_pattern, selectors)):
        return True
    if CHANNEL in output.text:
        raise UsageError(
            f"{output.text}: {CHANNEL} stands for a channel's name: name the columns by a pattern, 'V{{}}'"
        )
    return False


def identify_files(
    run: IdentifyRun, output: Address, work: Work, listener: Listener
) -> Outcome:
    """Identify a model of each log by itself."""
    from dbo_cli.runs.identifying import sign_warning

    check_names(output, run.logs)
    files = [of_file(output, log) for log in run.logs]
    of_all = None
    if run.summary is not None and FILE not in run.summary.text:
        of_all = run.summary
        check_document(of_all, "a summary", "json")
        run = dataclasses.replace(run, summary=None)
    documents = files if of_all is None else [*files, of_all]
    check_outputs(documents, [*run.logs, *run.validation])
    calls = []
    for log, file in zip(run.logs, files, strict=True):
        summary = None if run.summary is None else of_file(run.summary, log)
        of_log = dataclasses.replace(run, logs=[log], summary=summary)
        calls.append((log, functools.partial(of_log.run, file)))
    results, outcome = each_file(calls, work, listener)
    read = {name: result.remarks.read for name, result in results.items()}
    outcome.remarks.read += summed_up(read, "file")
    models = {name: result.model for name, result in results.items()}
    exchanged = sign_warning(models, "file")
    if exchanged is not None:
        outcome.remarks.warn(exchanged)
    if of_all is not None:
        write_json(of_all, _summaries_of_logs(run, results, outcome.failures))
    if len(run.logs) == 1 and results:
        outcome.remarks.notes += next(iter(results.values())).summary
    say_found(results, "file", outcome.remarks)
    return outcome


def _summaries_of_logs(
    run: IdentifyRun, results: Mapping[str, IdentifyResult], failures: Mapping[str, str]
) -> list[dict[str, Any]]:
    """Return for each log, in their order, what was identified, or why nothing was (``failed``)."""
    from dbo_cli.runs.identifying import summary_of_model

    summaries = []
    for log in run.logs:
        result = results.get(log.text)
        if result is None:
            what = {
                "format": "dbo-summary",
                "version": 1,
                "command": run.command,
                "failed": as_options(failures[log.text]),
            }
        else:
            what = {**summary_of_model(result, run.command), "failed": None}
        summaries.append({"file": log.text, **what})
    return summaries


def say_found(
    results: Mapping[str, IdentifyResult], noun: str, remarks: Remarks
) -> None:
    """Sum up what was found over all channels or files."""
    remarks_of = {name: result.remarks for name, result in results.items()}
    first_warnings = {}
    for name, of_name in remarks_of.items():
        first_warnings[name] = of_name.warnings[0] if of_name.warnings else ""
    for key, what in (
        ("rmse_percent", "fit, RMSE of the model's range"),
        ("expected_percent", "expected on new moves, of the model's range"),
    ):
        percents = {}
        for name, result in results.items():
            percent = result.model.fit.get(key)
            if isinstance(percent, float):
                percents[name] = percent
        if percents:
            remarks.notes.append(spread_line(percents, noun, what, first_warnings))
    sum_up(remarks, remarks_of, noun)


def in_name(name: str, channel: str) -> str:
    """Put a channel into the name of a file; a name that would lead to another folder is refused."""
    if CHANNEL in name and (
        channel in (".", "..") or any(sign in channel for sign in "/\\\0")
    ):
        raise InputError(
            f"channel '{channel}' cannot be part of a file's name ('{name}')"
        )
    return name.replace(CHANNEL, channel)


def address_of(address: Address, channel: str) -> Address:
    """Put a channel into the address of a file; see ``in_name``."""
    return parse_address(in_name(address.text, channel), address.format)


def make_folder_of(output: Address) -> None:
    """Make the folder that files of channels go to; it goes again where they are given up."""
    folder = output.path.rpartition("/")[0]
    if folder and CHANNEL not in folder:
        make_folder(folder)
