"""Model files and state files: UTF-8 JSON with stable key order, checked to the last key on reading.

The same values give the same bytes, floats are written so that reading them back gives
the same float64, and there is no time of day and no host name in them. A file that
contradicts itself is refused with the key that is wrong, spelled as a path:
``stages[0].dx[3]``.
"""

from __future__ import annotations

import functools
import itertools
import json
import math
import os
import re
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple, cast

from dbo_cli import extensions
from dbo_cli.errors import InputError, ModelError
from dbo_cli.hysteresis.cascade import (
    DelayHistory,
    DelayStage,
    OtherHysteresis,
    ScaleStage,
    Stage,
)
from dbo_cli.hysteresis.dynamics import (
    Antiresonance,
    InverseMemory,
    Lag,
    Resonance,
    Section,
    SectionStates,
)
from dbo_cli.hysteresis.model import (
    ActuatorModel,
    BacklashStage,
    DynamicsStage,
    PointStage,
)
from dbo_cli.hysteresis.model_state import ModelState, Quantity
from dbo_cli.hysteresis.operators import Axis, BacklashState, Relaxation

MODEL_FORMAT = "dbo-model"
STATE_FORMAT = "dbo-state"
SET_FORMAT = "dbo-model-set"
VERSION = 3
"""The newest of model files. Version 1 had every width written out; up to version 2 a delay is linear between
samples, from version 3 on smooth. A model without a delay, or with a linear one, is
written as version 2.
"""
STATE_VERSION = 2
"""Of state files. States of version 1 did not know their time."""

# twice what identification makes; 400 of a million segments took minutes to be refused
MOST_STAGES = 16
# a file of some bytes must not ask for more memory than a machine has
MOST_GEARS = 1_000_000
LARGEST = 1e60  # of every number: products of five of them are still within float64
SMALLEST = 1e-60  # of widths and damping; likewise
# s; and Hz: what is shorter than a period of light, or takes 30 million years
SHORTEST = 1e-15
# equal widths in a row are written once from this many on: two are shorter as they are
SHORTEST_RUN = 3
LINE = 100  # characters, after which the next line of a list begins
_BEGIN_OF_SET = re.compile(
    rb'(\xef\xbb\xbf)?\s*\{\s*"format":\s*"' + SET_FORMAT.encode() + rb'"'
)
AMOUNTS_OF_FIT = (
    "rmse",
    "rmse_percent",
    "cross_validated_rmse",
    "straight_line_rmse",
    "expected_rmse",
    "expected_percent",
    "expected_shape_rmse",
    "expected_zero",
    "left_out_rmse",
    "left_out_ratio",
    "line_left_out_rmse",
    "zero_drift",
    "zero_drift_rate",
    "fastest_drive",
    "trusted_hz",
    "gain_uncertainty",
    "scale_uncertainty_percent",
)
"""Keys of ``fit`` that commands print or compute with: null or numbers of at least 0."""
# null or numbers
SIGNED_OF_FIT = ("gain", "drive_bend", "lag_seconds", "loop_width_percent")
# objects within one another in what is carried along: a bound for recursion
_NOTE_DEPTH = 20

Json = dict[str, Any]


