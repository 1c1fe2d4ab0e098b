# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce emulate``: its options and the console that controls a running device."""

import json
import math
import os
import signal
import stat
import sys
from contextlib import closing

import click
from gnuradio.wiforce.errors import InputError

from .device import GRAMMAR, Device, parse_fault
from .frontend import Cable
from .wire import TICK_RATE

_USAGE = {
    "press": "press SENSOR FORCE_N LOCATION_MM",
    "release": "release SENSOR",
    "fault": "fault TIME KIND [ARGUMENTS]",
    "status": "status",
    "sent": "sent",
    "stop": "stop",
}
_COMMANDS = "; ".join(_USAGE.values())


class Console:
    """Lines on a file descriptor, answers on a stream; the end of a pipe ends the device.

    In the background of a terminal nothing is read: it would stop the process.
    """

    def __init__(self, device, descriptor, out):
        self._device, self._descriptor, self._out = device, descriptor, out
        self._rest = b""
        device.watched[descriptor] = self._read

    def _read(self):
        if _in_background(self._descriptor):
            del self._device.watched[self._descriptor]
            return
        data = os.read(self._descriptor, 65536)
        if not data:
            del self._device.watched[self._descriptor]
            if stat.S_ISFIFO(os.fstat(self._descriptor).st_mode):
                self._device.stop()
            return
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            if line.strip():
                print(self._answer(line.decode("utf-8", "replace")), file=self._out)
        self._out.flush()

    def _answer(self, line):
        """Execute a line; JSON with ``ok``, and ``error`` or the requested values."""
        try:
            return json.dumps({"ok": True, **self._do(line)})
        except InputError as error:
            return json.dumps({"ok": False, "error": str(error)})

    def _do(self, line):
        name, *arguments = line.split() or [""]
        if name not in _USAGE:
            raise InputError("control", f"must be one of: {_COMMANDS}", line)
        if name != "fault" and len(arguments) != len(_USAGE[name].split()) - 1:
            raise InputError("control", f"must have the form: {_USAGE[name]}", line)
        return getattr(self, f"_{name}")(*arguments) or {}

    def _press(self, sensor, force, location):
        air = self._device.air
        pressed = air.sensor(sensor).pressed
        try:
            force_n, location_mm = float(force), float(location)
        except ValueError:
            rule = f"must have the form: {_USAGE['press']}, with a decimal point"
            raise InputError("control", rule, f"{force} {location}") from None
        if not 0 <= force_n < 1000:
            raise InputError("press", "the force must be 0 to 1000 N", force_n)
        if not 0 <= location_mm <= pressed.length_mm:
            rule = f"the location must be 0 to {pressed.length_mm:g} mm, the length of {sensor}"
            raise InputError("press", rule, location_mm)
        pressed.hold(force_n, location_mm)
        notes = [air.beyond_calibration(sensor, force_n, location_mm)] if force_n else []
        again = "press again once it says that sensors may be pressed"
        status = self._device.status()
        if not status["rx_streaming"]:
            notes.append(f"no reader is connected, and this press ends when one starts: {again}")
        elif status["streaming_s"] <= air.reference_s:
            notes.append(f"the reader's reference must be untouched: release it, and {again}")
        note = "; ".join(filter(None, notes))
        return {"note": note} if note else {}

    def _release(self, sensor):
        self._device.air.sensor(sensor).pressed.hold(0.0, math.nan)

    def _fault(self, *arguments):
        self._device.add_fault(parse_fault(" ".join(arguments), "fault"))

    def _status(self):
        return self._device.status()

    def _sent(self):
        return {"sent_s": self._device.take_sent()}

    def _stop(self):
        self._device.stop()


def _in_background(descriptor):
    try:
        return os.tcgetpgrp(descriptor) != os.getpgrp()
    except OSError:  # no terminal of this session
        return False


_DEFAULT_DELAY_US = 5.12  # 64 samples at 12.5 Msps
_MOST_DELAY_US = 1000.0


@click.command(
    epilog="While it runs it accepts lines on standard input: "
    "'press SENSOR FORCE_N LOCATION_MM', 'release SENSOR', 'fault TIME KIND ...', "
    "'status', 'sent', 'stop'. Each is answered with a line of JSON."
)
@click.argument("scene", required=False)
@click.option("--bind", default="127.0.0.1", help="Loopback address to listen at.")
@click.option(
    "--air",
    type=click.Choice(["scene", "cable"]),
    default="scene",
    help="What connects transmit to receive: SCENE or a cable.",
)
@click.option(
    "--delay-us",
    type=float,
    default=_DEFAULT_DELAY_US,
    help="Delay of the device itself, from transmit to receive.",
)
@click.option(
    "--fault",
    "faults",
    multiple=True,
    metavar="'TIME KIND ...'",
    help="Schedule a fault at a time in seconds after the first received sample. May be repeated. "
    f"Kinds: {GRAMMAR}.",
)
@click.option(
    "--speed",
    type=float,
    default=1.0,
    help="Device seconds per second of wall time, at most.",
)
def emulate(scene, bind, air, delay_us, faults, speed):
    """Run a software USRP N210 with SCENE on the air.

    Unmodified UHD programs open it with --args addr=127.0.0.1.
    """
    names = {"speed": "--speed", "sensor": "--fault: sensor"}
    try:
        device = Device(
            _air(air, scene, _delay_ticks(delay_us)),
            bind,
            speed,
            faults=[parse_fault(text) for text in faults],
        )
    except InputError as error:
        raise error.renamed(names) from error
    with closing(device):
        Console(device, sys.stdin.fileno(), sys.stdout)
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: device.stop())
        print(f"listening: N210 with an SBX, --args addr={bind}", flush=True)
        click.echo(f"commands: {_COMMANDS}", err=True)
        device.run()
        stopped_s = device.status()["device_time_s"]
        click.echo(f"stopped at {stopped_s:.3f} s of device time", err=True)


def _delay_ticks(delay_us):
    if not 0 <= delay_us <= _MOST_DELAY_US:
        rule = f"must be 0 to {_MOST_DELAY_US:g} microseconds"
        raise InputError("--delay-us", rule, delay_us)
    return round(delay_us * 1e-6 * TICK_RATE)


def _air(kind, scene, delay_ticks):
    if kind != "scene" and scene is not None:
        raise InputError("SCENE", f"has no use with --air {kind}", scene)
    if kind == "cable":
        return Cable(delay_ticks)
    if scene is None:
        raise InputError("SCENE", "is required unless --air is cable")
    # Imported here, since a cable starts in a fraction of the time that a scene takes to load.
    from gnuradio.wiforce.scene import load_scene

    from .scene_air import SceneAir

    return SceneAir(load_scene(scene), delay_ticks)
