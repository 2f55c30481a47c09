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
from dbo_cli.hysteresis.identification import IdentificationOptions, Recording
from dbo_cli.hysteresis.identification.prior import OF_OTHERS
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
    Recordings,
    sign_line,
    sign_warning,
    summary_of_model,
    with_sign,
)
from dbo_cli.runs.jobs import Value
from dbo_cli.runs.many import CHANNEL, address_of, make_folder_of, say_found

# channels in the mean: with more, noise no longer matters beside the shape
MOST_POOLED = 64
# channels, each a log of one fit, where they are driven differently: it takes as long
MOST_UNLIKE = 8
LEAST_GAIN = 0.1  # of the middle one: a channel with less is dead, and takes no part
LEFT_OUT = 3  # channels, at most, that take no part in the mean and are asked about it
FEWEST = 4  # channels: of fewer, none could be left out
WORSE = 1.1
"""Times its own model's error on cycles left out, the median of the channels left out: what the one shape
may leave. Measured: docs/choices.md.
"""


def identify_channels(
    run: IdentifyRun, output: Address, work: jobs.Work, listener: Listener
) -> jobs.Outcome:
    """Identify a model of each channel and write a set of them, or (``{channel}``) a file of each."""
    patterns, inputs = asked_patterns(run), [*run.logs, *run.validation]
    if run.brought.get("coupling", False) and CHANNEL in output.text:
        raise UsageError(
            f"`coupling` belongs to all channels: write one set, without {CHANNEL} in its name"
        )
    if run.brought.get("coupling", False) and work.keep_going:
        raise UsageError(
            "`coupling` and `keep_going` exclude each other: each channel is needed for the others"
        )
    check_document(output, "a model", "json")
    run.check_outputs([] if CHANNEL in output.text else [output], inputs)
    outcome, work = (
        jobs.Outcome(),
        dataclasses.replace(work, all_needed=run.brought.get("coupling", False)),
    )
    fits, coupling = fits_of_channels(run, work, outcome, listener)
    if fits:
        with all_or_none():
            models = {channel: fit.model for channel, fit in fits.items()}
            _write_models(output, models, inputs, coupling)
            if run.summary is not None:
                summaries = []
                for channel, fit in fits.items():
                    summaries.append(
                        {"channel": channel, **summary_of_model(fit, run.command)}
                    )
                write_json(run.summary, summaries)
        shown = ", ".join(
            f"{option} '{pattern}'" for option, pattern in patterns.items()
        )
        read = next(iter(fits.values())).remarks.read
        read = [f"{line}; {len(fits):,} channels: {shown}" for line in read]
        outcome.remarks.read += with_sign(read, sign_line(models))
        exchanged = sign_warning(models, "channel")
        if exchanged is not None:
            outcome.remarks.warn(exchanged)
    say_found(fits, "channel", outcome.remarks)
    return outcome


def asked_patterns(run: IdentifyRun) -> dict[str, str]:
    """Return the patterns of columns; UsageError for a single column, or a shape from two places."""
    patterns = patterns_of(
        voltage=run.voltage or "",
        displacement=run.displacement or "",
        uncertainty=run.uncertainty,
    )
    if run.brought.get("shared_shape", False):
        if run.prior is not None:
            raise UsageError(
                "`shared_shape` and `prior` exclude each other: each is where the shape comes from"
            )
        if run.uncertainty is not None:
            raise UsageError(
                "`shared_shape` and `uncertainty` exclude each other: the shape is of the mean channel"
            )
    return patterns


