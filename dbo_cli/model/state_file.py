"""State files: where an actuator was left, so that the next run goes on from there."""

from __future__ import annotations

from itertools import pairwise

from dbo_cli.errors import ModelError
from dbo_cli.model.delay import BEFORE, Held
from dbo_cli.model.dynamics import SectionStates
from dbo_cli.model.model import Model
from dbo_cli.model.node import Json, Node, dumps, load
from dbo_cli.model.state import State
from dbo_cli.model.undoing import Undoing

STATE_FORMAT = "dbo-state"
VERSION = 1


def dumps_state(state: State, model: Model) -> str:
    """Return the text of a state file; it names the model that it belongs to by a hash."""
    values: Json = {
        "format": STATE_FORMAT,
        "version": VERSION,
        "model": model.digest,
        "gears": model.gears.n,
        "bits": f"{state.bits:x}",
        "memory": None if state.memory is None else list(state.memory),
        "time": state.time,
        "drive": state.drive,
        "sections": _lists(state.sections),
        "delay": None,
        "undoing": None,
    }
    if state.delay is not None:
        values["delay"] = {
            "times": list(state.delay.times),
            "values": list(state.delay.values),
        }
    if state.undoing is not None:
        values["undoing"] = {
            "dt": state.undoing.dt,
            "sections": _lists(state.undoing.sections),
            "past": list(state.undoing.past or ()),
        }
    return dumps(values)


def read_state(path: str, model: Model) -> State:
    """Read a state file for a model or its inverse; ``-`` is standard input.

    Raises
    ------
    InputError
        The file cannot be read.
    ModelError
        It is not a state, contradicts itself, or belongs to another model.
    """
    name, values = load(path, "state")
    if not isinstance(values, dict) or values.get("format") != STATE_FORMAT:
        raise ModelError(f'{name}: format: must be "{STATE_FORMAT}" in a state')
    root = Node(name, "", values)
    if values.get("version") != VERSION or isinstance(values.get("version"), bool):
        raise root.refuse(
            "version",
            f"{values.get('version')!r} is not version {VERSION}, which this program reads: save the state"
            " again",
        )
    keys = ("format", "version", "model", "gears", "bits", "memory", "time", "drive")
    root.only((*keys, "sections", "delay", "undoing"))
    if root.text("model") != model.digest:
        raise root.refuse(
            "model", "the state belongs to another model: save it again with this one"
        )
    return State(
        _bits(root, model.gears.n),
        _memory(root, model),
        _number_or_none(root, "drive"),
        _number_or_none(root, "time"),
        _sections(root, model),
        _held(root, model),
        _undoing(root, model),
        model=model.digest,
    )


def _lists(states: SectionStates | None) -> list[list[float]] | None:
    if states is None:
        return None
    return [list(section) for section in states]


def _bits(root: Node, gears: int) -> int:
    if root.count("gears") != gears:
        raise root.refuse("gears", f"is not {gears}, the number of gears of the model")
    digits = root.text("bits")
    hexadecimal = digits and not set(digits) - set("0123456789abcdef")
    if not hexadecimal or int(digits, 16) >> gears:
        raise root.refuse("bits", f"is not a hexadecimal number of {gears} bits")
    return int(digits, 16)


def _memory(root: Node, model: Model) -> tuple[float, ...] | None:
    if root.values["memory"] is None:
        return None
    memory = root.numbers("memory")
    terms = model.gears.gain.size
    if len(memory) != terms:
        raise root.refuse(
            "memory",
            f"has {len(memory)} entries where the model has {terms} relaxation terms",
        )
    return memory


def _number_or_none(root: Node, key: str) -> float | None:
    if root.values[key] is None:
        return None
    return root.number(key)


def _sections(node: Node, model: Model) -> SectionStates | None:
    """Return three numbers for each section of the dynamics."""
    if node.values["sections"] is None:
        return None
    count = 0
    if model.dynamics is not None:
        count = len(model.dynamics.sections)
    items = node.listed("sections", "sections")
    if len(items) != count:
        raise node.refuse(
            "sections", f"has {len(items)} entries where the model has {count} sections"
        )
    states = []
    for place, item in enumerate(items):
        key = f"sections[{place}]"
        if not isinstance(item, list) or len(item) != 3:
            raise node.refuse(key, "is not a list of three numbers")
        first, second, third = (node.finite(f"{key}[{k}]", item[k]) for k in range(3))
        states.append((first, second, third))
    return tuple(states)


def _held(root: Node, model: Model) -> Held | None:
    """Return what a delay held back."""
    if root.values["delay"] is None:
        return None
    if model.delay is None:
        raise root.refuse("delay", "the model has no delay")
    node = root.node("delay")
    node.only(("times", "values"))
    times, values = node.numbers("times"), node.numbers("values")
    if len(times) != len(values) or not times:
        raise node.refuse(
            "values", f"has {len(values)} entries where times has {len(times)}"
        )
    if any(later < earlier for earlier, later in pairwise(times)):
        raise node.refuse("times", "goes backwards")
    return Held(times, values)


def _undoing(root: Node, model: Model) -> Undoing | None:
    """Return what undoing dynamics and delay remembered."""
    if root.values["undoing"] is None:
        return None
    node = root.node("undoing")
    node.only(("dt", "sections", "past"))
    dt = node.number("dt")
    if not dt > 0.0:
        raise node.refuse("dt", f"{dt!r} is not greater than 0")
    past = node.numbers("past")
    if len(past) > BEFORE:
        raise node.refuse("past", f"has more than {BEFORE} entries")
    return Undoing(dt, _sections(node, model) or (), past)