class Node(NamedTuple):
    """One JSON object with the path that leads to it; reads keys and names them where they are wrong."""

    file: str
    path: str
    values: Json

    def at(self, key: str) -> str:
        """Return the path of a key."""
        if not self.path:
            return key
        if key.startswith("["):
            return f"{self.path}{key}"
        return f"{self.path}.{key}"

    def refuse(self, key: str, what: str) -> ModelError:
        """Return the error for a key; an empty key is the object itself."""
        place = self.path or "the file"
        if key:
            place = self.at(key)
        return ModelError(f"{self.file}: {place}: {what}")

    def only(self, required: tuple[str, ...], optional: tuple[str, ...] = ()) -> None:
        """Refuse missing and unknown keys."""
        for key in required:
            if key not in self.values:
                raise self.refuse(key, "is missing")
        for key in self.values:
            if key not in required and key not in optional:
                raise self.refuse(key, "is not a known key")

    def number(self, key: str) -> float:
        """Return a finite number."""
        return self.finite(key, self.values[key])

    def numbers(self, key: str) -> list[float]:
        """Return a list of finite numbers."""
        return [
            self.finite(f"{key}[{i}]", value)
            for i, value in enumerate(self.listed(key, "numbers"))
        ]

    def widths(self, key: str) -> list[float]:
        """Return a list of finite numbers in which (from version 2 on) a run of equal ones may stand once."""
        numbers: list[float] = []
        for place, item in enumerate(self.listed(key, "numbers")):
            repeated = None
            count = 1
            if isinstance(item, dict):
                repeated = self.below(f"{key}[{place}]", item)
                repeated.only(("repeat", "value"))
                count = repeated.times_repeated()
            if len(numbers) + count > MOST_GEARS:
                raise self.refuse(key, f"has more than {MOST_GEARS:,} entries")
            if repeated is not None:
                value = repeated.number("value")
            else:
                value = self.finite(f"{key}[{place}]", item)
            numbers.extend([value] * count)
        return numbers

    def times_repeated(self) -> int:
        """Return how often a width of a run stands there."""
        value = self.values["repeat"]
        if isinstance(value, bool) or not isinstance(value, int) or value < 1:
            raise self.refuse("repeat", f"{json.dumps(value)} is not a number of times")
        return value

    def listed(self, key: str, what: str) -> list[Any]:
        """Return a list of ``what``."""
        values = self.values[key]
        if not isinstance(values, list):
            raise self.refuse(key, f"is not a list of {what}")
        return values

    def finite(self, key: str, value: object) -> float:
        """Return a value as a finite number."""
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.refuse(key, f"{json.dumps(value)} is not a number")
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if not math.isfinite(number):
            raise self.refuse(key, f"{number!r} is not a finite number")
        if abs(number) > LARGEST:
            raise self.refuse(
                key, f"{number!r} is beyond {LARGEST:g}, which no signal reaches"
            )
        return number

    def lengths(self, key: str) -> list[float]:
        """Return widths (``widths``) of which none is too small to be divided by."""
        numbers = self.widths(key)
        for place, number in enumerate(numbers):
            self._refuse_tiny(f"{key}[{place}]", number)
        return numbers

    def length(self, key: str) -> float:
        """Return a number that is not too small to be divided by."""
        number = self.number(key)
        self._refuse_tiny(key, number)
        return number

    def _refuse_tiny(self, key: str, number: float) -> None:
        if 0.0 < abs(number) < SMALLEST:
            raise self.refuse(
                key, f"{number!r} is below {SMALLEST:g}, which is nothing"
            )

    def time(self, key: str) -> float:
        """Return a time in seconds, or a frequency in Hz, 0 included."""
        return self.as_time(key, self.number(key))

    def times(self, key: str) -> list[float]:
        """Return a list of times in seconds."""
        return [
            self.as_time(f"{key}[{i}]", number)
            for i, number in enumerate(self.numbers(key))
        ]

    def as_time(self, key: str, number: float) -> float:
        """Return a number that may be a time (s) or a frequency (Hz)."""
        if number != 0.0 and not SHORTEST <= abs(number) <= 1.0 / SHORTEST:
            raise self.refuse(
                key, f"{number!r} is not from {SHORTEST:g} to {1.0 / SHORTEST:g}"
            )
        return number

    def text(self, key: str) -> str:
        """Return a string."""
        value = self.values[key]
        if not isinstance(value, str):
            raise self.refuse(key, f"{json.dumps(value)} is not a text")
        if not value.isprintable():
            raise self.refuse(
                key, f"{json.dumps(value)} holds characters that cannot be shown"
            )
        return value

    def node(self, key: str) -> Node:
        """Return the object under a key."""
        return self.below(key, self.values[key])

    def below(self, key: str, value: object) -> Node:
        """Return an object that stands below this one under the name ``key``."""
        if not isinstance(value, dict):
            raise self.refuse(key, "is not an object")
        return Node(self.file, self.at(key), value)

    def check_notes(self, depth: int) -> None:
        """Refuse, in what is only carried along, what could not be written again."""
        for key, value in self.values.items():
            if isinstance(value, float) and not math.isfinite(value):
                raise self.refuse(key, f"{value!r} is not a finite number")
            if isinstance(value, list):
                value = {f"[{i}]": entry for i, entry in enumerate(value)}
            if isinstance(value, dict):
                if depth == 0:
                    raise self.refuse(key, "is nested too deeply")
                Node(self.file, self.at(key), value).check_notes(depth - 1)

    def build(self, make: Callable[[], Any]) -> Any:
        """Return what ``make`` builds; put file and path before the key it complains about."""
        try:
            return make()
        except ModelError as problem:
            raise ModelError(f"{self.file}: {self.at(str(problem))}") from None


