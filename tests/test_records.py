"""The package's ``dataclass`` does what the standard library's does."""

from __future__ import annotations

import copy
import dataclasses
import pickle
from collections.abc import Callable
from typing import Any

import pytest

from dbo_cli import records


def described(kind: Callable[..., Any], **given: Any) -> type[Any]:
    @kind(**given)
    class Log:
        """A log."""

        place: str
        rows: int = 0
        notes: list[str] = dataclasses.field(default_factory=list, compare=False, repr=False)

        def __post_init__(self) -> None:
            if self.rows < 0:
                raise ValueError(self.rows)

    return Log


BOTH = pytest.mark.parametrize("kind", [dataclasses.dataclass, records.dataclass], ids=["library", "own"])


@BOTH
@pytest.mark.parametrize("frozen", [True, False])
def test_equality_hash_and_text_are_those_of_the_fields(kind: Callable[..., Any], frozen: bool) -> None:
    log = described(kind, frozen=frozen)
    one, same, other = log("a", 1, ["x"]), log("a", 1), log("a", 2)
    assert one == same != other and one != ("a", 1, ["x"])
    assert repr(one).endswith("Log(place='a', rows=1)")
    assert dataclasses.replace(one, rows=2) == copy.copy(other) == other
    assert dataclasses.asdict(one) == {"place": "a", "rows": 1, "notes": ["x"]}
    with pytest.raises(ValueError, match="-1"):
        log("a", -1)
    if frozen:
        assert {one: 1}[same] == 1 and hash(one) == hash(same)
    else:
        with pytest.raises(TypeError, match="unhashable"):
            hash(one)


@BOTH
def test_a_frozen_record_keeps_its_fields(kind: Callable[..., Any]) -> None:
    one = described(kind, frozen=True)("a")
    for change in ("rows", "place", "another"):
        with pytest.raises(dataclasses.FrozenInstanceError, match=f"cannot assign to field '{change}'"):
            setattr(one, change, 3)
    with pytest.raises(dataclasses.FrozenInstanceError, match="cannot delete field 'rows'"):
        del one.rows
    free = described(kind)("a")
    free.rows = 3
    assert free.rows == 3


@BOTH
def test_identity_counts_without_eq_and_own_methods_stay(kind: Callable[..., Any]) -> None:
    log = described(kind, frozen=True, eq=False)
    assert log("a") != log("a")

    @kind(frozen=True)
    class Named:
        name: str

        def __repr__(self) -> str:
            return "named"

    assert repr(Named("a")) == "named"


@records.dataclass(frozen=True)
class Kept:
    """At the module's level, where pickle finds it."""

    values: tuple[float, ...]
    name: str = "a"


def test_a_frozen_record_travels_between_processes() -> None:
    kept = Kept((1.0, 2.0))
    assert pickle.loads(pickle.dumps(kept)) == kept
