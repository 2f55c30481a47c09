"""A PyMoDAQ actuator: positions are asked for, ``dbo`` finds the volts.

Copy this file and ``piezo_axis.py`` into the folder ``daq_move_plugins`` of a plug-in
package, and let ``volts_written`` hand the volts to your amplifier.
"""

from __future__ import annotations

from piezo_axis import PiezoAxis
from pymodaq.control_modules.move_utility_classes import (
    DAQ_Move_base,
    DataActuatorType,
    comon_parameters_fun,
)
from pymodaq.utils.data import DataActuator


class DAQ_Move_Dbo(DAQ_Move_base):
    """One actuator behind a model of ``dbo identify``."""

    _controller_units = "um"
    _epsilon = 1e-3
    data_actuator_type = DataActuatorType.DataActuator
    params = [  # noqa: RUF012  (the library reads it so)
        {
            "title": "Model file:",
            "name": "model",
            "type": "browsepath",
            "value": "model.json",
        },
        {"title": "Samples a second:", "name": "rate", "type": "float", "value": 500.0},
        {"title": "Speed (units/s):", "name": "speed", "type": "float", "value": 20.0},
        {"title": "Lowest drive (V):", "name": "v_min", "type": "float", "value": 0.0},
        {
            "title": "Highest drive (V):",
            "name": "v_max",
            "type": "float",
            "value": 100.0,
        },
        *comon_parameters_fun(epsilon=_epsilon),
    ]

    def ini_attributes(self):
        """Declare what ``ini_stage`` makes."""
        self.controller: PiezoAxis = None

    def volts_written(self, volts: float) -> None:
        """Hand volts to the amplifier: yours goes here."""
        self.last_volts = volts

    def ini_stage(self, controller=None):
        """Read the model and begin at the lower end; returns a text and whether it went well."""
        names = ("rate", "speed", "v_min", "v_max")
        rate, speed, low, high = (self.settings[name] for name in names)
        if self.is_master:
            self.controller = PiezoAxis(
                str(self.settings["model"]),
                self.volts_written,
                rate,
                speed,
                v_min=low,
                v_max=high,
            )
            self.controller.run()
        else:
            self.controller = controller
        self.axis_unit = self.controller.unit
        return (
            f"{self.controller.low:g} to {self.controller.high:g} {self.controller.unit}",
            True,
        )

    def get_actuator_value(self):
        """Return where the actuator is by the model."""
        if self.controller.failure is not None:
            raise self.controller.failure
        value = DataActuator(data=self.controller.position, units=self.axis_unit)
        return self.get_position_with_scaling(value)

    def move_abs(self, value):
        """Go to a position."""
        self.target_value = self.check_bound(value)
        self.controller.move(
            self.set_position_with_scaling(self.target_value).value(self.axis_unit)
        )

    def move_rel(self, value):
        """Go some way."""
        self.move_abs(self.current_value + value)

    def move_home(self, value=None):
        """Go to the lower end."""
        self.move_abs(DataActuator(data=self.controller.low, units=self.axis_unit))

    def stop_motion(self):
        """Stay where the actuator is."""
        self.controller.stop()
        self.move_done()

    def commit_settings(self, param):
        """Take nothing from a changed setting: all are read by ``ini_stage``."""

    def close(self):
        """Go back to rest."""
        if self.is_master and self.controller is not None:
            self.controller.close()
