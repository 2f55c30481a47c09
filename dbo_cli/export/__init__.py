"""A model as C99 for a controller."""

from __future__ import annotations

from dbo_cli.export.export import ARITHMETICS, Export, export_model
from dbo_cli.export.folder import check_folder, write_folder

__all__ = ["ARITHMETICS", "Export", "check_folder", "export_model", "write_folder"]
