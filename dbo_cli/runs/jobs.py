"""Many runs of one use case, for channels or files: in one process or several, with the same results.

A job is a name and a call. Its outputs are kept and handed back with its value, so that
whoever asked for the jobs writes them: in the order of the jobs, all or none, or those
that went well.
"""

from __future__ import annotations

import contextlib
import os
import re
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Generic, TypeVar

from dbo_cli import errors
from dbo_cli.errors import SILENT, DboError, Listener, Remarks, UsageError
from dbo_cli.logs.request import Address, parse_address
from dbo_cli.logs.whole_output import KeptOutputs, kept_outputs, make_folder

if TYPE_CHECKING:
    from concurrent.futures import Future

Value = TypeVar("Value")
Jobs = Iterable[tuple[str, Callable[[], Value]]]

# jobs a process that are in memory at once: one is worked on while the next is read
_AHEAD = 2
FILE = "{file}"  # in the name of an output: the log's name without folder and ending
_NAMED = 8  # channels or files that a message names at most
_NUMBER = re.compile(r"[-+]?\d[\d.,]*(?:e[-+]?\d+)?(?<![.,])")


@dataclass(frozen=True)
class Work:
    """How jobs are worked through.

    Attributes
    ----------
    processes
        How many at once; changes no bit of a result.
    keep_going
        Go on where a job fails, and write what the others gave.
    all_needed
        It could not go on without one: nothing is said of ``keep_going``.
    """

    processes: int = 1
    keep_going: bool = False
    all_needed: bool = False


@dataclass(frozen=True)
class Done(Generic[Value]):
    """What came of a job that went well: its value and outputs."""

    name: str
    value: Value
    outputs: KeptOutputs


@dataclass(frozen=True)
class Failed:
    """The error that ended a job."""

    name: str
    problem: DboError


@dataclass
class Outcome:
    """What is to be said of a run or of all jobs, and the error to end with once the outputs are written.

    ``last``: notes that come after all others. ``failures``: the errors of jobs by
    their names.
    """

    remarks: Remarks = field(default_factory=Remarks)
    failure: DboError | None = None
    last: list[str] = field(default_factory=list)
    failures: dict[str, str] = field(default_factory=dict)

    def good(
        self,
        jobs: Jobs[Value],
        work: Work,
        noun: str,
        count: int,
        listener: Listener = SILENT,
        keep: bool = True,
    ) -> Iterator[Done[Value]]:
        """Give the jobs that went well; the failures become warnings and the failure, or end it all.

        Parameters
        ----------
        jobs, work, keep
            What is to be done and how (see ``run_jobs``), and whether to go on where
            one failed.
        noun
            What a job is: ``channel`` or ``file``.
        count
            How many jobs there are.

        Raises
        ------
        DboError
            The first failure, where it is not to be gone on or where all failed.
        """
        failed: dict[str, DboError] = {}
        for number, end in enumerate(run_jobs(jobs, work.processes, keep), start=1):
            listener.finished()
            if isinstance(end, Done):
                yield end
            else:
                failed[end.name] = end.problem
                text = str(end.problem)
                if noun != "file" or not text.startswith(end.name):
                    text = f"{noun} {end.name}: {text}"
                if not work.keep_going:
                    if not work.all_needed:
                        text += f" (`keep_going` writes the other {noun}s)"
                    raise type(end.problem)(text)
                self.remarks.warn(text)
                self.failures[end.name] = str(end.problem)
            if number < count:
                listener.working(f"{noun} {number + 1:,} of {count:,}")
        if failed:
            # What the others gave is written: exit code 1, whatever ended the ones that
            # failed.
            fate = "the others are written"
            if len(failed) == count:
                fate = "nothing is written"
            self.failure = DboError(
                f"{len(failed):,} of {count:,} {noun}s failed ({named(list(failed))}): {fate}"
            )


def run_jobs(
    jobs: Jobs[Value], processes: int = 1, keep: bool = True
) -> Iterator[Done[Value] | Failed]:
    """Run jobs and give what came of them in their order; of several processes, each takes the next job.

    Without ``keep`` each job writes its outputs itself. Calls must pickle where there
    is more than one process. Errors that are no ``DboError`` come through.
    """
    if processes == 1:
        for name, call in jobs:
            yield run_job(name, call, keep)
        return
    import multiprocessing
    from concurrent.futures import ProcessPoolExecutor

    # Not forked: a library's threads (polars has some) would be missing in the copy,
    # their locks held.
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(processes, context, initializer=_prepare_worker)
    running: deque[Future[Done[Value] | Failed]] = deque()
    try:
        for name, call in jobs:
            running.append(pool.submit(run_job, name, call, keep))
            if len(running) >= _AHEAD * processes:
                yield running.popleft().result()
        while running:
            yield running.popleft().result()
    finally:
        pool.shutdown(cancel_futures=True)


def _prepare_worker() -> None:
    """Leave interrupts to the process that was asked, and libraries' warnings unsaid."""
    import signal
    import warnings

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    warnings.simplefilter("ignore")


def run_job(name: str, call: Callable[[], Value], keep: bool) -> Done[Value] | Failed:
    """Run one job, its outputs kept or written."""
    keeping = kept_outputs() if keep else contextlib.nullcontext(KeptOutputs())
    with keeping as outputs:
        try:
            return Done(name, call(), outputs)
        except DboError as problem:
            # Of the plain class: what a subclass holds besides may not pickle.
            return Failed(name, _plain_class(problem)(str(problem)))


