"""One loop shape for all channels: the mean of what they do, then gain, offset and lag of each.

The actuators of a mirror come from one batch: their loops differ in gain and offset, and hardly in shape. The
mean over channels has less noise than any of them, one long fit serves all, and each channel needs three
numbers. Channels that are driven differently have no mean: some of them are fitted together, as logs of one
actuator. Whether there is one shape is asked of channels that took no part in the mean.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from dbo_cli.errors import FitError, UsageError
from dbo_cli.hysteresis.identification import IdentificationOptions
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.runs.identifying import Identified, RecordedLog, identify_recordings
from dbo_cli.runs.jobs import named, run_jobs

Floats = NDArray[np.float64]

MOST_POOLED = 64  # channels in the mean: with more, noise no longer matters beside the shape
MOST_UNLIKE = (
    8  # channels of which each is a log of one fit, where they are driven differently: it takes as long
)
LEAST_GAIN = 0.1  # of the middle one: a channel with less is dead, and takes no part
LEFT_OUT = 3  # channels, at most, that take no part in the mean and are asked about it
FEWEST = 4  # channels: of fewer, none could be left out
WORSE = 1.1
"""Times its own model's error on cycles left out, the median of the channels left out: what the one shape
may leave. Eight virtual actuators (sample_data/) that differ in gain and offset left 0.82 times (noise of
0.05 % of the stroke) and 0.98 (of 0.5 %); with loops 10 % wider and narrower 6.6 times, with bends of 0 to
0.2 7.0 times.
"""


@dataclasses.dataclass(frozen=True)
class SharedShape:
    """The model of the mean channel, and in words what speaks for it."""

    model: ActuatorModel
    note: str


def options_of_channel(options: IdentificationOptions) -> IdentificationOptions:
    """Return what of the options goes with a shape that is kept."""
    kept = {name: getattr(options, name) for name in ("skip_seconds", "rated", "force")}
    return IdentificationOptions(**kept, sensor_delay=options.sensor_delay, sensor_lag=options.sensor_lag)


def shared_shape(
    channels: Sequence[str],
    read: Callable[[str], Sequence[RecordedLog]],
    options: IdentificationOptions,
    arguments: Sequence[str],
    processes: int = 1,
) -> SharedShape:
    """Return the shape that channels have in common.

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
    jobs = {"the mean": functools.partial(identify_recordings, mean, options, (), arguments)}
    jobs |= {channel: functools.partial(identify_recordings, logs[channel], options) for channel in asked}
    fits = _fits(jobs, processes)
    shape = fits.pop("the mean").model
    ratios = {channel: _ratio(shape, logs[channel], own_options, fits[channel]) for channel in asked}
    middle = float(np.median(list(ratios.values())))
    if middle > WORSE and not options.force:
        raise FitError(
            f"the channels have no common shape: on channels left out of it ({named(asked)}) one shape "
            f"for all leaves {middle:.3g} times what their own models leave on cycles left out; leave "
            "`shared_shape` out, or identify like channels together (`force` keeps it)"
        )
    what = "the mean" if alike else "fitted to the logs"
    return SharedShape(
        shape,
        f"one shape, {what} of {len(others)} channels: on {named(asked)}, left out of it, it leaves "
        f"{middle:.3g} times what their own models leave on cycles left out",
    )


def _fits(jobs: Mapping[str, Callable[[], Identified]], processes: int) -> dict[str, Identified]:
    """Return what each job identified; the first failure ends it, and names its job."""
    fits: dict[str, Identified] = {}
    for done in run_jobs(jobs.items(), processes):
        if done.problem is not None:
            raise type(done.problem)(f"shared shape, {done.name}: {done.problem}")
        assert done.value is not None
        fits[done.name] = done.value
    return fits


def _spread(channels: Sequence[str], count: int) -> list[str]:
    """Return at most so many channels, evenly spread, neither first nor last where there are others."""
    if count >= len(channels):
        return list(channels)
    return [channels[(2 * k + 1) * len(channels) // (2 * count)] for k in range(count)]


def _ratio(
    shape: ActuatorModel, logs: Sequence[RecordedLog], options: IdentificationOptions, own: Identified
) -> float:
    """Return what the shape leaves on a channel over what its own model leaves on cycles left out."""
    kept = identify_recordings(logs, dataclasses.replace(options, force=True), prior=shape)
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
            model = identify_recordings(scaled, options).model
            explained = {channel: [_predicted(model, one) for one in own] for channel, own in logs.items()}
    return scaled


def _slope(explained: Sequence[Floats], logs: Sequence[RecordedLog]) -> float:
    """Return the slope of a channel's displacements over something, each log with its own offset."""
    pairs = zip(explained, (one.recording.displacement for one in logs), strict=True)
    x, y = (
        np.concatenate(one) for one in zip(*((a - a.mean(), b - b.mean()) for a, b in pairs), strict=True)
    )
    return float(x @ y) / float(x @ x)


def _predicted(model: ActuatorModel, log: RecordedLog) -> Floats:
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
