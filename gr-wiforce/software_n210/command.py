# SPDX-License-Identifier: GPL-3.0-or-later
"""The command that runs a software N210: ``gr-wiforce emulate``, ``python3 -m software_n210``."""

import signal
import sys
from contextlib import closing

import click
from gnuradio.wiforce.errors import InputError

from .air.cable import Cable, Counter
from .air.frontend import DAUGHTERBOARDS
from .console import Console, LineControl, ZmqControl
from .device import Device
from .faults import GRAMMAR, parse_fault
from .wire import TICK_RATE

_DEFAULT_DELAY_US = 5.12  # 64 samples at 12.5 Msps
_MOST_DELAY_US = 1000.0


@click.command(
    epilog="While it runs it accepts lines on standard input and requests on --control: "
    "'press SENSOR FORCE_N LOCATION_MM', 'release SENSOR', 'fault TIME KIND ...', "
    "'status', 'sent', 'stop'. Each is answered with a line of JSON."
)
@click.argument("scene", required=False)
@click.option(
    "--bind", default="127.0.0.1", show_default=True, help="Loopback address to listen at."
)
@click.option(
    "--daughterboard",
    type=click.Choice(list(DAUGHTERBOARDS)),
    default="SBX",
    show_default=True,
    help="Daughterboard of the device.",
)
@click.option(
    "--air",
    type=click.Choice(["scene", "cable", "counter"]),
    default="scene",
    show_default=True,
    help="What connects transmit to receive: SCENE or a cable. 'counter' receives the device "
    "time in samples.",
)
@click.option(
    "--delay-us",
    type=float,
    default=_DEFAULT_DELAY_US,
    show_default=True,
    help="Delay of the device itself, from transmit to receive.",
)
@click.option(
    "--fault",
    "faults",
    multiple=True,
    metavar="'TIME KIND ...'",
    help="Schedule a fault at a device time in seconds or, with a leading +, at a time after the "
    f"first received sample. May be repeated. Kinds: {GRAMMAR}.",
)
@click.option(
    "--speed",
    type=float,
    default=1.0,
    show_default=True,
    help="Device seconds per second of wall time, at most.",
)
@click.option(
    "--real-time", is_flag=True, help="Lose samples when the host is slow, instead of waiting."
)
@click.option(
    "--control", metavar="ENDPOINT", help="Accept requests by ZMQ: PORT or tcp://127.0.0.1:PORT."
)
def emulate(scene, bind, daughterboard, air, delay_us, faults, speed, real_time, control):
    """Run a software USRP N210 with SCENE on the air.

    Unmodified UHD programs open it with --args addr=127.0.0.1.
    """
    names = {"speed": "--speed", "sensor": "--fault: sensor"}
    try:
        device = Device(
            _air(air, scene, _delay_ticks(delay_us)),
            bind,
            daughterboard,
            speed,
            lossless=not real_time,
            faults=[parse_fault(text) for text in faults],
        )
    except InputError as error:
        raise error.renamed(names) from error
    with closing(device):
        console = Console(device)
        LineControl(console, device, sys.stdin.fileno(), sys.stdout)
        zmq_control = ZmqControl(console, device, control) if control else None
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: device.stop())
        print(f"listening: N210 with {daughterboard}, --args addr={bind}", flush=True)
        try:
            device.run()
        finally:
            if zmq_control:
                zmq_control.close()
        click.echo(_summary(device.status()), err=True)


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
    if kind == "counter":
        return Counter(delay_ticks)
    if scene is None:
        raise InputError("SCENE", "is required unless --air is cable or counter")
    # Imported here, since a cable starts in a fraction of the time that a scene takes to load.
    from gnuradio.wiforce.scene import load_scene

    from .air.scene_air import SceneAir

    return SceneAir(load_scene(scene), delay_ticks)


def _summary(status):
    counts = {key: value for key, value in status.items() if type(value) is int and value}
    text = ", ".join(f"{key.replace('_', ' ')} {value}" for key, value in counts.items())
    return f"stopped at {status['device_time_s']:.3f} s of device time" + (text and f"; {text}")
