"""The DBO and its relatives, fitted to the same logs and judged alike: one row a model."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, partial

import numpy as np

from dbo_cli.errors import DboError, UsageError
from dbo_cli.extras.compare.fitting import RELATIVES, fit
from dbo_cli.extras.compare.play_model import RelativeModel, with_plays
from dbo_cli.hysteresis import kernel
from dbo_cli.hysteresis.identification import IdentificationOptions, Recording, identify
from dbo_cli.hysteresis.identification.cleaning import Sensor, clean
from dbo_cli.hysteresis.identification.evaluation import (
    Residual,
    residual_of,
    validation_of,
)
from dbo_cli.hysteresis.identification.preparation import Prepared, prepare
from dbo_cli.hysteresis.identification.recordings import (
    check_recordings,
    median_cycle_seconds,
    widest_first,
)
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.hysteresis.move_error import played, rms
from dbo_cli.hysteresis.operators import Floats

SAME_STAGES = "same-stages"
NAMES = ("dbo", *(relative.name for relative in RELATIVES), SAME_STAGES)
OWN_WORDS = "Discrete Backlash Operator"
SAME_WORDS = "PI plays in the place of the DBO's gears, all its other stages kept"
SHARED = (
    *(
        "points",
        "drive_bend",
        "slopes",
        "relaxation_seconds",
        "delay_seconds",
        "dynamics",
        "trusted_hz",
    ),
    *("expected_rmse", "fastest_drive"),
)
"""What the model file says of a model's stages and curve, whether gears or plays stand among them."""
# chosen: milliseconds, which a clock resolves
TIMED_SAMPLES = {"compiled": 100_000, "python": 2_000}
TIMED_RUNS = 5  # the fastest counts: what else the machine does can only add
ROUND_TRIP_SAMPLES = 50_000  # chosen: several cycles of a usual log
EXACT = 1e-9  # of the range: a round trip within it is one to rounding


def processor_ns() -> int:
    """Return the time that this thread has had of the processor (ns), or the clock where it is too coarse."""
    if time.get_clock_info("thread_time").resolution > 1e-6:
        return time.perf_counter_ns()
    return time.thread_time_ns()


@dataclass(frozen=True)
class Row:
    """The figures of one model; lengths in the displacement's unit, None where there is none.

    Attributes
    ----------
    name, words : str
        What it is called, and what it is.
    rmse, expected_rmse, validation_rmse : float
        On its own logs; expected on new moves; on the logs that took no part.
    parameters : int
        Numbers that were fitted.
    fit_seconds, forward_ns, inverse_ns : float
        Time to fit; the processor's a sample of the model without delay and dynamics.
        None: not timed, as the fit of plays among the DBO's own stages, which is the
        DBO's, and their inverse beside memories, which is in Python alone.
    round_trip : float
        The largest difference between what is wanted and what the model does with the
        drive of its inverse.
    refused : str
        Why it could not be fitted.
    model : ActuatorModel
        The model itself.
    """

    name: str
    words: str
    rmse: float | None = None
    expected_rmse: float | None = None
    validation_rmse: float | None = None
    parameters: int | None = None
    fit_seconds: float | None = None
    forward_ns: float | None = None
    inverse_ns: float | None = None
    round_trip: float | None = None
    refused: str | None = None
    model: ActuatorModel | None = None

    @property
    def invertible(self) -> bool | None:
        """Whether its inverse is exact to rounding; None where it could not be fitted."""
        if self.model is None or self.round_trip is None:
            return None
        return self.round_trip <= EXACT * self.model.output.span


def compare(
    recordings: Sequence[Recording],
    validation: Sequence[Recording] = (),
    names: Sequence[str] = NAMES,
    skip_seconds: float = 0.0,
    timed: bool = True,
    judged_from: float | None = None,
) -> list[Row]:
    """Fit each model to the logs and judge it; one that cannot be fitted has a row that says why.

    ``skip_seconds`` are left out of every log, ``judged_from``, where given, of those
    of the validation.

    Raises
    ------
    FitError
        Nothing can be fitted to such logs, whatever the model.
    UsageError
        A name is none of a model.
    """
    for name in names:
        if name not in NAMES:
            raise UsageError(f"`models` {name}: there are {', '.join(NAMES)}")
    check_recordings(recordings)
    recordings = widest_first(recordings)
    notes: list[str] = []
    mended, ends = clean(recordings, Sensor(), notes)
    ready = prepare(mended, skip_seconds, ends)
    cycle = median_cycle_seconds(recordings)
    judged = skip_seconds if judged_from is None else judged_from
    judge = _Judge(mended, ready, validation, judged, timed)
    fits: dict[str, tuple[str, Callable[[], ActuatorModel]]] = {}
    for relative in RELATIVES:
        fitted = partial(fit, relative, ready, judge.recordings, cycle)
        fits[relative.name] = relative.words, fitted
    # a mere line is compared, too
    options = IdentificationOptions(skip_seconds=skip_seconds, force=True)
    identified = cache(lambda: identify(recordings, options).model)
    fits |= {
        "dbo": (OWN_WORDS, identified),
        SAME_STAGES: (SAME_WORDS, lambda: _same_stages(identified())),
    }
    return [judge.row(name, *fits[name]) for name in dict.fromkeys(names)]


