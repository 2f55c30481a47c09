"""``dbo invert``: a model into its inverse."""

from __future__ import annotations

from dbo_cli.cli import options
from dbo_cli.cli.bundles import bundled
from dbo_cli.cli.messages import Voice


@bundled
def invert(model: options.Model, voice: Voice, output: options.Output = "-") -> None:
    """Write the exact inverse of a model.

    Every gear and segment exchanges its widths, the cascade runs backwards, a delay becomes a look ahead.
    The inverse of a forward model turns a desired displacement into the drive (dbo simulate runs it;
    dbo compensate does the same from the forward model and keeps the drive within its limits).
    """
    from dbo_cli.hysteresis.model_file import model_to_bytes, read_model
    from dbo_cli.logs.whole_output import write_whole

    inverse = read_model(model).inverse()
    write_whole(output, model_to_bytes(inverse), protect=[model])
    voice.detail(f"{model}: the inverse is {inverse.direction}")
