"""A PyMoDAQ actuator: positions are asked for, ``dbo`` finds the volts.

Copy this file into the folder ``daq_move_plugins`` of a plug-in package, and let
``write`` hand the volts to your amplifier. A move is a ramp at the computer's clock.
"""

from __future__ import annotations

import time

import numpy as np
from pymodaq.control_modules.move_utility_classes import (
    DAQ_Move_base,
    DataActuatorType,
    comon_parameters_fun,
)
from pymodaq.utils.data import DataActuator

import dbo_cli as dbo

RATE = 200.0  # Hz


class DAQ_Move_Dbo(DAQ_Move_base):
    """One actuator behind a model of ``dbo identify`` without dynamics."""

    _controller_units = "um"
    _epsilon = 1e-3
    data_actuator_type = DataActuatorType.DataActuator
    params = [  # noqa: RUF012  (the library reads it so)
        {"title": "Model file:", "name": "model", "type": "str", "value": "model.json"},
        {"title": "Speed (units/s):", "name": "speed", "type": "float", "value": 20.0},
        {"title": "Lowest drive:", "name": "v_min", "type": "float", "value": 0.0},
        {"title": "Highest drive:", "name": "v_max", "type": "float", "value": 100.0},
        *comon_parameters_fun(epsilon=_epsilon),
    ]

    def write(self, volts):
        """Hand volts to the amplifier: yours goes here."""
        self.last_volts = volts

    def ini_attributes(self):
        """Declare what ``ini_stage`` makes."""
        self.controller = None

    def ini_stage(self, controller=None):
        """Read the model and go to the lower end; returns a text and whether it went well."""
        model = dbo.read_model(self.settings["model"])
        low, high = self.settings["v_min"], self.settings["v_max"]
        self.controller = controller or model.controller(
            RATE, v_min=low, v_max=high, lookahead="auto"
        )
        self.axis_unit = model.output.unit
        self.low, self.high = model.output.min, model.output.max
        self.position = self.low
        self.go([self.position])
        return f"{self.low:g} to {self.high:g} {self.axis_unit}", True

    def go(self, positions):
        """Take a sample for each position: plan, write, commit."""
        for position in positions:
            self.write(self.controller.plan(position))
            self.controller.commit()  # not before the hardware has it
            self.position = position
            time.sleep(1.0 / RATE)

    def get_actuator_value(self):
        """Return where the actuator is by the model."""
        value = DataActuator(data=self.position, units=self.axis_unit)
        return self.get_position_with_scaling(value)

    def move_abs(self, value):
        """Go to a position by a ramp."""
        self.target_value = self.check_bound(value)
        target = self.set_position_with_scaling(self.target_value).value(self.axis_unit)
        if not self.low <= target <= self.high:
            raise ValueError(f"{target:g} is outside {self.low:g} to {self.high:g}")
        seconds = abs(target - self.position) / self.settings["speed"]
        ramp = np.linspace(self.position, target, 2 + round(seconds * RATE))[1:]
        rest = [target] * self.controller.lookahead  # a delay comes to its end
        self.go([*ramp.tolist(), *rest])

    def move_rel(self, value):
        """Go some way."""
        self.move_abs(self.current_value + value)

    def move_home(self, value=None):
        """Go to the lower end."""
        self.move_abs(DataActuator(data=self.low, units=self.axis_unit))

    def stop_motion(self):
        """Stay; a ramp that has begun is finished first."""
        self.move_done()

    def commit_settings(self, param):
        """Take nothing from a changed setting: all are read by ``ini_stage``."""

    def close(self):
        """Leave the volts as they are."""
