"""Many facts of one theme as one case: every one is tried, and those that fail are named."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import pytest

Test = Callable[..., None]
NO_PASS = (Exception, pytest.fail.Exception, pytest.skip.Exception)


def each(names: str | Sequence[str], cases: Iterable[Any]) -> Callable[[Test], Test]:
    """Run a test for every case of a list, with one name or several for what a case holds.

    Each has a ``tmp_path`` and a ``monkeypatch`` for itself.
    """
    keys = [names] if isinstance(names, str) else list(names)
    listed = list(cases)

    def decorate(test: Test) -> Test:
        signature = inspect.signature(test)
        fixtures = [
            parameter
            for name, parameter in signature.parameters.items()
            if name not in keys
        ]

        @functools.wraps(test)
        def run(**shared: Any) -> None:
            failures = []
            for number, case in enumerate(listed):
                values = (case,) if len(keys) == 1 else case
                arguments = dict(zip(keys, values, strict=True))
                try:
                    _run_one(test, arguments, dict(shared), number)
                except NO_PASS as failure:
                    failure.add_note(f"case {number}: {arguments}")
                    failures.append(failure)
            if failures:
                text = f"{len(failures)} of {len(listed)} cases fail"
                raise BaseExceptionGroup(text, failures)

        del run.__wrapped__  # type: ignore[attr-defined]
        run.__signature__ = signature.replace(parameters=fixtures)  # type: ignore[attr-defined]
        return run

    return decorate


def _run_one(
    test: Test, arguments: dict[str, Any], shared: dict[str, Any], number: int
) -> None:
    if "tmp_path" in shared:
        shared["tmp_path"] = shared["tmp_path"] / f"case{number}"
        shared["tmp_path"].mkdir()
    if "monkeypatch" not in shared:
        test(**arguments, **shared)
        return
    with shared["monkeypatch"].context() as patch:
        shared["monkeypatch"] = patch
        test(**arguments, **shared)
