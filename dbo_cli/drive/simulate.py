"""A model run over a signal block by block, in constant memory."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from dbo_cli.model import Model, State, read_ahead

Floats = NDArray[np.float64]
Outside = Literal["extend", "hold", "error"]


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
    model: Model,
    blocks: Iterable[tuple[Any, Floats, float | Floats | None]],
    run: Simulation,
    start: str = "auto",
    outside: Outside = "extend",
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
    if not model.is_forward and (model.dynamics or model.delay):
        blocks = _undone(model, blocks, run)
    for payload, x, dt in blocks:
        if not x.size:
            continue
        if run.state is None:
            run.state = model.start(float(x[0]), start)
        done = model.run(x, run.state, dt, outside)
        if done.outside and not run.outside:
            run.first_outside = run.rows + done.first_outside + 1
        run.outside += done.outside
        run.rows += x.size
        run.state = done.state
        yield payload, done.y


def _undone(
    model: Model, blocks: Iterable[tuple[Any, Floats, Any]], run: Simulation
) -> Iterator[tuple[Any, Floats, Any]]:
    """Undo dynamics and delay of an inverse model's input, which is read ahead for it."""
    stream = iter(blocks)
    first = next(stream, None)
    if first is None:
        return
    step = first[2]
    undoing = None if run.state is None else run.state.undoing

    def pairs() -> Iterator[tuple[Any, Floats]]:
        yield (first[0], first[2]), first[1]
        for payload, x, dt in stream:
            yield (payload, dt), x

    for (payload, dt), ahead in read_ahead(pairs(), model.ahead(step)):
        undone, undoing = model.undo(ahead, undoing, dt)
        if run.state is not None:
            run.state = dataclasses.replace(run.state, undoing=undoing)
        yield payload, undone, dt
