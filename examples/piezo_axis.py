"""One actuator that is asked for positions: what the adapters beside this file have in common.

The model is driven at an even rate, moving or not, since creep goes on at rest. ``run``
does so in a thread whose clock is the computer's: good for positioning, not for
waveforms (``dbo compensate`` writes these).
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import dbo_cli as dbo


class PiezoAxis:
    """Positions in, volts out.

    Parameters
    ----------
    model_file : str
        A model without dynamics; one with a delay moves later by that delay.
    write : callable
        Takes the volts of the model's logs and returns when the hardware has them.
    sample_rate, speed : float
        Samples a second; the fastest move, in the model's unit a second.
    **limits
        ``v_min``, ``v_max``, ``max_slew``, ``from_`` as in ``Model.controller``.
    """

    def __init__(
        self,
        model_file: str,
        write: Callable[[float], object],
        sample_rate: float = 500.0,
        speed: float = 20.0,
        **limits: float | None,
    ) -> None:
        model = dbo.read_model(model_file)
        self.low, self.high, self.unit = (
            model.output.minimum,
            model.output.maximum,
            model.output.unit or "",
        )
        self._live = model.controller(sample_rate, ahead=True, **limits)
        self._write, self._period, self._step = (
            write,
            1.0 / sample_rate,
            speed / sample_rate,
        )
        self.position = self.target = self.low
        self._ended = threading.Event()
        self._thread: threading.Thread | None = None
        self.failure: BaseException | None = None

    @property
    def arrived(self) -> bool:
        """Whether the position that was asked for is the target."""
        return self.position == self.target

    def move(self, target: float) -> None:
        """Go to a position; ValueError outside what the actuator reaches."""
        if not self.low <= target <= self.high:
            raise ValueError(
                f"{target:g} is outside {self.low:g} to {self.high:g} {self.unit}"
            )
        self.target = target

    def stop(self) -> None:
        """Stay where the actuator is."""
        self.target = self.position

    def tick(self) -> None:
        """Take one sample on the way to the target: plan, write, commit."""
        way = self.target - self.position
        position = (
            self.target
            if abs(way) <= self._step
            else self.position + (self._step if way > 0.0 else -self._step)
        )
        volts = self._live.plan(position)
        self._write(volts)
        self._live.commit()  # not before the hardware has it
        self.position = position

    def run(self) -> None:
        """Take samples in a thread until ``close``."""
        self._thread = threading.Thread(target=self._samples, daemon=True)
        self._thread.start()

    def _samples(self) -> None:
        due = time.monotonic()
        try:
            while not self._ended.wait(max(0.0, due - time.monotonic())):
                self.tick()
                due += self._period
        except BaseException as failure:
            self.failure = failure  # nothing further is written

    def close(self) -> None:
        """End the thread and go back to rest, by a ramp."""
        self._ended.set()
        if self._thread is not None:
            self._thread.join()
        if self.failure is None and self._live.state is not None:
            for volts in self._live.close():
                self._write(volts)
                if self._thread is not None:
                    time.sleep(self._period)
