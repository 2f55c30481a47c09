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
    from dbo_cli.model import read_models
    from dbo_cli.reports import ShownModel

    pages = []
    for name, channel in read_models(model).items():
        pages.append(ShownModel(channel, f"{model}::{name}" if name else model))
    is_json = opt.form_of(form, output) == "json"
    texts = [page.json() if is_json else page.text() for page in pages]
    check_outputs(output)
    if figures is not None:
        for page in pages:
            detail(*map(str, page.figures(figures)))
    write_text(output, "\n".join(texts))
