"""A running Qudi with dummy cards that moves its cursor and scans by ``qudi_scanner.py``.

    python try_in_qudi.py FOLDER

What the dummy cards played is played on the sample actuator. Exit 1 where more than 100
nm (RMS over the pixels) are left: a straight line leaves some 600. FOLDER gets Qudi's
configuration and its data. The classes are its dummy cards.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from qudi.hardware.dummy.finite_sampling_io_dummy import FiniteSamplingIODummy
from qudi.hardware.dummy.process_control_dummy import ProcessSetpointDummy

AXES = {"x": "ao0", "y": "ao1"}
GAIN, CARD = 20.0, [0.0, 5.0]  # of the amplifiers; V
RATE, PIXELS, LINES, BACK = 1000.0, 100, 20, 50
RANGE = (2e-6, 12e-6)  # m
CURSOR = ({"x": 5e-6, "y": 4e-6}, {"x": 9e-6, "y": 9e-6})
PATIENCE, BEGUN = 120.0, 0.3  # s: for all of a move, and until it has begun
MOST = 100.0  # nm


class Output(ProcessSetpointDummy):
    """Set points that may be switched as those of a card."""

    def set_activity_state(self, channel, active):
        """Switch a channel."""
        self._activity_states[channel] = bool(active)
        self._update_module_state()


class Frames(FiniteSamplingIODummy):
    """Frames of a card that are remembered."""

    frames: list = []  # noqa: RUF012

    @property
    def is_running(self):
        """The interfuse asks for it, and Qudi's dummy does not have it."""
        return self.module_state() == "locked"

    def set_frame_data(self, data):
        """Remember what is to be played."""
        super().set_frame_data(data)
        self._data = data

    def get_buffered_samples(self, number_of_samples=None):
        """Fail as the module of real cards does."""
        try:
            return super().get_buffered_samples(number_of_samples)
        except AssertionError as problem:
            raise ValueError(str(problem)) from problem

    def start_buffered_frame(self):
        """Remember what is played."""
        super().start_buffered_frame()
        self.frames.append(
            {name: list(map(float, v)) for name, v in self._data.items()}
        )


def configuration(folder, reach):
    """Return Qudi's configuration; both axes have one model."""
    scanner = {
        "ni_channel_mapping": {**AXES, "APD1": "pfi8"},
        "position_ranges": {axis: list(reach) for axis in AXES},
        "frequency_ranges": {axis: [1, 5000] for axis in AXES},
        "resolution_ranges": {axis: [1, 10000] for axis in AXES},
        "input_channel_units": {"APD1": "c/s"},
        "models": dict.fromkeys(AXES, str(folder / "stack.json")),
        "gains": dict.fromkeys(AXES, GAIN),
    }
    points = {"unit": "V", "limits": CARD, "dtype": "float"}
    frames = {
        "simulation_mode": "RANDOM",
        "input_channel_units": {"pfi8": "c/s"},
        "input_channel_limits": {"pfi8": [0, 1e8]},
        "output_channel_units": dict.fromkeys(AXES.values(), "V"),
        "output_channel_limits": dict.fromkeys(AXES.values(), CARD),
    }
    modules = {
        "ni_scanner": {
            "module.Class": "dbo.qudi_scanner.DboScanningProbe",
            "connect": {"scan_hardware": "ni_frames", "analog_output": "ni_ao"},
            "options": scanner,
        },
        "ni_ao": {
            "module.Class": "dbo.try_in_qudi.Output",
            "options": {"setpoint_channels": dict.fromkeys(AXES.values(), points)},
        },
        "ni_frames": {"module.Class": "dbo.try_in_qudi.Frames", "options": frames},
    }
    logic = {
        "module.Class": "scanning_probe_logic.ScanningProbeLogic",
        "connect": {"scanner": "ni_scanner"},
    }
    program = {
        "startup_modules": [],
        "extension_paths": [str(folder / "lab")],
        "namespace_server_port": 18873,
        "default_data_dir": str(folder / "data"),
    }
    return {
        "global": program,
        "gui": {},
        "logic": {"logic": logic},
        "hardware": modules,
    }


