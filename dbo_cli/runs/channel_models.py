"""Identification over channels or files: a model of each, in one set or a file of each."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from dbo_cli.errors import DboError, UsageError
from dbo_cli.hysteresis.identification import IdentificationOptions
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.hysteresis.model_file import model_to_bytes
from dbo_cli.hysteresis.model_set import Coupling, read_model, set_to_bytes
from dbo_cli.logs.addresses import Address, Given, check_document
from dbo_cli.logs.channels import ChannelReader
from dbo_cli.logs.reading_options import ALL_ROWS, ReadingOptions
from dbo_cli.logs.whole_output import all_or_none, check_outputs, write_whole
from dbo_cli.remarks import SILENT, Listener, Remarks
from dbo_cli.runs.channels import (
    CHANNEL,
    Columns,
    address_of,
    make_folder_of,
    models_by_channel,
    opened_readers,
)
from dbo_cli.runs.coupled import Recordings, recordings_apart
from dbo_cli.runs.identifying import (
    Identified,
    arguments_of,
    chosen_of,
    identify_logs,
    identify_recordings,
    read_recordings,
)
from dbo_cli.runs.jobs import Outcome, Work, good_ones, named, run_jobs, spread_line, summed_up
from dbo_cli.runs.many_files import check_names, each_file, of_file
from dbo_cli.runs.shared_shape import options_of_channel, shared_shape


def identify_channels(
    logs: Sequence[Address],
    validation: Sequence[Address],
    output: Address,
    reading: ReadingOptions,
    options: IdentificationOptions,
    *,
    voltage: str | None,
    displacement: str | None,
    prior: str | None = None,
    shared_shape: bool = False,
    coupling: bool = False,
    work: Work = Work(),  # noqa: B008 - frozen
    listener: Listener = SILENT,
) -> Outcome:
    """Identify a model of each channel and write a set of them, or (``{channel}``) a file of each."""
    columns = Columns.of(voltage=voltage or "", displacement=displacement or "")
    if coupling and CHANNEL in output.text:
        raise UsageError(f"`coupling` belongs to all channels: write one set, without {CHANNEL} in its name")
    if coupling and work.keep_going:
        raise UsageError(
            "`coupling` and `keep_going` exclude each other: each channel is needed for the others"
        )
    if shared_shape and prior is not None:
        raise UsageError("`shared_shape` and `prior` exclude each other: each is where the shape comes from")
    check_document(output, "a model", "json")
    if CHANNEL not in output.text:
        check_outputs([output], [*logs, *validation])
    outcome, found = Outcome(), {}
    shared, work = Shared(shared_shape, coupling), dataclasses.replace(work, all_needed=coupling)
    for channel, one in models_of_channels(
        logs, validation, reading, options, columns, prior, work, outcome, listener, shared
    ):
        found[channel] = one
    with all_or_none():
        if found:
            models = {channel: one.model for channel, one in found.items()}
            _write_models(output, models, [*logs, *validation], shared.found)
    if found:
        first = next(iter(found.values()))
        patterns = ", ".join(f"{option} '{one}'" for option, one in columns.patterns.items())
        outcome.remarks.read += [
            f"{line}; {len(found):,} channels: {patterns}" for line in first.remarks.read
        ]
    _say_found(found, "channel", outcome.remarks)
    return outcome


def identify_files(
    logs: Sequence[Address],
    validation: Sequence[Address],
    output: Address,
    *words: Any,
    work: Work = Work(),  # noqa: B008 - frozen
    listener: Listener = SILENT,
    **more: Any,
) -> Outcome:
    """Identify a model of each log by itself; ``words`` and ``more`` are those of ``identify_logs``."""
    check_names(output, logs)
    files = [of_file(output, log) or output for log in logs]
    check_outputs(files, [*logs, *validation])
    calls = [
        (log, functools.partial(identify_logs, [log], validation, file, *words, **more))
        for log, file in zip(logs, files, strict=True)
    ]
    found, outcome = each_file(calls, work, listener)
    outcome.remarks.read += summed_up({name: one.remarks.read for name, one in found.items()}, "file")
    if len(logs) == 1 and found:
        outcome.remarks.notes += next(iter(found.values())).summary
    _say_found(found, "file", outcome.remarks)
    return outcome


@dataclasses.dataclass
class Shared:
    """What channels have in common besides their log: whether it is asked for, and the coupling found."""

    shape: bool = False
    coupling: bool = False
    found: Coupling | None = None

    def given(self) -> dict[str, object]:
        """Return the parameters that were chosen, as ``arguments_of`` takes them."""
        asked = {"shared_shape": self.shape, "coupling": self.coupling}
        return {name: True for name, chosen in asked.items() if chosen}


def models_of_channels(
    logs: Sequence[Address],
    validation: Sequence[Address],
    reading: ReadingOptions,
    options: IdentificationOptions,
    columns: Columns,
    prior: str | None,
    work: Work,
    outcome: Outcome,
    listener: Listener = SILENT,
    shared: Shared | None = None,
) -> Iterator[tuple[str, Identified]]:
    """Identify a model of each channel, in the order of the log."""
    shared = shared or Shared()
    whole = dataclasses.replace(reading, rows=ALL_ROWS)
    with (
        opened_readers(logs, reading, columns, digest=True) as readers,
        opened_readers(validation, whole, columns, digest=True) as checks,
    ):
        channels = list(readers[0].channels)
        priors = models_by_channel(prior, channels) if prior is not None else None
        recordings = _Recordings(readers, checks, reading, columns, priors or (lambda channel: None))
        given = chosen_of(options) | reading.chosen() | shared.given()
        names, checked = ([one.text for one in some] for some in (logs, validation))
        if shared.coupling:
            listener.working("how the channels show in each other")
            shared.found, recordings.apart = recordings_apart(_recorded(recordings, channels))
            listener.finished()
            outcome.remarks.notes.append(shared.found.summary())
        if shared.shape:
            listener.working("the shape that the channels share")
            arguments = arguments_of(names, [], given | dict(columns.patterns))
            words = (channels, lambda one: recordings.of(one)()[0], options, arguments)
            found = shared_shape(*words, work.processes)
            listener.finished()
            outcome.remarks.notes.append(found.note)
            recordings.kept, options = (lambda channel: found.model), options_of_channel(options)

        def jobs() -> Iterator[tuple[str, Callable[[], Identified]]]:
            for channel in channels:
                chosen, kept = given | columns.of_channel(channel), recordings.kept(channel)
                if isinstance(kept, str):
                    chosen["prior"] = os.path.basename(kept)
                words = (options, arguments_of(names, checked, chosen), kept)
                yield channel, functools.partial(_identified, recordings.of(channel), *words)

        done = run_jobs(jobs(), work.processes)
        for one in good_ones(done, work, "channel", outcome, len(channels), listener):
            assert one.value is not None
            yield one.name, one.value
    for twins in recordings.seen.values():
        if len(twins) > 1:
            outcome.remarks.warn(
                f"channels {named(list(twins))} hold the same displacements, sample by sample: is one "
                "channel's log another's?"
            )


@dataclasses.dataclass
class _Recordings:
    """What reads a channel's recordings, in whichever process; ``apart`` where all were read before."""

    readers: Sequence[ChannelReader]
    checks: Sequence[ChannelReader]
    reading: ReadingOptions
    columns: Columns
    kept: Callable[[str], str | ActuatorModel | None]
    apart: Mapping[str, Recordings] = dataclasses.field(default_factory=dict)
    seen: dict[bytes, dict[str, None]] = dataclasses.field(default_factory=dict)

    def of(self, channel: str) -> Callable[[], Recordings]:
        """Return what reads one channel; two of the same displacements are kept in mind."""
        if channel in self.apart:
            return functools.partial(_as_it_is, self.apart[channel])
        fit, judged = ([one.log(channel) for one in some] for some in (self.readers, self.checks))
        number = self.readers[0].channels[channel]["displacement"].number
        if fit[0].table is not None:
            digest = hashlib.sha256(fit[0].table.block.values[str(number)].tobytes()).digest()
            self.seen.setdefault(digest, {})[channel] = None
        own = self.columns.of_channel(channel)
        return functools.partial(_read, fit, judged, self.reading, own, self.kept(channel))


