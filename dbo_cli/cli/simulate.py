"""``dbo simulate``: a model and its input signal into the output signal."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from typing import TYPE_CHECKING

from dbo_cli.cli import options
from dbo_cli.cli.messages import Progress, Voice

if TYPE_CHECKING:
    from dbo_cli.logs.reading_options import ReadingOptions


def simulate(
    *,
    model: options.Model,
    log: options.Log,
    reading: ReadingOptions,
    voice: Voice,
    typed: Sequence[str],
    outside: options.Outside,
    state: options.State,
    save_state: options.SaveState,
    input_column: options.Input,
    flush: options.Flush,
    summary: options.Summary,
    output: options.Output,
) -> None:
    """Run a model over its input signal and write the output signal.

    A forward model turns a drive into the displacement, an inverse model a displacement into the drive. The
    log is read block by block, so that it may be larger than memory or never end (tail -f ... | dbo simulate
    model.json - --flush). Written are time (when known), the input column and the result.

    Example: dbo simulate model.json drive.csv -o predicted.csv
    """
    from dbo_cli.runs.files import Destination, simulate_log

    remarks = simulate_log(
        model,
        log,
        Destination(output, save_state, [model, log, state], flush, shlex.join(["dbo", *typed]), summary),
        reading,
        column=input_column,
        outside=outside,
        state=state,
        listener=Progress(voice, "written"),
    )
    voice.remarks(remarks)
