"""``dbo export``: a model as source code for the controller that runs it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dbo_cli.cli import options
from dbo_cli.cli.messages import Voice

if TYPE_CHECKING:
    from dbo_cli.export import ExportSummary


def export(
    *,
    model: options.Model,
    voice: Voice,
    folder: options.Folder,
    name: options.Name,
    direction: options.Direction,
    arithmetic: options.Arithmetic,
    sample_rate: options.ControllerRate,
    gears: options.FewerGears,
    v_min: options.VoltageMin,
    v_max: options.VoltageMax,
    max_slew: options.MaxSlew,
    lookup: options.Lookup,
    arduino: options.Arduino,
    fmu: options.Fmu,
    shared: options.Shared,
    overwrite: options.Overwrite,
) -> None:
    """Write a model as C for a controller, with the tables, a self-test and a page to read.

    C99 without allocation, recursion or library calls. double gives the bits of dbo compensate; float and
    q31 (32-bit fixed point) come with a derived bound on their error. The folder holds NAME.h, NAME.c,
    NAME_test.c, the kernel, build files and README.md; it appears whole or not at all.

    Example: dbo export model.json -o firmware --sample-rate 10000
    """
    from dbo_cli.export import export_model
    from dbo_cli.relatives.model_file import read_model

    summary = export_model(
        read_model(model),
        folder,
        name=name,
        direction=direction,  # type: ignore[arg-type]
        arithmetic=arithmetic,  # type: ignore[arg-type]
        sample_rate=sample_rate,
        gears=gears,
        v_min=v_min,
        v_max=v_max,
        max_slew=max_slew,
        lookup=lookup,
        arduino=arduino,
        fmu=fmu,
        shared=shared,
        overwrite=overwrite,
    )
    for line in _told(summary):
        voice.note(line)


def _told(summary: ExportSummary) -> list[str]:
    """Return what the shell says of an export."""
    lines = [
        f"{summary.folder}: {summary.direction} model '{summary.name}' in {summary.arithmetic},"
        f" {summary.gears} gears in {summary.table_rows} rows; {summary.table_bytes} bytes of tables,"
        f" {summary.state_bytes} of state; {summary.vectors} samples of self-test"
    ]
    if summary.bounds:
        same, close = (summary.bounds[f"{key}_percent"] for key in ("same_gears", "after_close_turn"))
        lines.append(
            f"error at most {same:.2g} % of the range while both cross the same gears, {close:.2g} % after a "
            "turn close to a gear's end"
        )
    return lines + list(summary.notes)