def fits_of_channels(
    run: IdentifyRun,
    work: jobs.Work,
    outcome: jobs.Outcome,
    listener: Listener = SILENT,
) -> tuple[dict[str, IdentifyResult], Coupling | None]:
    """Identify a model of each channel, in the order of the log; return how they show in each other, too."""
    patterns, reading, options = asked_patterns(run), run.reading, run.options
    whole, coupling = dataclasses.replace(reading, rows=ALL_ROWS), None
    judged = {
        role: pattern for role, pattern in patterns.items() if role != "uncertainty"
    }
    apart: Mapping[str, Recordings] = {}  # where all have to be read before
    channels_by_drive: dict[bytes, dict[str, None]] = {}
    with (
        opened_readers(run.logs, reading, patterns, digest=True) as readers,
        opened_readers(run.validation, whole, judged, digest=True) as checks,
    ):
        channels = list(readers[0].channels)
        prior_of = _priors(run.prior, channels)

        def recordings(channel: str) -> Callable[[], Recordings]:
            """Return what reads one channel; two of the same displacements are kept in mind."""
            fit, judged = apart.get(channel) or (
                [reader.log(channel) for reader in readers], [reader.log(channel) for reader in checks]
            )  # fmt: skip
            number = readers[0].channels[channel]["displacement"].number
            if isinstance(fit[0], Address) and fit[0].table is not None:
                values = fit[0].table.block.values[str(number)]
                channels_by_drive.setdefault(
                    hashlib.sha256(values.tobytes()).digest(), {}
                )[channel] = None
            fields: dict[str, Any] = columns_of(patterns, channel)
            fields |= {"logs": fit, "validation": judged, "prior": None}
            return functools.partial(
                dataclasses.replace(run, **fields).read, prior=prior_of(channel)
            )

        if run.brought.get("coupling", False):
            listener.working("how the channels show in each other")
            readings = ((channel, recordings(channel)) for channel in channels)
            coupling, apart = recordings_apart(
                _all_of(readings, "channel", len(channels))
            )
            listener.finished()
            outcome.remarks.notes.append(coupling.summary())
        if run.brought.get("shared_shape", False):
            listener.working("the shape that the channels share")
            arguments = run.arguments(patterns, checked=False)
            words = (
                channels,
                lambda channel: recordings(channel)()[0],
                options,
                arguments,
            )
            shape, note = shared_shape(*words, work.processes)
            listener.finished()
            outcome.remarks.notes.append(note)
            prior_of, options = (lambda channel: shape), options_of_channel(options)

        def call(channel: str) -> Callable[[], IdentifyResult]:
            arguments = run.arguments(columns_of(patterns, channel), prior_of(channel))
            return functools.partial(
                _identify_channel,
                recordings(channel),
                options,
                arguments,
                prior_of(channel),
            )

        calls = ((channel, call(channel)) for channel in channels)
        good = outcome.good(calls, work, "channel", len(channels), listener)
        fits = {done.name: done.value for done in good}
    for twins in channels_by_drive.values():
        if len(twins) > 1:
            outcome.remarks.warn(
                f"channels {jobs.named(list(twins))} hold the same displacements, sample by sample: is "
                "one channel's log another's?"
            )
    return fits, coupling


def _all_of(
    calls: jobs.Jobs[Value], noun: str, count: int, processes: int = 1
) -> dict[str, Value]:
    """Return what came of jobs that are all needed; the first failure ends it, and is named."""
    good = jobs.Outcome().good(
        calls, jobs.Work(processes, all_needed=True), noun, count
    )
    return {done.name: done.value for done in good}


def _priors(
    prior: Any, channels: Sequence[str]
) -> Callable[[str], str | ActuatorModel | None]:
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
    logs = [
        list(of_all)
        for of_all in zip(*(fit for fit, _ in recorded.values()), strict=True)
    ]
    checks = [
        list(of_all)
        for of_all in zip(*(check for _, check in recorded.values()), strict=True)
    ]
    coupling = find_coupling(channels, [_frames(channels, frame) for frame in logs])
    for frame in [*logs, *checks]:
        apart = coupling.apart(
            matrix_of(
                channels,
                [log.displacement for log in frame],
                frame[0].name,
            )
        )
        for place, log in enumerate(frame):
            frame[place] = dataclasses.replace(
                log, displacement=np.ascontiguousarray(apart[:, place])
            )
    return coupling, {
        channel: ([frame[k] for frame in logs], [frame[k] for frame in checks])
        for k, channel in enumerate(channels)
    }


def _frames(channels: Sequence[str], logs: Sequence[Recording]) -> Frames:
    first = logs[0]
    seconds = first.seconds()
    return Frames(
        np.arange(float(len(first.voltage))) if seconds is None else seconds,
        matrix_of(channels, [log.voltage for log in logs], first.name),
        matrix_of(channels, [log.displacement for log in logs], first.name),
    )


