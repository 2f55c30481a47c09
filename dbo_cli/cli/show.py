"""``dbo show``: what is in a model, on one screen."""

from __future__ import annotations

from dbo_cli.cli import options
from dbo_cli.cli.messages import Voice


def show(
    *,
    model: options.Model,
    voice: Voice,
    form: options.ShowFormat,
    figures: options.ModelFigures,
    output: options.Output,
) -> None:
    """Show what is in a model: range and units, how good it is, lag, where it comes from, its warnings.

    Example: dbo show model.json
    """
    from dbo_cli.runs.showing import show_model

    voice.notes(show_model(model, output, form, figures))
