"""The report of one or several logs: its values, and what is written of them."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from dbo_cli.reports.comparison import Scores
from dbo_cli.reports.plots import plots_of_report, save
from dbo_cli.reports.render import FORMS

if TYPE_CHECKING:
    import pandas


@dataclass(frozen=True)
class Report(Scores):
    """A comparison that is written as text, JSON, CSV, a page or figures."""

    def render(self, form: str) -> str:
        """Return the report as ``text``, ``json``, ``csv`` or ``html``."""
        return FORMS[form](self)

    def to_html(self) -> str:
        """Return a page that needs no other file."""
        return self.render("html")

    def to_frame(self) -> pandas.DataFrame:
        """Return one row a log under the keys of the JSON form, the name as index."""
        import pandas as pd

        return pd.DataFrame([log.record() for log in self.logs]).set_index("name")

    def figures(self, folder: str | os.PathLike[str]) -> list[Path]:
        """Draw the figures into a folder, PNG and SVG; return the files."""
        return save(plots_of_report(self), folder)
