"""A model as source code for the controller that runs it: C in the arithmetic of the chip, and an FMU."""

from dbo_cli.export.export import export_model, export_set
from dbo_cli.export.project_files import ExportSummary

__all__ = ["ExportSummary", "export_model", "export_set"]
