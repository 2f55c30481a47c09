"""The DBO beside the operators of the paper's references [6] to [9]."""

from dbo_cli.compare.compare import compare_operators, compared_text

__all__ = ["compare_operators", "compared_text"]