def read_relaxation(node: Node, key: str) -> tuple[Relaxation, Axis]:
    """Return the relaxation of a backlash stage, and the axis that it follows."""
    terms = node.node(key)
    terms.only(("on", "reference", "tau", "gain"))
    axis = terms.text("on")
    if axis not in {"input", "output"}:
        raise terms.refuse("on", f"{axis!r} is neither 'input' nor 'output'")
    reference = terms.number("reference")
    tau = tuple(terms.times("tau"))
    gain = tuple(terms.numbers("gain"))
    relaxation: Relaxation = node.build(lambda: Relaxation(reference, tau, gain))
    return relaxation, cast(Axis, axis)


def _read_quantity(node: Node) -> Quantity:
    node.only(("quantity", "unit", "min", "max"))
    name = node.text("quantity")
    unit = None if node.values["unit"] is None else node.text("unit")
    low = node.number("min")
    high = node.number("max")
    quantity: Quantity = node.build(lambda: Quantity(name, unit, low, high))
    return quantity


def _read_backlash(node: Node) -> BacklashStage:
    node.only(("type", "x0", "y0", "dx", "dy"), ("relaxation",))
    x0 = node.number("x0")
    y0 = node.number("y0")
    dx = node.lengths("dx")
    dy = node.lengths("dy")
    terms: Relaxation | None = None
    axis: Axis = "input"
    if "relaxation" in node.values:
        terms, axis = read_relaxation(node, "relaxation")
    stage: BacklashStage = node.build(
        lambda: BacklashStage(dx, dy, x0, y0, terms, axis)
    )
    return stage


def _read_point(node: Node) -> PointStage:
    node.only(("type", "x0", "y0", "dx", "dy"))
    x0 = node.number("x0")
    y0 = node.number("y0")
    dx = node.lengths("dx")
    dy = node.lengths("dy")
    stage: PointStage = node.build(lambda: PointStage(dx, dy, x0, y0))
    return stage


def _read_scale(node: Node) -> ScaleStage:
    node.only(("type", "gain", "offset"))
    gain = node.number("gain")
    offset = node.number("offset")
    stage: ScaleStage = node.build(lambda: ScaleStage(gain, offset))
    return stage


def _read_delay(node: Node) -> DelayStage:
    node.only(("type", "seconds"))
    seconds = node.time("seconds")
    stage: DelayStage = node.build(lambda: DelayStage(seconds))
    return stage


def _read_dynamics(node: Node) -> DynamicsStage:
    node.only(("type", "sections"))
    listed = node.listed("sections", "sections")
    nodes = [node.below(f"sections[{k}]", item) for k, item in enumerate(listed)]
    sections: list[Section] = []
    for section in nodes:
        if "lag" in section.values:
            sections.append(_read_lag(section))
        else:
            sections.append(_read_resonance(section))
    stage: DynamicsStage = node.build(lambda: DynamicsStage(tuple(sections)))
    return stage


def _read_lag(node: Node) -> Lag:
    node.only(("lag",), ("lead",))
    seconds = node.time("lag")
    lead = node.time("lead") if "lead" in node.values else 0.0
    lag: Lag = node.build(lambda: Lag(seconds, lead))
    return lag


def _read_resonance(node: Node) -> Resonance:
    node.only(("frequency", "damping"), ("antiresonance",))
    frequency = node.time("frequency")
    damping = node.length("damping")
    beside = None
    if "antiresonance" in node.values:
        beside = _read_antiresonance(node.node("antiresonance"))
    resonance: Resonance = node.build(lambda: Resonance(frequency, damping, beside))
    return resonance


