"""Identification of a model from recordings: the whole story on one screen."""

from collections.abc import Sequence
from dataclasses import replace

from dbo_cli.errors import warn
from dbo_cli.identification.averaging import (
    average_model,
    candidates,
    invented_problem,
    weighed,
    with_levels,
)
from dbo_cli.identification.clean import clean
from dbo_cli.identification.figures import judged, measured, refuse_other_sign, stated
from dbo_cli.identification.moving import moving
from dbo_cli.identification.problem import prepare
from dbo_cli.identification.recording import Options, Recording
from dbo_cli.identification.search import FEWEST_SWINGS, Search, choices_for
from dbo_cli.identification.sections import split
from dbo_cli.identification.stages import model_of
from dbo_cli.identification.threads import one_thread
from dbo_cli.model import Cascade


def identify(
    recordings: Sequence[Recording],
    options: Options | None = None,
    validation: Sequence[Recording] = (),
) -> Cascade:
    """Identify a model from logs of one actuator.

    Parameters
    ----------
    recordings : the logs
    options : what the user fixed
    validation : logs that the model is tried on

    Raises
    ------
    FitError
        No model better than a straight line can be identified.
    LimitError
        The displacement does not have the sign that was asked for.
    """
    options = options or Options()
    with one_thread():
        model = _judged(recordings, options, validation)
    for text in model.fit["warnings"]:
        warn(text)
    return model


def _judged(
    recordings: Sequence[Recording],
    options: Options,
    validation: Sequence[Recording],
) -> Cascade:
    """Return the model of the logs with its figures on them and on others."""
    logs, notes = clean(recordings, options)
    refuse_other_sign(logs, options)
    if options.method == "paper":
        from dbo_cli.identification.paper import identify_paper

        model = identify_paper(logs[0], options)
    elif options.prior is not None:
        from dbo_cli.identification.prior import rescale

        model = rescale(options.prior, logs, options)
    else:
        model = _searched(logs, options)
    model = measured(model, logs, options, notes)
    return judged(model, logs, validation)


def _searched(logs: Sequence[Recording], options: Options) -> Cascade:
    """Return the model that structures judged on parts left out add up to."""
    slow, fast = split(logs)
    problem, choices = choices_for(prepare(slow, options), options)
    search = Search(problem, choices)
    found = moving(problem, search.run(), slow, fast, options)
    problem, fits = found.problem, weighed(found.fits)
    invented = invented_problem(problem)
    mean = average_model(problem, invented, fits)
    few = problem.one_amplitude or problem.different_swings < FEWEST_SWINGS
    if few and found.figures is None:
        others = search.unjudged(fits[0])
    else:
        others = with_levels(fits, found.fits, problem.different_swings)
    others = candidates(problem, invented, others)
    model = found.applied(model_of(problem, mean, slow[0], options, others))
    model = replace(model, auto_start=fits[0].structure.start)
    return stated(model, problem, invented.logs[0], fits, logs, options)
