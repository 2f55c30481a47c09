"""A model run over a signal block by block, in constant memory."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np

from dbo_cli.arrays import Floats
from dbo_cli.model import Cascade, Outside, State, Undoing, read_ahead


@dataclass
class Simulation:
    """What a run over blocks has come to.

    Attributes
    ----------
    state : State, or None
        After the last row; None before the first.
    rows : int
        Rows so far.
    outside, first_outside : int
        Rows beyond the model's input range, and the first of them, from 1.
    """

    state: State | None = None
    rows: int = 0
    outside: int = 0
    first_outside: int = 0


def simulate_blocks(
    model: Cascade,
    blocks: Iterable[tuple[Any, Floats, float | Floats | None]],
    run: Simulation,
    start: str = "auto",
    outside: Outside = "extend",
    name: str = "",
) -> Iterator[tuple[Any, Floats]]:
    """Yield the output of a model for blocks of its input.

    Parameters
    ----------
    blocks : iterable of (payload, input, dt)
        The payload is handed on; dt in s as ``Model.run`` takes it.
    run : Simulation
        Takes the state and the counts. Its state, if there is one, is the start.
    start : str
        ``auto``, ``empty``, ``full`` or ``settled``, where there is no state.
    outside : {"extend", "hold", "error"}
        What happens beyond the model's input range.
    name : str
        Of the input, in messages.

    Yields
    ------
    payload, output
        Of each block, in order; the values do not depend on the size of the blocks.

    Raises
    ------
    ModelError
        The model needs time and there is none.
    InputError
        A row is outside, and ``outside`` is ``error``.
    """
    stream = iter(blocks)
    first = next(stream, None)
    if first is None:
        return
    rows = 0 if model.is_forward else model.inverter(first[2]).ahead
    undoing: Undoing | None = None
    if run.state is not None and not model.is_forward:
        undoing = model.inverter(first[2]).behind(run.state)
    signal = (((payload, dt), x) for payload, x, dt in chain([first], stream))
    for (payload, dt), ahead in read_ahead(signal, rows):
        x = ahead
        if not model.is_forward:
            x, undoing = model.inverter(dt).run(ahead, undoing)
        if run.state is None:
            run.state = model.start(float(x[0]), start)
        if outside == "error":
            model.require_inside(x, run.rows, name)
        beyond = model.outside(x)
        if beyond.any() and not run.outside:
            run.first_outside = run.rows + int(np.argmax(beyond)) + 1
        run.outside += int(np.count_nonzero(beyond))
        run.rows += x.size
        done = model.run(x, run.state, dt, outside)
        run.state = done.state
        yield payload, done.y