def _read_antiresonance(node: Node) -> Antiresonance:
    node.only(("frequency", "damping"))
    frequency = node.time("frequency")
    damping = node.length("damping")
    antiresonance: Antiresonance = node.build(lambda: Antiresonance(frequency, damping))
    return antiresonance


def _read_gears_state(node: Node, model: ActuatorModel) -> BacklashState:
    """Return bits and memory of the gears, checked against the model's."""
    gears = model.backlash
    node.only(("gears", "bits", "memory"))
    if node.values["gears"] != gears.n:
        raise node.refuse(
            "gears", f"is not {gears.n}, the number of gears of the model"
        )
    digits = node.text("bits")
    hexadecimal = digits and not set(digits) - set("0123456789abcdef")
    if not hexadecimal or int(digits, 16) >> gears.n:
        raise node.refuse("bits", f"is not a hexadecimal number of {gears.n} bits")
    bits = int(digits, 16)
    if node.values["memory"] is None:
        return BacklashState(bits, None)
    memory = tuple(node.numbers("memory"))
    terms = len(gears.relaxation.tau) if gears.relaxation else 0
    if len(memory) != terms:
        raise node.refuse(
            "memory",
            f"has {len(memory)} entries where the model has {terms} relaxation terms",
        )
    return BacklashState(bits, memory)


class StageInFiles(NamedTuple):
    """How a type of stage is read, and what its hysteresis asks for where it has one.

    Attributes
    ----------
    read_stage : callable
        Makes the stage of its node.
    model : callable
        Makes the model of a cascade with such a hysteresis, as ``ActuatorModel`` does.
    read_state : callable
        Makes what the hysteresis remembers of its node in a state file and the model.
    """

    read_stage: Callable[[Node], Stage]
    model: Callable[..., ActuatorModel] = ActuatorModel
    read_state: Callable[[Node, Any], BacklashState] = _read_gears_state


STAGES = {
    "backlash": StageInFiles(_read_backlash),
    "point": StageInFiles(_read_point),
    "scale": StageInFiles(_read_scale),
    "dynamics": StageInFiles(_read_dynamics),
    "delay": StageInFiles(_read_delay),
}
"""Every stage that a model of gears may have; ``docs/model-file.md`` says what they mean.
Extras bring those with another hysteresis.
"""


def _hysteresis_in_files(stages: Iterable[Stage]) -> StageInFiles:
    """Return how the hysteresis of a cascade is read: that of gears, or what an extra brings."""
    for stage in stages:
        if isinstance(stage, OtherHysteresis):
            brought: StageInFiles = extensions.find(
                "model", stage.file_values()["type"]
            )
            return brought
    return STAGES["backlash"]


def read_model(path: str) -> ActuatorModel:
    """Read a model file, or one model of a set (``FILE::CHANNEL``); ``-`` is standard input.

    A file that has not changed is not read again: a thousand logs are run through one
    model.

    Raises
    ------
    InputError
        The file cannot be read, or the set has no such channel.
    ModelError
        It is not a model, of a newer version, or contradicts itself; the message names
        file and key.
    """
    file, separator, channel = path.partition("::")
    if separator and not os.path.exists(path):
        model: ActuatorModel = read_set(file)[channel]
        return model
    if not os.path.isfile(path):
        return _read_single(path)
    status = os.stat(path)
    return _unchanged(path, status.st_mtime_ns, status.st_size)


@functools.lru_cache(maxsize=1)
def _unchanged(path: str, changed: int, size: int) -> ActuatorModel:
    return _read_single(path)


def read_set(path: str) -> Any:
    """Read a set of models: a mapping of channels to models, with their ``coupling``.

    Raises
    ------
    UsageError
        The extra that reads sets is not installed.
    InputError, ModelError
        As for ``read_model``.
    """
    return extensions.find("model", SET_FORMAT)(path)


def is_set(path: str) -> bool:
    """Tell whether a file begins as a model set does; a pipe is not read."""
    if not os.path.isfile(path):
        return False
    try:
        with open(path, "rb") as file:
            return _BEGIN_OF_SET.match(file.read(200)) is not None
    except OSError:
        return False


