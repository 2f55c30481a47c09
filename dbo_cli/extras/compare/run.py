"""The use case ``compare``: every model fitted to the same logs, in one table."""

from __future__ import annotations

import dataclasses
import os
from dataclasses import dataclass
from pathlib import Path

from dbo_cli.errors import SILENT, Listener, Remarks
from dbo_cli.extras.compare.judging import NAMES, compare
from dbo_cli.extras.compare.table import ModelTable
from dbo_cli.hysteresis.model_file import model_to_bytes
from dbo_cli.logs import request
from dbo_cli.logs.request import Address
from dbo_cli.logs.whole_output import all_or_none, check_output, write_whole
from dbo_cli.reports.drawing import check_folder, save
from dbo_cli.runs.identifying import IdentifyRun
from dbo_cli.runs.reporting import report_form
from dbo_cli.version import program_version_string


@dataclass(frozen=True)
class TableOptions:
    """What to compare and how; ``names`` None: all models; not ``timed``: same input, same bytes."""

    names: tuple[str, ...] | None = None
    skip_seconds: float = 0.0
    timed: bool = True
    form: str | None = None
    figures: str | None = None
    models_folder: str | None = None


@all_or_none()
def compare_logs(
    run: IdentifyRun,
    output: Address,
    options: TableOptions,
    listener: Listener = SILENT,
) -> Remarks:
    """Fit every model to the logs and write the table; ``asked.reading.rows`` are not the validation's."""
    form = report_form(output, options.form)
    inputs = [*run.logs, *run.validation]
    check_output(output, inputs)
    request.check_format(run.reading.format, inputs)
    for folder in (options.figures, options.models_folder):
        if folder is not None:
            check_folder(folder)
    fitted, checks = run.read(listener)
    rows = compare(
        fitted, checks, options.names or NAMES, options.skip_seconds, options.timed
    )
    unit = fitted[0].displacement_unit
    fitted_names = tuple(log.name for log in fitted)
    judged_names = tuple(log.name for log in checks)
    shown = ModelTable(tuple(rows), unit, fitted_names, judged_names)
    if options.figures is not None:
        save(shown.plots(), Path(options.figures), "models")
    program = program_version_string()
    provenance = {
        "program": program,
        "inputs": [dict(log.record) for log in [*fitted, *checks]],
    }
    if options.models_folder is not None:
        for row in rows:
            if row.model is not None:
                path = os.path.join(options.models_folder, f"{row.name}.json")
                content = model_to_bytes(
                    dataclasses.replace(row.model, provenance=provenance)
                )
                write_whole(path, content, protect=inputs)
    content = shown.rendered(form, provenance, program)
    write_whole(output, content, protect=inputs)
    remarks = Remarks()
    for log in [*fitted, *checks]:
        remarks.add(log.remarks)
    return remarks
