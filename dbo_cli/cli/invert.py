"""``dbo invert``: a model into its inverse."""

from __future__ import annotations

from dbo_cli.cli import options
from dbo_cli.cli.messages import Voice, refuse_terminal


def invert(*, model: options.Model, voice: Voice, output: options.Output) -> None:
    """Write the exact inverse of a model.

    Every gear and segment exchanges its widths, the cascade runs backwards, a delay becomes a look ahead.
    The inverse of a forward model turns a desired displacement into the drive (dbo simulate runs it;
    dbo compensate does the same from the forward model and keeps the drive within its limits).

    Example: dbo invert model.json -o inverse.json
    """
    refuse_terminal(output)
    from dbo_cli.runs.files import invert_model

    inverse = invert_model(model, output)
    voice.detail(f"{model}: the inverse is {inverse.direction}")
