"""``dbo simulate``: a model and its input signal into the output signal."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, cast

from dbo_cli.cli import options, signals, values
from dbo_cli.cli.bundles import Reading, bundled
from dbo_cli.cli.messages import Voice
from dbo_cli.cli.responses import Destination, start_of, write_response
from dbo_cli.cli.streams import LAG_DEPENDS, Clock, ModelStream, ahead

if TYPE_CHECKING:
    from dbo_cli.hysteresis.operators import Outside

OUTSIDE = ("extend", "hold", "error")


@bundled
def simulate(
    model: options.Model,
    log: options.Log,
    reading: Reading,
    voice: Voice,
    command_line: Sequence[str],
    outside: options.Outside = "extend",
    state: options.State = "auto",
    save_state: options.SaveState = None,
    input_column: options.Input = None,
    flush: options.Flush = False,
    output: options.Output = "-",
) -> None:
    """Run a model over its input signal and write the output signal.

    A forward model turns a drive into the displacement, an inverse model a displacement into the drive. The
    log is read block by block, so that it may be larger than memory or never end (tail -f ... | dbo simulate
    model.json - --flush). Written are time (when known), the input column and the result.
    """
    behaviour = cast("Outside", values.choice("--outside", outside, OUTSIDE))
    from dbo_cli.hysteresis.model_file import read_model
    from dbo_cli.logs.columns import ColumnWish

    destination = Destination(
        output, save_state, [model, log, state], reading.file_format, flush, command_line
    )
    destination.check()
    operator = read_model(model)
    taken = operator.input
    want = {taken.quantity: ColumnWish(input_column, signals.guesses_for(taken.quantity), option="input")}
    with signals.open_signals(log, want, reading, voice, live=flush) as source:
        signals.check_unit(source, taken.quantity, taken, signals.spoken(model))
        look_ahead = operator.delay_seconds if operator.direction == "inverse" else 0.0
        why = LAG_DEPENDS if operator.needs_time or look_ahead else None
        clock = Clock(source, reading, why)
        stream = ModelStream(operator, source, clock, start_of(state, operator), behaviour)
        blocks = ahead(source, taken.quantity, look_ahead)
        write_response(stream, blocks, operator.output, reading, voice, destination)
