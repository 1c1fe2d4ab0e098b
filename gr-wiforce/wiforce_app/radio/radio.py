# SPDX-License-Identifier: GPL-3.0-or-later
"""A radio, opened and set up for a scene by one of its drivers; every refusal is one line."""

import contextlib
import importlib
import math
import os
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from typing import Any

from gnuradio.wiforce.blocks.usrp import require_rate
from gnuradio.wiforce.errors import InputError, printable

from .request import DRIVERS, RadioRequest

_LOCK_S = 1.0
_CARRIER_TOLERANCE_HZ = 10.0


class End(ABC):
    """One direction of a device: a driver's ``block``, with all channels in use."""

    def __init__(self, block, channels=1):
        self.block, self._channels = block, range(channels)

    @abstractmethod
    def set(self, name: str, value: object) -> None:
        """Set something of all channels by the block's method ``set_NAME``."""

    def get(self, name: str) -> Any:
        """What is set of the first channel."""
        return getattr(self.block, f"get_{name}")(0)

    @abstractmethod
    def set_rate(self, rate_hz: float) -> float:
        """Set the sample rate; the rate that the device takes."""

    @abstractmethod
    def set_carrier(self, carrier_hz: float) -> float:
        """Tune; the carrier that the device takes."""

    @abstractmethod
    def limits(self, name: str) -> tuple[float, float] | None:
        """Of the ``carrier``, ``gain`` or ``bandwidth``; None of a filter that cannot be set."""

    @abstractmethod
    def antennas(self) -> list[str]: ...

    @abstractmethod
    def locked(self) -> bool:
        """Whether the oscillator has locked; true where the device does not report it."""


class Radio(ABC):
    """Receiver and transmitter of a device, both with samples of ``item_type``.

    Drivers derive from it: they open the device, or raise DeviceAbsent, and know times and streams.
    ``source`` has an output per antenna, ``sink`` is None without transmitter.
    """

    has_time = True  # received samples are tagged with the device's time
    starts_together = True  # both streams start at one device time
    item_type = "sc16"  # or fc32
    hardware = ""  # kind and serial number
    serials: Sequence[str | None] = ()  # serial number, and that of another transmitter
    # By which a driver refuses a setting. UHD raises RuntimeError when a device does not answer.
    refusals: tuple[type[Exception], ...] = (ValueError, LookupError, ArithmeticError)

    def __init__(self, request: RadioRequest):
        self._name = request.scene_name
        self._receiver, self._transmitter = self._open(request)
        self.source = self._receiver.block
        self.sink = None if self._transmitter is None else self._transmitter.block
        if request.reference is not None:
            with self.applying("--reference", request.reference):
                _require_known("--reference", request.reference, self._clock_sources())
                self._set_clock_source(request.reference)
        for end in self._ends.values():
            self._set_rate(end, request.sample_rate_hz)
            self._set_carrier(end, request.center_frequency_hz)
        wanted = {
            "tx": ("--tx-gain", request.tx_gain_db, "--tx-antenna", request.tx_antenna),
            "rx": ("--rx-gain", request.rx_gain_db, "--antenna", request.rx_antenna),
        }
        for direction, end in self._ends.items():
            gain_option, gain_db, antenna_option, antenna = wanted[direction]
            if gain_db is None:
                self._set_first_gain(end)
            for name, option, value in (
                ("gain", gain_option, gain_db),
                ("antenna", antenna_option, antenna),
                ("bandwidth", "--bandwidth", request.bandwidth_hz),
            ):
                if value is not None:
                    with self.applying(option, value):
                        _check(option, end, name, value)
                        end.set(name, value)

    @contextlib.contextmanager
    def applying(
        self, where: str, *value: object, rule: str = "must be what the device's driver accepts"
    ) -> Iterator[None]:
        """Ask a driver within this for what the option or key ``where`` wants."""
        try:
            yield
        except InputError:
            raise
        except self.refusals as error:
            raise InputError(where, f"{rule} ({last_line(error)})", *value) from error

    @abstractmethod
    def _open(self, request: RadioRequest) -> tuple[End, End | None]:
        """Receiver and transmitter, the latter None where only the former is used."""

    def _set_first_gain(self, end: End) -> None:  # noqa: B027
        """Set the gain to begin with where none is asked for; the driver's own unless derived."""

    @abstractmethod
    def _clock_sources(self) -> list[str]: ...

    @abstractmethod
    def _set_clock_source(self, name: str) -> None: ...

    @property
    @abstractmethod
    def time_s(self) -> float:
        """Device time; the host's where the device has none."""

    def accepts_time(self, time_s: float) -> bool:
        """Whether a time of received samples is the device's; decided by the first one."""
        return True

    @abstractmethod
    def start_together(self, lead_s: float) -> float:
        """Schedule the start of both streams `lead_s` from now, where the driver can; its time."""

    def collect(self, samples: int, timeout_s: float) -> bool:
        """Say how many samples to hand over together, and how long to wait; whether it does."""
        return False

    @property
    def _ends(self) -> dict[str, End]:
        ends = {"tx": self._transmitter, "rx": self._receiver}
        return {direction: end for direction, end in ends.items() if end is not None}

    def unlocked(self) -> list[str]:
        """Directions (``tx``, ``rx``) whose oscillator has not locked after a second."""
        return [direction for direction, end in self._ends.items() if not _locks(end)]

    def settings(self) -> dict:
        """Gains and antennas as plain values for metadata."""
        gains = {f"{name}_gain_db": end.get("gain") for name, end in self._ends.items()}
        # Neither JSON nor SigMF has a NaN.
        known = {name: gain_db for name, gain_db in gains.items() if math.isfinite(gain_db)}
        return known | {f"{name}_antenna": end.get("antenna") for name, end in self._ends.items()}

    def _set_rate(self, end, rate_hz):
        where = f"{self._name}: radio.sample_rate_hz"
        with self.applying(where, rate_hz):
            actual = end.set_rate(rate_hz)
        require_rate(where, actual, rate_hz)

    def _set_carrier(self, end, carrier_hz):
        where = f"{self._name}: radio.center_frequency_hz"
        with self.applying(where, carrier_hz):
            actual = end.set_carrier(carrier_hz)
        if not abs(actual - carrier_hz) <= _CARRIER_TOLERANCE_HZ:  # nor a driver that states NaN
            with self.applying(where, carrier_hz):
                low, high = (limit / 1e6 for limit in end.limits("carrier"))
            rule = f"must lie in the device's range, {low:.6g} to {high:.6g} MHz"
            raise InputError(where, rule, carrier_hz)


