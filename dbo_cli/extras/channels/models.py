"""Identification over channels or files: a model of each, in one set or a file of each."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import os
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from dbo_cli.errors import SILENT, FitError, Listener, UsageError
from dbo_cli.extras.channels.coupling_fit import Frames, find_coupling
from dbo_cli.extras.channels.model_set import Coupling, set_to_bytes
from dbo_cli.extras.channels.signals import (
    columns_of,
    matrix_of,
    models_by_channel,
    opened_readers,
    patterns_of,
)
from dbo_cli.hysteresis.identification import IdentificationOptions
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.hysteresis.model_file import model_to_bytes, read_model
from dbo_cli.logs.request import ALL_ROWS, Address, Given, check_document
from dbo_cli.logs.sample_block import FloatArray
from dbo_cli.logs.whole_output import all_or_none, check_outputs, write_whole
from dbo_cli.runs import identifying, jobs
from dbo_cli.runs.files import write_json
from dbo_cli.runs.identifying import (
    IdentifyResult,
    IdentifyRun,
    RecordedLog,
    Recordings,
    sign_line,
    sign_warning,
    summary_of_model,
    with_sign,
)
from dbo_cli.runs.jobs import Value
from dbo_cli.runs.many import CHANNEL, address_of, make_folder_of, say_found

MOST_POOLED = 64  # channels in the mean: with more, noise no longer matters beside the shape
MOST_UNLIKE = 8  # channels, each a log of one fit, where they are driven differently: it takes as long
LEAST_GAIN = 0.1  # of the middle one: a channel with less is dead, and takes no part
LEFT_OUT = 3  # channels, at most, that take no part in the mean and are asked about it
FEWEST = 4  # channels: of fewer, none could be left out
WORSE = 1.1
"""Times its own model's error on cycles left out, the median of the channels left out: what the one shape
may leave. Measured: docs/choices.md."""


def identify_channels(
    asked: IdentifyRun, output: Address, work: jobs.Work, listener: Listener
) -> jobs.Outcome:
    """Identify a model of each channel and write a set of them, or (``{channel}``) a file of each."""
    patterns, inputs = asked_patterns(asked), [*asked.logs, *asked.validation]
    if asked.brought.get("coupling", False) and CHANNEL in output.text:
        raise UsageError(f"`coupling` belongs to all channels: write one set, without {CHANNEL} in its name")
    if asked.brought.get("coupling", False) and work.keep_going:
        raise UsageError(
            "`coupling` and `keep_going` exclude each other: each channel is needed for the others"
        )
    check_document(output, "a model", "json")
    asked.check_outputs([] if CHANNEL in output.text else [output], inputs)
    outcome, work = jobs.Outcome(), dataclasses.replace(work, all_needed=asked.brought.get("coupling", False))
    found, coupling = fits_of_channels(asked, work, outcome, listener)
    if found:
        with all_or_none():
            models = {channel: one.model for channel, one in found.items()}
            _write_models(output, models, inputs, coupling)
            if asked.summary is not None:
                summaries = []
                for channel, one in found.items():
                    summaries.append({"channel": channel, **summary_of_model(one, asked.command)})
                write_json(asked.summary, summaries)
        shown = ", ".join(f"{option} '{one}'" for option, one in patterns.items())
        read = next(iter(found.values())).remarks.read
        read = [f"{line}; {len(found):,} channels: {shown}" for line in read]
        outcome.remarks.read += with_sign(read, sign_line(models))
        exchanged = sign_warning(models, "channel")
        if exchanged is not None:
            outcome.remarks.warn(exchanged)
    say_found(found, "channel", outcome.remarks)
    return outcome


def asked_patterns(asked: IdentifyRun) -> dict[str, str]:
    """Return the patterns of columns; UsageError for a single column, or a shape from two places."""
    patterns = patterns_of(voltage=asked.voltage or "", displacement=asked.displacement or "")
    if asked.brought.get("shared_shape", False) and asked.prior is not None:
        raise UsageError("`shared_shape` and `prior` exclude each other: each is where the shape comes from")
    return patterns


def fits_of_channels(
    asked: IdentifyRun, work: jobs.Work, outcome: jobs.Outcome, listener: Listener = SILENT
) -> tuple[dict[str, IdentifyResult], Coupling | None]:
    """Identify a model of each channel, in the order of the log; return how they show in each other, too."""
    patterns, reading, options = asked_patterns(asked), asked.reading, asked.options
    whole, coupling = dataclasses.replace(reading, rows=ALL_ROWS), None
    apart: Mapping[str, Recordings] = {}  # where all have to be read before
    seen: dict[bytes, dict[str, None]] = {}
    with (
        opened_readers(asked.logs, reading, patterns, digest=True) as readers,
        opened_readers(asked.validation, whole, patterns, digest=True) as checks,
    ):
        channels = list(readers[0].channels)
        kept = _priors(asked.prior, channels)

        def recordings(channel: str) -> Callable[[], Recordings]:
            """Return what reads one channel; two of the same displacements are kept in mind."""
            fit, judged = apart.get(channel) or (
                [one.log(channel) for one in readers], [one.log(channel) for one in checks]
            )  # fmt: skip
            number = readers[0].channels[channel]["displacement"].number
            if isinstance(fit[0], Address) and fit[0].table is not None:
                values = fit[0].table.block.values[str(number)]
                seen.setdefault(hashlib.sha256(values.tobytes()).digest(), {})[channel] = None
            own: dict[str, Any] = columns_of(patterns, channel)
            own |= {"logs": fit, "validation": judged, "prior": None}
            return functools.partial(dataclasses.replace(asked, **own).read, prior=kept(channel))

        if asked.brought.get("coupling", False):
            listener.working("how the channels show in each other")
            readings = ((channel, recordings(channel)) for channel in channels)
            coupling, apart = recordings_apart(_all_of(readings, "channel", len(channels)))
            listener.finished()
            outcome.remarks.notes.append(coupling.summary())
        if asked.brought.get("shared_shape", False):
            listener.working("the shape that the channels share")
            arguments = asked.arguments(patterns, checked=False)
            words = (channels, lambda one: recordings(one)()[0], options, arguments)
            shape, note = shared_shape(*words, work.processes)
            listener.finished()
            outcome.remarks.notes.append(note)
            kept, options = (lambda channel: shape), options_of_channel(options)

        def call(channel: str) -> Callable[[], IdentifyResult]:
            arguments = asked.arguments(columns_of(patterns, channel), kept(channel))
            return functools.partial(
                _identify_channel, recordings(channel), options, arguments, kept(channel)
            )

        calls = ((channel, call(channel)) for channel in channels)
        good = outcome.good(calls, work, "channel", len(channels), listener)
        found = {one.name: one.value for one in good}
    for twins in seen.values():
        if len(twins) > 1:
            outcome.remarks.warn(
                f"channels {jobs.named(list(twins))} hold the same displacements, sample by sample: is "
                "one channel's log another's?"
            )
    return found, coupling


def _all_of(calls: jobs.Jobs[Value], noun: str, count: int, processes: int = 1) -> dict[str, Value]:
    """Return what came of jobs that are all needed; the first failure ends it, and is named."""
    good = jobs.Outcome().good(calls, jobs.Work(processes, all_needed=True), noun, count)
    return {one.name: one.value for one in good}


def _priors(prior: Any, channels: Sequence[str]) -> Callable[[str], str | ActuatorModel | None]:
    """Return what gives each channel's prior: from a file its name, from Python the model, or None."""
    if prior is None:
        return lambda channel: None
    if isinstance(prior, Mapping):
        return lambda channel: prior[channel].actuator
    return models_by_channel(os.fspath(prior), channels)


