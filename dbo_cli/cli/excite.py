"""``dbo excite``: the drive from which an actuator is identified well."""

from __future__ import annotations

from dbo_cli.cli import options
from dbo_cli.cli.messages import Voice


def excite(
    *,
    voice: Voice,
    v_max: options.ExciteMax,
    v_min: options.ExciteMin,
    sample_rate: options.ExciteRate,
    duration: options.Duration,
    frequency: options.Frequency,
    max_slew: options.MaxSlew,
    seed: options.Seed,
    file_format: options.OutputFormat,
    output: options.Output,
) -> None:
    """Write the drive that identifies well; play it and record the displacement.

    Two sweeps over the whole range wipe out the past, then amplitudes decay towards the middle, so that every
    gear turns at many places and lag is told from loop width, and minor loops at both ends show the
    asymmetry. It ends where it began, so that drift shows, and it never leaves the limits.

    Example: dbo excite --v-max 100 --sample-rate 5000 -o excitation.csv
    """
    from dbo_cli.runs.files import write_excitation

    rows = write_excitation(
        output, v_min, v_max, sample_rate, duration, frequency, max_slew, file_format, seed
    )
    voice.detail(f"{rows:,} rows, {duration:g} s, {v_min:g} to {v_max:g} V")
