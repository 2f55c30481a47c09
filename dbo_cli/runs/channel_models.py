"""Identification over channels or files: a model of each, in one set or a file of each."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from dbo_cli.errors import UsageError
from dbo_cli.hysteresis.identification import IdentificationOptions
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.hysteresis.model_file import model_to_bytes
from dbo_cli.hysteresis.model_set import read_model, set_to_bytes
from dbo_cli.logs.addresses import Address, Given, check_document
from dbo_cli.logs.channels import ChannelReader
from dbo_cli.logs.reading_options import ALL_ROWS, ReadingOptions
from dbo_cli.logs.tables import ReadLog
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
from dbo_cli.runs.identifying import (
    Identified,
    RecordedLog,
    arguments_of,
    chosen_of,
    identify_logs,
    identify_recordings,
    read_recordings,
)
from dbo_cli.runs.jobs import Outcome, Work, good_ones, named, run_jobs, spread_line, summed_up
from dbo_cli.runs.many_files import check_names, each_file, of_file
from dbo_cli.runs.shared_shape import SharedShape, options_of_channel, shared_shape


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
    work: Work = Work(),  # noqa: B008 - frozen
    listener: Listener = SILENT,
) -> Outcome:
    """Identify a model of each channel and write a set of them, or (``{channel}``) a file of each."""
    columns = Columns.of(voltage=voltage or "", displacement=displacement or "")
    if shared_shape and prior is not None:
        raise UsageError("`shared_shape` and `prior` exclude each other: each is where the shape comes from")
    check_document(output, "a model", "json")
    if CHANNEL not in output.text:
        check_outputs([output], [*logs, *validation])
    outcome, found = Outcome(), {}
    for channel, one in models_of_channels(
        logs, validation, reading, options, columns, prior, work, outcome, listener, shared_shape
    ):
        found[channel] = one
    with all_or_none():
        if found:
            _write_models(
                output, {channel: one.model for channel, one in found.items()}, [*logs, *validation]
            )
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
    shared: bool = False,
) -> Iterator[tuple[str, Identified]]:
    """Identify a model of each channel, in the order of the log."""
    seen: dict[bytes, list[str]] = {}
    whole = dataclasses.replace(reading, rows=ALL_ROWS)
    with (
        opened_readers(logs, reading, columns, digest=True) as readers,
        opened_readers(validation, whole, columns, digest=True) as checks,
    ):
        channels = list(readers[0].channels)
        priors = models_by_channel(prior, channels) if prior is not None else None
        given = chosen_of(options) | reading.chosen()
        shape = None
        if shared:
            given["shared_shape"] = True
            listener.working("the shape that the channels share")
            found = _shape_of(readers, reading, options, columns, given, work)
            listener.finished()
            outcome.remarks.notes.append(found.note)
            shape, options = found.model, options_of_channel(options)

        def jobs() -> Iterator[tuple[str, Callable[[], Identified]]]:
            for channel in channels:
                read = [reader.log(channel) for reader in readers]
                _note_twin(read[0], readers[0].channels[channel]["displacement"].number, channel, seen)
                judged = [reader.log(channel) for reader in checks]
                kept = priors(channel) if priors else shape
                own = columns.of_channel(channel)
                words = (read, judged, reading, options, own, given, kept)
                yield channel, functools.partial(_identified, *words)

        done = run_jobs(jobs(), work.processes)
        for one in good_ones(done, work, "channel", outcome, len(channels), listener):
            assert one.value is not None
            yield one.name, one.value
    for twins in seen.values():
        if len(twins) > 1:
            outcome.remarks.warn(
                f"channels {named(twins)} hold the same displacements, sample by sample: is one channel's log"
                " another's?"
            )


def _identified(
    logs: Sequence[Address],
    validation: Sequence[Address],
    reading: ReadingOptions,
    options: IdentificationOptions,
    columns: Mapping[str, str],
    given: Mapping[str, object],
    prior: str | ActuatorModel | None,
) -> Identified:
    """Identify one channel, in whichever process; ``given`` is how the identification was called."""
    kept = read_model(prior) if isinstance(prior, str) else prior
    fitted, checks = read_recordings(
        logs, validation, reading, columns["voltage"], columns["displacement"], prior=kept
    )
    chosen = dict(given) | dict(columns)
    if isinstance(prior, str):
        chosen["prior"] = os.path.basename(prior)
    fit, checked = ([one.text for one in some] for some in (logs, validation))
    return identify_recordings(fitted, options, checks, arguments_of(fit, checked, chosen), kept)


def _shape_of(
    readers: Sequence[ChannelReader],
    reading: ReadingOptions,
    options: IdentificationOptions,
    columns: Columns,
    given: Mapping[str, object],
    work: Work,
) -> SharedShape:
    """Return the shape that the channels share."""

    def read(channel: str) -> list[RecordedLog]:
        logs = [reader.log(channel) for reader in readers]
        own = columns.of_channel(channel)
        return read_recordings(logs, [], reading, own["voltage"], own["displacement"])[0]

    names = [reader.address.text for reader in readers]
    arguments = arguments_of(names, [], dict(given) | dict(columns.patterns))
    return shared_shape(list(readers[0].channels), read, options, arguments, work.processes)


def _note_twin(log: Address, number: int, channel: str, seen: dict[bytes, list[str]]) -> None:
    """Remember what a channel's displacements are, so that two channels of one log show."""
    if isinstance(log, ReadLog) and log.table is not None:
        digest = hashlib.sha256(log.table.block.values[str(number)].tobytes()).digest()
        seen.setdefault(digest, []).append(channel)


def _write_models(output: Address, models: Mapping[str, ActuatorModel], inputs: Sequence[Given]) -> None:
    if CHANNEL not in output.text:
        write_whole(output, set_to_bytes(models), protect=inputs)
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