def _read_single(path: str) -> ActuatorModel:
    """Read a model file; ``-`` is standard input.

    Raises
    ------
    InputError
        The file cannot be read.
    ModelError
        It is not a model, of a newer version, or contradicts itself; the message names
        file and key.
    """
    return model_of(load_document(path, MODEL_FORMAT, "model"))


def model_of(root: Node) -> ActuatorModel:
    """Return the model that an object describes, checked to the last key (ModelError)."""
    root.only(
        ("format", "version", "direction", "input", "output", "stages"),
        ("fit", "provenance"),
    )
    direction = root.text("direction")
    if direction not in {"forward", "inverse"}:
        raise root.refuse(
            "direction", f"{direction!r} is neither 'forward' nor 'inverse'"
        )
    cascade = _stages(root, "stages")
    if root.values["version"] < 3:
        cascade = tuple(_with_linear_delay(stage) for stage in cascade)
    notes = {key: root.node(key) for key in ("fit", "provenance") if key in root.values}
    for note in notes.values():
        note.check_notes(_NOTE_DEPTH)
    if "fit" in notes:
        _check_fit(notes["fit"])
    source = _read_quantity(root.node("input"))
    result = _read_quantity(root.node("output"))
    carried = {key: note.values for key, note in notes.items()}
    make = _hysteresis_in_files(cascade).model
    model: ActuatorModel = root.build(
        lambda: make(direction, source, result, cascade, **carried)
    )
    return model


def _check_fit(fit: Node) -> None:
    """Refuse what cannot be a figure where commands take it for one."""
    for key in (*AMOUNTS_OF_FIT, *SIGNED_OF_FIT):
        if fit.values.get(key) is None:
            continue
        number = fit.number(key)
        if number < 0.0 and key in AMOUNTS_OF_FIT:
            raise fit.refuse(key, f"{number!r} is not a finite number of at least 0")


def _with_linear_delay(stage: Stage) -> Stage:
    """Return a stage as files before version 3 mean it."""
    if isinstance(stage, DelayStage):
        return DelayStage(stage.seconds, "linear")
    return stage


def _version(model: ActuatorModel) -> int:
    """Return the oldest version of the model file that says what a model is."""
    if model.delay is not None and model.delay.between == "smooth":
        return VERSION
    return 2


def load_document(path: str, wanted: str, noun: str, newest: int = VERSION) -> Node:
    """Return the top of a JSON file, its format and version checked.

    Raises
    ------
    InputError
        The file cannot be read.
    ModelError
        It is no file of that format, or of a newer version than ``newest``.
    """
    name = "standard input" if path == "-" else path
    try:
        text = _content_of(path).decode("utf-8-sig")
    except OSError as problem:
        raise InputError(
            f"{name}: cannot be read: {problem.strerror or problem}"
        ) from None
    except UnicodeDecodeError as problem:
        raise ModelError(
            f"{name}: byte {problem.start + 1} is not UTF-8; this is no {noun} file"
        ) from None
    if not text.strip():
        raise ModelError(f"{name}: is empty; this is no {noun} file")
    try:
        values = parsed(name, text)
    except json.JSONDecodeError as problem:
        remedy = ""
        if text.lstrip()[0] not in "{[":  # a log
            remedy = " (identify makes a model from a log)"
        raise ModelError(
            f"{name}:{problem.lineno}: is not JSON: {problem.msg}{remedy}"
        ) from None
    except (ValueError, RecursionError):
        raise ModelError(f"{name}: is not readable JSON") from None
    if isinstance(values, dict) and values.get("format") == SET_FORMAT != wanted:
        raise ModelError(
            f"{name}: is a set of models: name one of them ({name}::CHANNEL), or the columns of all with a "
            "pattern ('V{}')"
        )
    if not isinstance(values, dict) or values.get("format") != wanted:
        raise ModelError(f'{name}: is not a {noun} file ("format" must be "{wanted}")')
    return checked_version(Node(name, "", values), newest)


def _content_of(path: str) -> bytes:
    """Return the bytes of a file, or of standard input (``-``)."""
    if path == "-":
        return sys.stdin.buffer.read()
    return Path(path).read_bytes()


