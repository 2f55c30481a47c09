"""``dbo identify``: recorded logs into a model."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dbo_cli.cli import options
from dbo_cli.cli.messages import Progress, Voice, refuse_terminal
from dbo_cli.errors import UsageError

if TYPE_CHECKING:
    from dbo_cli.logs.reading_options import ReadingOptions


def identify(
    *,
    logs: options.Logs,
    reading: ReadingOptions,
    voice: Voice,
    gears: options.Gears,
    points: options.Points,
    relaxation: options.RelaxationTimes,
    delay: options.DelaySeconds,
    dynamics: options.Dynamics,
    sensor_delay: options.SensorDelay,
    sensor_lag: options.SensorLag,
    slopes: options.Slopes,
    skip: options.Skip,
    zero: options.Zero,
    method: options.Method,
    validate: options.Validate,
    v_min: options.RatedMin,
    v_max: options.RatedMax,
    force: options.Force,
    voltage: options.Voltage,
    displacement: options.Displacement,
    output: options.Output,
) -> None:
    """Identify a model of an actuator from logs of its drive voltage and displacement.

    What is left at auto is chosen on cycles left out of the fit. Several logs of one actuator are fitted
    together, each with its own sensor offset and drift. What was found, and what to be careful about, is said
    on standard error and kept in the model.

    Example: dbo identify recorded.csv -o model.json
    """
    refuse_terminal(output)
    from dbo_cli.hysteresis.identification import IdentificationOptions
    from dbo_cli.runs.identifying import identify_logs

    asked = IdentificationOptions(
        gears=gears,
        points=points,
        relaxation=relaxation,
        delay=delay,
        dynamics=dynamics,
        slopes=slopes,
        skip_seconds=skip,
        method=method,
        zero=zero,
        rated=_rating(v_min, v_max),
        force=force,
        sensor_delay=sensor_delay,
        sensor_lag=sensor_lag,
    )
    found = identify_logs(
        logs,
        validate or [],
        output,
        reading,
        asked,
        voltage=voltage,
        displacement=displacement,
        listener=Progress(voice, "read"),
    )
    voice.notes([*found.remarks.read, *found.remarks.notes, *found.summary])
    voice.warnings(found.remarks.warnings)


def _rating(low: float | None, high: float | None) -> tuple[float, float] | None:
    """Return the actuator's rated range, where both ends were given."""
    if low is None and high is None:
        return None
    if low is None or high is None:
        raise UsageError("`v_min` and `v_max` belong together: the rated range of the drive")
    return low, high
