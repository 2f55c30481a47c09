"""One sample at a time, for live control: gears whose state stays in compiled code."""

from __future__ import annotations

import math

import numpy as np

from dbo_cli.model import kernel
from dbo_cli.model.gears import OPEN, Gears, Window, bits_of


class Stepper:
    """Steps gears at an even rate from a committed state; a step counts once it is committed.

    ``Gears.run`` checks, allocates and converts for every block, which a block pays once
    and a live sample would pay each time. The values are the same.

    Parameters
    ----------
    gears : Gears
        Those of an inverse model for a drive.
    bits, memory
        The state; with relaxation, what is remembered.
    last : float, or None
        The output before, for the slew.
    dt : float
        Seconds between samples.
    window : Window, optional
        Limits on the output.

    Attributes
    ----------
    plan : callable
        ``plan(x) -> y``: the output for an input; nothing changes yet.
    follow : callable
        ``follow(y)``: work out the state that this output leads to, whatever was asked
        for; nothing changes yet.
    commit : callable
        ``commit()``: go on to the state that was worked out last.

    Raises
    ------
    DboError
        The compiled part is missing.
    ModelError
        The state is not of these gears.
    """

    def __init__(
        self,
        gears: Gears,
        bits: int,
        memory: tuple[float, ...] | None,
        last: float | None,
        dt: float,
        window: Window | None = None,
    ) -> None:
        decay = np.zeros((0, 0))
        if gears.relaxation is not None:
            decay = gears.relaxation.decay(dt)
        bound = window or OPEN
        step = bound.largest_step(dt)
        self._gears = gears
        self._inner = kernel.require("live control").Stepper(
            *gears.constants(True), decay, window is not None, bound.low, bound.high,
            gears.slack(bound), math.nan if step is None else float(step),
        )  # fmt: skip
        memories = np.array(memory or (), dtype=np.float64)
        self._inner.set(gears.words(bits), memories, math.nan if last is None else last)
        self.plan = self._inner.plan
        self.follow = self._inner.follow
        self.commit = self._inner.commit

    def committed(self) -> tuple[int, tuple[float, ...] | None]:
        """Return bits and memory (None without relaxation) of the committed state."""
        words = self._gears.words(0)
        memory = np.zeros(self._gears.gain.size)
        self._inner.get(words, memory)
        if self._gears.relaxation is None:
            return bits_of(words), None
        return bits_of(words), tuple(memory.tolist())

    @property
    def clipped(self) -> bool:
        """Whether the last plan met the window."""
        return bool(self._inner.clipped)
