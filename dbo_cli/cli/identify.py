"""``dbo identify``: recorded logs into a model."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from dbo_cli.cli import options, signals, values
from dbo_cli.cli.bundles import Reading, bundled
from dbo_cli.cli.messages import Voice
from dbo_cli.errors import UsageError

if TYPE_CHECKING:
    from dbo_cli.hysteresis.identification import Identification, IdentificationOptions, Recording

METHODS = ("least-squares", "paper")
SLOPES = ("auto", "growing", "falling", "free")
ZEROS = ("none", "mean", "first")


@bundled
def identify(
    logs: options.Logs,
    reading: Reading,
    voice: Voice,
    command_line: Sequence[str],
    gears: options.Gears = "auto",
    points: options.Points = "auto",
    relaxation: options.RelaxationTimes = "auto",
    delay: options.DelaySeconds = "auto",
    slopes: options.Slopes = "auto",
    skip: options.Skip = "0",
    zero: options.Zero = "none",
    method: options.Method = "least-squares",
    validate: options.Validate = None,
    rated_min: options.RatedMin = None,
    rated_max: options.RatedMax = None,
    force: options.Force = False,
    voltage: options.Voltage = None,
    displacement: options.Displacement = None,
    output: options.Output = "-",
) -> None:
    """Identify a model of an actuator from logs of its drive voltage and displacement.

    What is left at auto is chosen on cycles left out of the fit. Several logs of one actuator are fitted
    together, each with its own sensor offset and drift. What was found, and what to be careful about, is said
    on standard error and kept in the model.
    """
    asked: dict[str, Any] = {
        "gears": values.auto_or(_gears, "--gears", gears),
        "points": values.auto_or(_points, "--points", points),
        "relaxation": values.auto_or(values.times, "--relaxation", relaxation),
        "delay": values.auto_or(values.not_negative, "--delay", delay),
        "slopes": None if slopes == "auto" else values.choice("--slopes", slopes, SLOPES),
        "skip_seconds": values.not_negative("--skip", skip),
        "method": values.choice("--method", method, METHODS),
        "zero": _zero(zero),
        "rated": _rating(rated_min, rated_max),
        "force": force,
    }
    from dbo_cli.hysteresis.identification import IdentificationOptions
    from dbo_cli.logs.whole_output import check_output

    others = validate or []
    check_output(output, [*logs, *others])
    reader = RecordingReader(voice, voltage, displacement, signals.short_names([*logs, *others]))
    recordings = [reader.read(address, reading) for address in logs]
    checks = [reader.read(address, dataclasses.replace(reading, rows=None)) for address in others]
    result = _identified(recordings, IdentificationOptions(**asked), checks)
    _write(result, output, reader.inputs, _arguments(command_line, [*logs, *others]))
    voice.notes(result.summary)
    for warning in result.warnings:
        voice.warning(warning)


class RecordingReader:
    """Reads whole logs and keeps the record of each for the model's provenance."""

    def __init__(
        self,
        voice: Voice,
        voltage: str | None,
        displacement: str | None,
        names: Mapping[str, str],
    ) -> None:
        from dbo_cli.logs.columns import ColumnWish

        self.voice = voice
        self.names = names
        self.want = {
            "voltage": ColumnWish(voltage, signals.VOLTAGE, option="voltage"),
            "displacement": ColumnWish(displacement, signals.DISPLACEMENT, option="displacement"),
        }
        self.inputs: list[dict[str, Any]] = []

    def read(self, address: str, reading: Reading) -> Recording:
        """Read the wanted rows of one log."""
        from dbo_cli.hysteresis.identification import Recording

        with signals.open_signals(address, self.want, reading, self.voice, digest=True) as log:
            block = log.read()
        self.voice.notes(log.notes)
        self.inputs.append(dict(log.record()))
        rate = None if reading.skip_bad else reading.resample or log.sample_rate
        return Recording(
            self.names.get(address, log.name),
            block.values["voltage"],
            block.values["displacement"],
            time=block.time if rate is None else None,
            sample_period=None if rate is None else 1.0 / rate,
            voltage_unit=log.columns["voltage"].unit,
            displacement_unit=log.columns["displacement"].unit,
        )


def _identified(
    recordings: Sequence[Recording], asked: IdentificationOptions, checks: Sequence[Recording]
) -> Identification:
    from dbo_cli.hysteresis.identification import identify as identify_model

    return identify_model(recordings, asked, checks)


def _write(
    result: Identification, output: str, inputs: Iterable[dict[str, Any]], arguments: Sequence[str]
) -> None:
    """Write the model with its provenance."""
    from dbo_cli.hysteresis.model_file import model_to_bytes
    from dbo_cli.logs.provenance import program_version_string
    from dbo_cli.logs.whole_output import write_whole

    provenance = {
        "program": program_version_string(),
        "arguments": list(arguments),
        "inputs": list(inputs),
    }
    write_whole(output, model_to_bytes(dataclasses.replace(result.model, provenance=provenance)))


def _arguments(words: Sequence[str], logs: Iterable[str]) -> list[str]:
    """Return the command line as far as it bears on the result: no folders, no output, no loudness.

    Folders differ between machines, and the same logs and options shall give the same bytes.
    """
    kept: list[str] = []
    known = set(logs)
    following = iter(words)
    for word in following:
        if word in ("-o", "--output"):
            next(following, None)
        elif word.startswith("--output=") or word in ("-q", "--quiet", "--verbose", "--debug"):
            continue
        else:
            kept.append(os.path.basename(word) if word in known else word)
    return kept


def _gears(option: str, text: str) -> int:
    return values.whole(option, text, 1)


def _points(option: str, text: str) -> int:
    return values.whole(option, text, 0)


def _zero(text: str) -> str | float:
    if text in ZEROS:
        return text
    try:
        return values.number("--zero", text)
    except UsageError:
        raise UsageError(f"--zero: '{text}' is none of {', '.join(ZEROS)} and not a number") from None


def _rating(low: str | None, high: str | None) -> tuple[float, float] | None:
    """Return the actuator's rated range, where both ends were given."""
    if low is None and high is None:
        return None
    if low is None or high is None:
        raise UsageError("--v-min and --v-max belong together: the rated range of the drive")
    rated = values.number("--v-min", low), values.number("--v-max", high)
    if rated[0] >= rated[1]:
        raise UsageError(f"--v-min {low} must be below --v-max {high}")
    return rated
