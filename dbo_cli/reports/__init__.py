"""Reports: how well what was measured follows what was desired, or what a model predicts."""

from dbo_cli.reports.expected import Expected, expected_in
from dbo_cli.reports.matching import match
from dbo_cli.reports.pair import Pair, predict
from dbo_cli.reports.report import Report

__all__ = [
    "Expected",
    "Pair",
    "Report",
    "expected_in",
    "match",
    "predict",
]
