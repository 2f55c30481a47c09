"""``dbo show``."""

import os

from dbo_cli.cli import options as opt
from dbo_cli.cli.options import Text


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
    from dbo_cli.files import Outputs
    from dbo_cli.model import read_cascades
    from dbo_cli.reports.plots import drawn, model_plots
    from dbo_cli.reports.show import shown_text, shown_values
    from dbo_cli.reports.words import json_text

    models = read_cascades(model)
    texts = []
    for channel, shown in models.items():
        if opt.form_of(form, output) == "json":
            texts.append(json_text(shown_values(shown)))
        else:
            texts.append(shown_text(shown, f"{model}::{channel}" if channel else model))
    with Outputs() as outputs:
        if figures is not None:
            for channel, shown in models.items():
                folder = os.path.join(figures, channel)
                outputs.write_all(folder, drawn(model_plots(shown)))
        outputs.write_text(output, "\n".join(texts))
