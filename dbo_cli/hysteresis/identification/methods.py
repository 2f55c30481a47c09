"""What all ways to identify have in common: what is refused before, how one is picked, what is said after.

A model comes of the logs alone (``identify``), of logs in which a sweep shows dynamics
(``dynamics``), of a short log and a prior (``prior``), or of one cycle as in the paper
(``paper``).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

from dbo_cli.errors import LimitError, UsageError
from dbo_cli.hysteresis.identification.identify import Identification, identify_static
from dbo_cli.hysteresis.identification.preparation import gain_sign
from dbo_cli.hysteresis.identification.recordings import (
    IdentificationOptions,
    Recording,
    check_recordings,
    split,
    widest_first,
)
from dbo_cli.hysteresis.model import SIGN_VERBS, ActuatorModel, Sign


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
    LimitError
        The displacement goes the other way than ``options.sign`` says.
    """
    options = options or IdentificationOptions()
    check_recordings(recordings)
    if options.sign is not None:
        _refuse_other_sign(recordings, options.sign)
    result = _identify_by_method(widest_first(recordings), options, validation, prior)
    sign: dict[str, object] = {"sign": result.model.sign}
    stated: dict[str, object] = {}
    lines: list[str] = []
    if options.scale_uncertainty > 0.0:
        stated, lines = _stated_gain(result.model, options.scale_uncertainty)
    model = dataclasses.replace(
        result.model, fit=sign | dict(result.model.fit) | stated
    )
    return dataclasses.replace(
        result,
        model=model,
        fit=sign | result.fit | stated,
        summary=[*result.summary, *lines],
    )


def _stated_gain(
    model: ActuatorModel, percent: float
) -> tuple[dict[str, object], list[str]]:
    """Return the gain from end to end with its standard uncertainty, as figures and as a line.

    The shape's error is met at both ends, and the scale's ``percent`` in all rows
    alike; squares add.
    """
    span = model.output.span
    gain = span / model.input.span
    shape = model.fit.get("expected_shape_rmse")
    of_ends = 0.0
    if isinstance(shape, float):
        of_ends = math.sqrt(2.0) * shape / span
    uncertainty = gain * math.hypot(of_ends, percent / 100.0)
    if model.sign == "falling":
        gain = -gain
    unit = ""
    if model.output.unit and model.input.unit:
        unit = f" {model.output.unit}/{model.input.unit}"
    figures: dict[str, object] = {
        "gain": gain,
        "gain_uncertainty": uncertainty,
        "scale_uncertainty_percent": percent,
    }
    return figures, [
        f"gain {gain:.6g}{unit} from end to end, standard uncertainty {uncertainty:.2g}{unit}: "
        f"{percent:.3g} % of the displacement's scale, {100.0 * of_ends:.3g} % of the shape"
    ]


def _refuse_other_sign(recordings: Sequence[Recording], sign: str) -> None:
    """Refuse logs (LimitError) whose displacement does not go the way with the voltage that it should."""
    for log in recordings:
        measured: Sign = "rising" if gain_sign([log]) > 0.0 else "falling"
        if measured != sign:
            moves = f"{log.displacement_quantity} {SIGN_VERBS[measured]} as {log.voltage_quantity} rises"
            raise LimitError(
                f"{log.name}: {moves}, and `sign` is {sign}: check the actuator's leads and the sensor's sign"
                " (`scale` displacement=-1 turns it)"
            )


def _identify_by_method(
    recordings: Sequence[Recording],
    options: IdentificationOptions,
    validation: Sequence[Recording],
    prior: ActuatorModel | None,
) -> Identification:
    """Identify a model by the method, or with the prior, that was asked for."""
    if prior is not None:
        from dbo_cli.hysteresis.identification.prior import refresh

        return refresh(prior, recordings, options, validation)
    if options.method == "paper":
        from dbo_cli.hysteresis.identification.paper import identify_by_paper

        return identify_by_paper(recordings, options, validation)
    unexplained: list[str] = []
    clocked = all(log.seconds() is not None for log in recordings)
    if not clocked and (options.delay or options.relaxation or options.dynamics):
        raise UsageError(
            "`delay`, `relaxation` and `dynamics` need a clock: name the time column (`time`) or give "
            "`sample_rate`"
        )
    if clocked and (
        options.dynamics or (options.dynamics is None and split(recordings)[1])
    ):
        # The signal processing behind it takes half a second to import, and few logs
        # need it.
        from dbo_cli.hysteresis.identification.dynamics import with_dynamics

        moving = with_dynamics(recordings, options, validation)
        if isinstance(moving, Identification):
            return moving
        unexplained = moving
    return identify_static(recordings, options, validation, unexplained)