def parsed(name: str, text: str) -> Any:
    """Return the values of JSON text; keys that occur twice and half surrogate pairs are refused.

    Raises
    ------
    ModelError
        A key occurs twice.
    ValueError, RecursionError
        It is no JSON, or none that could be written again.
    """
    values = json.loads(text, object_pairs_hook=functools.partial(_distinct, name))
    if "\\u" in text:
        # raises at half a surrogate pair
        json.dumps(values, ensure_ascii=False).encode()
    return values


def checked_version(root: Node, newest: int = VERSION) -> Node:
    """Return an object whose version is one that this program reads (ModelError where it is not)."""
    if "version" not in root.values:
        raise root.refuse("version", "is missing")
    version = root.values["version"]
    if isinstance(version, float) and version.is_integer():
        version = int(version)  # JSON has one kind of number
    if isinstance(version, bool) or not isinstance(version, int) or version < 1:
        raise root.refuse("version", f"{json.dumps(version)} is not a version")
    if version > newest:
        raise root.refuse(
            "version",
            f"{version} is newer than this program reads, {newest}; upgrade dbo-cli",
        )
    return root


def _distinct(name: str, pairs: list[tuple[str, Any]]) -> Json:
    """Return an object, refusing keys that occur twice: which of them counts would be a guess."""
    values: Json = {}
    for key, value in pairs:
        if key in values:
            raise ModelError(f"{name}: {key}: occurs twice in one object")
        values[key] = value
    return values


def _stage(node: Node) -> Stage:
    """Return one stage of the cascade by its type."""
    if "type" not in node.values:
        raise node.refuse("type", "is missing")
    kind = node.text("type")
    if kind not in STAGES:
        brought: StageInFiles | None = extensions.find("model", kind)
        if brought is None:
            of_extras = [key for key in extensions.keys("model") if key != SET_FORMAT]
            known = ", ".join([*STAGES, *of_extras])
            raise node.refuse(
                "type", f"{kind!r} is not a known stage; there are: {known}"
            )
        return brought.read_stage(node)
    return STAGES[kind].read_stage(node)


def _stages(node: Node, key: str) -> tuple[Stage, ...]:
    stages = node.values[key]
    if not isinstance(stages, list):
        raise node.refuse(key, "is not a list")
    if len(stages) > MOST_STAGES:
        raise node.refuse(key, f"has {len(stages):,} entries, more than {MOST_STAGES}")
    return tuple(
        _stage(node.below(f"{key}[{i}]", stage)) for i, stage in enumerate(stages)
    )


def read_stages(values: object, key: str) -> tuple[Stage, ...]:
    """Return the stages that plain values describe (ModelError, with the place below ``key``)."""
    return _stages(Node("the model", "", {key: values}), key)


def model_to_bytes(model: ActuatorModel) -> bytes:
    """Return the model file of a model: the same model gives the same bytes."""
    return document_bytes(model_values(model))


def model_values(model: ActuatorModel) -> Json:
    """Return the keys and values of a model file."""
    values: Json = {
        "format": MODEL_FORMAT,
        "version": _version(model),
        "direction": model.direction,
        "input": _quantity_values(model.input),
        "output": _quantity_values(model.output),
        "stages": [stage_values(stage) for stage in model.stages],
    }
    for key, notes in (("fit", model.fit), ("provenance", model.provenance)):
        if notes:
            values[key] = dict(notes)
    return values


def stage_values(stage: Stage) -> Json:
    """Return a stage as plain values, its type first."""
    if isinstance(stage, OtherHysteresis):
        return stage.file_values()
    if isinstance(stage, ScaleStage):
        return {"type": "scale", "gain": stage.gain, "offset": stage.offset}
    if isinstance(stage, DelayStage):
        return {"type": "delay", "seconds": stage.seconds}
    if isinstance(stage, DynamicsStage):
        sections = [section_values(section) for section in stage.sections]
        return {"type": "dynamics", "sections": sections}
    if isinstance(stage, PointStage):
        return {"type": "point", **_curve_values(stage)}
    values = {"type": "backlash", **_curve_values(stage)}
    terms = relaxation_values(stage.relaxation, stage.memory_on)
    if terms is not None:
        values["relaxation"] = terms
    return values


