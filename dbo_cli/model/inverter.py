"""Dynamics and a delay undone together on an even clock."""

from __future__ import annotations

from dbo_cli.arrays import Floats
from dbo_cli.model.delay import Delay
from dbo_cli.model.dynamics import Dynamics
from dbo_cli.model.state import State, Undoing


class Inverter:
    """Undoes dynamics and a delay on an even clock of ``dt`` (s), reading ahead by ``ahead`` samples.

    Attributes
    ----------
    stages : tuple of (Delay or Dynamics, int)
        The stages in the order in which they are undone, and the rows that each reads
        ahead.

    Raises
    ------
    InputError
        The clock does not resolve a section.
    """

    def __init__(
        self, dynamics: Dynamics | None, delay: Delay | None, dt: float
    ) -> None:
        self.dt = dt
        self.dynamics = dynamics
        stages = [stage for stage in (delay, dynamics) if stage is not None]
        self.stages = tuple((stage, stage.ahead(dt)) for stage in stages)
        self.ahead = sum(rows for _, rows in self.stages)

    def run(
        self, desired: Floats, undoing: Undoing | None = None
    ) -> tuple[Floats, Undoing | None]:
        """Return what the static part must reach for a displacement, and what comes next goes on from.

        Parameters
        ----------
        desired : array
            A block and ``ahead`` samples of what follows it.
        undoing : Undoing, or None
            From the block before, or ``behind``; None: at rest at the first value.
        """
        if not self.stages:
            return desired, None
        signal, state, ahead = desired, State(undoing=undoing), self.ahead
        for stage, rows in self.stages:
            after = stage.undo(signal, state, self.dt, ahead)
            signal, state, ahead = after.y, after.state, ahead - rows
        return signal, state.undoing

    def behind(self, state: State) -> Undoing | None:
        """Return what ``run`` goes on from behind a state; None where nothing is known of it."""
        if state.undoing is not None and state.undoing[0] == self.dt:
            return state.undoing
        if self.dynamics is None or state.sections is None:
            return None
        return self.dt, self.dynamics.undoing_behind(state.sections, self.dt), ()

    def loop(self, desired: Floats) -> Floats:
        """Return what ``run`` does, for one period of a displacement that repeats for ever."""
        for stage, _ in self.stages:
            desired = stage.undo_loop(desired, self.dt)
        return desired