def _same_stages(dbo: ActuatorModel) -> RelativeModel:
    """Return the DBO's own model with plays in the place of its gears; nothing is fitted again."""
    model = with_plays(dbo)
    figures = {key: dbo.fit[key] for key in SHARED if key in dbo.fit}
    figures |= {
        "method": SAME_STAGES,
        "operator": SAME_WORDS,
        "plays": model.plays.n,
        "parameters": _parameters(dbo),
    }
    return dataclasses.replace(model, fit=figures)


@dataclass(frozen=True)
class _Judge:
    """Judges every model in the same way."""

    recordings: Sequence[Recording]
    ready: Prepared
    validation: Sequence[Recording]
    skip_seconds: float
    timed: bool

    def row(self, name: str, words: str, make: Callable[[], ActuatorModel]) -> Row:
        """Return the row of one model, or of why there is none."""
        begun = time.perf_counter()
        try:
            model = make()
        except DboError as problem:
            return Row(name, words, refused=str(problem))
        except np.linalg.LinAlgError as problem:
            return Row(
                name,
                words,
                refused=f"its least-squares problem cannot be solved ({problem})",
            )
        seconds = time.perf_counter() - begun
        logs = zip(self.recordings, self.ready.logs, strict=True)
        rmse = _pooled([residual_of(model, recording, log) for recording, log in logs])
        checks = [
            validation_of(model, log, self.skip_seconds) for log in self.validation
        ]
        stated = model.fit.get("expected_rmse")
        ratio = model.fit.get("left_out_ratio")
        expected = None
        if ratio is not None:
            expected = rmse * float(str(ratio))
        elif stated is not None:
            expected = float(str(stated))
        if isinstance(model, RelativeModel):
            model = dataclasses.replace(
                model, fit=self._figures(model, rmse, expected, checks)
            )
        validated = _pooled(checks) if checks else None
        fit_seconds = forward = inverse = None
        if self.timed:
            forward, inverse = self._times(model)
        if self.timed and name != SAME_STAGES:
            fit_seconds = seconds
        return Row(
            name,
            words,
            rmse,
            expected,
            validated,
            _parameters(model),
            fit_seconds,
            forward,
            inverse,
            self._round_trip(model),
            None,
            model,
        )

    def _figures(
        self,
        model: ActuatorModel,
        rmse: float,
        expected: float | None,
        checks: Sequence[Residual],
    ) -> dict[str, object]:
        """Return what a relative's model file says of its fit, under the names that ``identify`` uses."""
        span = abs(self.ready.scale)
        figures: dict[str, object] = {"rmse": rmse, "rmse_percent": 100.0 * rmse / span}
        percent = None if expected is None else 100.0 * expected / span
        figures |= {"expected_rmse": expected, "expected_percent": percent}
        if checks:
            figures["validation"] = [
                {"name": check.name, "samples": len(check.values), "rmse": check.rmse}
                for check in checks
            ]
        values = dict(model.fit)
        values.pop("left_out_ratio", None)
        return values | figures

    def _step(self, model: ActuatorModel) -> float | None:
        """Return the time step (s) of the first log, where a model needs one."""
        if not model.needs_time:
            return None
        clock = self.recordings[0].seconds()
        if clock is None:
            return 1.0
        steps = np.diff(clock)
        return float(np.median(steps[steps > 0.0]))

    def _times(self, model: ActuatorModel) -> tuple[float, float | None]:
        """Return nanoseconds a sample, forward and inverse, on the first log's own drive."""
        still = model.without_lag
        voltage = np.resize(self.recordings[0].voltage, TIMED_SAMPLES[kernel.KIND])
        forward = self._time(still, voltage)
        if isinstance(still, RelativeModel) and still.plays.relaxation is not None:
            return forward, None
        return forward, self._time(
            still.inverse(), played(still, voltage, self._step(still))
        )

    def _time(self, model: ActuatorModel, signal: Floats) -> float:
        step = self._step(model)
        start = model.start(float(signal[0]))
        fastest = math.inf
        for _ in range(TIMED_RUNS):
            begun = processor_ns()
            model.simulate(signal, start, time_step=step)
            fastest = min(fastest, processor_ns() - begun)
        return fastest / len(signal)

    def _round_trip(self, model: ActuatorModel) -> float:
        """Return the largest difference after inverse and model, on what the first log's drive leads to."""
        still = model.without_lag
        step = self._step(still)
        wanted = played(still, self.recordings[0].voltage[:ROUND_TRIP_SAMPLES], step)
        drive = played(still.inverse(), wanted, step)
        return float(np.abs(played(still, drive, step) - wanted).max())


def _pooled(residuals: Sequence[Residual]) -> float:
    """Root of the mean square over all logs, weighted by their rows."""
    return rms(np.concatenate([residual.values for residual in residuals]))


def _parameters(model: ActuatorModel) -> int:
    """Return how many numbers were fitted."""
    fit = model.fit
    if "parameters" in fit:
        return int(str(fit["parameters"]))
    memories = fit.get("relaxation_seconds")
    count = int(str(fit["different_slopes"])) + max(int(str(fit["points"])) - 1, 0) + 1
    if isinstance(memories, list):
        count += len(memories)
    count += bool(fit.get("drive_bend")) + bool(fit.get("delay_seconds"))
    if model.dynamics is not None:
        count += sum(
            sum(v is not None for v in vars(section).values())
            for section in model.dynamics.sections
        )
    return count
