"""``dbo invert``."""

from __future__ import annotations

from dbo_cli.cli.options import ModelFile, Output
from dbo_cli.cli.say import detail


def invert(model: ModelFile, output: Output = "-") -> None:
    """Write the exact inverse of a model.

    Every gear and segment exchanges its widths, and the cascade runs backwards.
    The inverse of a forward model turns a displacement into the drive.
    """
    from dbo_cli.logs import write_text
    from dbo_cli.model import dumps_model, read_model

    inverse = read_model(model).inverse()
    write_text(output, dumps_model(inverse))
    detail(
        f"{output}: {inverse.direction} model, {inverse.input.quantity} to {inverse.output.quantity}"
    )
