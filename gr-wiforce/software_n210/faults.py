# SPDX-License-Identifier: GPL-3.0-or-later
"""Faults on demand: what goes wrong, when, and what it does to the device."""

import time
from dataclasses import dataclass

from gnuradio.wiforce.errors import InputError

from .wire import TICK_RATE


def _set_clock(hardware, sensor, ppm):
    hardware.air.sensor(sensor).clock.retune(hardware.air.time_s, ppm)


def _switch_off(hardware, sensor):
    hardware.air.sensor(sensor).on = False


def _switch_on(hardware, sensor):
    hardware.air.sensor(sensor).on = True


# Arguments of each kind, and what it does to the hardware.
_KINDS = {
    "overflow": ("samples", lambda hardware, samples: hardware.receive.overflow(samples)),
    "lose": ("packets", lambda hardware, packets: hardware.receive.packets.lose(packets)),
    "stall": ("seconds", lambda hardware, seconds: time.sleep(seconds)),
    "clock": ("sensor ppm", _set_clock),
    "off": ("sensor", _switch_off),
    "on": ("sensor", _switch_on),
}
# Arguments that are numbers: type and limits, those of ppm as in a scene.
_NUMBERS = {
    "samples": (int, 1, 1e9),
    "packets": (int, 1, 1e9),
    "seconds": (float, 1e-6, 1e9),
    "ppm": (float, -1000, 1000),
}
GRAMMAR = "; ".join(f"{kind} {arguments}".rstrip() for kind, (arguments, _) in _KINDS.items())


@dataclass(frozen=True)
class Fault:
    """One fault, at ticks of device time or, ``relative``, after the first received sample."""

    time: int
    relative: bool
    kind: str
    arguments: tuple


def parse_fault(text: str, where: str = "--fault") -> Fault:
    """A fault from ``TIME KIND ARGUMENTS``.

    TIME is in seconds of device time or, with a leading ``+``, in seconds after the first sample
    that was received since the device was opened; given while nothing streams, they wait for the
    next stream. The kinds are::

        overflow SAMPLES        report an overflow, lose SAMPLES and continue
        lose PACKETS            number the next packets but do not send them
        stall SECONDS           do nothing for SECONDS of wall time
        clock SENSOR PPM        set the clock offset of a tag
        off SENSOR, on SENSOR   stop or start the switches of a tag

    ``where``: named in the error.
    """
    time, *rest = text.split() or [""]
    kind, *arguments = rest or [""]
    try:
        ticks = round(float(time) * TICK_RATE)
    except (ValueError, OverflowError):
        ticks = -1
    if ticks < 0:
        raise InputError(where, "must begin with a time in seconds, not negative", text)
    if kind not in _KINDS:
        raise InputError(where, f"must be one of: {GRAMMAR}", text)
    return Fault(ticks, time.startswith("+"), kind, _convert(kind, arguments, text, where))


def _convert(kind, texts, text, where):
    """Arguments as numbers and words, each checked."""
    wanted = _KINDS[kind][0].split()
    form = " ".join(("TIME", kind, *wanted))
    if len(texts) != len(wanted):
        raise InputError(where, f"must have the form {form}", text)
    converted = []
    for name, argument in zip(wanted, texts, strict=True):
        if name in _NUMBERS:
            convert, low, high = _NUMBERS[name]
            try:
                argument = convert(argument)
            except ValueError:
                raise InputError(where, f"{name} must be a number in {form}", text) from None
            if not low <= argument <= high:
                raise InputError(where, f"{name} must be {low:g} to {high:g} in {form}", text)
        converted.append(argument)
    return tuple(converted)


def check_fault(fault, air):
    """Raise an InputError when a fault names a sensor that is not on the air."""
    if _KINDS[fault.kind][0].startswith("sensor"):
        air.sensor(fault.arguments[0])


def apply_fault(fault, hardware):
    """Let a fault happen now."""
    _KINDS[fault.kind][1](hardware, *fault.arguments)


class FaultQueue:
    """Scheduled faults; relative ones given between two streams belong to the next one."""

    def __init__(self):
        self._faults, self._waiting = [], []

    def add(self, fault):
        (self._waiting if fault.relative else self._faults).append(fault)

    def begin(self):
        """Schedule the relative faults, as a stream runs."""
        self._faults += self._waiting
        self._waiting = []

    def next_tick(self, clock, origin):
        """Tick of the first fault, or None; `origin` is the tick of the first sample, or None."""
        ticks = [t for fault in self._faults if (t := _tick(fault, clock, origin)) is not None]
        return min(ticks, default=None)

    def due(self, clock, origin):
        """Faults that are due, earliest first; they leave the queue."""
        timed = [(_tick(fault, clock, origin), fault) for fault in self._faults]
        due = [(t, f) for t, f in timed if t is not None and t <= clock.ticks]
        self._faults = [f for t, f in timed if t is None or t > clock.ticks]
        return [fault for _, fault in sorted(due, key=lambda pair: pair[0])]


def _tick(fault, clock, origin):
    if fault.relative:
        return None if origin is None else origin + fault.time
    return clock.to_ticks(fault.time)
