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
    sweep_to: options.SweepTo,
    sweep_amplitude: options.SweepAmplitude,
    file_format: options.OutputFormat,
    output: options.Output,
) -> None:
    """Write the drive that identifies well; play it and record the displacement.

    A sweep over the whole range wipes out the past; then the drive turns at random levels, at speeds from a
    quarter to eight times the sweep's, with some holds, so that loop width, asymmetry, lag and creep come
    apart. It ends at rest where it began, so that drift shows, and it never leaves the limits. 15 s leave
    about half the error of 8 s, 30 s no less; at another --frequency, scale the duration with it. With
    --sweep-to, a small sweep in the middle of the range follows, in which a resonance shows itself (4 s
    more, and longer below 60 Hz).

    Example: dbo excite --v-max 100 --sample-rate 5000 -o excitation.csv
    """
    from dbo_cli.hysteresis.excitation import Excitation
    from dbo_cli.runs.drive_files import write_excitation

    drive = Excitation(
        v_min, v_max, sample_rate, duration, frequency, max_slew, seed, sweep_to, sweep_amplitude
    )
    rows = write_excitation(output, drive, file_format)
    voice.detail(f"{rows:,} rows, {rows / sample_rate:g} s, {v_min:g} to {v_max:g} V")
