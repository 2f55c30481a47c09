"""Identification from end to end: recordings and options in, a model and what must be said of it out."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from dbo_cli.errors import UsageError
from dbo_cli.hysteresis.identification.evaluation import (
    loop_width_percent,
    residual_of,
    validated,
    validation_of,
)
from dbo_cli.hysteresis.identification.options import IdentificationOptions
from dbo_cli.hysteresis.identification.paper_method import identify_as_in_paper
from dbo_cli.hysteresis.identification.recordings import (
    Recording,
    check_recordings,
    split,
)
from dbo_cli.hysteresis.identification.static import Identification, identify_static
from dbo_cli.hysteresis.model import ActuatorModel


def identify(
    recordings: Sequence[Recording],
    options: IdentificationOptions | None = None,
    validation: Sequence[Recording] = (),
    prior: ActuatorModel | None = None,
) -> Identification:
    """Identify a forward model from one or more recordings of one actuator.

    Parameters
    ----------
    recordings : logs of drive voltage and displacement, in one unit each
    options : what is fixed; everything else is chosen on data left out
    validation : logs that take no part in the fit and tell how well the model predicts
    prior : a model whose shape is kept: gain, offset and lag alone are found

    Raises
    ------
    FitError
        Nothing trustworthy can be identified.
    UsageError
        Options that contradict the recordings.
    """
    options = options or IdentificationOptions()
    check_recordings(recordings)
    if prior is not None:
        from dbo_cli.hysteresis.identification.prior import refresh

        return refresh(prior, recordings, options, validation)
    if options.method == "paper":
        return _paper(recordings, options, validation)
    unexplained: list[str] = []
    clocked = all(log.seconds() is not None for log in recordings)
    if not clocked and (options.delay or options.relaxation or options.dynamics):
        raise UsageError(
            "`delay`, `relaxation` and `dynamics` need a clock: name the time column (`time`) or give "
            "`sample_rate`"
        )
    if clocked and (options.dynamics or (options.dynamics is None and split(recordings)[1])):
        # The signal processing behind it takes half a second to import, and few logs need it.
        from dbo_cli.hysteresis.identification.dynamics import with_dynamics

        moving = with_dynamics(recordings, options, validation)
        if isinstance(moving, Identification):
            return moving
        unexplained = moving
    return identify_static(recordings, options, validation, unexplained)


def _paper(
    recordings: Sequence[Recording], options: IdentificationOptions, validation: Sequence[Recording]
) -> Identification:
    """Identify as in the paper's Section V."""
    if len(recordings) > 1:
        raise UsageError("`method` paper takes one log of one cycle (`rows` A:B cuts it out)")
    log = recordings[0]
    model, cycle = identify_as_in_paper(log, options.gears, options.points, options.zero)
    again = dataclasses.replace(
        log, time=None, sample_period=None, voltage=cycle.voltage, displacement=np.tile(log.displacement, 2)
    )
    drift = np.ones((len(cycle.voltage), 1))
    residual = residual_of(model, again, dataclasses.replace(cycle, drift=drift))
    span = float(np.ptp(log.displacement))
    checks = [validation_of(model, other, options.skip_seconds) for other in validation]
    figures: dict[str, object] = {
        "method": "paper",
        "rmse": residual.rmse,
        "rmse_percent": 100.0 * residual.rmse / span,
        "samples": len(residual.values),
        "gears": len(model.backlash.dx),
        "loop_width_percent": loop_width_percent(model),
    }
    unit = f" {model.output.unit}" if model.output.unit else ""
    summary = [f"fit RMSE {residual.rmse:.4g}{unit} ({figures['rmse_percent']:.2f} % of range) on one cycle"]
    found, lines = validated(checks, span, unit)
    figures |= found
    summary += lines
    return Identification(dataclasses.replace(model, fit=figures), figures, summary, [])
