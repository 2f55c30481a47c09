"""State files: where an actuator was left, so that the next run goes on from there."""

from __future__ import annotations

from itertools import chain, pairwise

from dbo_cli.model.delay import Held
from dbo_cli.model.dynamics import SectionStates
from dbo_cli.model.model import Model
from dbo_cli.model.node import VERSION, Json, Node, dumps, load
from dbo_cli.model.state import State

STATE_FORMAT = "dbo-state"


def dumps_state(state: State, model: Model) -> str:
    """Return the text of a state file; it names the model that it belongs to by a hash."""
    values: Json = {
        "format": STATE_FORMAT,
        "version": VERSION,
        "model": model.digest,
        "gears": model.gears.n,
        "bits": f"{state.bits:x}",
        "memory": state.memory,
        "time": state.time,
        "drive": state.drive,
        "sections": _flat(state.sections),
        "delay": None,
    }
    if state.delay is not None:
        values["delay"] = state.delay._asdict()
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
    root = Node(name, "", values)
    root.require_format(STATE_FORMAT, "a state")
    if root.text("model") != model.digest:
        raise root.refuse(
            "model", "the state belongs to another model: save it again with this one"
        )
    return root.build(
        State,
        _bits(root, model.gears.n),
        _memory(root, model.gears.gain.size),
        root.unless_null("drive", root.number),
        root.unless_null("time", root.number),
        _sections(root, model),
        _held(root, model),
    )


def _flat(sections: SectionStates | None) -> list[float] | None:
    if sections is None:
        return None
    return list(chain.from_iterable(sections))


def _bits(root: Node, gears: int) -> int:
    if root.value("gears") != gears:
        raise root.refuse("gears", f"is not {gears}, the number of gears of the model")
    digits = root.text("bits")
    hexadecimal = digits and not set(digits) - set("0123456789abcdef")
    if not hexadecimal or int(digits, 16) >> gears:
        raise root.refuse("bits", f"is not a hexadecimal number of {gears} bits")
    return int(digits, 16)


def _memory(root: Node, terms: int) -> tuple[float, ...] | None:
    memory = root.unless_null("memory", root.numbers)
    if memory is not None and len(memory) != terms:
        raise root.refuse("memory", f"has {len(memory)} entries, not {terms}")
    return memory


def _sections(node: Node, model: Model) -> SectionStates | None:
    """Return three numbers for each section of the dynamics."""
    numbers = node.unless_null("sections", node.numbers)
    if numbers is None:
        return None
    needed = 0
    if model.dynamics is not None:
        needed = 3 * len(model.dynamics.sections)
    if len(numbers) != needed:
        raise node.refuse("sections", f"has {len(numbers)} entries, not {needed}")
    return tuple(zip(numbers[::3], numbers[1::3], numbers[2::3], strict=True))


def _held(root: Node, model: Model) -> Held | None:
    """Return what a delay held back."""
    if root.value("delay") is None:
        return None
    if model.delay is None:
        raise root.refuse("delay", "the model has no delay")
    node = root.node("delay")
    times, values = node.numbers("times"), node.numbers("values")
    if len(times) != len(values) or not times:
        raise node.refuse("values", f"has {len(values)} entries, not {len(times)}")
    if any(later < earlier for earlier, later in pairwise(times)):
        raise node.refuse("times", "goes backwards")
    return node.build(Held, times, values)
