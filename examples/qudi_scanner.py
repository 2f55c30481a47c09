"""A Qudi scanner: confocal scans and cursor moves whose voltages ``dbo`` finds.

``NiScanningProbeInterfuse`` turns positions into volts by a straight line. This is that
module with the models of the axes in the line's place. Put the file where Qudi finds
hardware (``qudi/hardware/dbo/qudi_scanner.py``), and give the scanner's section another
class and some more options::

    module.Class: 'dbo.qudi_scanner.DboScanningProbe'
    options:
        ...                                   # as for NiScanningProbeInterfuse
        models: {x: '/path/to/x.json', y: '/path/to/y.json'}
        gains: {x: 20, y: 20}                 # V behind the amplifier for 1 V of the card
        limits: {x: {v_max: 75, max_slew: 2000}}     # behind the amplifier; else the identified range

``position_ranges`` are displacements of the models, in metres. Every frame, and every
cursor move after one, begins as if the actuator had settled there: what was before is
not carried over.
"""

from __future__ import annotations

import numpy as np
from PySide6 import QtCore
from qudi.core.configoption import ConfigOption
from qudi.hardware.interfuse.ni_scanning_probe_interfuse import NiScanningProbeInterfuse

import dbo_cli as dbo

METRES = {"m": 1.0, "mm": 1e-3, "um": 1e-6, "nm": 1e-9}
CURSOR_RATE = 1000.0  # Hz: the cursor's steps count as so many a second
SAME = 1e-6  # V: so near a set point is the one that was written


class DboScanningProbe(NiScanningProbeInterfuse):
    """Qudi's scanner on NI cards with models of ``dbo identify``."""

    _model_files = ConfigOption("models", missing="error")
    _gains = ConfigOption("gains", {})
    _limits = ConfigOption("limits", {})

    def on_activate(self):
        """Read the models, and begin where the card's outputs stand."""
        self._models = {}
        for axis in self._position_ranges:
            self._models[axis] = dbo.read_model(self._model_files[axis])
        self._live = {}
        self._positions = {}  # m, by axis
        super().on_activate()

    def _gain(self, axis):
        return self._gains.get(axis, 1.0)

    def _metres(self, axis):
        return METRES[self._models[axis].output.unit]

    def _voltage_dict_to_position_dict(self, voltages):
        """Return the positions; where the card stands elsewhere than it was sent, go on from there."""
        for axis, model in self._models.items():
            volts = voltages[self._ni_channel_mapping[axis]] * self._gain(axis)
            live = self._live.get(axis)
            if live is None or abs(live.last - volts) > SAME:
                self._live[axis] = model.controller(
                    CURSOR_RATE,
                    from_=volts,
                    lookahead="auto",
                    **self._limits.get(axis, {}),
                )
                moved = model.simulate([volts], sample_rate=CURSOR_RATE)
                self._positions[axis] = float(moved[0]) * self._metres(axis)
        return dict(self._positions)

    def _position_to_voltage(self, axis, positions):
        """Return the voltage of the card for the cursor's next step."""
        self._positions[axis] = float(np.squeeze(positions))
        volts = self._live[axis].step(self._positions[axis] / self._metres(axis))
        return volts / self._gain(axis)

    def _init_ni_scan_arrays(self, settings, back_settings):
        """Return the voltages of a frame; ValueError if it is out of reach."""
        coords = self._init_scan_grid(settings, back_settings)
        self._check_scan_grid(coords)
        frame = {}
        for axis, positions in coords.items():
            try:
                volts = self._models[axis].compensate(
                    positions / self._metres(axis),
                    sample_rate=settings.frequency,
                    **self._limits.get(axis, {}),
                )
            except dbo.LimitError as problem:
                raise ValueError(f"axis {axis}: {problem}") from problem
            frame[self._ni_channel_mapping[axis]] = volts / self._gain(axis)
        return frame

    @QtCore.Slot()  # Qt finds slots in the class itself only
    def _stop_scan(self):
        """End a frame; the cursor begins anew behind it."""
        self._live.clear()
        super()._stop_scan()
