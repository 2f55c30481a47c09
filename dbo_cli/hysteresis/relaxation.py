"""Relaxation: lag and creep beside the gears (beyond the paper)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dbo_cli.errors import InputError, ModelError
from dbo_cli.hysteresis import kernel

Floats = NDArray[np.float64]

_FEW, _LOOKED_AT = 16, 256
"""So few different steps among so many first rows are taken for all: looking one up costs 8 to 10 ns a
row, the exponential function with five terms 45 to 95."""


@dataclass(frozen=True)
class Relaxation:
    """Lag and creep beside the gears: sum_j gain_j L_j, each L_j a first-order lag of the voltage.

    L_j,k = a_j L_j,k-1 + (1 - a_j)(v_k - reference), a_j = exp(-Δt_k/tau_j). Beyond the paper.

    Attributes
    ----------
    reference : float
        Voltage at which nothing is remembered.
    tau : tuple of float
        Time constants in seconds, > 0.
    gain : tuple of float
        Output per volt, >= 0, one for each time constant.
    """

    reference: float
    tau: tuple[float, ...]
    gain: tuple[float, ...]

    def __post_init__(self) -> None:
        """Refuse what no actuator has, naming the key."""
        if not math.isfinite(self.reference):
            raise ModelError(f"relaxation.reference: {self.reference!r} is not a finite number")
        if not self.tau:
            raise ModelError("relaxation.tau: is empty; leave relaxation out instead")
        if len(self.tau) != len(self.gain):
            raise ModelError(
                f"relaxation.gain: has {len(self.gain)} entries where relaxation.tau has {len(self.tau)}"
            )
        for j, (tau, gain) in enumerate(zip(self.tau, self.gain, strict=True)):
            if not (math.isfinite(tau) and tau > 0.0):
                raise ModelError(f"relaxation.tau[{j}]: {tau!r} is not a finite time greater than 0")
            if not (math.isfinite(gain) and gain >= 0.0):
                raise ModelError(f"relaxation.gain[{j}]: {gain!r} is not a finite number of at least 0")

    def decay(self, time_step: float | ArrayLike) -> Floats:
        """Return a_j = exp(-Δt/tau_j) as rows: one for a single time step (s), else one per sample.

        Steps that are all the same come as one row, too. An even clock written in decimals has two or three
        different steps: each is computed once, with the bits of the exponential function all the same.

        Raises
        ------
        InputError
            A time step is negative or not a number.
        """
        steps = np.asarray(time_step, dtype=np.float64).reshape(-1)
        if not np.all(steps >= 0.0):
            k = int(np.flatnonzero(~(steps >= 0.0))[0])
            raise InputError(f"time step {k + 1}: {float(steps[k])!r} s; time must not go backwards")
        few, which = np.array(sorted(set(steps[:_LOOKED_AT].tolist()))), None
        if few.size <= _FEW < steps.size:
            which = np.minimum(np.searchsorted(few, steps), few.size - 1)
            steps, which = (few, which) if np.array_equal(few[which], steps) else (steps, None)
        factors: Floats = np.exp(-steps[:, np.newaxis] / np.array(self.tau))
        return factors if which is None or steps.size == 1 else factors.take(which, axis=0)

    def lags(
        self, x: ArrayLike, time_step: float | ArrayLike, memory: Sequence[float] | None = None
    ) -> tuple[Floats, tuple[float, ...]]:
        """Return L_j after each sample (len(x) × terms) and after the last; at rest first without memory."""
        drive = np.ascontiguousarray(x, dtype=np.float64)
        held = np.array(memory if memory is not None else [0.0] * len(self.tau), dtype=np.float64)
        rows = np.empty((drive.size, len(self.tau)))
        decay = self.decay(time_step)
        start = 0
        if memory is None and drive.size:
            rows[0] = held[:] = drive[0] - self.reference
            start = 1
        later = decay if len(decay) == 1 else np.ascontiguousarray(decay[start:])
        kernel.CHOSEN.memory_run(self.reference, held, drive[start:], rows[start:], later)
        return rows, tuple(held.tolist())
