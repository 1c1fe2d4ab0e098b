# SPDX-License-Identifier: GPL-3.0-or-later
"""Faults on demand: what goes wrong, when, and what it does to the device."""

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
    "clock": ("sensor ppm", _set_clock),
    "off": ("sensor", _switch_off),
    "on": ("sensor", _switch_on),
}
# Arguments that are numbers: type and limits, those of ppm as in a scene.
_NUMBERS = {
    "samples": (int, 1, 1e9),
    "packets": (int, 1, 1e9),
    "ppm": (float, -1000, 1000),
}
GRAMMAR = "; ".join(f"{kind} {arguments}".rstrip() for kind, (arguments, _) in _KINDS.items())


@dataclass(frozen=True)
class Fault:
    """One fault, so many ticks after the first received sample."""

    time: int
    kind: str
    arguments: tuple

    def check(self, air):
        """Raise an InputError when it names a sensor that is not on the air."""
        if _KINDS[self.kind][0].startswith("sensor"):
            air.sensor(self.arguments[0])

    def apply(self, hardware):
        """Let it happen now."""
        _KINDS[self.kind][1](hardware, *self.arguments)


def parse_fault(text: str, where: str = "--fault") -> Fault:
    """A fault from ``TIME KIND ARGUMENTS``.

    TIME is in seconds after the first sample that was received since the device was opened. Faults
    that are given while it is closed wait for the next host. The kinds are::

        overflow SAMPLES        report an overflow, lose SAMPLES and continue
        lose PACKETS            number the next packets but do not send them
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
    return Fault(ticks, kind, _convert(kind, arguments, text, where))


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
