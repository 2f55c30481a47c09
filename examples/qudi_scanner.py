"""A Qudi scanner: confocal scans and cursor moves whose voltages ``dbo`` finds.

``NiScanningProbeInterfuse`` turns positions into volts by a straight line.
``DboScanningProbe`` is the same module with the models of the axes in the line's place.
Put this file where Qudi finds hardware (``qudi/hardware/dbo/qudi_scanner.py``), and
give the scanner's section another class and a few more options::

    hardware:
        ni_scanner:
            module.Class: 'dbo.qudi_scanner.DboScanningProbe'
            connect:
                scan_hardware: 'ni_finite_sampling_io'
                analog_output: 'ni_ao'
            options:
                ...                             # as for NiScanningProbeInterfuse
                models:                         # of dbo identify, one for each axis;
                    x: '/path/to/x.json'        # or one file, a set whose channels are called like the axes
                    y: '/path/to/y.json'
                gains: {x: 20, y: 20}           # V behind the amplifier for 1 V of the card; 1
                limits: {x: [0, 75]}            # V behind the amplifier, cuts the range that was identified
                max_slew: {x: 2000}             # V/s behind the amplifier; none
                start: {x: empty}               # before the first move: auto, empty, full or settled; auto
                way_back: True                  # see below; False

Positions are the displacements that the models know, in metres, so that
``position_ranges`` lie within what the models reach. A frame is computed when the
cursor stands on its first pixel, from the state of that moment: all that was played
before counts. Where the actuators rest, their creep is followed by the clock.

After a frame Qudi's card goes from the last row to its old set point, where the frame
began, in one step. With ``way_back`` the slow axis walks back during the fast axis'
last return line instead; the back scan of that line is then taken on the way.
"""

from __future__ import annotations

import time

import numpy as np
from PySide6 import QtCore
from qudi.core.configoption import ConfigOption
from qudi.hardware.interfuse.ni_scanning_probe_interfuse import NiScanningProbeInterfuse

import dbo_cli as dbo

METRES = {"m": 1.0, "mm": 1e-3, "um": 1e-6, "µm": 1e-6, "nm": 1e-9}
CURSOR_RATE = 1000.0  # Hz: in steps of this clock the cursor's moves are planned
REST = 0.1  # s between two steps of the cursor after which the actuator has rested
LAGS = 0.05  # s after a jump, by when lags and delays are over
TINY = 1e-9  # V: a set point that differs by no more is the one that was written


class ModelledAxis:
    """One actuator: where it is, the voltage that it stands at, and the state of its model.

    Displacements are in the model's unit, voltages those behind the amplifier, times
    seconds of one clock.
    """

    def __init__(self, model, start, **limits):
        self.model = model
        self.start = start
        self.limits = limits
        self.position = None
        self.volts = None
        self._state = None
        self._time = None
        self._live = None
        self._frame = None

    def stand(self, volts, now):
        """Go on from a voltage that stands there, whoever wrote it."""
        state = self.start
        times = []
        if self._state is not None:
            state = self._state if self._live is None else self._live.state
            now = max(now, self._time + 1.0 / CURSOR_RATE)
        if self._live is not None:
            # A controller's state does not know the time: the last voltage stands from
            # then on.
            times = [self._time]
        times.append(now)
        if volts != self.volts:
            # The cursor is not to make up for the lag behind a jump that it did not ask
            # for.
            now += LAGS
            times.append(now)
        displacement, self._state = self.model.simulate(
            [volts] * len(times), time=times, state=state, return_state=True
        )
        self._live = None
        self.position = float(displacement[-1])
        self.volts = volts
        self._time = now

    def move(self, position, now):
        """Go to a position at once: a step of the cursor; returns the voltage."""
        if self._live is None or now - self._time > REST:
            self.stand(self.volts, now)
            self._live = self.model.controller(
                CURSOR_RATE, state=self._state, lookahead="auto", **self.limits
            )
            ticks = 1
        else:
            ticks = max(1, round((now - self._time) * CURSOR_RATE))
        for target in np.linspace(self.position, position, ticks + 1)[1:]:
            self.volts = self._live.plan(float(target))
            self._live.commit()
        self.position = position
        self._time = now
        return self.volts

    def try_frame(self, positions, rate):
        """Return the voltages of a frame from a start of its own, to see whether it can be played."""
        return self._computed(positions, rate, 0.0, "auto")[0]

    def frame(self, positions, rate, now):
        """Return the voltages of a frame that begins now; ``played`` says how much of it was."""
        self.stand(self.volts, now)
        volts, times = self._computed(positions, rate, self._time, self._state)
        self._frame = positions, volts, times
        return volts

    def _computed(self, positions, rate, begin, state):
        """Return the voltages of a frame whose first row comes a sample after ``begin``, and its times."""
        # The last position is held, for a delay to be undone up to the frame's end.
        ahead = self.model.controller(rate, lookahead="auto", **self.limits).lookahead
        held = np.concatenate([positions, np.full(ahead, positions[-1])])
        times = begin + np.arange(1, len(held) + 1) / rate
        count = len(positions)
        done = self.model.compensate(
            held,
            time=times,
            rows=f"1:{count}",
            state=state,
            details=True,
            **self.limits,
        )
        return done.values, times[:count]

    def played(self, rows):
        """Go on from where a frame has ended, after so many of its rows."""
        positions, volts, times = self._frame
        self._frame = None
        if rows == 0:
            return
        _, self._state = self.model.simulate(
            volts[:rows], time=times[:rows], state=self._state, return_state=True
        )
        self.position = float(positions[rows - 1])
        self.volts = float(volts[rows - 1])
        self._time = float(times[rows - 1])