def recordings_apart(
    recorded: Mapping[str, Recordings],
) -> tuple[Coupling, dict[str, Recordings]]:
    """Find the coupling in the recordings of all channels; return them without it.

    Parameters
    ----------
    recorded
        By channel.

    Raises
    ------
    InputError
        The channels of a log have different rows.
    FitError, ModelError
        The logs do not tell the coupling, or it cannot be undone.
    """
    channels = list(recorded)
    logs = [list(of_all) for of_all in zip(*(fit for fit, _ in recorded.values()), strict=True)]
    checks = [list(of_all) for of_all in zip(*(check for _, check in recorded.values()), strict=True)]
    coupling = find_coupling(channels, [_frames(channels, one) for one in logs])
    for one in [*logs, *checks]:
        own = coupling.apart(
            matrix_of(channels, [log.recording.displacement for log in one], one[0].recording.name)
        )
        for place, log in enumerate(one):
            changed = dataclasses.replace(log.recording, displacement=np.ascontiguousarray(own[:, place]))
            one[place] = dataclasses.replace(log, recording=changed)
    return coupling, {
        channel: ([one[k] for one in logs], [one[k] for one in checks]) for k, channel in enumerate(channels)
    }


def _frames(channels: Sequence[str], logs: Sequence[RecordedLog]) -> Frames:
    first = logs[0].recording
    seconds = first.seconds()
    return Frames(
        np.arange(float(len(first.voltage))) if seconds is None else seconds,
        matrix_of(channels, [log.recording.voltage for log in logs], first.name),
        matrix_of(channels, [log.recording.displacement for log in logs], first.name),
    )


