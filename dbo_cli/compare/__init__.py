"""The DBO beside the operators of the paper's references [6] to [9]."""

from dbo_cli.compare.compare import OperatorTable, Row, compare

__all__ = ["OperatorTable", "Row", "compare"]