class DboScanningProbe(NiScanningProbeInterfuse):
    """Qudi's scanner on NI cards with models of ``dbo identify`` in the place of a straight line."""

    _model_files = ConfigOption("models", missing="error")
    _gains = ConfigOption("gains", {})
    _limits = ConfigOption("limits", {})
    _max_slew = ConfigOption("max_slew", {})
    _start = ConfigOption("start", {})
    _way_back = ConfigOption("way_back", False)

    def on_activate(self):
        """Read the models, and begin where the card's outputs stand."""
        self._metres = {}
        self._drives = {}
        self._written = {}  # by channel of the card: what the cursor wrote last
        self._planned = {}  # by axis: volts of the card for the cursor's next step
        self._coords = None  # of the frame that is configured, in metres
        self._frame_runs = False
        models = self._models_of_axes()
        for axis in sorted(self._position_ranges):
            self._drives[axis] = self._modelled(axis, models[axis])
        super().on_activate()

    def _models_of_axes(self):
        self._coupling = None
        if not isinstance(self._model_files, str):
            return {
                axis: dbo.read_model(self._model_files[axis])
                for axis in self._position_ranges
            }
        models = dbo.read_model(self._model_files)
        missing = set(self._position_ranges) - set(models)
        if missing:
            raise ValueError(
                f"{self._model_files} has no model of {', '.join(sorted(missing))}"
            )
        if models.coupling is not None:
            self._coupling = models.coupling.of(sorted(self._position_ranges))
        return models

    def _modelled(self, axis, model):
        """Return what drives an axis, within its amplifier's limits and the card's."""
        channel = self._ni_channel_mapping[axis]
        gain = self._gain(axis)
        card = self._ni_finite_sampling_io().constraints.output_channel_limits[channel]
        low, high = sorted(gain * volts for volts in card)
        allowed = self._limits.get(axis, (low, high))
        unit = model.output.unit
        if unit not in METRES:
            raise ValueError(
                f"axis {axis}: its model is in '{unit}', which is no length that is known here"
            )
        self._metres[axis] = METRES[unit]
        reach = [
            METRES[unit] * model.output.minimum,
            METRES[unit] * model.output.maximum,
        ]
        asked = self._position_ranges[axis]
        if self._coupling is None and not reach[0] <= asked[0] <= asked[1] <= reach[1]:
            raise ValueError(
                f"axis {axis}: position_ranges ask for {asked[0]:g} to {asked[1]:g} m, and its model reaches "
                f"{reach[0]:g} to {reach[1]:g} m"
            )
        return ModelledAxis(
            model,
            self._start.get(axis, "auto"),
            v_min=max(low, allowed[0]),
            v_max=min(high, allowed[1]),
            max_slew=self._max_slew.get(axis),
        )

    def _gain(self, axis):
        return self._gains.get(axis, 1.0)

    def _displacements(self, coords):
        """Return what each actuator is to do alone, by axis, in its model's unit."""
        axes = sorted(self._drives)
        together = np.column_stack(
            [np.atleast_1d(coords[axis]) / self._metres[axis] for axis in axes]
        )
        alone = together if self._coupling is None else self._coupling.apart(together)
        return dict(zip(axes, alone.T, strict=True))

    def _positions(self):
        """Return where the axes are, in metres."""
        axes = sorted(self._drives)
        alone = np.array([self._drives[axis].position for axis in axes])
        together = alone if self._coupling is None else self._coupling.together(alone)
        return {
            axis: float(x * self._metres[axis])
            for axis, x in zip(axes, together, strict=True)
        }

    # --- the cursor: the interfuse asks for a position, then for each axis' voltage ---

    def _voltage_dict_to_position_dict(self, voltages):
        """Return the positions; where the card's outputs are not what was written, go on from there."""
        now = time.monotonic()
        for axis, drive in self._drives.items():
            channel = self._ni_channel_mapping[axis]
            card = voltages[channel]
            if abs(card - self._written.get(channel, np.inf)) > TINY:
                drive.stand(card * self._gain(axis), now)
                self._written[channel] = card
        return self._positions()

    def _pos_vec_to_dict(self, position_vec):
        """Plan the cursor's next step, of all axes at once."""
        position = super()._pos_vec_to_dict(position_vec)
        now = time.monotonic()
        for axis, displacement in self._displacements(position).items():
            volts = self._drives[axis].move(float(displacement[0]), now)
            self._planned[axis] = volts / self._gain(axis)
        return position

    def _position_to_voltage(self, axis, positions):
        """Return the voltage of the cursor's next step."""
        card = self._planned[axis]
        self._written[self._ni_channel_mapping[axis]] = card
        return card

    # --- frames ---

    def _get_scan_lines(self, settings, back_settings):
        """Return the lines of a scan, with the way back if it is wanted."""
        coords = super()._get_scan_lines(settings, back_settings)
        if self._way_back and settings.scan_dimension == 2:
            slow = coords[settings.axes[1]]
            count = back_settings.resolution[0]
            slow[-count:] = np.linspace(slow[-1], slow[0], count)
        return coords

    def _init_ni_scan_arrays(self, settings, back_settings):
        """Return the volts of a frame from a start of its own; ValueError if it is out of reach.

        What is played is computed once more when the cursor stands on the first pixel.
        """
        coords = self._init_scan_grid(settings, back_settings)
        self._check_scan_grid(coords)
        try:
            volts = {
                self._ni_channel_mapping[axis]: self._drives[axis].try_frame(
                    displacement, settings.frequency
                )
                / self._gain(axis)
                for axis, displacement in self._displacements(coords).items()
            }
        except dbo.LimitError as problem:
            raise ValueError(str(problem)) from problem
        self._coords = coords
        return volts

    def _start_hw_timed_scan(self):
        """Compute the frame from where the actuators are now, and start it."""
        card = self._ni_finite_sampling_io()
        now = time.monotonic()
        frame = {}
        try:
            for axis, displacement in self._displacements(self._coords).items():
                volts = self._drives[axis].frame(displacement, card.sample_rate, now)
                frame[self._ni_channel_mapping[axis]] = volts / self._gain(axis)
            card.set_frame_data(frame)
        except (dbo.DboError, ValueError) as problem:
            self.log.error(f"Could not start frame: {problem}")
            self._start_scan_after_cursor = False
            self.module_state.unlock()
            return
        self._frame_runs = True
        super()._start_hw_timed_scan()

    # Qt finds slots in the class itself only.
    @QtCore.Slot()
    def _start_scan(self):
        super()._start_scan()

    @QtCore.Slot()
    def _stop_scan(self):
        if self._frame_runs:
            self._frame_runs = False
            rows = int(self.raw_data_container.number_of_non_nan_values)
            for drive in self._drives.values():
                drive.played(rows)
            # The card writes its old set points when the cursor goes on.
            self._written.clear()
        super()._stop_scan()
