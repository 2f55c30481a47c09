"""An EPICS server of one actuator: a set point in, ``dbo`` finds the volts.

    pip install caproto
    python epics_ioc.py model.json --prefix LAB:PIEZO: --v-max 100
    caput LAB:PIEZO:SetPoint 5.0                # in the model's unit; refused outside what it reaches
    camonitor LAB:PIEZO:Position LAB:PIEZO:Moving LAB:PIEZO:Volts

``volts_written`` is to hand the volts to your amplifier, for example by a record of its
own server.
"""

from __future__ import annotations

import argparse

from caproto.server import PVGroup, pvproperty, run
from piezo_axis import PiezoAxis

PERIOD = 0.05  # s between two updates of what clients watch


class DboAxis(PVGroup):
    """Records of one actuator behind a model of ``dbo identify``."""

    set_point = pvproperty(name="SetPoint", value=0.0, precision=6)
    position = pvproperty(name="Position", value=0.0, precision=6, read_only=True)
    volts = pvproperty(name="Volts", value=0.0, precision=6, units="V", read_only=True)
    moving = pvproperty(name="Moving", value=0, read_only=True)
    stop = pvproperty(name="Stop", value=0)

    def __init__(self, model_file, v_min, v_max, **names):
        super().__init__(**names)
        self.axis = PiezoAxis(model_file, self.volts_written, v_min=v_min, v_max=v_max)
        self.last_volts = 0.0

    def volts_written(self, volts: float) -> None:
        """Hand volts to the amplifier: yours goes here."""
        self.last_volts = volts

    @set_point.putter
    async def set_point(self, instance, value):
        """Go to a position; what the actuator cannot reach is refused, and the client told so."""
        self.axis.move(value)

    @stop.putter
    async def stop(self, instance, value):
        """Stay where the actuator is."""
        self.axis.stop()

    @position.startup
    async def position(self, instance, async_lib):
        """Begin at the lower end, and tell clients where the actuator is."""
        self.axis.run()
        await self.set_point.write(self.axis.low)
        while self.axis.failure is None:
            await self.position.write(self.axis.position)
            await self.moving.write(int(not self.axis.arrived))
            await self.volts.write(self.last_volts)
            await async_lib.library.sleep(PERIOD)
        raise self.axis.failure

    @position.shutdown
    async def position(self, instance, async_lib):
        """Go back to rest."""
        self.axis.close()


def main() -> None:
    """Serve until the process is interrupted."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("model")
    parser.add_argument("--prefix", default="DBO:")
    parser.add_argument("--v-min", type=float, default=None)
    parser.add_argument("--v-max", type=float, default=None)
    asked = parser.parse_args()
    group = DboAxis(asked.model, asked.v_min, asked.v_max, prefix=asked.prefix)
    run(group.pvdb, module_name="caproto.asyncio.server", interfaces=["127.0.0.1"])


if __name__ == "__main__":
    main()