def _identify_channel(
    read: Callable[[], Recordings],
    options: IdentificationOptions,
    arguments: Sequence[str],
    prior: str | ActuatorModel | None,
) -> IdentifyResult:
    """Identify one channel, in whichever process; ``arguments`` say how the identification was called."""
    fitted, checks = read()
    kept = read_model(prior) if isinstance(prior, str) else prior
    return identifying.identify_recordings(fitted, options, checks, arguments, kept)


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


# --- one loop shape for all channels: the mean of what they do, then gain, offset and lag of each ---
#
# The actuators of a mirror come from one batch: their loops differ in gain and offset, and hardly in shape.
# The mean over channels has less noise than any of them, one long fit serves all, and each needs three
# numbers. Channels that are driven differently have no mean: some of them are fitted together, as logs of one
# actuator. Whether there is one shape is asked of channels that took no part in the mean.


def options_of_channel(options: IdentificationOptions) -> IdentificationOptions:
    """Return what of the options goes with a shape that is kept."""
    kept = {name: getattr(options, name) for name in ("skip_seconds", "rated", "force", "sign")}
    return IdentificationOptions(**kept, sensor_delay=options.sensor_delay, sensor_lag=options.sensor_lag)


def shared_shape(
    channels: Sequence[str],
    read: Callable[[str], Sequence[RecordedLog]],
    options: IdentificationOptions,
    arguments: Sequence[str],
    processes: int = 1,
) -> tuple[ActuatorModel, str]:
    """Return the shape that channels have in common, the model of the mean channel, and what speaks for it.

    Parameters
    ----------
    channels
        All of them.
    read
        Gives the logs of a channel.
    options
        Of the identification; they hold for the shape.
    arguments
        How the identification was called.
    processes
        How many fits at once; changes no bit.

    Raises
    ------
    UsageError
        There are too few channels.
    FitError
        Channels that took no part in the mean are followed worse than by models of their own.
    """
    if len(channels) < FEWEST:
        raise UsageError(f"`shared_shape` needs {FEWEST} channels or more, and there are {len(channels)}")
    chosen = _spread(channels, MOST_POOLED + LEFT_OUT)
    asked = _spread(chosen, min(LEFT_OUT, len(chosen) // FEWEST))
    logs = {channel: read(channel) for channel in chosen}
    others = {channel: logs[channel] for channel in chosen if channel not in asked}
    alike = _are_driven_alike(others)
    if not alike:
        others = {channel: others[channel] for channel in _spread(list(others), MOST_UNLIKE)}
    mean = _mean_of(others) if alike else _of_one_gain(others, options)
    own_options = options_of_channel(options)
    fit = identifying.identify_recordings
    calls = {"the mean": functools.partial(fit, mean, options, (), arguments)}
    calls |= {channel: functools.partial(fit, logs[channel], options) for channel in asked}
    fits = _all_of(calls.items(), "shared shape,", len(calls), processes)
    shape = fits.pop("the mean").model
    ratios = {channel: _ratio(shape, logs[channel], own_options, fits[channel]) for channel in asked}
    middle = float(np.median(list(ratios.values())))
    if middle > WORSE and not options.force:
        raise FitError(
            f"the channels have no common shape: on channels left out of it ({jobs.named(asked)}) one shape "
            f"for all leaves {middle:.3g} times what their own models leave on cycles left out; leave "
            "`shared_shape` out, or identify like channels together (`force` keeps it)"
        )
    what = "the mean" if alike else "fitted to the logs"
    return (
        shape,
        f"one shape, {what} of {len(others)} channels: on {jobs.named(asked)}, left out of it, it leaves "
        f"{middle:.3g} times what their own models leave on cycles left out",
    )


def _spread(channels: Sequence[str], count: int) -> list[str]:
    """Return at most so many channels, evenly spread, neither first nor last where there are others."""
    if count >= len(channels):
        return list(channels)
    return [channels[(2 * k + 1) * len(channels) // (2 * count)] for k in range(count)]


def _ratio(
    shape: ActuatorModel, logs: Sequence[RecordedLog], options: IdentificationOptions, own: IdentifyResult
) -> float:
    """Return what the shape leaves on a channel over what its own model leaves on cycles left out."""
    kept = identifying.identify_recordings(logs, dataclasses.replace(options, force=True), prior=shape)
    error, left_out = kept.model.fit["rmse"], own.model.fit.get("cross_validated_rmse")
    if not isinstance(left_out, float):
        left_out = own.model.fit["rmse"]
    assert isinstance(error, float) and isinstance(left_out, float)
    return error / left_out


def _are_driven_alike(logs: Mapping[str, Sequence[RecordedLog]]) -> bool:
    """Tell whether all channels have the same drive, so that their displacements have a mean."""
    first, *others = logs.values()
    return all(
        np.array_equal(one.recording.voltage, other.recording.voltage)
        for own in others
        for one, other in zip(first, own, strict=True)
    )


def _of_one_gain(
    logs: Mapping[str, Sequence[RecordedLog]], options: IdentificationOptions
) -> list[RecordedLog]:
    """Return the logs of channels that are driven differently, as of one actuator, their gains made equal.

    A gain is the slope over the drive at first, then over what a model of all of them gives for that drive.
    """
    explained = {channel: [one.recording.voltage for one in own] for channel, own in logs.items()}
    for last in (False, True):
        slopes = {channel: _slope(explained[channel], own) for channel, own in logs.items()}
        middle = float(np.median(list(slopes.values())))
        logs = {channel: own for channel, own in logs.items() if slopes[channel] / middle > LEAST_GAIN}
        scaled = [
            dataclasses.replace(one, recording=dataclasses.replace(
                one.recording, displacement=one.recording.displacement * (middle / slopes[channel])
            ))
            for channel, own in logs.items() for one in own
        ]  # fmt: skip
        if not last:
            model = identifying.identify_recordings(scaled, options).model
            explained = {channel: [_predicted(model, one) for one in own] for channel, own in logs.items()}
    return scaled


def _slope(explained: Sequence[FloatArray], logs: Sequence[RecordedLog]) -> float:
    """Return the slope of a channel's displacements over something, each log with its own offset."""
    pairs = zip(explained, (one.recording.displacement for one in logs), strict=True)
    x, y = (
        np.concatenate(one) for one in zip(*((a - a.mean(), b - b.mean()) for a, b in pairs), strict=True)
    )
    return float(x @ y) / float(x @ x)


def _predicted(model: ActuatorModel, log: RecordedLog) -> FloatArray:
    drive, seconds = log.recording.voltage, log.recording.seconds()
    steps = None if seconds is None else np.diff(seconds, prepend=2.0 * seconds[0] - seconds[1])
    return model.simulate(drive, model.start(float(drive[0]), "auto"), time_step=steps).y


def _mean_of(logs: Mapping[str, Sequence[RecordedLog]]) -> list[RecordedLog]:
    """Return the mean of channels that are driven alike, each brought to the mean gain and offset.

    Twice: the first channel is what the others are compared with, then the mean of the first time.
    """
    names = list(logs)
    means = []
    for place, first in enumerate(logs[names[0]]):
        table = np.column_stack([logs[channel][place].recording.displacement for channel in names])
        table = table - table.mean(axis=0)
        mean = table[:, 0]
        for _ in range(2):
            gains = table.T @ mean / float(mean @ mean)
            moving = np.abs(gains) > LEAST_GAIN * np.median(np.abs(gains))
            mean = (table[:, moving] / gains[moving]).mean(axis=1) * float(np.median(gains[moving]))
        recording = dataclasses.replace(first.recording, displacement=np.ascontiguousarray(mean))
        means.append(dataclasses.replace(first, recording=recording))
    return means
