# SPDX-License-Identifier: GPL-3.0-or-later
"""Faults on demand: what goes wrong, and at which device time."""

from dataclasses import dataclass

from gnuradio.wiforce.errors import InputError

from .wire import TICK_RATE

# Kind of fault -> converters of its arguments, the optional ones last and in brackets.
_KINDS = {
    "overflow": (("samples", int), ("[stop]", str)),
    "lose": (("packets", int),),
    "swap": (),
    "late": (("rx|tx", str),),
    "stall": (("seconds", float),),
    "clock": (("sensor", str), ("ppm", float)),
    "off": (("sensor", str),),
    "on": (("sensor", str),),
}

_MOST_PPM = 1000  # as in a scene
SENSOR_KINDS = tuple(kind for kind, args in _KINDS.items() if ("sensor", str) in args)
GRAMMAR = "; ".join(" ".join((kind, *(name for name, _ in args))) for kind, args in _KINDS.items())


@dataclass(frozen=True)
class Fault:
    """One fault.

    Attributes
    ----------
    time : int
        Ticks: of device time, or after the first received sample when `relative`.
    relative : bool
    kind : str
    arguments : tuple
    """

    time: int
    relative: bool
    kind: str
    arguments: tuple


def parse_fault(text, where="--fault"):
    """A fault from ``TIME KIND ARGUMENTS``.

    TIME is in seconds of device time; with a leading ``+``, in seconds after the first sample
    received since the device was opened. The kinds::

        overflow SAMPLES [stop]   report an overflow, lose so many samples, go on (or go idle)
        lose PACKETS              send nothing for so many packets, but count them
        swap                      send the next two packets in the wrong order
        late rx|tx                report the next receive command or transmit burst as late
        stall SECONDS             do nothing for so long, by the wall clock
        clock SENSOR PPM          the tag's clock offset is now PPM
        off SENSOR, on SENSOR     the tag's switches stop, go on

    Raises
    ------
    InputError
        When it doesn't follow this grammar.
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


def _convert(kind, arguments, text, where):
    wanted = _KINDS[kind]
    required = sum(not name.startswith("[") for name, _ in wanted)
    usage = " ".join((kind, *(name for name, _ in wanted)))
    if not required <= len(arguments) <= len(wanted):
        raise InputError(where, f"must read TIME {usage}", text)
    converted = []
    for (name, convert), argument in zip(wanted, arguments, strict=False):
        try:
            value = convert(argument)
        except ValueError:
            raise InputError(where, f"{name} must be a number in TIME {usage}", text) from None
        choices = name.strip("[]").split("|")
        if convert is str and name != "sensor" and value not in choices:
            raise InputError(where, f"must read TIME {usage}", text)
        if name == "ppm" and not abs(value) <= _MOST_PPM:
            rule = f"ppm must lie from -{_MOST_PPM:g} to {_MOST_PPM:g} in TIME {usage}"
            raise InputError(where, rule, text)
        if convert is not str and name != "ppm" and not 0 < value < 1e9:
            raise InputError(where, f"{name} must be positive in TIME {usage}", text)
        converted.append(value)
    return tuple(converted)


class FaultQueue:
    """Faults that are still to come."""

    def __init__(self):
        self._faults = []

    def add(self, fault):
        self._faults.append(fault)

    def next_tick(self, clock, origin):
        """Tick of the first fault, or None; `origin` is that of the first sample, or None."""
        ticks = [t for fault in self._faults if (t := _tick(fault, clock, origin)) is not None]
        return min(ticks, default=None)

    def due(self, clock, origin):
        """Faults whose tick has come, earliest first; they leave the queue."""
        timed = [(_tick(fault, clock, origin), fault) for fault in self._faults]
        due = [(t, f) for t, f in timed if t is not None and t <= clock.ticks]
        self._faults = [f for t, f in timed if t is None or t > clock.ticks]
        return [fault for _, fault in sorted(due, key=lambda pair: pair[0])]


def _tick(fault, clock, origin):
    if fault.relative:
        return None if origin is None else origin + fault.time
    return clock.to_ticks(fault.time)
