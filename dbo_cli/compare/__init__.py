"""The DBO beside the operators of the paper's references [6] to [9]."""

from dbo_cli.compare.compare import compare, compared_text

__all__ = ["compare", "compared_text"]
