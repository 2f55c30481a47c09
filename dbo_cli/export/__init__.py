"""A model as C99 for a controller."""

from dbo_cli.export.export import Export, export_model, write_folder

__all__ = ["Export", "export_model", "write_folder"]
