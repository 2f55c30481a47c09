"""The folder of an export appears whole or not at all, and only replaces an export."""

import os
from pathlib import Path

import pytest

from dbo_cli.errors import OutputError
from dbo_cli.export import write_folder

FILES = {"a.c": "int a;\n", "README.md": "# a\n"}


def content(folder):
    return {path.name: path.read_text() for path in Path(folder).iterdir()}


def test_files_are_refused_and_folders_are_made(tmp_path):
    (tmp_path / "file").write_text("")
    (tmp_path / "other").mkdir()
    (tmp_path / "other/a.c").mkdir()
    for name in ("file", "file/fw", "other"):
        with pytest.raises(OutputError, match=name):
            write_folder(str(tmp_path / name), FILES, {"name": "a"})
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/README.md").write_text("mine")  # no export wrote it
    with pytest.raises(OutputError, match="README"):
        write_folder(str(tmp_path / "mine"), FILES, {"name": "a"})
    (tmp_path / "empty").mkdir()
    for name in ("empty", "new/fw"):
        write_folder(str(tmp_path / name), FILES, {"name": "a"})
        assert len(content(tmp_path / name)) == 3


def test_a_failure_leaves_what_stood_there(tmp_path, monkeypatch):
    folder = tmp_path / "fw"
    write_folder(str(folder), FILES, {"name": "a"})
    before = content(folder)

    def failing(descriptor):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", failing)
    with pytest.raises(OutputError, match="disk is full"):
        write_folder(str(folder), {"b.c": "", **FILES}, {"name": "a"})
    assert content(folder) == before
    assert os.listdir(tmp_path) == ["fw"]
