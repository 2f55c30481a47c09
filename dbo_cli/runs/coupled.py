"""Runs over coupled channels: what the sensors show on the one side, what each model takes on the other.

Identification takes apart what was recorded, ``compensate`` what is wanted; ``simulate`` puts together what
the models give. All channels are in memory at once.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from dbo_cli.errors import InputError, UsageError
from dbo_cli.hysteresis.identification.coupling_fit import Frames, find_coupling
from dbo_cli.hysteresis.model_set import Coupling, is_set, read_model, read_set
from dbo_cli.logs.addresses import Address
from dbo_cli.logs.channels import ChannelReader, column_of
from dbo_cli.logs.reading_options import ALL_ROWS, ReadingOptions
from dbo_cli.logs.sample_block import FloatArray, joined
from dbo_cli.logs.signal_log import open_log
from dbo_cli.logs.whole_output import KeptOutputs
from dbo_cli.runs.identifying import RecordedLog
from dbo_cli.runs.jobs import Work
from dbo_cli.runs.roles import bring_to, quantity_wish

Recordings = tuple[Sequence[RecordedLog], Sequence[RecordedLog]]
"""Of one channel: what is fitted, and what its model is judged on."""


def coupling_of(model_file: str, channels: Sequence[str], work: Work) -> Coupling | None:
    """Return the coupling that a set holds, in the order of channels, of which none may be missing."""
    found = read_set(model_file).coupling if is_set(model_file) else None
    if found is not None and work.keep_going:
        raise UsageError(
            f"`keep_going`: the models of {model_file} are coupled: each is needed for the others"
        )
    return None if found is None else found.of(channels)


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
            _matrix(channels, [log.recording.displacement for log in one], one[0].recording.name)
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
        _matrix(channels, [log.recording.voltage for log in logs], first.name),
        _matrix(channels, [log.recording.displacement for log in logs], first.name),
    )


def _matrix(channels: Sequence[str], columns: Sequence[FloatArray], name: str) -> FloatArray:
    """Return a column a channel (InputError where their rows are not the same)."""
    for channel, column in zip(channels, columns, strict=True):
        if len(column) != len(columns[0]):
            raise InputError(
                f"channel {channel}: {name} has {len(column):,} good rows of it and {len(columns[0]):,} of "
                f"channel {channels[0]}: coupled channels are needed in every row (take good `rows` A:B)"
            )
    return np.column_stack(columns)


def logs_apart(
    reader: ChannelReader,
    models: Callable[[str], str],
    pattern: str,
    reading: ReadingOptions,
    coupling: Coupling,
) -> dict[str, Address]:
    """Return logs of what each channel has to do alone, so that the sensors show what is wanted of all."""
    whole = dataclasses.replace(reading, rows=ALL_ROWS, resample=None, skip_bad=False)
    logs, columns = {}, []
    for channel in coupling.channels:
        model = read_model(models(channel))
        logs[channel] = reader.log(channel)
        want = {
            "wanted": quantity_wish(
                model.output, column_of(pattern, channel), option="displacement", trajectory=True
            )
        }
        with open_log(logs[channel], want, whole) as opened:
            bring_to(opened, "wanted", model.output, models(channel))
            columns.append(joined(list(opened.blocks())).values["wanted"])
    own = coupling.apart(_matrix(coupling.channels, columns, reader.address.text))
    for place, (channel, log) in enumerate(logs.items()):
        table, number = log.table, reader.channels[channel]["displacement"].number
        assert table is not None  # a bad row was refused above
        unit = read_model(models(channel)).output.unit
        infos = [
            dataclasses.replace(one, unit=unit) if one.number == number else one for one in table.columns
        ]
        block = dataclasses.replace(
            table.block, values={**table.block.values, str(number): own[:, place].copy()}
        )
        logs[channel] = dataclasses.replace(log, table=dataclasses.replace(table, columns=infos, block=block))
    return logs


def put_together(outputs: Mapping[str, KeptOutputs], coupling: Coupling, result: int) -> None:
    """Let one column of all channels' kept signals (``result``: its place) be what the sensors show."""
    signals = [one.signals[0] for one in outputs.values()]
    name = signals[0].address.text
    shown = coupling.together(_matrix(list(outputs), [one.arrays[result] for one in signals], name))
    for place, (one, signal) in enumerate(zip(outputs.values(), signals, strict=True)):
        arrays = list(signal.arrays)
        arrays[result] = np.ascontiguousarray(shown[:, place])
        one.signals[0] = dataclasses.replace(signal, arrays=tuple(arrays))
