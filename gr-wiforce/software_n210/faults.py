# SPDX-License-Identifier: GPL-3.0-or-later
"""Faults on demand: what goes wrong, when, and what it does to the device."""

import time
from collections.abc import Callable
from dataclasses import dataclass

from gnuradio.wiforce.errors import InputError

from .wire import TICK_RATE

_MOST_PPM = 1000  # as in a scene


@dataclass(frozen=True)
class _Kind:
    """Names and converters of a fault's arguments, optional ones in brackets; what it does."""

    arguments: tuple
    apply: Callable


def _overflow(hardware, samples, stop=None):
    hardware.receive[0].overflow(samples, restart=stop is None)


def _late(hardware, which):
    (hardware.receive[0] if which == "rx" else hardware.transmit).make_late()


_KINDS = {
    "overflow": _Kind((("samples", int), ("[stop]", str)), _overflow),
    "lose": _Kind((("packets", int),), lambda hw, packets: hw.receive[0].packets.lose(packets)),
    "swap": _Kind((), lambda hw: hw.receive[0].packets.swap()),
    "late": _Kind((("rx|tx", str),), _late),
    "cut": _Kind((("seconds", float),), lambda hw, seconds: hw.network.cut(seconds)),
    "stall": _Kind((("seconds", float),), lambda hw, seconds: time.sleep(seconds)),
    "clock": _Kind(
        (("sensor", str), ("ppm", float)),
        lambda hw, sensor, ppm: hw.air.set_clock_offset(sensor, ppm),
    ),
    "off": _Kind((("sensor", str),), lambda hw, sensor: hw.air.switch_tag(sensor, on=False)),
    "on": _Kind((("sensor", str),), lambda hw, sensor: hw.air.switch_tag(sensor, on=True)),
}


def _usage(name):
    return " ".join((name, *(argument for argument, _ in _KINDS[name].arguments)))


GRAMMAR = "; ".join(_usage(name) for name in _KINDS)


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

        overflow SAMPLES [stop]   report an overflow and lose SAMPLES; then continue, or go idle
        lose PACKETS              number the next packets but do not send them
        swap                      exchange the next two packets
        late rx|tx                report the next receive command or transmit burst as late
        cut SECONDS               send half of the next packet, then let nothing pass in either
                                  direction for SECONDS of wall time
        stall SECONDS             do nothing for SECONDS of wall time
        clock SENSOR PPM          set the clock offset of a tag
        off SENSOR, on SENSOR     stop or start the switches of a tag

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
    wanted, form = _KINDS[kind].arguments, f"TIME {_usage(kind)}"
    required = sum(not name.startswith("[") for name, _ in wanted)
    if not required <= len(texts) <= len(wanted):
        raise InputError(where, f"must have the form {form}", text)
    converted = []
    for (name, convert), argument in zip(wanted, texts, strict=False):
        try:
            value = convert(argument)
        except ValueError:
            raise InputError(where, f"{name} must be a number in {form}", text) from None
        choices = name.strip("[]").split("|")
        if convert is str and name != "sensor" and value not in choices:
            raise InputError(where, f"must have the form {form}", text)
        if name == "ppm" and not abs(value) <= _MOST_PPM:
            rule = f"ppm must lie from -{_MOST_PPM:g} to {_MOST_PPM:g} in {form}"
            raise InputError(where, rule, text)
        if convert is not str and name != "ppm" and not 0 < value < 1e9:
            raise InputError(where, f"{name} must be positive in {form}", text)
        converted.append(value)
    return tuple(converted)


def check_fault(fault, air):
    """Raise an InputError when a fault names a sensor that is not on the air."""
    for (name, _), value in zip(_KINDS[fault.kind].arguments, fault.arguments, strict=False):
        if name == "sensor":
            air.check_sensor(value)


def apply_fault(fault, hardware):
    """Let a fault happen now."""
    _KINDS[fault.kind].apply(hardware, *fault.arguments)


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