def _read(
    logs: Sequence[Address],
    validation: Sequence[Address],
    reading: ReadingOptions,
    columns: Mapping[str, str],
    prior: str | ActuatorModel | None,
) -> Recordings:
    """Read what one channel is fitted to and judged on, in the units of a prior."""
    kept = read_model(prior) if isinstance(prior, str) else prior
    words = (logs, validation, reading, columns["voltage"], columns["displacement"])
    return read_recordings(*words, prior=kept)


def _recorded(recordings: _Recordings, channels: Sequence[str]) -> dict[str, Recordings]:
    """Read all channels; one that cannot be read ends it, and is named."""
    found = {}
    for channel in channels:
        try:
            found[channel] = recordings.of(channel)()
        except DboError as problem:
            raise type(problem)(f"channel {channel}: {problem}") from None
    return found


def _as_it_is(recorded: Recordings) -> Recordings:
    return recorded


def _identified(
    read: Callable[[], Recordings],
    options: IdentificationOptions,
    arguments: Sequence[str],
    prior: str | ActuatorModel | None,
) -> Identified:
    """Identify one channel, in whichever process; ``arguments`` say how the identification was called."""
    fitted, checks = read()
    kept = read_model(prior) if isinstance(prior, str) else prior
    return identify_recordings(fitted, options, checks, arguments, kept)


def _write_models(
    output: Address, models: Mapping[str, ActuatorModel], inputs: Sequence[Given], coupling: Coupling | None
) -> None:
    if CHANNEL not in output.text:
        write_whole(output, set_to_bytes(models, coupling), protect=inputs)
        return
    make_folder_of(output)
    files = {channel: address_of(output, channel) for channel in models}
    check_outputs(list(files.values()), inputs)
    for channel, model in models.items():
        write_whole(files[channel], model_to_bytes(model), protect=inputs)


def _say_found(found: Mapping[str, Identified], noun: str, remarks: Remarks) -> None:
    """Sum up what was found over all channels or files."""
    why = {channel: next(iter(one.remarks.warnings), "") for channel, one in found.items()}
    for key, what in (("rmse_percent", "fit, RMSE of range"), ("expected_percent", "expected on new moves")):
        percents = {c: one.model.fit.get(key) for c, one in found.items()}
        known = {c: value for c, value in percents.items() if isinstance(value, float)}
        if known:
            remarks.notes.append(spread_line(known, noun, what, why))
    remarks.notes += summed_up({c: one.remarks.notes for c, one in found.items()}, noun)
    remarks.warnings += summed_up({c: one.remarks.warnings for c, one in found.items()}, noun)
