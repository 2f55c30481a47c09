"""One sample at a time, for live control: gears whose state stays in compiled code."""

from __future__ import annotations

import math

import numpy as np

from dbo_cli.model import kernel
from dbo_cli.model.gears import Gears, Window, bits_of


class Stepper:
    """Steps gears at an even rate from a committed state; a step counts once it is committed.

    ``Gears.run`` checks, allocates and converts for every block, which a block pays once
    and a live sample would pay each time. The values are the same.

    Parameters
    ----------
    gears : Gears
        Those of an inverse model for a drive.
    bits : int
        Where they start.
    memory : tuple of float, or None
        What relaxation remembers there; needed where the gears relax.
    last : float, or None
        The output before (for the largest step).
    dt : float, optional
        Seconds between samples; needed with relaxation.
    window : Window, optional
        Limits on the output, with one number as largest step.

    Attributes
    ----------
    plan : callable
        ``plan(x) -> y``: the output for an input; nothing changes yet.
    follow : callable
        ``follow(y)``: work out the state that this output leads to, whatever was asked
        for; nothing changes yet. ValueError where memory follows the input.
    commit : callable
        ``commit()``: go on to the state that was worked out last. ValueError where none
        was.

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
        memory: tuple[float, ...] | None = None,
        last: float | None = None,
        dt: float | None = None,
        window: Window | None = None,
    ) -> None:
        decay = np.zeros((0, 0))
        if gears.relaxation is not None and dt is not None:
            decay = gears.relaxation.decay(dt)
        bound = window or Window()
        step = math.nan
        if bound.step is not None:
            step = float(np.asarray(bound.step))
        self._gears = gears
        self._inner = kernel.require("live control").Stepper(
            *gears.constants(True), decay, window is not None, bound.low, bound.high, bound.slack, step
        )  # fmt: skip
        self.plan = self._inner.plan
        self.follow = self._inner.follow
        self.commit = self._inner.commit
        self.set(bits, memory, last)

    def set(
        self, bits: int, memory: tuple[float, ...] | None, last: float | None
    ) -> None:
        """Take a state over from these gears or their inverse: bits and memory mean the same."""
        memories = np.array(memory or (), dtype=np.float64)
        before = math.nan if last is None else last
        self._inner.set(self._gears.words(bits), memories, before)

    def _committed(self) -> tuple[int, tuple[float, ...]]:
        words = self._gears.words(0)
        memory = np.zeros(self._gears.gain.size)
        self._inner.get(words, memory)
        return bits_of(words), tuple(memory.tolist())

    @property
    def bits(self) -> int:
        """The committed bits."""
        return self._committed()[0]

    @property
    def memory(self) -> tuple[float, ...] | None:
        """What relaxation remembers in the committed state; None without relaxation."""
        if self._gears.relaxation is None:
            return None
        return self._committed()[1]

    @property
    def last(self) -> float:
        """The output of the last step committed, or NaN."""
        return float(self._inner.last)

    @property
    def clipped(self) -> bool:
        """Whether the last plan met the window."""
        return bool(self._inner.clipped)