def _identify_channel(
    read: Callable[[], Recordings],
    options: IdentificationOptions,
    arguments: Sequence[str],
    prior: str | ActuatorModel | None,
) -> IdentifyResult:
    """Identify one channel, in whichever process; ``arguments`` say how the identification was called."""
    fitted, checks = read()
    prior_model = read_model(prior) if isinstance(prior, str) else prior
    return identifying.identify_recordings(
        fitted, options, checks, arguments, prior_model
    )


def _write_models(
    output: Address,
    models: Mapping[str, ActuatorModel],
    inputs: Sequence[Given],
    coupling: Coupling | None,
) -> None:
    if CHANNEL not in output.text:
        write_whole(output, set_to_bytes(models, coupling), protect=inputs)
        return
    make_folder_of(output)
    files = {channel: address_of(output, channel) for channel in models}
    check_outputs(list(files.values()), inputs)
    for channel, model in models.items():
        write_whole(files[channel], model_to_bytes(model), protect=inputs)


# --- one loop shape for all channels: the mean of what they do, then gain, offset and
# lag of each ---
#
# The actuators of a mirror come from one batch: their loops differ in gain and offset,
# and hardly in shape. The mean over channels has less noise than any of them, one long
# fit serves all, and each needs three numbers. Channels that are driven differently
# have no mean: some of them are fitted together, as logs of one actuator. Whether there
# is one shape is asked of channels that took no part in the mean.


def options_of_channel(options: IdentificationOptions) -> IdentificationOptions:
    """Return what of the options goes with a shape that is kept."""
    fields = {
        name: getattr(options, name)
        for name in ("skip_seconds", "rated", "force", "sign")
    }
    return IdentificationOptions(
        **fields, sensor_delay=options.sensor_delay, sensor_lag=options.sensor_lag
    )