def _plain_class(problem: DboError) -> type[DboError]:
    """Return the first class of an error that stands in ``errors``."""
    for kind in type(problem).__mro__:
        if kind.__module__ == errors.__name__:
            return kind
    return DboError


def summed_up(texts: Mapping[str, Sequence[str]], noun: str) -> list[str]:
    """Put messages of many channels or files together: those that differ in their numbers alone are one.

    Parameters
    ----------
    texts
        The messages by channel.
    noun
        ``channel`` or ``file``.
    """
    groups: dict[str, list[tuple[str, str]]] = {}
    for name, messages in texts.items():
        for text in dict.fromkeys(messages):
            groups.setdefault(_without_numbers(text, name), []).append((name, text))
    return [_group_line(group, len(texts), noun) for group in groups.values()]


def _without_numbers(text: str, name: str) -> str:
    """Return a message with a mark in the place of its numbers, and of the channel's or file's name."""
    if not name.isdigit():
        whole_name = re.compile(rf"(?<!\w){re.escape(name)}(?!\w)")
        text = whole_name.sub("#", text)
    return _NUMBER.sub("#", text)


def _group_line(group: Sequence[tuple[str, str]], count: int, noun: str) -> str:
    """Return one line for the messages (name, text) of a group, of ``count`` channels or files in all."""
    names = list(dict.fromkeys(name for name, _ in group))
    first = group[0][1]
    if count == 1:
        return first
    if len(names) == 1:
        if noun == "file" and first.startswith(names[0]):
            return first
        return f"{noun} {names[0]}: {first}"
    which = f"{noun}s {named(names)}"
    if len(names) == count:
        which = f"all {count:,} {noun}s"
    line = f"{which}: {first}"
    if any(text != first for _, text in group):
        line += f" ({noun} {names[0]}'s)"
    return line


def sum_up(remarks: Remarks, remarks_of: Mapping[str, Remarks], noun: str) -> None:
    """Add the notes and warnings of many channels or files, put together."""
    notes = {name: of_name.notes for name, of_name in remarks_of.items()}
    warnings = {name: of_name.warnings for name, of_name in remarks_of.items()}
    remarks.notes += summed_up(notes, noun)
    remarks.warnings += summed_up(warnings, noun)


def named(names: Sequence[str]) -> str:
    """Name channels or files: all of a few, the first and the number of many."""
    if len(names) <= _NAMED:
        return ", ".join(names)
    return f"{', '.join(names[: _NAMED - 1])}, … {len(names):,} in all"


def spread_line(
    percents: Mapping[str, float], noun: str, what: str, why: Mapping[str, str]
) -> str:
    """Return in one line how a figure in % is spread: below which round one nine of ten are, and the worst.

    Parameters
    ----------
    percents
        The figure by channel.
    noun, what
        ``channel``, and what the figure is.
    why
        What is known about a channel's figure.
    """
    ordered = sorted(percents.values())
    most = ordered[(9 * len(ordered) - 1) // 10]
    bound = _next_round(most, ordered[-1])
    below = sum(value < bound for value in ordered)
    worst = max(percents, key=lambda name: percents[name])
    reason = ""
    if why.get(worst):
        reason = f": {why[worst]}"
    return (
        f"{what}: {below:,} of {len(ordered):,} {noun}s below {bound:g} %; worst: {worst}, "
        f"{percents[worst]:.2g} %{reason}"
    )


def _next_round(value: float, last: float) -> float:
    """Return the next of 1, 2, 5, 10, 20, ... above a value; ``last`` where it is beyond them all."""
    for power in range(-6, 7):
        for digit in (1, 2, 5):
            step = digit * 10.0**power
            if step > value:
                return step
    return last


# --- files: each is one run, its outputs whole by themselves, whatever becomes of the
# others ---


def name_of(log: Address) -> str:
    """Return a log's name without folder and ending, and with the group in it."""
    if log.is_stream:
        return "stdin"
    name = os.path.basename(log.path)
    if name.lower().endswith(".gz"):
        name = name[:-3]
    group = (log.group or "").strip("/").replace("/", "_")
    stem = os.path.splitext(name)[0]
    return f"{stem}_{group}" if group else stem


def of_file(address: Address, log: Address) -> Address:
    """Return an output of one log."""
    return parse_address(address.text.replace(FILE, name_of(log)), address.format)


def check_names(output: Address, logs: Sequence[Address]) -> None:
    """Refuse two logs of one name (UsageError), and make the folder that the outputs go to."""
    logs_by_name: dict[str, Address] = {}
    for log in logs:
        name = name_of(log)
        if name in logs_by_name:
            raise UsageError(
                f"{logs_by_name[name].text} and {log.text} would both be written to"
                f" {output.text.replace(FILE, name)}: rename one, or run them apart"
            )
        logs_by_name[name] = log
    folder = os.path.dirname(output.path)
    if folder and "{" not in folder:
        make_folder(folder)


def each_file(
    calls: Sequence[tuple[Address, Callable[[], Value]]], work: Work, listener: Listener
) -> tuple[dict[str, Value], Outcome]:
    """Run a call for each log; returns what came of those that went well, and the outcome of all."""
    outcome, going = Outcome(), Work(work.processes, keep_going=True)
    jobs = ((log.text, call) for log, call in calls)
    done = outcome.good(jobs, going, "file", len(calls), listener, keep=False)
    return {job.name: job.value for job in done}, outcome
