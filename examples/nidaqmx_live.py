"""Drive an amplifier on an NI card, a sample at a time: plan, write, commit.

    python nidaqmx_live.py model.json trajectory.csv --channel Dev1/ao0 --gain 20

The card's clock is not used: the computer waits for every sample, so some hundred a
second are what to expect. For a fixed waveform let the card play it (``dbo waveform
drive.csv --to npy --gain 20``). Where no driver is, a simulated output takes the volts,
and that is said.
"""

from __future__ import annotations

import argparse
import sys
import time
from typing import Any

import dbo_cli as dbo


class SimulatedOutput:
    """Takes volts as a task of nidaqmx does."""

    def __init__(self) -> None:
        self.written: list[float] = []

    def write(self, volts: float) -> int:
        """Keep one sample."""
        self.written.append(volts)
        return 1

    def close(self) -> None:
        """Do nothing."""


def output_on(channel: str, low: float, high: float) -> Any:
    """Return a task with one analogue output, or a simulated one where there is no library or no driver."""
    try:
        import nidaqmx
        from nidaqmx.errors import DaqNotFoundError
    except ImportError:
        return SimulatedOutput()
    try:
        task = nidaqmx.Task()
    except DaqNotFoundError:
        return SimulatedOutput()
    task.ao_channels.add_ao_voltage_chan(channel, min_val=low, max_val=high)
    return task


def play(
    model_file: str,
    trajectory: str,
    channel: str,
    gain: float,
    v_min: float,
    v_max: float,
) -> Any:
    """Follow a trajectory with an even time column, and ramp back to rest; returns the output."""
    frame = dbo.read_log(trajectory)
    wanted = frame["displacement"].to_numpy()
    period = float(frame["time"].diff().median())
    live = dbo.read_model(model_file).controller(
        1.0 / period, v_min=v_min, v_max=v_max, ahead=True
    )
    output = output_on(channel, v_min / gain, v_max / gain)
    due = time.monotonic()

    def written(volts: float) -> None:
        nonlocal due
        output.write(volts / gain)
        due += period
        if not isinstance(output, SimulatedOutput):
            time.sleep(max(0.0, due - time.monotonic()))

    try:
        for position in wanted:
            written(float(live.plan(position)))
            live.commit()  # the hardware has it
    finally:
        if live.state is not None:
            for volts in live.close():
                written(float(volts))
        output.close()
    return output


def main() -> None:
    """Read the command line and play."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("model")
    parser.add_argument("trajectory")
    parser.add_argument("--channel", default="Dev1/ao0")
    parser.add_argument(
        "--gain", type=float, default=20.0, help="of the amplifier behind the card"
    )
    parser.add_argument(
        "--v-min", type=float, default=0.0, help="lowest drive, V at the actuator"
    )
    parser.add_argument(
        "--v-max", type=float, default=100.0, help="highest drive, V at the actuator"
    )
    given = parser.parse_args()
    output = play(
        given.model,
        given.trajectory,
        given.channel,
        given.gain,
        given.v_min,
        given.v_max,
    )
    if isinstance(output, SimulatedOutput):
        kept = output.written
        print(
            f"no NI-DAQmx here: {len(kept):,} samples simulated, {min(kept):g} to {max(kept):g} V",
            file=sys.stderr,
        )


if __name__ == "__main__":
    main()
