"""``dbo compensate``: a forward model and a desired displacement into the feedforward drive."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain
from typing import TYPE_CHECKING

from dbo_cli.cli import options, signals, values
from dbo_cli.cli.bundles import Reading, bundled
from dbo_cli.cli.messages import Voice
from dbo_cli.cli.responses import Destination, start_of, write_response
from dbo_cli.cli.streams import LAG_DEPENDS, Clock, ModelStream, ahead
from dbo_cli.errors import UsageError

if TYPE_CHECKING:
    from dbo_cli.hysteresis.model import ActuatorModel, Quantity
    from dbo_cli.hysteresis.model_state import DriveLimits
    from dbo_cli.logs.sample_block import FloatArray, SampleBlock

ON_LIMIT = ("clip", "error")


@bundled
def compensate(
    model: options.Model,
    trajectory: options.Trajectory,
    reading: Reading,
    voice: Voice,
    command_line: Sequence[str],
    v_min: options.VoltageMin = None,
    v_max: options.VoltageMax = None,
    max_slew: options.MaxSlew = None,
    on_limit: options.OnLimit = "clip",
    condition: options.Condition = False,
    state: options.State = "auto",
    save_state: options.SaveState = None,
    displacement: options.Displacement = None,
    flush: options.Flush = False,
    output: options.Output = "-",
) -> None:
    """Write the drive voltage that makes the actuator follow a desired displacement.

    The forward model is inverted exactly and started in the state in which dbo simulate of the drive starts;
    a delay is made up for by reading the trajectory ahead. What the drive cannot reach within its limits is
    clipped, counted and said. Written are time (when known), the desired displacement and the drive.
    """
    refuse = values.choice("--on-limit", on_limit, ON_LIMIT) == "error"
    low = values.optional(values.number, "--v-min", v_min)
    high = values.optional(values.number, "--v-max", v_max)
    slew = values.optional(values.positive, "--max-slew", max_slew)
    if low is not None and high is not None and low >= high:
        raise UsageError(f"--v-min {v_min} must be below --v-max {v_max}")
    if condition and state != "auto":
        raise UsageError(f"--condition and --state {state} exclude each other: the sweep makes its own state")
    from dbo_cli.hysteresis.model_file import read_model
    from dbo_cli.hysteresis.model_state import DriveLimits
    from dbo_cli.logs.columns import ColumnWish

    destination = Destination(
        output, save_state, [model, trajectory, state], reading.file_format, flush, command_line
    )
    destination.check()
    operator = read_model(model)
    operator.require("forward", signals.spoken(model))
    drive, wanted = operator.input, operator.output
    limits = DriveLimits(drive.minimum if low is None else low, drive.maximum if high is None else high, slew)
    names = (*signals.guesses_for(wanted.quantity), *signals.DESIRED)
    want = {wanted.quantity: ColumnWish(displacement, names, option="displacement")}
    with signals.open_signals(trajectory, want, reading, voice, live=flush) as source:
        signals.check_unit(source, wanted.quantity, wanted, signals.spoken(model))
        clock = Clock(source, reading, _why_time(operator, limits, condition))
        begin = start_of(state, operator)
        stream = ModelStream(operator, source, clock, begin, limits=limits, refuse_clipping=refuse)
        blocks = ahead(source, wanted.quantity, operator.delay_seconds)
        sweep = None
        if condition:
            first = next(blocks)
            blocks = chain([first], blocks)
            sweep = _condition(stream, limits, *first)
        write_response(stream, blocks, drive, reading, voice, destination, sweep)
    _warn_of_range(voice, limits, drive)


def _why_time(model: ActuatorModel, limits: DriveLimits, condition: bool) -> str | None:
    """Return why the time between samples is needed, or None where it is not."""
    if model.needs_time or model.delay_seconds > 0.0:
        return LAG_DEPENDS
    if limits.max_slew is not None:
        return "--max-slew depends on it"
    return "--condition depends on it" if condition else None


def _condition(
    stream: ModelStream, limits: DriveLimits, block: SampleBlock, x: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the rows of the conditioning sweep, and let the stream go on from the state it leaves.

    Their displacement is the model's own: nothing else is wanted there, and every cell must hold a number.
    """
    from dbo_cli.hysteresis.excitation import condition
    from dbo_cli.logs.clock import require_even

    assert block.time is not None
    step = stream.clock.step
    if step is None:
        step = require_even(stream.log.name, block.time, "--condition takes its rate from them")
    sweep = condition(stream.model, float(x[0]), limits, step)
    start = stream.model.start(float(sweep.voltage[0]))
    expected = stream.model.simulate(sweep.voltage, start, time_step=step).y
    stream.state = sweep.state
    return sweep.time + float(block.time[0]), expected, sweep.voltage


def _warn_of_range(voice: Voice, limits: DriveLimits, drive: Quantity) -> None:
    """Say that limits wider than the model's range ask it for what it has not seen."""
    if limits.v_min < drive.minimum or limits.v_max > drive.maximum:
        unit = f" {drive.unit}" if drive.unit else ""
        voice.warning(
            f"the limits of the drive reach beyond {drive.minimum:.6g} to {drive.maximum:.6g}{unit}, "
            "where the model was identified; it extrapolates there"
        )
