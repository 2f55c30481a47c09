"""A dashboard of PyMoDAQ without a screen that moves ``examples/daq_move_Dbo.py``; for ``test_pymodaq.py``.

Called as ``python pymodaq_bench.py MODEL RESULT``; where the actuator went is written
as JSON.
"""

from __future__ import annotations

import json
import sys
import time

PATIENCE = 60.0  # s
HARDWARE = "actuator_settings"  # the settings of a plug-in, as the dashboard names them
TARGETS = ((5.0, "um"), (2500.0, "nm"))


def wait_until(condition, application, what):
    """Let the dashboard work until something is so."""
    end = time.monotonic() + PATIENCE
    while not condition():
        if time.monotonic() > end:
            raise TimeoutError(f"the dashboard did not get there: {what}")
        application.processEvents()
        time.sleep(0.01)


def moved(model_file, application):
    """Add the actuator to a dashboard, move it, and return where it went."""
    from pymodaq.dashboard import create_load_dashboard
    from pymodaq.utils.data import DataActuator
    from pymodaq.utils.managers.modules import ModuleType
    from pymodaq.utils.managers.modules.loader import PluginInfo

    _, dashboard = create_load_dashboard(show_dashboard=False)
    stage = PluginInfo(
        id=1, name="stage", class_name="Dbo", type=ModuleType.Actuator, do_init=False
    )
    dashboard.module_creator.load_created_modules([[stage]])
    wait_until(
        lambda: dashboard.actuators_modules, application, "the actuator is added"
    )
    [actuator] = dashboard.actuators_modules
    settings = actuator.settings.child(HARDWARE)
    settings.child("model").setValue(model_file)
    settings.child("v_max").setValue(10.0)
    actuator.init_hardware(True)
    wait_until(
        lambda: actuator.initialized_state, application, "the actuator is initialised"
    )
    places = []
    arrived = []
    actuator.move_done_signal.connect(arrived.append)
    for value, units in TARGETS:
        arrived.clear()
        actuator.move_abs(DataActuator("stage", data=value, units=units))
        wait_until(lambda: arrived, application, f"the move to {value} {units}")
        places.append(float(arrived[-1].value("um")))
    actuator.quit_fun()
    application.processEvents()
    return {"places": places}


def main():
    """Write where the actuator went."""
    from pymodaq_gui.qt_utils import mkQApp

    application = mkQApp("bench")
    try:
        result = moved(sys.argv[1], application)
    except Exception as problem:
        result = {"failed": f"{type(problem).__name__}: {problem}"}
    with open(sys.argv[2], "w") as file:
        json.dump(result, file)


if __name__ == "__main__":
    main()
