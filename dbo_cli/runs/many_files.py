"""Use cases over files: each file is one run, its outputs whole by themselves.

``{file}`` in the name of an output stands for the log's name without folder and ending. Files that fail are
named at the end; what the others gave is there.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from dbo_cli.errors import UsageError
from dbo_cli.logs.addresses import Address, parse_address
from dbo_cli.logs.whole_output import check_outputs, make_folder
from dbo_cli.remarks import SILENT, Listener, Remarks
from dbo_cli.runs.files import Destination
from dbo_cli.runs.jobs import Outcome, Work, good_ones, run_jobs, summed_up

Value = TypeVar("Value")
FILE = "{file}"
_WORTH_POLARS = 32  # files of 1,000 rows: importing polars (0.1 s) costs less than formatting them in Python


def require_files(logs: Sequence[Address], output: Address) -> None:
    """Refuse one output for several logs, or a place for a name that is none (UsageError)."""
    if FILE not in output.text and len(logs) > 1:
        raise UsageError(
            f"{len(logs)} logs and one output, {output.text}: put {FILE} into its name (-o 'out/{FILE}.csv')"
        )


def name_of(log: Address) -> str:
    """Return a log's name without folder and ending, and with the group in it."""
    if log.is_stream:
        return "stdin"
    name = os.path.basename(log.path)
    if name.lower().endswith(".gz"):
        name = name[:-3]
    group = (log.group or "").strip("/").replace("/", "_")
    return os.path.splitext(name)[0] + (f"_{group}" if group else "")


def of_file(address: Address | None, log: Address) -> Address | None:
    """Return an output of one log."""
    if address is None:
        return None
    return parse_address(address.text.replace(FILE, name_of(log)), address.format)


def of_files(destination: Destination, logs: Sequence[Address]) -> list[Destination]:
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
    mine = set(logs)
    others = [one for one in destination.protect if one not in mine]
    found = []
    for log in logs:
        output, save_state, summary = (
            of_file(one, log) for one in (destination.output, destination.save_state, destination.summary)
        )
        assert output is not None
        found.append(
            destination._replace(
                output=output, save_state=save_state, protect=[*others, log], live=False, summary=summary
            )
        )
    check_outputs([one.output for one in found], destination.protect)
    return found


def check_names(output: Address, logs: Sequence[Address]) -> None:
    """Refuse two logs of one name (UsageError), and make the folder that the outputs go to."""
    seen: dict[str, Address] = {}
    for log in logs:
        name = name_of(log)
        if name in seen:
            raise UsageError(
                f"{seen[name].text} and {log.text} would both be written to"
                f" {output.text.replace(FILE, name)}: rename one, or run them apart"
            )
        seen[name] = log
    folder = os.path.dirname(output.path)
    if folder and "{" not in folder:
        make_folder(folder)


def each_file(
    calls: Sequence[tuple[Address, Callable[[], Value]]],
    work: Work = Work(),  # noqa: B008 - frozen
    listener: Listener = SILENT,
) -> tuple[dict[str, Value], Outcome]:
    """Run a call for each log; returns what came of those that went well, and the outcome of all."""
    outcome = Outcome()
    jobs = ((log.text, call) for log, call in calls)
    done = run_jobs(jobs, work.processes, keep=False)
    going = Work(work.processes, keep_going=True)
    found = {}
    for one in good_ones(done, going, "file", outcome, len(calls), listener):
        assert one.value is not None
        found[one.name] = one.value
    return found, outcome


def signals_of_files(
    use_case: Callable[..., Remarks],
    model_file: str,
    logs: Sequence[Address],
    destination: Destination,
    *words: Any,
    work: Work = Work(),  # noqa: B008 - frozen
    listener: Listener = SILENT,
    **more: Any,
) -> Outcome:
    """Run ``simulate_log`` or ``compensate_trajectory`` for each log; ``words`` and ``more`` are its own."""
    places = of_files(destination, logs)
    if len(logs) >= _WORTH_POLARS and work.processes == 1:
        import polars  # noqa: F401 - text of small files, too, is then written by it, the same bytes
    calls = [
        (log, functools.partial(use_case, model_file, log, place, *words, **more))
        for log, place in zip(logs, places, strict=True)
    ]
    found, outcome = each_file(calls, work, listener)
    outcome.remarks.read += summed_up({name: one.read for name, one in found.items()}, "file")
    outcome.remarks.notes += summed_up({name: one.notes for name, one in found.items()}, "file")
    outcome.remarks.warnings += summed_up({name: one.warnings for name, one in found.items()}, "file")
    return outcome
