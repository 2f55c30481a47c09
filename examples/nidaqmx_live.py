"""Drive an amplifier on an NI card, a sample at a time: plan, write, commit.

    python nidaqmx_live.py model.json trajectory.csv --channel Dev1/ao0 --gain 20 --v-max 100

The computer's clock is used, not the card's: some hundred samples a second are what to
expect. A fixed waveform is better played by the card (``dbo compensate``, then ``dbo
waveform``). A model with a delay or dynamics moves later by ``live.lookahead`` samples.
The output stays where it is at the end.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterable
from typing import Any

import dbo_cli as dbo


def follow(
    live: Any,
    wanted: Iterable[float],
    write: Callable[[float], object],
    period: float,
) -> None:
    """Follow positions at an even rate (s a sample); ``write`` hands volts to the hardware."""
    due = time.monotonic()
    for position in wanted:
        write(live.plan(position))
        live.commit()  # not before the hardware has it
        due += period
        time.sleep(max(0.0, due - time.monotonic()))


def main() -> None:
    """Read the command line and play."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("model")
    parser.add_argument("trajectory", help="displacement with an even time column")
    parser.add_argument("--channel", default="Dev1/ao0")
    parser.add_argument("--gain", type=float, default=1.0, help="of the amplifier")
    parser.add_argument("--v-min", type=float, help="V at the actuator")
    parser.add_argument("--v-max", type=float, help="V at the actuator")
    typed = parser.parse_args()
    frame = dbo.read_log(typed.trajectory)
    period = float(frame["time"].diff().median())
    live = dbo.read_model(typed.model).controller(
        1.0 / period, v_min=typed.v_min, v_max=typed.v_max, lookahead="auto"
    )

    import nidaqmx

    low, high = live.limits.rating
    with nidaqmx.Task() as task:
        task.ao_channels.add_ao_voltage_chan(
            typed.channel, min_val=low / typed.gain, max_val=high / typed.gain
        )
        follow(
            live, frame["displacement"], lambda v: task.write(v / typed.gain), period
        )


if __name__ == "__main__":
    main()
