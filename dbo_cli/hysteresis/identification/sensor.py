"""The sensor is not the actuator: its own delay and lag, where they are known, are taken off the log.

A log cannot tell a sensor that is late from an actuator that is; only the latter is to be compensated.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dbo_cli.errors import UsageError
from dbo_cli.hysteresis.identification.recordings import FEWEST_ROWS, Floats, Recording

EVEN = 1e-3  # of a sample: a clock written with few digits still counts as even
LARGEST_PART_OF_CYCLE = 0.25  # a sensor later than that shows nothing of what the actuator does


@dataclass(frozen=True)
class Sensor:
    """Delay and first-order lag of the sensor, in seconds."""

    delay: float = 0.0
    lag: float = 0.0

    def __bool__(self) -> bool:
        """Whether there is anything to take off."""
        return self.delay > 0.0 or self.lag > 0.0

    def check(self, cycle: float | None) -> None:
        """Raise UsageError where the figures are not a sensor's; ``cycle`` is the logs' in seconds."""
        if not self:
            return
        if cycle is None:
            raise UsageError(
                "`sensor_delay` and `sensor_lag` need a clock: name the time column (`time`) or give "
                "`sample_rate`"
            )
        for value, name in ((self.delay, "sensor_delay"), (self.lag, "sensor_lag")):
            if value > LARGEST_PART_OF_CYCLE * cycle:
                raise UsageError(
                    f"`{name}` {value:g} s is more than a quarter of a cycle of the logs ({cycle:.3g} s): "
                    "give it in seconds, or record more slowly"
                )

    def taken_off(self, recording: Recording) -> Recording:
        """Return the recording as a sensor without delay and lag would have made it.

        The last rows, for which the sensor answers only after the log's end, are cut off.
        """
        seconds = recording.seconds()
        if not self or seconds is None:
            return recording
        known = int(np.searchsorted(seconds, seconds[-1] - self.delay, side="right"))
        known = max(known, min(FEWEST_ROWS, len(seconds)))
        ordered = np.maximum.accumulate(seconds)
        displacement = recording.displacement
        if self.lag > 0.0:
            displacement = displacement + self.lag * slope(displacement, ordered, self.lag)
        if self.delay > 0.0:
            displacement = np.interp(ordered + self.delay, ordered, displacement)
        return replace(
            recording,
            voltage=recording.voltage[:known],
            displacement=displacement[:known],
            time=None if recording.time is None else recording.time[:known],
        )


def slope(values: Floats, seconds: Floats, width: float) -> Floats:
    """Rate of change of noisy values, from cubics fitted over ``width`` seconds to either side.

    A difference of neighbours would multiply the noise by the lag over the sample period.
    """
    from scipy.signal import savgol_filter

    steps = np.diff(seconds)
    step = float(np.median(steps[steps > 0.0]))
    if float(np.abs(steps - step).max()) > EVEN * step:
        even = np.linspace(seconds[0], seconds[-1], max(round((seconds[-1] - seconds[0]) / step) + 1, 5))
        filled = slope(np.interp(even, seconds, values), even, width)
        spread: Floats = np.interp(seconds, even, filled)
        return spread
    half = min(max(round(width / step), 2), (len(values) - 1) // 2)
    found: Floats = savgol_filter(values, 2 * half + 1, min(3, 2 * half), deriv=1, delta=step)
    return found
