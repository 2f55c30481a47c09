"""A Qudi hardware module: set points are positions, ``dbo`` finds the volts.

Put this file and ``piezo_axis.py`` where Qudi finds hardware (``qudi/hardware/dbo/``),
and configure::

    hardware:
        stage:
            module.Class: 'dbo.dbo_positioner.DboPositioner'
            options:
                model: '/path/to/model.json'
                v_max: 100.0

``volts_written`` is to hand the volts to your amplifier.
"""

from __future__ import annotations

from piezo_axis import PiezoAxis
from qudi.core.configoption import ConfigOption
from qudi.interface.process_control_interface import (
    ProcessControlConstraints,
    ProcessSetpointInterface,
)

CHANNEL = "position"


class DboPositioner(ProcessSetpointInterface):
    """One actuator behind a model of ``dbo identify``."""

    _model = ConfigOption("model", missing="error")
    _rate = ConfigOption("sample_rate", 500.0)
    _speed = ConfigOption("speed", 20.0)
    _v_min = ConfigOption("v_min", 0.0)
    _v_max = ConfigOption("v_max", 100.0)

    def on_activate(self):
        """Read the model and begin at the lower end."""
        limits = {"v_min": self._v_min, "v_max": self._v_max}
        self._axis = PiezoAxis(
            self._model, self.volts_written, self._rate, self._speed, **limits
        )
        self._axis.run()

    def on_deactivate(self):
        """Go back to rest."""
        self._axis.close()

    def volts_written(self, volts: float) -> None:
        """Hand volts to the amplifier: yours goes here."""
        self.last_volts = volts

    @property
    def constraints(self) -> ProcessControlConstraints:
        """One channel, in the model's unit, from end to end."""
        axis = self._axis
        return ProcessControlConstraints(
            [CHANNEL],
            units={CHANNEL: axis.unit},
            limits={CHANNEL: (axis.low, axis.high)},
        )

    def set_activity_state(self, channel: str, active: bool) -> None:
        """Keep the channel active: creep goes on at rest."""
        if not active:
            raise ValueError("the actuator is driven until the module is deactivated")

    def get_activity_state(self, channel: str) -> bool:
        """Return whether samples are written."""
        return self._axis.failure is None

    def set_setpoint(self, channel: str, value: float) -> None:
        """Go to a position."""
        self._axis.move(value)

    def get_setpoint(self, channel: str) -> float:
        """Return where the actuator is to be."""
        return self._axis.target
