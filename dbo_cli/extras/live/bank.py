"""Live use of many channels: arrays in, arrays out, one call of the kernel a frame.

The rules are those of one channel's ``Controller``: plan, hand over, commit; the same
bits, the same gate.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dbo_cli.drives.gate import Bools, Floats, GateError
from dbo_cli.errors import DboError, InputError, UsageError
from dbo_cli.extras.channels.model_set import Coupling
from dbo_cli.extras.live.controller import Controller
from dbo_cli.extras.live.converter import Codes, codes_may_follow
from dbo_cli.extras.live.rows import LiveDrive, Pending, number, refused
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.hysteresis.model_state import ModelState
from dbo_cli.hysteresis.stepper import make_bank


class Bank(LiveDrive[ArrayLike, Any]):
    """The drives of the forward models of a set, frame by frame; made by ``ModelSet.controller``.

    A frame is taken whole, or refused whole.

    Attributes
    ----------
    channels : tuple of str
        The order of the arrays.
    clipped : array of int
        Committed samples of each channel in which the limits of its drive were met.
    """

    def __init__(
        self,
        models: Mapping[str, ActuatorModel],
        sample_rate: float | None,
        *,
        states: Mapping[str, ModelState] | None = None,
        dac: ArrayLike | None = None,
        coupling: Coupling | None = None,
        **limits: Any,
    ) -> None:
        self.channels = tuple(models)
        if states is not None:
            _require_channels("states", states, self.channels)
        by_channel = {
            name: _by_channel(name, value, self.channels)
            for name, value in limits.items()
        }
        self._controllers: list[Controller] = []
        for place, (channel, model) in enumerate(models.items()):
            options = {name: values[place] for name, values in by_channel.items()}
            state = None if states is None else states.get(channel)
            if state is not None:
                options["state"] = state
            try:
                self._controllers.append(
                    Controller(model, sample_rate, dac=dac, **options)
                )
            except DboError as problem:
                raise type(problem)(f"channel {channel}: {problem}") from None
        self._coupling = coupling
        converters = [
            controller.converter
            for controller in self._controllers
            if controller.converter is not None
        ]
        self._codes = Codes(converters) if converters else None
        self._saved = np.zeros(len(self.channels))
        self._live: Any = None
        self._stand = np.zeros(len(self.channels))
        self._low, self._high = self._stand, self._stand
        self.clipped = np.zeros(len(self.channels), np.int64)

    @property
    def held_back(self) -> Bools:
        """Whether the limits hold back what was planned and is not committed yet, of each channel."""
        if self._pending is None:
            return np.zeros(len(self.channels), np.bool_)
        return np.asarray(self._pending[2], np.bool_)

    @property
    def states(self) -> dict[str, ModelState | None]:
        """The committed state of each channel, to go on from; None before the first."""
        return {
            name: controller.state
            for name, controller in zip(self.channels, self._controllers, strict=True)
        }

    def __getstate__(self) -> dict[str, Any]:
        """Pickle the committed states; what was planned stays behind."""
        return super().__getstate__() | {"_live": self._live is not None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Go on from committed states."""
        self.__dict__.update(state)
        live, self._live = self._live, None
        if live:
            self._begin(self._stand)

    def _worked_out(self, wanted: ArrayLike) -> Pending:
        """Return what a plan comes to: voltages or codes, volts, which are clipped, and what is saved up."""
        if self._live is None:
            self._drop_all()
        frame = self._frame(wanted, "what is wanted")
        if self._coupling is not None and np.isfinite(frame).all():
            with np.errstate(over="ignore", invalid="ignore"):
                frame = self._coupling.apart(frame)
        if self._live is None:
            return self._each_worked_out(frame)
        volts, clipped = np.empty(len(frame)), np.empty(len(frame), np.uint8)
        bad = self._live.plan(frame, volts, clipped, self._codes is None)
        if bad >= 0:
            raise self._refused(bad, "what is wanted", float(frame[bad]), wanted=True)
        if self._codes is not None and bad == -1:
            return self._coded(volts, clipped, self._codes)
        if bad < -1:
            raise self._broken(-2 - bad, float(volts[-2 - bad]))
        return volts.copy(), volts, clipped, None, None

    def _coded(
        self, volts: Floats, clipped: NDArray[np.uint8], codes: Codes
    ) -> Pending:
        """Return what a plan of codes comes to; the kernel has the states that their volts lead to."""
        planned, volts, most, saved, held_back = codes.next(
            volts, self._stand, self._saved
        )
        good = codes_may_follow(volts, self._stand, self._low, self._high, most)
        if not good.all():
            place = int(np.argmin(good))
            raise self._broken(place, float(volts[place]))
        self._live.follow(volts)
        return planned, volts, clipped | held_back, saved, None

    def _each_worked_out(self, frame: Floats) -> Pending:
        """Return what a plan comes to, of one controller after the other."""
        planned = []
        for channel, controller, value in zip(
            self.channels, self._controllers, frame.tolist(), strict=True
        ):
            try:
                planned.append(controller.plan(value))
            except DboError as problem:
                self._drop_all()
                raise type(problem)(f"channel {channel}: {problem}") from None
        held_back = np.array([controller.held_back for controller in self._controllers])
        return np.array(planned), None, held_back, None, None

    def _drop_all(self) -> None:
        """Leave nothing to commit in any channel."""
        for controller in self._controllers:
            controller.drop()

    def _followed(self, applied: ArrayLike, pending: Pending | None) -> Pending:
        """Return what applied volts, or codes, come to, after all of them were checked."""
        frame = self._frame(applied, "what was applied")
        volts = frame
        if self._codes is not None:
            volts = self._codes.volts_of(frame, self.channels)
        clipped = np.zeros(len(frame), np.bool_) if pending is None else pending[2]
        if self._live is None:
            self._require_played(volts)
            return frame, frame, clipped, None, None
        bad = self._live.follow(volts)
        if bad >= 0:
            raise self._refused(
                bad, "what was applied", float(volts[bad]), wanted=False
            )
        saved = None
        if self._codes is not None:
            saved = self._codes.left(volts, self._stand, self._saved)
        return frame, volts.copy(), clipped, saved, None

    def _take(self, pending: Pending) -> None:
        """Go on from what was worked out last."""
        _, volts, clipped, saved, _ = pending
        if self._live is None:
            applied = [None] * len(self.channels) if volts is None else volts.tolist()
            for controller, value in zip(self._controllers, applied, strict=True):
                controller.commit(value)
            self.clipped[:] = [controller.clipped for controller in self._controllers]
            self._begin()
            return
        self._live.commit()
        self._stand = volts
        if saved is not None:
            self._saved = saved
        self.clipped += clipped

    def _begin(self, stand: Floats | None = None) -> None:
        """Put channels that have begun into one bank of the kernel; what looks ahead, or lags, goes on alone.

        ``stand`` are the voltages that stand, where the bank is made again.
        """
        parts = [controller.begun for controller in self._controllers]
        begun = [part for part in parts if part is not None]
        if len(begun) < len(parts):
            return
        bounds = np.array(
            [controller.bounds for controller in self._controllers]
        ).T.copy()
        if stand is None:
            self._saved = np.array(
                [controller.saved for controller in self._controllers]
            )
        else:
            bounds[3] = stand
        self._low, self._high, self._stand = bounds[0], bounds[1], bounds[3]
        steppers, before, after = zip(*begun, strict=True)
        self._live = make_bank(steppers, before, after, bounds)

    def _require_played(self, volts: Floats) -> None:
        """Refuse a frame with a voltage that no channel takes (InputError)."""
        for place, (value, controller) in enumerate(
            zip(volts.tolist(), self._controllers, strict=True)
        ):
            if not controller.played_reach.low < value < controller.played_reach.high:
                raise self._refused(place, "what was applied", value, wanted=False)

    def _refused(self, place: int, what: str, value: float, wanted: bool) -> InputError:
        """Return why a value of a channel was refused."""
        controller = self._controllers[place]
        reach, unit = controller.played_reach, controller.units[0]
        if wanted:
            reach, unit = controller.wanted_reach, controller.units[1]
        return InputError(
            f"channel {self.channels[place]}: {refused(what, value, reach, unit)}"
        )

    def _broken(self, place: int, volts: float) -> GateError:
        """Return what the gate says about a frame that breaks a limit: a fault of this program."""
        return GateError(
            f"channel {self.channels[place]}: this program planned {volts!r}, which breaks its limits;"
            " nothing is to be played (please report it)"
        )

    def _frame(self, values: ArrayLike, what: str) -> Floats:
        """Return a number of each channel (InputError where they are none, or more, or fewer)."""
        if values.__class__ is np.ndarray and values.dtype.kind in "iuf":
            frame = np.ascontiguousarray(values, dtype=np.float64)
        else:
            frame = _checked(values, what)
        if frame.shape != (len(self.channels),):
            raise InputError(
                f"{what} has the shape {frame.shape}; give {len(self.channels)} values, one a channel"
            )
        return frame