def _curve_values(stage: BacklashStage | PointStage) -> Json:
    return {
        "x0": stage.x0,
        "y0": stage.y0,
        "dx": _with_runs(stage.dx.tolist()),
        "dy": _with_runs(stage.dy.tolist()),
    }


def _with_runs(widths: list[float]) -> list[float | Json]:
    """Return widths with every run of equal ones written once."""
    written: list[float | Json] = []
    for value, run in itertools.groupby(widths):
        count = sum(1 for _ in run)
        if count >= SHORTEST_RUN:
            written.append({"repeat": count, "value": value})
        else:
            written.extend([value] * count)
    return written


def relaxation_values(terms: Relaxation | None, axis: Axis) -> Json | None:
    """Return relaxation and the axis that it follows as plain values."""
    if terms is None:
        return None
    return {
        "on": axis,
        "reference": terms.reference,
        "tau": list(terms.tau),
        "gain": list(terms.gain),
    }


def section_values(section: Section) -> Json:
    """Return a section of the dynamics as plain values."""
    if isinstance(section, Lag):
        lag: Json = {"lag": section.seconds}
        if section.lead:
            lag["lead"] = section.lead
        return lag
    values: Json = {"frequency": section.frequency, "damping": section.damping}
    beside = section.antiresonance
    if beside is not None:
        values["antiresonance"] = {
            "frequency": beside.frequency,
            "damping": beside.damping,
        }
    return values


def _quantity_values(quantity: Quantity) -> Json:
    return {
        "quantity": quantity.quantity,
        "unit": quantity.unit,
        "min": quantity.minimum,
        "max": quantity.maximum,
    }


def document_bytes(values: Mapping[str, Any]) -> bytes:
    """Return JSON with one line for a short object and filled lines for a long list, for people and diff."""
    return (_layout(values, "") + "\n").encode()


def _layout(value: Any, indent: str) -> str:
    flat = json.dumps(value, ensure_ascii=False, allow_nan=False)
    if (
        not isinstance(value, dict | list)
        or not value
        or len(indent) + len(flat) <= LINE
    ):
        return flat
    inner = indent + "  "
    if isinstance(value, dict):
        lines = [
            f"{inner}{json.dumps(key, ensure_ascii=False)}: {_layout(item, inner)}"
            for key, item in value.items()
        ]
        return "{\n" + ",\n".join(lines) + f"\n{indent}}}"
    if all(_is_number_or_run(item) for item in value):  # lines of as many as fit
        items = [json.dumps(item, ensure_ascii=False) for item in value]
        return f"[\n{filled(items, LINE, inner)}\n{indent}]"
    lines = [inner + _layout(item, inner) for item in value]
    return "[\n" + ",\n".join(lines) + f"\n{indent}]"


def _is_number_or_run(item: Any) -> bool:
    """Whether an entry of a list is a number, or a number that is repeated."""
    if isinstance(item, dict):
        return item.keys() == {"repeat", "value"}
    return isinstance(item, int | float)


def filled(items: Sequence[str], width: int, indent: str) -> str:
    """Return items with commas between them, in lines of at most ``width`` characters where they fit."""
    import textwrap  # most runs write no list

    # a line does not end inside an item
    whole = ", ".join(item.replace(" ", "\0") for item in items)
    lines = textwrap.fill(
        whole, width, initial_indent=indent, subsequent_indent=indent, break_long_words=False,
        break_on_hyphens=False,
    )  # fmt: skip
    return lines.replace("\0", " ")


def state_to_bytes(state: ModelState, model: ActuatorModel) -> bytes:
    """Return the state file of a state; it names the gears it belongs to by a digest."""
    values: Json = {
        "format": STATE_FORMAT,
        "version": STATE_VERSION,
        "model": model.digest,
        **model.state_values(state.backlash),
        "time": state.time,
        "drive": state.drive,
        "delay": None,
    }
    if state.history is not None:
        values["delay"] = {
            "times": list(state.history.times),
            "values": list(state.history.values),
        }
    if state.dynamics is not None or state.undoing is not None:
        values["dynamics"] = _dynamics_values(state)
    if state.drive_lag is not None:
        values["drive_lag"] = {"sections": _lists(state.drive_lag)}
    return document_bytes(values)


