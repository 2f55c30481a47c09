"""Relaxation beside the gears (beyond the paper): lag and creep, sum_j gain_j L_j.

Negative gains must leave enough of the slopes.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from dbo_cli.arrays import Floats
from dbo_cli.errors import InputError, ModelError
from dbo_cli.model import kernel
from dbo_cli.model.fields import Keyed, above_0, listed, number, number_list


def checked_steps(dt: float | ArrayLike) -> Floats:
    """Return time steps (s) as an array; InputError where one is negative or not a number."""
    steps = np.asarray(dt, dtype=np.float64).reshape(-1)
    right = steps >= 0.0
    if right.all():
        return steps
    row = int(np.argmin(right))
    raise InputError(
        f"time step {row + 1}: {float(steps[row])!r} s; time must not go backwards"
    )


@dataclass(frozen=True)
class Relaxation(Keyed):
    """Lag and creep beside the gears: sum_j gain_j L_j, each L_j a first-order lag of the voltage.

    L_j,k = a_j L_j,k-1 + (1 - a_j)(v_k - reference), a_j = exp(-dt_k/tau_j). Beyond the
    paper.

    Attributes
    ----------
    reference : float
        Voltage at which nothing is remembered.
    tau : tuple of float
        Time constants in seconds, > 0.
    gain : tuple of float
        Output per volt, one for each time constant; may be negative (``Gears`` checks how
        much the slopes of the gears allow).
    """

    reference: float
    tau: tuple[float, ...]
    gain: tuple[float, ...]
    KEYS: ClassVar = {
        "reference": number,
        "tau": partial(listed, read=above_0),
        "gain": number_list,
    }

    def __post_init__(self) -> None:
        """Refuse what no actuator has, naming the key."""
        if not 0 < len(self.tau) == len(self.gain):
            raise ModelError(
                f"gain: has {len(self.gain)} entries where tau has {len(self.tau)}, and 1 is the least"
            )

    def decay(self, dt: float | ArrayLike) -> Floats:
        """Return a_j = exp(-dt/tau_j) as rows: one for a single time step (s), else one a sample.

        Raises
        ------
        InputError
            A time step is negative or not a number.
        """
        return (
            _even_decay(self.tau, dt) if isinstance(dt, float) else _decay(self.tau, dt)
        )

    def lags(
        self,
        voltage: ArrayLike,
        dt: float | ArrayLike,
        memory: Sequence[float] | None = None,
    ) -> tuple[Floats, tuple[float, ...]]:
        """Return L_j after each sample (rows x terms), and after the last.

        Without ``memory`` the actuator rests at the first sample.
        """
        drive = np.ascontiguousarray(voltage, dtype=np.float64)
        memories = np.array(memory or np.zeros(len(self.tau)), dtype=np.float64)
        rows = np.empty((drive.size, len(self.tau)))
        kernel.extension.memory_run(
            self.reference, memories, memory is None, drive, rows, self.decay(dt)
        )
        return rows, tuple(memories.tolist())


def _decay(tau: tuple[float, ...], dt: float | ArrayLike) -> Floats:
    factors: Floats = np.exp(-checked_steps(dt)[:, np.newaxis] / np.array(tau))
    factors.flags.writeable = False
    return factors


# of one time step; every block of a stream asks for it
_even_decay = lru_cache(maxsize=32)(_decay)
