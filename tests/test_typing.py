"""What a type checker says of a program that uses the library (PEP 561)."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from mypy import api

import dbo_cli

SCRIPT = Path(__file__).parent / "user_script.py"
# of the library, from last time
KEPT = Path(__file__).parent.parent / ".mypy_cache" / "of_users"
WRONG = """
def odd(model: dbo.Model) -> str:
    dbo.identfy("run.csv")
    volts = model.compensate([1.0, 2.0])
    return volts
"""


def test_a_users_script_is_checked_strictly_and_a_wrong_one_is_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert (Path(dbo_cli.__file__).parent / "py.typed").exists()
    shutil.copy(SCRIPT, tmp_path / "right.py")
    (tmp_path / "wrong.py").write_text(
        "import dbo_cli as dbo\n" + WRONG, encoding="utf-8"
    )
    monkeypatch.chdir(tmp_path)  # where no configuration lies
    # the types are found where the package is installed
    monkeypatch.delenv("MYPYPATH", raising=False)
    # What the library imports is its own affair, as it is where it is installed.
    said, trouble, code = api.run(
        ["--strict", "--follow-imports=silent", "--ignore-missing-imports", f"--cache-dir={KEPT}",
         "--disable-error-code=import-untyped", "right.py", "wrong.py"]
    )  # fmt: skip
    found = [
        line.partition(": error: ")[::2]
        for line in said.splitlines()
        if ": error: " in line
    ]
    assert (trouble, code) == ("", 1)
    assert [place for place, _ in found] == ["wrong.py:4", "wrong.py:6"], said
    assert 'Module has no attribute "identfy"' in found[0][1]
    assert 'Incompatible return value type (got "ndarray' in found[1][1]
