"""The faults of benchmarks/planted_faults.py can be planted: their places are where the table says."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.whole
ROOT = Path(__file__).resolve().parent.parent
spec = importlib.util.spec_from_file_location(
    "planted_faults", ROOT / "benchmarks" / "planted_faults.py"
)
assert spec is not None and spec.loader is not None
planted_faults = importlib.util.module_from_spec(spec)
sys.modules["planted_faults"] = planted_faults
spec.loader.exec_module(planted_faults)
FAULTS = planted_faults.FAULTS


def test_there_are_many_and_all_differ() -> None:
    assert len(FAULTS) >= 40
    assert len({(fault.file, fault.text) for fault in FAULTS}) == len(FAULTS)


@pytest.mark.parametrize(
    "fault", FAULTS, ids=lambda fault: f"{Path(fault.file).name}: {fault.breaks}"
)
def test_a_fault_has_its_place(fault: planted_faults.Fault) -> None:
    text = (ROOT / fault.file).read_text(encoding="utf-8")
    assert len(fault.places(text)) == 1, (
        "the code has changed: plant this fault anew (make mutants)"
    )
    assert fault.planted(text) != text
    for name in fault.tests:
        assert len(list((ROOT / "tests").rglob(f"test_{name}.py"))) == 1
