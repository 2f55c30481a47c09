"""``dbo show``."""

from __future__ import annotations

from dbo_cli.cli import options as opt
from dbo_cli.cli.options import Text
from dbo_cli.cli.say import detail


def show(
    model: str = opt.MODEL,
    output: str = opt.OUTPUT_FILE,
    form: opt.TextOrJson = opt.FORM,
    figures: Text = opt.FIGURES_DIR,
) -> None:
    """Show what is in a model, and how good it is.

    Examples: dbo show model.json;
    dbo show model.json --format json | jq .fit.expected_rmse
    """
    from dbo_cli.files import check_outputs, write_text
    from dbo_cli.model import read_cascades
    from dbo_cli.reports.plots import model_plots, save
    from dbo_cli.reports.show import shown_text, shown_values
    from dbo_cli.reports.words import json_text

    models = {}
    for name, channel in read_cascades(model).items():
        models[f"{model}::{name}" if name else model] = channel
    check_outputs(output)
    texts = []
    for name, shown in models.items():
        if opt.form_of(form, output) == "json":
            texts.append(json_text(shown_values(shown)))
        else:
            texts.append(shown_text(shown, name))
        if figures is not None:
            detail(*map(str, save(model_plots(shown), figures)))
    write_text(output, "\n".join(texts))
