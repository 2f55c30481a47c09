"""``dbo show``."""

from __future__ import annotations

from dbo_cli.cli.options import Figures, ModelFile, Output, TextOrJson
from dbo_cli.cli.say import detail


def show(
    model: ModelFile,
    output: Output = "-",
    form: TextOrJson = None,
    figures: Figures = None,
) -> None:
    """Show what is in a model: range and units, how good it is, lag, where it comes from.

    Examples: dbo show model.json;
    dbo show model.json --format json | jq .fit.expected_rmse
    """
    from dbo_cli.logs import write_text
    from dbo_cli.model import is_set, read_model, read_models
    from dbo_cli.reports import show_model

    if is_set(model):
        pages = [
            show_model(one, f"{model}::{name}")
            for name, one in read_models(model).items()
        ]
    else:
        pages = [show_model(read_model(model), model)]
    as_json = form == "json" or (form is None and output.endswith(".json"))
    texts = []
    for page in pages:
        texts.append(page.json() if as_json else page.text())
    write_text(output, "\n".join(texts))
    if figures is not None:
        for page in pages:
            for path in page.figures(figures):
                detail(str(path))
