"""A focus drive for Micro-Manager's core in Python: positions in, ``dbo`` finds the volts.

pymmcore-plus lets a device be a Python class (``UniMMCore``, experimental there),
beside those of Micro-Manager's own adapters. ``volts_written`` is to hand the volts to
your amplifier.

    core = UniMMCore()
    core.loadPyDevice("Piezo", DboStage("model.json"))
    core.initializeDevice("Piezo")
    core.setFocusDevice("Piezo")
    core.setPosition(5.0)                       # um
    core.waitForDevice("Piezo")
"""

from __future__ import annotations

from piezo_axis import PiezoAxis
from pymmcore_plus.experimental.unicore import StageDevice


class DboStage(StageDevice):
    """One actuator behind a model of ``dbo identify``.

    Parameters
    ----------
    model_file : str
        A model whose displacement is in um.
    **options
        Of ``PiezoAxis``: ``sample_rate``, ``speed`` and the limits.
    """

    def __init__(self, model_file: str, **options: float) -> None:
        super().__init__()
        self._axis = PiezoAxis(model_file, self.volts_written, **options)
        if self._axis.unit != "um":
            raise ValueError(
                f"Micro-Manager's positions are in um, and the model's in '{self._axis.unit}'"
            )
        self._origin = 0.0

    def volts_written(self, volts: float) -> None:
        """Hand volts to the amplifier: yours goes here."""
        self.last_volts = volts

    def initialize(self) -> None:
        """Begin at the lower end."""
        self._axis.run()

    def shutdown(self) -> None:
        """Go back to rest."""
        self._axis.close()

    def busy(self) -> bool:
        """Return whether a move goes on."""
        if self._axis.failure is not None:
            raise self._axis.failure
        return not self._axis.arrived

    def set_position_um(self, val: float) -> None:
        """Go to a position."""
        self._axis.move(val + self._origin)

    def get_position_um(self) -> float:
        """Return where the actuator is by the model."""
        return self._axis.position - self._origin

    def set_origin(self) -> None:
        """Count from here."""
        self._origin = self._axis.position

    def home(self) -> None:
        """Go to the lower end."""
        self._axis.move(self._axis.low)

    def stop(self) -> None:
        """Stay where the actuator is."""
        self._axis.stop()
