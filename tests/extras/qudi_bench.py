"""What the test of ``examples/qudi_scanner.py`` puts into Qudi: cards that remember what they played.

Called as ``python qudi_bench.py CONFIG RESULT`` it starts Qudi, moves the cursor,
scans, and writes what the cards played.
"""

from __future__ import annotations

import json
import sys
import time

from qudi.hardware.dummy.finite_sampling_io_dummy import FiniteSamplingIODummy
from qudi.hardware.dummy.process_control_dummy import ProcessSetpointDummy

PATIENCE = 120.0  # s
BEGUN = 0.3  # s, by when what was asked for has begun


class RememberingOutput(ProcessSetpointDummy):
    """Set points as Qudi's module for NI cards has them: a channel that becomes active writes its old one."""

    def on_activate(self):
        super().on_activate()
        self.events = []

    def set_activity_state(self, channel, active):
        if active and not self._activity_states[channel]:
            self.events.append((time.monotonic(), channel, self._setpoints[channel]))
        self._activity_states[channel] = bool(active)
        self._update_module_state()

    def set_setpoint(self, channel, value):
        super().set_setpoint(channel, value)
        self.events.append((time.monotonic(), channel, float(value)))


class RememberingFrames(FiniteSamplingIODummy):
    """Frames of a card, with the time at which each began."""

    def on_activate(self):
        super().on_activate()
        self.frames = []
        self._data = None

    @property
    def is_running(self):
        """The interfuse asks for it, and Qudi's dummy does not have it."""
        return self.module_state() == "locked"

    def set_frame_data(self, data):
        super().set_frame_data(data)
        self._data = data

    def get_buffered_samples(self, number_of_samples=None):
        try:
            return super().get_buffered_samples(number_of_samples)
        except AssertionError as problem:
            # what the module for real cards raises
            raise ValueError(str(problem)) from problem

    def start_buffered_frame(self):
        super().start_buffered_frame()
        volts = {
            channel: list(map(float, values)) for channel, values in self._data.items()
        }
        self.frames.append(
            {"begin": time.monotonic(), "rate": self.sample_rate, "volts": volts}
        )


def wait_until(condition, application):
    """Let Qudi work until something is so, and for a while at least: a move begins with the next tick."""
    begin = time.monotonic()
    end = begin + PATIENCE
    while time.monotonic() < begin + BEGUN or not condition():
        if time.monotonic() > end:
            raise TimeoutError("Qudi did not get there")
        application.processEvents()
        time.sleep(0.005)


def scan(manager, application, plan):
    """Move the cursor, scan by Qudi's own logic, and return what was played."""
    manager.activate_module("scanning_probe_logic")
    logic = manager["scanning_probe_logic"].instance
    scanner = manager["ni_scanner"].instance
    for target in plan["cursor"]:
        logic.set_target_position(target, move_blocking=False)
        wait_until(lambda: not scanner.is_move_running, application)
    cursor = scanner.get_position()
    for axis, asked in plan["axes"].items():
        logic.set_scan_range(axis, asked["range"])
        logic.set_scan_resolution(axis, asked["pixels"])
        logic.set_scan_frequency(axis, plan["rate"])
    logic.start_scan(tuple(plan["axes"]))
    wait_until(lambda: logic.module_state() == "idle", application)
    wait_until(lambda: not scanner.is_move_running, application)
    data = logic.scan_data
    return {
        "cursor": cursor,
        "image": [
            None if data is None else list(channel.shape)
            for channel in data.data.values()
        ],
        "events": manager["ni_ao"].instance.events,
        "frames": manager["ni_finite_sampling_io"].instance.frames,
        "after": scanner.get_position(),
    }


def main():
    """Run Qudi with a configuration; what was played goes into a file."""
    from PySide6 import QtCore
    from qudi.core.application import Qudi

    config, result = sys.argv[1:3]
    with open(config + ".json") as file:
        plan = json.load(file)
    application = QtCore.QCoreApplication(sys.argv[:1])
    qudi = Qudi(no_gui=True, config_file=config)

    def drive():
        try:
            played = scan(qudi.module_manager, application, plan)
        except Exception as problem:
            played = {"failed": f"{type(problem).__name__}: {problem}"}
        with open(result, "w") as file:
            json.dump(played, file)
        qudi.quit()

    QtCore.QTimer.singleShot(0, drive)
    qudi.run()


if __name__ == "__main__":
    main()
