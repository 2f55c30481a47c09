"""A model run over its input, block by block, in constant memory.

A forward model turns a drive into the displacement. An inverse one turns a displacement
into a drive, which is judged against the voltages that the model was identified on.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dbo_cli.arrays import Floats
from dbo_cli.drive.ahead import NO_ROWS, Ahead, Rows, joined
from dbo_cli.errors import LimitError, warn
from dbo_cli.model import Cascade, Outside, State, Steps, Undoing, steps_behind


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
    """

    def __init__(
        self,
        model: Cascade,
        state: State | str = "auto",
        outside: Outside = "extend",
        name: str = "input",
    ) -> None:
        self.model = model
        self.state = state
        self.outside = outside
        self.name = name
        self.row_count = 0
        self.outside_count = 0
        self.first_outside = 0
        self._ahead: Ahead | None = None
        self._dt: Steps = None
        self._undoing: Undoing | None = None

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
            Likewise, of a drive that an inverse model makes.
        """
        if self._ahead is None:
            if isinstance(self.state, State):
                dt = steps_behind(self.state.time, time, dt)
            self._ahead = Ahead(self._rows_ahead(dt))
        self._dt = dt
        return joined([self._run(*block) for block in self._ahead.take(x, time)])

    def finish(self) -> Rows:
        """Return what was held back, as if the last value went on for ever; warn of rows outside."""
        rows = NO_ROWS
        if self._ahead is not None:
            rows = joined([self._run(*block) for block in self._ahead.remaining()])
        if self.outside_count:
            drive, verb = self._forward.input, "leave"
            if not self.model.is_forward:
                verb = (
                    f"of its drive {'are held in' if self.outside == 'hold' else verb}"
                )
            warn(
                f"{self.name}: {self.outside_count:,} of {self.row_count:,} rows (first: row "
                f"{self.first_outside:,}) {verb} the identified range, {drive.min:.6g} to "
                f"{drive.max:.6g}{drive.suffix}"
            )
        return rows

    @property
    def _forward(self) -> Cascade:
        return self.model.forward()

    def _rows_ahead(self, dt: Steps) -> int:
        """Return how many rows an inverse model reads ahead; begin there."""
        if self.model.is_forward:
            return 0
        inverter = self._forward.inverter(dt)
        if isinstance(self.state, State):
            self._undoing = inverter.behind(self.state)
        return inverter.ahead

    def _run(self, columns: tuple[Floats | None, ...], ahead: Floats) -> Rows:
        """Return the output of rows that are ready; ``known`` is their input and what is read ahead."""
        x, time = columns
        if x is None or not x.size:
            return NO_ROWS
        y = self._displacement(x) if self.model.is_forward else self._drive(ahead)
        self.row_count += x.size
        if time is not None:
            assert isinstance(self.state, State)
            self.state = replace(self.state, time=float(time[-1]))
        return Rows(time, x, y)

    def _displacement(self, voltage: Floats) -> Floats:
        """Return what a forward model makes of a drive."""
        self.state = self.model.start(float(voltage[0]), self.state)
        if self.outside == "error":
            self.model.require_inside(voltage, self.row_count, self.name)
        self._count_outside(voltage)
        run = self.model.run(voltage, self.state, self._dt, self.outside)
        self.state = run.state
        return run.y

    def _drive(self, ahead: Floats) -> Floats:
        """Return the drive that an inverse model makes, within its range where it is held."""
        model, is_held = self._forward, self.outside == "hold"
        window = (model.input.min, model.input.max) if is_held else None
        target, self._undoing = model.inverter(self._dt).run(ahead, self._undoing)
        self.state = model.start_drive(float(target[0]), self.state)
        run = model.drive(target, self.state, self._dt, window)
        self.state = run.state
        if run.clipped and not self.outside_count:
            self.first_outside = self.row_count + run.first_clipped + 1
        self.outside_count += run.clipped
        self._count_outside(run.y)
        return run.y

    def _count_outside(self, voltage: Floats) -> None:
        """Count the rows whose voltage the model does not know; refuse those of an inverse model if asked."""
        outside = self._forward.outside(voltage)
        if not outside.any():
            return
        first = int(np.argmax(outside))
        if self.outside == "error":
            drive = self._forward.input
            raise LimitError(
                f"{self.name}: row {self.row_count + first + 1:,}: its drive, {voltage[first]:.6g}"
                f"{drive.suffix}, is outside the identified range, {drive.min:.6g} to {drive.max:.6g} "
                "(`outside` extend or hold)"
            )
        self.first_outside = self.first_outside or self.row_count + first + 1
        self.outside_count += int(np.count_nonzero(outside))
