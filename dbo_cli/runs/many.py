"""Which way a use case goes: over one log, over the channels that a pattern names, or over many files."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from dbo_cli.errors import UsageError
from dbo_cli.logs.addresses import Address
from dbo_cli.logs.reading_options import ReadingOptions
from dbo_cli.remarks import Listener, Remarks
from dbo_cli.runs.files import Destination
from dbo_cli.runs.jobs import Outcome, Work

if TYPE_CHECKING:
    from dbo_cli.hysteresis.identification import IdentificationOptions
    from dbo_cli.runs.reporting import Written
    from dbo_cli.runs.tracking import TrackingOptions

_PLACES = ("{}", "{channel}", "{file}")


def signals(
    use_case: Callable[..., Remarks],
    model_file: str,
    logs: Sequence[Address],
    destination: Destination,
    reading: ReadingOptions,
    column: Mapping[str, str | None],
    *,
    work: Work,
    listener: Listener,
    tracked: Sequence[Address] = (),
    **more: Any,
) -> Outcome:
    """Run ``simulate_log`` or ``compensate_trajectory`` over one log, channels or files.

    Parameters
    ----------
    use_case, more
        What is run for each, and its own parameters.
    column
        The signal's column, by the parameter that names it.
    tracked
        Recordings of the last pass, of one trajectory alone.

    Raises
    ------
    UsageError
        Patterns, names of files and logs contradict each other.
    """
    ((option, selector),) = column.items()
    if not _are_many(logs, destination.output, selector):
        one = more | ({"tracked": tracked} if tracked else {})
        done = use_case(model_file, logs[0], destination, reading, column=selector, listener=listener, **one)
        return Outcome(done)
    if tracked:
        raise UsageError("`tracked` learns one trajectory at a time: one log, one column and one output")
    from dbo_cli.runs.channels import Columns, wants_channels

    if wants_channels(destination.output, selector):
        from dbo_cli.runs.channel_signals import signals_of_channels

        columns = Columns.of(**{option: selector or ""})
        words = (model_file, _only(logs), destination, reading, columns)
        return signals_of_channels(use_case, *words, work=work, listener=listener, **more)
    from dbo_cli.runs.many_files import require_files, signals_of_files

    require_files(logs, destination.output)
    words_of_files = (model_file, logs, destination, reading)
    return signals_of_files(use_case, *words_of_files, column=selector, work=work, listener=listener, **more)


def identified(
    logs: Sequence[Address],
    validation: Sequence[Address],
    output: Address,
    reading: ReadingOptions,
    options: IdentificationOptions,
    *,
    work: Work,
    listener: Listener,
    shared_shape: bool = False,
    coupling: bool = False,
    **columns: Any,
) -> Outcome:
    """Identify one model of all logs, one of each channel, or one of each log (``{file}``)."""
    words = (logs, validation, output, reading, options)
    if _are_many(logs[:1], output, columns["voltage"], columns["displacement"]):
        from dbo_cli.runs.channel_models import identify_channels, identify_files
        from dbo_cli.runs.channels import wants_channels

        channels = wants_channels(output, columns["voltage"], columns["displacement"])
        if channels:
            more = columns | {"shared_shape": shared_shape, "coupling": coupling}
            return identify_channels(*words, work=work, listener=listener, **more)
        if not (shared_shape or coupling):
            return identify_files(*words, work=work, listener=listener, **columns)
    if shared_shape or coupling:
        asked = "shared_shape" if shared_shape else "coupling"
        raise UsageError(f"`{asked}` is for channels: name their columns by patterns, 'V{{}}' and 'D{{}}'")
    from dbo_cli.runs.identifying import identify_logs

    found = identify_logs(*words, **columns, listener=listener)
    read, remarks = found.remarks.read, found.remarks
    return Outcome(Remarks([*remarks.notes, *found.summary], remarks.warnings, read))


def reported(
    logs: Sequence[Address],
    output: Address,
    reading: ReadingOptions,
    options: TrackingOptions,
    *,
    work: Work,
    **more: Any,
) -> Written:
    """Report on logs side by side, or on the channels that a pattern names."""
    if _are_many([], output, options.desired, options.measured, options.voltage):
        from dbo_cli.runs.channel_reports import report_channels

        return report_channels(logs, output, reading, options, work=work, **more)
    from dbo_cli.runs.reporting import report_logs

    return report_logs(logs, output, reading, options, **more)


def _are_many(logs: Sequence[Address], output: Address, *selectors: str | None) -> bool:
    """Tell whether there is more than one run, or a name that asks for more."""
    texts = [one for one in (output.text, *selectors) if one is not None]
    return len(logs) > 1 or any(place in one for one in texts for place in _PLACES)


def _only(logs: Sequence[Address]) -> Address:
    if len(logs) > 1:
        raise UsageError(f"{len(logs)} logs, and a pattern of columns of one: give one log")
    return logs[0]
