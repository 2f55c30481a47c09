"""A model run over its input, block by block, in constant memory.

A forward model turns a drive into the displacement. An inverse one turns a displacement
into a drive, which is judged against the voltages that the model was identified on. To
undo dynamics and delay, rows wait until those after them are known.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple, get_args

import numpy as np

from dbo_cli.arrays import Floats
from dbo_cli.errors import InputError, LimitError, UsageError, warn
from dbo_cli.model import Cascade, Outside, State, Steps, steps_behind


class Rows(NamedTuple):
    """Rows, ready or recorded: seconds (None without a clock), what was asked for, what came of it."""

    time: Floats | None
    x: Floats
    y: Floats

    def send(self, write: Callable[..., None]) -> None:
        """Hand the columns to what writes a table, if there are any rows."""
        if self.x.size:
            write(*(column for column in self if column is not None))


NO_ROWS = Rows(None, np.empty(0), np.empty(0))


def stacked(blocks: list[Rows]) -> Rows:
    """Return rows one behind the other; blocks without rows do not count."""
    blocks = [rows for rows in blocks if rows.x.size]
    if len(blocks) < 2:
        return blocks[0] if blocks else NO_ROWS
    times = [rows.time for rows in blocks if rows.time is not None]
    time = np.concatenate(times) if len(times) == len(blocks) else None
    x = np.concatenate([rows.x for rows in blocks])
    return Rows(time, x, np.concatenate([rows.y for rows in blocks]))


class Due(NamedTuple):
    """Rows on their way to a drive.

    Attributes
    ----------
    target : array
        What is asked for; once enough is known behind them, what the static part is to
        reach.
    desired, time : array
        Of the rows; no time without a clock.
    dt : float, array or None
        Seconds since the row before.
    phase : {"move", "lead"}
        Whether they stand before the move.
    """

    target: Floats
    desired: Floats
    time: Floats | None
    dt: Steps
    phase: str = "move"


class Ahead:
    """Undoes dynamics and delay of rows in blocks, which wait until the rows after them are known.

    Parameters
    ----------
    model, dt, state
        A forward model, seconds a row, and the state before the first row.
    """

    def __init__(self, model: Cascade, dt: Steps, state: State | str) -> None:
        self._model = model
        inverter = model.inverter(dt)
        self._count = inverter.ahead
        self._undoing = inverter.behind(state) if isinstance(state, State) else None
        self._waiting: deque[Due] = deque()
        self._asked = np.empty(0)  # of the blocks that wait, and of those after

    def take(self, block: Due) -> list[Due]:
        """Take a block; return the blocks that are due."""
        self._waiting.append(block)
        return self._due(block.target)

    def remaining(self) -> list[Due]:
        """Return the blocks that are left: the last value goes on for ever."""
        return self._due(np.repeat(self._asked[-1:], self._count))

    def _due(self, asked: Floats) -> list[Due]:
        """Return each block of which enough is known with what is asked for behind it."""
        if self._asked.size:
            asked = np.concatenate([self._asked, asked])
        blocks = []
        while (
            self._waiting and asked.size >= self._waiting[0].desired.size + self._count
        ):
            block = self._waiting.popleft()
            rows = block.desired.size
            inverter = self._model.inverter(block.dt)
            read = asked[: rows + self._count]
            target, self._undoing = inverter.run(read, self._undoing)
            asked = asked[rows:]
            blocks.append(block._replace(target=target))
        self._asked = asked
        return blocks


class Simulator:
    """Runs a model over a signal that comes in blocks; an array is one block.

    Parameters
    ----------
    model : Cascade
        Forward or inverse.
    state : State or str
        Before the first row: a state, ``auto``, ``empty``, ``full`` or ``settled``.
    outside : {"extend", "hold", "error"}
        What happens where the drive leaves the model's range: the input of a forward
        model, the output of an inverse one.
    name : str
        Of the input, in messages.

    Attributes
    ----------
    state : State or str
        After the last row.
    row_count : int
        Rows so far.
    outside_count, first_outside : int
        Rows whose voltage leaves the range (or was held there), and the first of them,
        from 1; 0: none.

    Raises
    ------
    UsageError
        ``outside`` is unknown.
    """

    def __init__(
        self,
        model: Cascade,
        state: State | str = "auto",
        outside: Outside = "extend",
        name: str = "input",
    ) -> None:
        if outside not in get_args(Outside):
            raise UsageError(f"`outside` {outside}: give extend, hold or error")
        self.model, self.state = model, state
        self.outside, self.name = outside, name
        self.row_count = self.outside_count = self.first_outside = 0
        self._forward = model.forward()
        self._ahead: Ahead | None = None  # of an inverse model

    def rows(self, x: Floats, dt: Steps = None, time: Floats | None = None) -> Rows:
        """Return input and output of the rows that are ready: reading ahead holds some back.

        Parameters
        ----------
        x : array
            The next rows of the input.
        dt : float, array or None
            Seconds since the row before, as ``Cascade.run`` takes them.
        time : array, optional
            Seconds of each row; handed on, and kept in the state.

        Raises
        ------
        ModelError
            The model needs a clock and there is none.
        InputError
            A row of a drive is outside, and ``outside`` is ``error``.
        LimitError
            Likewise, of a displacement that an inverse model is to reach, or its drive.
        """
        if not x.size:
            return NO_ROWS
        if not self.row_count and self._ahead is None:  # the first rows
            if isinstance(self.state, State):
                dt = steps_behind(self.state.time, time, dt)
            if not self.model.is_forward:
                self._ahead = Ahead(self._forward, dt, self.state)
        if self._ahead is None:
            start = self.model.start(float(x[0]), self.state)
            self._watch(x, self.model)
            run = self.model.run(x, start, dt, self.outside)
            self.state = run.state
            return self._counted(x, run.y, time)
        return self._driven(self._ahead.take(Due(x, x, time, dt)))

    def finish(self) -> Rows:
        """Return what was held back, as if the last value went on for ever; warn of rows outside."""
        rows = NO_ROWS if self._ahead is None else self._driven(self._ahead.remaining())
        if isinstance(self.state, State):
            self.state = replace(self.state, model=self.model.digest)
        if self.outside_count:
            drive = self._forward.input
            held = ", where they are held" if self.outside == "hold" else ""
            warn(
                f"{self.name}: {self.outside_count:,} of {self.row_count:,} rows (first: row "
                f"{self.first_outside:,}) leave the identified range of the drive, {drive.min:.6g} to "
                f"{drive.max:.6g}{drive.suffix}{held}"
            )
        return rows

    def _counted(self, x: Floats, y: Floats, time: Floats | None) -> Rows:
        """Count rows that are ready, and return them."""
        self.row_count += x.size
        if time is not None:
            assert isinstance(self.state, State)
            self.state = replace(self.state, time=float(time[-1]))
        return Rows(time, x, y)

    def _driven(self, blocks: list[Due]) -> Rows:
        """Return rows with the drive that an inverse model makes, within its range where it is held."""
        model, is_held = self._forward, self.outside == "hold"
        window = (model.input.min, model.input.max) if is_held else None
        driven = []
        for due in blocks:
            self.state = model.start_drive(float(due.target[0]), self.state)
            run = model.drive(due.target, self.state, due.dt, window)
            self.state = run.state
            if run.clipped and not self.outside_count:
                self.first_outside = self.row_count + run.first_clipped + 1
            self.outside_count += run.clipped
            if self.outside == "error":
                self._watch(due.desired, self.model)
            self._watch(run.y, model)
            driven.append(self._counted(due.desired, run.y, due.time))
        return stacked(driven)

    def _watch(self, values: Floats, model: Cascade) -> None:
        """Count the rows that are outside the input's range of a model, or refuse the first of them."""
        outside = model.outside(values)
        if not outside.any():
            return
        first, known = int(np.argmax(outside)), model.input
        row = self.row_count + first + 1
        if self.outside == "error":
            kind = InputError if self.model.is_forward else LimitError
            raise kind(
                f"{self.name}: row {row:,}: {values[first]:.6g}{known.suffix} is outside the model's "
                f"range, {known.min:.6g} to {known.max:.6g}{known.suffix} (`outside` extend or hold)"
            )
        self.first_outside = self.first_outside or row
        self.outside_count += int(np.count_nonzero(outside))
