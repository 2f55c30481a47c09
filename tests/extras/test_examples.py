"""The examples for laboratories, with the real libraries where they are installed."""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import SMALL_MODEL

import dbo_cli as dbo

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "examples"))
import nidaqmx_live
from piezo_axis import PiezoAxis


@pytest.fixture
def model_file(tmp_path: Path) -> str:
    (tmp_path / "model.json").write_text(json.dumps(SMALL_MODEL))
    return str(tmp_path / "model.json")


def arrive(axis: PiezoAxis) -> None:
    for _ in range(500):
        if axis.arrived:
            return
        time.sleep(0.01)
    raise AssertionError("the axis never arrived")


def test_an_axis_writes_the_drive_of_its_positions(model_file: str) -> None:
    written: list[float] = []
    positions = []
    axis = PiezoAxis(model_file, written.append, sample_rate=100.0, speed=50.0)
    for target, ticks in ((5.0, 12), (3.0, 6), (8.0, 12)):
        axis.move(target)
        for _ in range(ticks):
            axis.tick()
            positions.append(axis.position)
        assert axis.arrived
    steps = np.abs(np.diff(positions))
    assert steps.max() == pytest.approx(0.5)
    model = dbo.read_model(model_file)
    assert written == model.compensate(np.array(positions), sample_rate=100.0).tolist()
    axis.close()
    assert written[-1] == 0.0 and np.abs(np.diff(written[30:])).max() < 0.2
    with pytest.raises(ValueError, match=r"^99 is outside 1 to 9 um$"):
        axis.move(99.0)


def test_what_the_hardware_refused_is_not_committed(model_file: str) -> None:
    def refuse(volts: float) -> None:
        raise OSError("no such device")

    axis = PiezoAxis(model_file, refuse, sample_rate=1000.0)
    axis.run()
    for _ in range(500):
        if axis.failure is not None:
            break
        time.sleep(0.01)
    axis.close()  # nothing was committed, so there is no way back
    assert str(axis.failure) == "no such device" and axis.position == axis.low


def test_a_card_gets_the_volts_before_the_amplifier(
    model_file: str, tmp_path: Path
) -> None:
    wanted = 1.0 + 3.0 * (1.0 - np.cos(np.arange(200) / 20.0))
    rows = "".join(f"{k / 100},{x!r}\n" for k, x in enumerate(wanted.tolist()))
    (tmp_path / "wish.csv").write_text("time_s,displacement_um\n" + rows)
    output = nidaqmx_live.play(
        model_file, str(tmp_path / "wish.csv"), "Dev1/ao0", 20.0, 0.0, 10.0
    )
    if not isinstance(output, nidaqmx_live.SimulatedOutput):
        pytest.skip("there is a driver here, and perhaps a card")
    drive = dbo.read_model(model_file).compensate(wanted, sample_rate=100.0)
    assert (20.0 * np.array(output.written[:200])).tolist() == pytest.approx(
        drive.tolist(), abs=1e-12
    )
    assert output.written[-1] == 0.0


@pytest.mark.filterwarnings("ignore")
def test_a_pymodaq_actuator(model_file: str, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pymodaq")
    monkeypatch.setenv("QT_QPA_PLATFORM", "offscreen")
    from pymodaq_gui.qt_utils import mkQApp

    application: Any = mkQApp("test")
    from daq_move_Dbo import DAQ_Move_Dbo, DataActuator

    actuator = DAQ_Move_Dbo()
    actuator.settings.child("model").setValue(model_file)
    actuator.settings.child("v_max").setValue(10.0)
    assert actuator.ini_stage() == ("1 to 9 um", True)
    for target in (
        DataActuator(data=5.0, units="um"),
        DataActuator(data=2500.0, units="nm"),
    ):
        actuator.move_abs(target)
        arrive(actuator.controller)
        assert actuator.get_actuator_value().value("um") == pytest.approx(
            target.value("um")
        )
    actuator.move_home()
    arrive(actuator.controller)
    assert actuator.get_actuator_value().value("um") == 1.0
    actuator.close()
    assert actuator.last_volts == 0.0 and application is not None


@pytest.mark.filterwarnings("ignore")
def test_a_qudi_module(model_file: str, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("qudi.interface.process_control_interface")
    monkeypatch.setenv("QT_QPA_PLATFORM", "offscreen")
    import weakref

    from dbo_positioner import CHANNEL, DboPositioner
    from PySide6 import QtWidgets

    application = QtWidgets.QApplication.instance() or QtWidgets.QApplication([])

    class Main:
        module_manager = None

    main = Main()
    options = {"model": model_file, "v_max": 10.0}
    module = DboPositioner(
        qudi_main_weakref=weakref.ref(main), name="stage", config=options
    )
    module.on_activate()
    assert module.constraints.channel_limits == {CHANNEL: (1.0, 9.0)}
    assert module.constraints.channel_units == {CHANNEL: "um"}
    module.set_setpoint(CHANNEL, 4.0)
    arrive(module._axis)
    assert module.setpoints == {CHANNEL: 4.0} and module.activity_states == {
        CHANNEL: True
    }
    module.on_deactivate()
    assert module.last_volts == 0.0 and application is not None
