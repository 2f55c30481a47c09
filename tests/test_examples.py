"""The examples for laboratories; those of a program run where that program is installed (``make labs``)."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import dbo_cli as dbo

ROOT = Path(__file__).resolve().parent.parent
MODEL = ROOT / "tests" / "contract" / "models" / "small.json"
sys.path.insert(0, str(ROOT / "examples"))


def within(model, *parts):
    """Return displacements at parts of what a model reaches."""
    return [model.output.min + part * model.output.span for part in parts]


def test_a_card_gets_the_drive_of_the_trajectory():
    from nidaqmx_live import follow

    model = dbo.read_model(MODEL)
    wanted = np.linspace(*within(model, 0.0, 0.7), 50)
    written = []
    live = model.controller(5000.0, state="empty")
    follow(live, wanted, written.append, 1.0 / 5000.0)
    expected = model.compensate(wanted, sample_rate=5000.0, state="empty")
    np.testing.assert_allclose(written, expected, rtol=0, atol=1e-12)


def test_what_a_card_did_not_take_is_not_committed():
    from nidaqmx_live import follow

    def refuse(volts):
        raise OSError("no such device")

    model = dbo.read_model(MODEL)
    live = model.controller(5000.0)
    with pytest.raises(OSError, match="no such device"):
        follow(live, within(model, 0.5), refuse, 1e-3)
    assert live.last is None


@pytest.mark.filterwarnings("ignore")
def test_pymodaq_moves_an_actuator(monkeypatch):
    pytest.importorskip("pymodaq", exc_type=ImportError)
    monkeypatch.setenv("QT_QPA_PLATFORM", "offscreen")
    from pymodaq_gui.qt_utils import mkQApp

    application = mkQApp("test")
    from daq_move_Dbo import DAQ_Move_Dbo, DataActuator

    model = dbo.read_model(MODEL)
    low, middle, high = within(model, 0.0, 0.5, 1.0)
    actuator = DAQ_Move_Dbo()
    actuator.settings.child("model").setValue(str(MODEL))
    actuator.settings.child("speed").setValue(10.0 * model.output.span)
    assert actuator.ini_stage() == (f"{low:g} to {high:g} um", True)
    for value, units in ((middle, "um"), (1000.0 * within(model, 0.3)[0], "nm")):
        target = DataActuator(data=value, units=units)
        actuator.move_abs(target)
        came = actuator.get_actuator_value().value("um")
        assert came == pytest.approx(target.value("um"))
    with pytest.raises(ValueError, match="is outside"):
        actuator.move_abs(DataActuator(data=high + 1.0, units="um"))
    written = actuator.last_volts
    actuator.move_home()
    assert actuator.get_actuator_value().value("um") == pytest.approx(low)
    assert actuator.last_volts < written and application is not None


@pytest.mark.filterwarnings("ignore")
def test_qudi_scans(tmp_path):
    """A running Qudi with dummy cards; what the cards played is played on the sample actuator."""
    place = "qudi.hardware.interfuse.ni_scanning_probe_interfuse"
    pytest.importorskip(place, exc_type=ImportError)
    words = [sys.executable, str(ROOT / "examples" / "try_in_qudi.py"), str(tmp_path)]
    environment = os.environ | {"PYTHONPATH": str(ROOT), "HOME": str(tmp_path)}
    environment |= {"QT_QPA_PLATFORM": "offscreen"}
    done = subprocess.run(
        words, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