def read_state(path: str, model: ActuatorModel) -> ModelState:
    """Read a state file for a model or its inverse.

    Raises
    ------
    InputError
        The file cannot be read.
    ModelError
        It is not a state, contradicts itself, or belongs to another model.
    """
    root = load_document(path, STATE_FORMAT, "state", STATE_VERSION)
    timed = root.values["version"] > 1
    key = "backlash" if model.has_gears else "plays"
    required = ["format", "version", "model", key, "drive", "delay"]
    optional: tuple[str, ...] = ()
    if timed:
        required.insert(4, "time")
        optional = ("dynamics", "drive_lag")
    root.only(tuple(required), optional)
    if root.text("model") != model.digest:
        raise root.refuse(
            "model", "the state belongs to another model (save it again with this one)"
        )
    hysteresis = _hysteresis_in_files(model.stages)
    backlash = hysteresis.read_state(root.node(key), model)
    drive = time = None
    if root.values["drive"] is not None:
        drive = root.number("drive")
    if timed and root.values["time"] is not None:
        time = root.number("time")
    begun = ModelState(backlash, drive, _history(root), time=time)
    return _with_dynamics(begun, root, model)


def _dynamics_values(state: ModelState) -> Json:
    values: Json = {"sections": None, "inverse": None}
    if state.dynamics is not None:
        values["sections"] = _lists(state.dynamics)
    if state.undoing is not None:
        values["inverse"] = {
            "time_step": state.undoing.time_step,
            "sections": _lists(state.undoing.states),
        }
    return values


def _lists(states: SectionStates) -> list[list[float]]:
    return [list(section) for section in states]


def _with_dynamics(state: ModelState, root: Node, model: ActuatorModel) -> ModelState:
    """Return a state with that of the dynamics, where the file holds one."""
    if "drive_lag" in root.values:
        node = root.node("drive_lag")
        node.only(("sections",))
        if model.drive_lag is None:
            raise root.refuse("drive_lag", "the model has none")
        state = replace(state, drive_lag=_section_states(node, 1))
    if "dynamics" not in root.values:
        return state
    node = root.node("dynamics")
    node.only(("sections", "inverse"))
    if model.dynamics is None:
        raise root.refuse("dynamics", "the model has none")
    count = len(model.dynamics.sections)
    forward = undoing = None
    if node.values["sections"] is not None:
        forward = _section_states(node, count)
    if node.values["inverse"] is not None:
        inverse = node.node("inverse")
        inverse.only(("time_step", "sections"))
        time_step = inverse.number("time_step")
        if not time_step > 0.0:
            raise inverse.refuse("time_step", f"{time_step!r} is not greater than 0")
        undoing = InverseMemory(time_step, _section_states(inverse, count))
    return replace(state, dynamics=forward, undoing=undoing)


def _section_states(node: Node, count: int) -> SectionStates:
    items = node.values["sections"]
    if not isinstance(items, list) or len(items) != count:
        raise node.refuse(
            "sections", f"is not a list of {count}, the number of sections of the model"
        )
    states = []
    for k, item in enumerate(items):
        place = f"sections[{k}]"
        if not isinstance(item, list) or len(item) != 3:
            raise node.refuse(place, "is not a list of three numbers")
        p = node.finite(f"{place}[0]", item[0])
        q = node.finite(f"{place}[1]", item[1])
        u = node.finite(f"{place}[2]", item[2])
        states.append((p, q, u))
    return tuple(states)


def _history(root: Node) -> DelayHistory | None:
    """Return what a delay held back."""
    if root.values["delay"] is None:
        return None
    node = root.node("delay")
    node.only(("times", "values"))
    times, values = tuple(node.numbers("times")), tuple(node.numbers("values"))
    if len(times) != len(values) or not times:
        raise node.refuse(
            "values", f"has {len(values)} entries where times has {len(times)}"
        )
    if any(later < earlier for earlier, later in pairwise(times)):
        raise node.refuse("times", "goes backwards")
    return DelayHistory(times, values)