def shared_shape(
    channels: Sequence[str],
    read: Callable[[str], Sequence[Recording]],
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
        Channels that took no part in the mean are followed worse than by models of
        their own.
    """
    if len(channels) < FEWEST:
        raise UsageError(
            f"`shared_shape` needs {FEWEST} channels or more, and there are {len(channels)}"
        )
    chosen = _spread(channels, MOST_POOLED + LEFT_OUT)
    left_out = _spread(chosen, min(LEFT_OUT, len(chosen) // FEWEST))
    logs = {channel: read(channel) for channel in chosen}
    fitted = {channel: logs[channel] for channel in chosen if channel not in left_out}
    alike = _are_driven_alike(fitted)
    if not alike:
        fitted = {
            channel: fitted[channel] for channel in _spread(list(fitted), MOST_UNLIKE)
        }
    mean = _mean_of(fitted) if alike else _of_one_gain(fitted, options)
    own_options = options_of_channel(options)
    fit = identifying.identify_recordings
    calls = {"the mean": functools.partial(fit, mean, options, (), arguments)}
    calls |= {
        channel: functools.partial(fit, logs[channel], options) for channel in left_out
    }
    fits = _all_of(calls.items(), "shared shape,", len(calls), processes)
    shape = fits.pop("the mean").model
    shape = dataclasses.replace(shape, fit={**shape.fit, OF_OTHERS: True})
    ratios = {
        channel: _ratio(shape, logs[channel], own_options, fits[channel])
        for channel in left_out
    }
    middle = float(np.median(list(ratios.values())))
    if middle > WORSE and not options.force:
        raise FitError(
            f"the channels have no common shape: on channels left out of it ({jobs.named(left_out)}) one "
            f"shape "
            f"for all leaves {middle:.3g} times what their own models leave on cycles left out; leave "
            "`shared_shape` out, or identify like channels together (`force` keeps it)"
        )
    what = "the mean" if alike else "fitted to the logs"
    return (
        shape,
        f"one shape, {what} of {len(fitted)} channels: on {jobs.named(left_out)}, left out of it, it leaves "
        f"{middle:.3g} times what their own models leave on cycles left out",
    )


def _spread(channels: Sequence[str], count: int) -> list[str]:
    """Return at most so many channels, evenly spread, neither first nor last where there are others."""
    if count >= len(channels):
        return list(channels)
    return [channels[(2 * k + 1) * len(channels) // (2 * count)] for k in range(count)]


def _ratio(
    shape: ActuatorModel,
    logs: Sequence[Recording],
    options: IdentificationOptions,
    own_fit: IdentifyResult,
) -> float:
    """Return what the shape leaves on a channel over what its own model leaves on cycles left out."""
    with_shape = identifying.identify_recordings(
        logs, dataclasses.replace(options, force=True), prior=shape
    )
    error, left_out = (
        with_shape.model.fit["rmse"],
        own_fit.model.fit.get("cross_validated_rmse"),
    )
    if not isinstance(left_out, float):
        left_out = own_fit.model.fit["rmse"]
    assert isinstance(error, float) and isinstance(left_out, float)
    return error / left_out


def _are_driven_alike(logs: Mapping[str, Sequence[Recording]]) -> bool:
    """Tell whether all channels have the same drive, so that their displacements have a mean."""
    first, *rest = logs.values()
    return all(
        np.array_equal(log.voltage, same.voltage)
        for logs_of_channel in rest
        for log, same in zip(first, logs_of_channel, strict=True)
    )


def _of_one_gain(
    logs: Mapping[str, Sequence[Recording]], options: IdentificationOptions
) -> list[Recording]:
    """Return the logs of channels that are driven differently, as of one actuator, their gains made equal.

    A gain is the slope over the drive at first, then over what a model of all of them
    gives for that drive.
    """
    explained = {}
    for channel, logs_of_channel in logs.items():
        explained[channel] = [log.voltage for log in logs_of_channel]
    for last in (False, True):
        slopes = {
            channel: _slope(explained[channel], logs_of_channel)
            for channel, logs_of_channel in logs.items()
        }
        middle = float(np.median(list(slopes.values())))
        logs = {
            channel: logs_of_channel
            for channel, logs_of_channel in logs.items()
            if slopes[channel] / middle > LEAST_GAIN
        }
        scaled = [
            dataclasses.replace(
                log, displacement=log.displacement * (middle / slopes[channel])
            )
            for channel, logs_of_channel in logs.items()
            for log in logs_of_channel
        ]
        if not last:
            model = identifying.identify_recordings(scaled, options).model
            explained = {}
            for channel, logs_of_channel in logs.items():
                explained[channel] = [_predicted(model, log) for log in logs_of_channel]
    return scaled


def _slope(explained: Sequence[FloatArray], logs: Sequence[Recording]) -> float:
    """Return the slope of a channel's displacements over something, each log with its own offset."""
    pairs = zip(explained, (log.displacement for log in logs), strict=True)
    x, y = (
        np.concatenate(parts)
        for parts in zip(*((a - a.mean(), b - b.mean()) for a, b in pairs), strict=True)
    )
    return float(np.sum(x * y)) / float(np.sum(x * x))


def _predicted(model: ActuatorModel, log: Recording) -> FloatArray:
    drive, seconds = log.voltage, log.seconds()
    steps = (
        None
        if seconds is None
        else np.diff(seconds, prepend=2.0 * seconds[0] - seconds[1])
    )
    return model.simulate(
        drive, model.start(float(drive[0]), "auto"), time_step=steps
    ).y


def _mean_of(logs: Mapping[str, Sequence[Recording]]) -> list[Recording]:
    """Return the mean of channels that are driven alike, each brought to the mean gain and offset.

    Twice: the first channel is what the others are compared with, then the mean of the
    first time.
    """
    names = list(logs)
    means = []
    for place, first in enumerate(logs[names[0]]):
        table = np.column_stack(
            [logs[channel][place].displacement for channel in names]
        )
        table = table - table.mean(axis=0)
        mean = table[:, 0]
        for _ in range(2):
            gains = table.T @ mean / float(np.sum(mean * mean))
            moving = np.abs(gains) > LEAST_GAIN * np.median(np.abs(gains))
            mean = (table[:, moving] / gains[moving]).mean(axis=1) * float(
                np.median(gains[moving])
            )
        displacement = np.ascontiguousarray(mean)
        means.append(dataclasses.replace(first, displacement=displacement))
    return means
