"""``dbo invert``."""

from dbo_cli.cli import options as opt


def invert(model: str = opt.MODEL, output: str = opt.OUTPUT_FILE) -> None:
    """Write the exact inverse of a model.

    The inverse of a forward model turns a displacement into the drive.

    Example: dbo invert model.json -o inverse.json
    """
    from dbo_cli.files import write_text
    from dbo_cli.model import dumps_model, read_cascade

    write_text(output, dumps_model(read_cascade(model).inverse()))