def _checked(values: ArrayLike, what: str) -> Floats:
    """Return anything but an array of numbers as one (InputError where something in it is none)."""
    try:
        if np.ma.is_masked(values):
            raise TypeError
        array = np.asarray(
            values, dtype=None if isinstance(values, np.ndarray) else object
        )
        frame = np.empty(array.shape)
        for place, value in enumerate(array.reshape(-1).tolist()):
            frame.flat[place] = (
                value if value.__class__ is float else number(what, value)
            )
    except (TypeError, ValueError, InputError):
        raise InputError(f"{what} is no array of numbers") from None
    return frame


def _require_channels(
    name: str, values: Mapping[str, Any], channels: Sequence[str]
) -> None:
    """Refuse values of channels that are not there (UsageError)."""
    for channel in values:
        if channel not in channels:
            raise UsageError(f"`{name}`: there is no channel {channel!r}")


def _by_channel(name: str, value: Any, channels: Sequence[str]) -> list[Any]:
    """Return a limit of each channel: one for all, a list, or by name (UsageError where they do not fit)."""
    if isinstance(value, Mapping):
        _require_channels(name, value, channels)
        return [value.get(channel) for channel in channels]
    if value is None or np.ndim(value) == 0:
        return [value] * len(channels)
    if len(value) != len(channels):
        raise UsageError(f"`{name}`: {len(value)} values for {len(channels)} channels")
    return list(value)
