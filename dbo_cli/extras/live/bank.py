"""Live use of many channels: arrays in, arrays out, one call of the kernel a frame.

The rules are those of one channel's ``Controller``: plan, hand over, commit; the same bits, the same gate.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dbo_cli.drives.gate import Floats, GateError
from dbo_cli.errors import DboError, InputError, UsageError
from dbo_cli.extras.channels.model_set import Coupling
from dbo_cli.extras.live.controller import Controller
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.hysteresis.model_state import ModelState
from dbo_cli.hysteresis.stepper import ROUNDING, make_bank


class Bank:
    """The drives of the forward models of a set, frame by frame; made by ``ModelSet.controller``.

    Attributes
    ----------
    channels : tuple of str
        The order of the arrays.
    clipped : array of int
        Committed samples of each channel in which the limits of its drive were met.
    planned : array or None
        What was planned and is not committed yet.
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
        own = {name: _by_channel(name, value, self.channels) for name, value in limits.items()}
        self._controllers = []
        for place, (channel, model) in enumerate(models.items()):
            options = {name: values[place] for name, values in own.items()}
            options |= {"state": states[channel]} if states else {}
            try:
                self._controllers.append(Controller(model, sample_rate, dac=dac, **options))
            except DboError as problem:
                raise type(problem)(f"channel {channel}: {problem}") from None
        self._coupling = coupling
        self._codes = None if dac is None else Codes(dac, self._controllers)
        count = len(self.channels)
        self._live: Any = None
        self._volts, self._stand = np.zeros(count), np.zeros(count)
        self._clipped_now = np.zeros(count, np.uint8)
        self.clipped = np.zeros(count, np.int64)
        self.planned: NDArray[Any] | None = None

    def plan(self, displacements: ArrayLike) -> NDArray[Any]:
        """Return the voltage (the code, with a converter) of each channel; nothing changes yet.

        Parameters
        ----------
        displacements : array_like of shape (channels,)
            What is wanted at this sample, in the unit of each model's output.

        Raises
        ------
        InputError
            There are more or fewer than channels, or one is not a finite number.
        LimitError
            A drive cannot begin within its limits.
        """
        wanted = self._frame(displacements, "what is wanted")
        if self._coupling is not None and np.isfinite(wanted).all():
            wanted = self._coupling.apart(wanted)
        if self._live is None:
            planned = []
            for channel, one, value in zip(self.channels, self._controllers, wanted.tolist(), strict=True):
                try:
                    planned.append(one.plan(value))
                except DboError as problem:
                    raise type(problem)(f"channel {channel}: {problem}") from None
            self.planned = np.array(planned)
            return self.planned
        bad = self._live.plan(wanted, self._volts, self._clipped_now, self._codes is None)
        if bad >= 0:
            raise InputError(
                f"channel {self.channels[bad]}: what is wanted is not a finite number: {wanted[bad]!r}"
            )
        if self._codes is not None and bad == -1:
            self.planned = self._codes.plan(self._volts)
            self._volts, bad = self._codes.volts, self._codes.broken()
        elif bad == -1:
            self.planned = self._volts.copy()
        if bad < -1:
            place = -2 - bad
            raise GateError(
                f"channel {self.channels[place]}: this program planned {self._volts[place]!r}, which breaks "
                "its limits; nothing is to be played (please report it)"
            )
        assert self.planned is not None
        return self.planned

    def commit(self, applied: ArrayLike | None = None) -> None:
        """Go on from what was planned, or from what was ``applied`` instead (volts, or codes), a value each.

        Raises
        ------
        UsageError
            Nothing was planned, and nothing applied is given.
        InputError
            What was applied is not a finite number for each channel.
        """
        if applied is None and self.planned is None:
            raise UsageError("nothing was planned to be committed: call plan first")
        if self._live is None:
            given: Sequence[Any] = [None] * len(self.channels)
            if applied is not None:
                given = self._frame(applied, "what was applied").tolist()
            for controller, value in zip(self._controllers, given, strict=True):
                controller.commit(value)
            self.clipped[:] = [one.clipped for one in self._controllers]
            self._begin()
        else:
            self._go_on(applied)
            self.clipped += self._clipped_now
        self._clipped_now[:] = 0
        self.planned = None

    def step(self, displacements: ArrayLike) -> NDArray[Any]:
        """Plan and commit at once, where the hardware takes what it is given."""
        planned = self.plan(displacements)
        self.commit()
        return planned

    @property
    def states(self) -> dict[str, ModelState | None]:
        """The committed state of each channel, to go on from; None before the first."""
        return {name: one.state for name, one in zip(self.channels, self._controllers, strict=True)}

    def __getstate__(self) -> dict[str, Any]:
        """Pickle the committed states; what was planned stays behind."""
        return self.__dict__ | {"planned": None, "_live": self._live is not None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Go on from committed states."""
        self.__dict__.update(state)
        live, self._live = self._live, None
        if live:
            self._begin(self._stand)

    def _go_on(self, applied: ArrayLike | None) -> None:
        """Go on in the kernel: from the plan, or from other voltages (of codes)."""
        volts = self._volts
        if applied is None and self._codes is None:
            self._live.commit()
            self._stand[:] = volts
            return
        if applied is not None:
            volts = self._frame(applied, "what was applied")
            volts = volts if self._codes is None else self._codes.volts_of(volts, self.channels)
        bad = self._live.apply(volts)
        if bad >= 0:
            raise InputError(f"channel {self.channels[bad]}: what was applied is not a finite number")
        if self._codes is not None:
            self._codes.commit(volts)
        self._stand[:] = volts

    def _begin(self, stand: Floats | None = None) -> None:
        """Put channels that have begun into one bank of the kernel; what looks ahead, or lags, goes on alone.

        ``stand`` are the voltages that stand, where the bank is made again.
        """
        parts = [one.begun for one in self._controllers]
        begun = [one for one in parts if one is not None]
        if len(begun) < len(parts):
            return
        limits = np.array([one.bounds for one in self._controllers]).T.copy()  # low, high, most and last
        if stand is not None:
            limits[3] = stand
        elif self._codes is not None:
            self._codes.begin(limits)
        steppers, before, after = zip(*begun, strict=True)
        self._live, self._stand = make_bank(steppers, before, after, limits), limits[3].copy()

    def _frame(self, values: ArrayLike, what: str) -> Floats:
        try:
            frame = np.ascontiguousarray(values, dtype=np.float64)
        except (TypeError, ValueError):
            raise InputError(f"{what} is no array of numbers") from None
        if frame.shape != (len(self.channels),):
            raise InputError(
                f"{what} has the shape {frame.shape}; give {len(self.channels)} values, one a channel"
            )
        return frame


class Codes:
    """One converter's curve for all channels; the rules of ``converter.Converter``, on arrays.

    Parameters
    ----------
    dac
        The voltage of every code from 0 on, rising.
    controllers
        Of the channels; each has checked the curve against its own limits.
    """

    def __init__(self, dac: ArrayLike, controllers: Sequence[Controller]) -> None:
        self._curve = np.ascontiguousarray(dac, dtype=np.float64)
        gaps = np.diff(self._curve)
        self._widest = float(gaps.max())
        self._gaps = np.maximum(np.concatenate([gaps[:1], gaps]), np.concatenate([gaps, gaps[-1:]]))
        self._controllers = controllers

    def begin(self, limits: Floats) -> None:
        """Take over from the controllers: rows low, high, most, last, a column of each channel."""
        self._low, self._high, _, self.last = limits.copy()
        own = [(one.converter.step, one.converter.saved) for one in self._controllers if one.converter]
        self._step = np.array([np.nan if step is None else step for step, _ in own])
        self._saved = np.array([saved for _, saved in own])
        self._first = np.searchsorted(self._curve, self._low, "left")
        self._final = np.searchsorted(self._curve, self._high, "right") - 1

    def plan(self, volts: Floats) -> NDArray[np.int64]:
        """Return the code nearest to each voltage, of those within range and slew."""
        curve, last, end = self._curve, self.last, len(self._curve) - 1
        place = np.searchsorted(curve, last, "left")
        fine = np.maximum(self._step, self._gaps[np.minimum(place, end)])
        self._most = np.where(
            self._step < self._widest, np.minimum(self._saved + self._step, fine), self._step
        )
        after = np.searchsorted(curve, volts, "left")
        between = (after > 0) & (after <= end)
        above, below = curve[np.minimum(after, end)], curve[np.maximum(after - 1, 0)]
        near = after - (between & (above - volts >= volts - below))
        near = np.clip(near, self._first, self._final)
        change = curve[near] - last
        far = ~((-self._most <= change) & (change <= self._most)) & ~np.isnan(self._most)
        low = np.maximum(self._first, np.searchsorted(curve, last - self._most, "left"))
        high = np.minimum(self._final, np.searchsorted(curve, last + self._most, "right") - 1)
        none = np.clip(place, self._first, self._final)
        codes = np.where(far, np.where(low > high, none, np.clip(near, low, high)), near)
        self.volts = curve[codes]
        return codes

    def broken(self) -> int:
        """Return -1, or -2 - k where the voltage of channel k breaks its limits: the gate on arrays."""
        volts, last, low, high = self.volts, self.last, self._low, self._high
        inside = (low <= volts) & (volts <= high)
        inside |= (last < low) & (last <= volts) & (volts <= low)
        inside |= (last > high) & (high <= volts) & (volts <= last)
        digits = ROUNDING * np.maximum(np.abs(last), np.abs(volts))
        inside &= np.isnan(self._most) | (np.abs(volts - last) <= self._most + digits)
        return -1 if inside.all() else -2 - int(np.argmin(inside))

    def volts_of(self, codes: Floats, channels: Sequence[str]) -> Floats:
        """Return the voltages of codes (InputError where one is none)."""
        good = (codes == np.floor(codes)) & (codes >= 0) & (codes < len(self._curve))
        if not good.all():
            place = int(np.argmin(good))
            raise InputError(
                f"channel {channels[place]}: code {codes[place]:g} is not one of the converter's, 0 to"
                f" {len(self._curve) - 1}"
            )
        return self._curve[codes.astype(np.int64)]

    def commit(self, volts: Floats) -> None:
        """Take what a change used off what was saved up."""
        saved = np.maximum(self._most - np.abs(volts - self.last), 0.0)
        self._saved = np.where(np.isnan(self._most), self._saved, saved)
        self.last = volts.copy()


def _by_channel(name: str, value: Any, channels: Sequence[str]) -> list[Any]:
    """Return a limit of each channel: one for all, a list, or by name (UsageError where they do not fit)."""
    if isinstance(value, Mapping):
        value = [value.get(channel) for channel in channels]
    if value is None or np.ndim(value) == 0:
        return [value] * len(channels)
    if len(value) != len(channels):
        raise UsageError(f"`{name}`: {len(value)} values for {len(channels)} channels")
    return [None if one is None else float(one) for one in value]