def open_radio(request: RadioRequest) -> Radio:
    """The radio that is asked for, by its driver."""
    driver = DRIVERS[request.driver]
    return getattr(importlib.import_module(driver.module, __package__), driver.radio)(request)


def set_environment(values: dict[str, str]) -> None:
    """Set variables that a driver reads when it is loaded, unless a user has set them."""
    for name, value in values.items():
        os.environ.setdefault(name, value)


def last_line(error: Exception) -> str:
    """The last line of what a driver reports."""
    lines = str(error).strip().splitlines()
    return printable(lines[-1]).strip() if lines else type(error).__name__


def absent_rule(reason: str, finder: str) -> str:
    """What to do without a device, for a DeviceAbsent; ``finder`` lists those of the driver."""
    return (
        f"must name a device that answers ({reason}): {finder}; without a device, use "
        "`gr-wiforce emulate`, or `gr-wiforce read` for recordings"
    )


def _check(option, end, name, value):
    """Refuse a gain, antenna or bandwidth that the device has not."""
    if name == "antenna":
        _require_known(option, value, end.antennas())
        return
    limits = end.limits(name)
    if limits is None:
        raise InputError(option, "must not be given: this device's filter is fixed")
    unit, scale = ("dB", 1.0) if name == "gain" else ("MHz", 1e6)
    low, high = (limit / scale for limit in limits)
    if not low <= value / scale <= high:
        raise InputError(option, f"must be {low:.6g} to {high:.6g} {unit} with this device", value)


def _require_known(option, name, known):
    if not known:
        raise InputError(option, "must not be given: this device has nothing to choose from", name)
    if name not in known:
        raise InputError(option, f"must be one of {', '.join(known)}", name)


def _locks(end):
    deadline = time.monotonic() + _LOCK_S
    while not end.locked():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.05)
    return True
