"""The use case ``export``: a model, or a set of models, to a folder of sources."""

from __future__ import annotations

from typing import Any

from dbo_cli.drives.options import require_one_unit
from dbo_cli.errors import Remarks
from dbo_cli.extras.export.export import export_model, export_set
from dbo_cli.extras.export.project_files import ExportSummary
from dbo_cli.hysteresis.model_file import is_set, read_model, read_set
from dbo_cli.logs import whole_output
from dbo_cli.logs.request import parse_address
from dbo_cli.runs.many import CHANNEL, in_name, make_folder_of


def export_models(
    model_file: str, folder: str, remarks: Remarks, *, name: str, **options: Any
) -> dict[str, ExportSummary]:
    """Export a model, or a set: to one folder with one kernel, or (``{channel}``) to a folder of each model.

    Raises
    ------
    UsageError
        A channel's name makes no names of its own in C, or an option is not for sets.
    """
    if not is_set(model_file):
        return {"": export_model(read_model(model_file), folder, name=name, **options)}
    models = read_set(model_file)
    typed = {key: options.get(key) for key in ("v_min", "v_max", "max_slew")}
    if any(limit is not None for limit in typed.values()):
        require_one_unit(
            {channel: model.drive.unit for channel, model in models.items()}, **typed
        )
    if models.coupling is not None:
        remarks.warn(
            f"the models of {model_file} are coupled, and the sources are of single channels: what is wanted "
            "of all has to be multiplied by the inverse of the gains first (docs/model-file.md)"
        )
    if CHANNEL not in folder:
        return export_set(models, folder, name=name, **options)
    with whole_output.all_or_none():
        make_folder_of(parse_address(folder))
        return {
            channel: export_model(
                model, in_name(folder, channel), name=f"{name}_{channel}", **options
            )
            for channel, model in models.items()
        }
