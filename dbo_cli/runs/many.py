"""Which way a use case goes: over one log, over the channels that a pattern names, or over many files."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from typing import TYPE_CHECKING

from dbo_cli.errors import Listener, Remarks, UsageError
from dbo_cli.logs.request import Address
from dbo_cli.logs.whole_output import check_outputs
from dbo_cli.runs.files import Destination, SignalRun
from dbo_cli.runs.jobs import FILE, Outcome, Work, check_names, each_file, of_file, sum_up, summed_up

if TYPE_CHECKING:
    from dbo_cli.runs.identifying import IdentifyRun
    from dbo_cli.runs.reporting import ReportRun

_PLACES = ("{}", "{channel}", FILE)
_WORTH_POLARS = 32  # files of 1,000 rows: importing polars (0.1 s) costs less than formatting them in Python


def signals(asked: SignalRun, logs: Sequence[Address], work: Work, listener: Listener) -> Outcome:
    """Run ``simulate`` or ``compensate`` over one log, the channels that a pattern names, or many files.

    Raises
    ------
    UsageError
        Patterns, names of files and logs contradict each other.
    """
    output = asked.destination.output
    if not _are_many(logs, output, asked.column):
        return Outcome(asked.run(listener))
    if asked.tracked:
        raise UsageError("`tracked` learns one trajectory at a time: one log, one column and one output")
    from dbo_cli.extras.channels.signals import signals_of_channels, wants_channels

    if wants_channels(output, asked.column):
        if len(logs) > 1:
            raise UsageError(f"{len(logs)} logs, and a pattern of columns of one: give one log")
        return signals_of_channels(asked, work, listener)
    return _signals_of_files(asked, logs, work, listener)


def _signals_of_files(asked: SignalRun, logs: Sequence[Address], work: Work, listener: Listener) -> Outcome:
    """Run ``simulate`` or ``compensate`` over each log."""
    if FILE not in asked.destination.output.text and len(logs) > 1:
        raise UsageError(
            f"{len(logs)} logs and one output, {asked.destination.output.text}: put {FILE} into its name "
            f"(-o 'out/{FILE}.csv')"
        )
    places = _of_files(asked.destination, logs)
    if len(logs) >= _WORTH_POLARS and work.processes == 1:
        import polars  # noqa: F401 - text of small files, too, is then written by it, the same bytes
    calls = [
        (log, dataclasses.replace(asked, log=log, destination=place).run)
        for log, place in zip(logs, places, strict=True)
    ]
    found, outcome = each_file(calls, work, listener)
    outcome.remarks.read += summed_up({name: one.read for name, one in found.items()}, "file")
    sum_up(outcome.remarks, found, "file")
    return outcome


def _of_files(destination: Destination, logs: Sequence[Address]) -> list[Destination]:
    """Return where the outputs of each log go; their folders are made.

    Raises
    ------
    UsageError
        Two logs have one name, or an output that every log would write lacks ``{file}``.
    OutputError
        An output cannot be written.
    """
    if destination.live:
        raise UsageError("`flush` follows one log row by row: give one")
    for option in ("save_state", "summary"):
        address = getattr(destination, option)
        if address is not None and FILE not in address.text:
            raise UsageError(f"`{option}` {address.text}: each log has its own (put {FILE} into its name)")
    check_names(destination.output, logs)
    others = [one for one in destination.protect if one not in set(logs)]
    found = [
        destination._replace(protect=[*others, log]).placed(functools.partial(of_file, log=log))
        for log in logs
    ]
    check_outputs([one.output for one in found], destination.protect)
    return found


def identified(asked: IdentifyRun, output: Address, work: Work, listener: Listener) -> Outcome:
    """Identify one model of all logs, one of each channel, or one of each log (``{file}``)."""
    if _are_many(asked.logs[:1], output, asked.voltage, asked.displacement):
        from dbo_cli.extras.channels.models import identify_channels, identify_files
        from dbo_cli.extras.channels.signals import wants_channels

        if wants_channels(output, asked.voltage, asked.displacement):
            return identify_channels(asked, output, work, listener)
        if not (asked.shared_shape or asked.coupling):
            return identify_files(asked, output, work, listener)
    asked.refuse_channels_options()
    found = asked.run(output, listener)
    read, remarks = found.remarks.read, found.remarks
    return Outcome(Remarks([*remarks.notes, *found.summary], remarks.warnings, read))


def reported(asked: ReportRun, work: Work, listener: Listener) -> Outcome:
    """Report on logs side by side, or on the channels that a pattern names."""
    from dbo_cli.runs.reporting import report_channels, report_logs

    columns = (asked.options.desired, asked.options.measured, asked.options.voltage)
    if _are_many([], asked.output, *columns):
        return report_channels(asked, work, listener)
    return report_logs(asked, listener)


def _are_many(logs: Sequence[Address], output: Address, *selectors: str | None) -> bool:
    """Tell whether there is more than one run, or a name that asks for more."""
    texts = [one for one in (output.text, *selectors) if one is not None]
    return len(logs) > 1 or any(place in one for one in texts for place in _PLACES)
