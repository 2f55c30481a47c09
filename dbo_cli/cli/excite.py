"""``dbo excite``: the drive from which an actuator is identified well."""

from __future__ import annotations

from dbo_cli.cli import options, signals, values
from dbo_cli.cli.bundles import bundled
from dbo_cli.cli.messages import Voice
from dbo_cli.errors import UsageError


@bundled
def excite(
    voice: Voice,
    v_max: options.ExciteMax,
    v_min: options.ExciteMin = "0",
    sample_rate: options.ExciteRate = "1000",
    duration: options.Duration = "30",
    frequency: options.Frequency = "1",
    max_slew: options.MaxSlew = None,
    file_format: options.OutputFormat = None,
    output: options.Output = "-",
) -> None:
    """Write the drive that identifies well; play it and record the displacement.

    Two sweeps over the whole range wipe out the past, then amplitudes decay towards the middle, so that every
    gear turns at many places and lag is told from loop width, and minor loops at both ends show the
    asymmetry. It ends where it began, so that drift shows, and it never leaves the limits.
    """
    low, high = values.number("--v-min", v_min), values.number("--v-max", v_max)
    rate = values.positive("--sample-rate", sample_rate)
    seconds = values.positive("--duration", duration)
    cycles = values.positive("--frequency", frequency)
    slew = values.optional(values.positive, "--max-slew", max_slew)
    if low >= high:
        raise UsageError(f"--v-min {v_min} must be below --v-max {v_max}")
    from dbo_cli.hysteresis.excitation import excitation
    from dbo_cli.logs.signal_writer import OutColumn, signal_writer

    time, voltage = excitation(low, high, rate, seconds, cycles, slew)
    columns = [OutColumn("time", "s"), OutColumn("voltage", "V")]
    form = signals.format_for(output, file_format)
    with signal_writer(output, columns, format=form, attributes={"sample_rate": rate}) as writer:
        writer.write(time, voltage)
    voice.detail(f"{len(time):,} rows, {seconds:g} s, {low:g} to {high:g} V")
