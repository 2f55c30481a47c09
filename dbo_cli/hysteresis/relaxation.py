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

_REPEATED = 4
"""So many samples a step repeating rows takes less than computing them (measured with five terms)."""


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

        Steps that are all the same come as one row, too. A step that repeats the one before repeats its row;
        the bits are those of the exponential function all the same.

        Raises
        ------
        InputError
            A time step is negative or not a number.
        """
        steps = np.asarray(time_step, dtype=np.float64).reshape(-1, 1)
        if not np.all(steps >= 0.0):
            k = int(np.flatnonzero(~(steps[:, 0] >= 0.0))[0])
            raise InputError(f"time step {k + 1}: {float(steps[k, 0])!r} s; time must not go backwards")
        starts = np.concatenate([[0], np.flatnonzero(steps[1:] != steps[:-1]) + 1])
        if starts.size > steps.size // _REPEATED:
            factors: Floats = np.exp(-steps / np.array(self.tau))
            return factors
        factors = np.exp(-steps[starts] / np.array(self.tau))
        lengths = np.diff(starts, append=steps.size)
        return factors if starts.size == 1 else np.repeat(factors, lengths, axis=0)

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