def scanned(manager, application):
    """Move the cursor, scan by Qudi's own logic, and return what was played."""

    def wait_until(condition):
        begun = time.monotonic()
        while time.monotonic() < begun + BEGUN or not condition():
            if time.monotonic() > begun + PATIENCE:
                raise TimeoutError("Qudi did not get there")
            application.processEvents()
            time.sleep(0.005)

    manager.activate_module("logic")
    logic = manager["logic"].instance
    scanner = manager["ni_scanner"].instance
    for target in CURSOR:
        logic.set_target_position(target, move_blocking=False)
        wait_until(lambda: not scanner.is_move_running)
    cursor = scanner.get_position()
    for axis, count in (("x", PIXELS), ("y", LINES)):
        logic.set_scan_range(axis, RANGE)
        logic.set_scan_resolution(axis, count)
        logic.set_scan_frequency(axis, RATE)
    logic.start_scan(tuple(AXES))
    wait_until(lambda: logic.module_state() == "idle")
    wait_until(lambda: not scanner.is_move_running)
    after = scanner.get_position()
    frames = manager["ni_frames"].instance.frames
    return {"cursor": cursor, "after": after, "frames": frames}


def run(config, result):
    """Run Qudi with a configuration; what was played goes into a file."""
    from PySide6 import QtCore
    from qudi.core.application import Qudi

    application = QtCore.QCoreApplication(sys.argv[:1])
    qudi = Qudi(no_gui=True, config_file=config)

    def drive():
        try:
            played = scanned(qudi.module_manager, application)
        except Exception as problem:
            played = {"failed": f"{type(problem).__name__}: {problem}"}
        Path(result).write_text(json.dumps(played))
        qudi.quit()

    QtCore.QTimer.singleShot(0, drive)
    qudi.run()


def errors(frame):
    """Play a frame on the sample actuator; return the RMS error of each axis over the pixels (nm)."""
    from virtual_actuator import PRESETS, VirtualActuator

    line = np.arange(LINES * (PIXELS + BACK)) % (PIXELS + BACK)
    low, high = 1e6 * RANGE[0], 1e6 * RANGE[1]
    wanted = {
        "x": low + (high - low) * line / (PIXELS - 1),
        "y": np.repeat(np.linspace(low, high, LINES), PIXELS + BACK),
    }
    left = {}
    for axis, channel in AXES.items():
        # The cursor went to the frame's first pixel before, from the lower end.
        first = GAIN * frame[channel][0]
        way = first * (0.5 - 0.5 * np.cos(np.pi * np.arange(500) / 500))
        drive = np.concatenate([way, GAIN * np.array(frame[channel])])
        time_s = np.arange(drive.size) / RATE
        moved = VirtualActuator(PRESETS["stack"]).displacement(time_s, drive)
        error = (moved[way.size :][: line.size] - wanted[axis])[line < PIXELS]
        left[axis] = 1000.0 * float(np.sqrt(np.mean(error**2)))
    return left


def main():
    """Scan in a Qudi of its own, and judge what it played."""
    here = Path(__file__).resolve().parent
    sys.path.insert(0, str(here.parent / "sample_data"))
    import dbo_cli as dbo

    folder = Path(sys.argv[1])
    model = dbo.identify(str(here.parent / "sample_data" / "identification.csv"))
    model.save(folder / "stack.json")
    hardware = folder / "lab" / "qudi" / "hardware" / "dbo"
    hardware.mkdir(parents=True)
    for name in ("qudi_scanner.py", "try_in_qudi.py"):
        shutil.copy(here / name, hardware)
    reach = (1e-6 * model.output.min, 1e-6 * model.output.max)
    config = folder / "lab.cfg"
    config.write_text(json.dumps(configuration(folder, reach)))
    words = [sys.executable, __file__, str(config), str(folder / "played.json")]
    subprocess.run(words, check=True)
    played = json.loads((folder / "played.json").read_text())
    if "failed" in played:
        raise SystemExit(played["failed"])
    for place in ("cursor", "after"):
        away = max(abs(played[place][axis] - CURSOR[-1][axis]) for axis in AXES)
        print(f"{place}: {1e9 * away:.2f} nm off by its own account")
    [frame] = played["frames"]
    left = errors(frame)
    print(f"RMS over the pixels, nm: {left}")
    return int(max(left.values()) > MOST)


if __name__ == "__main__":
    if len(sys.argv) == 3:
        run(*sys.argv[1:])
    else:
        sys.exit(main())
