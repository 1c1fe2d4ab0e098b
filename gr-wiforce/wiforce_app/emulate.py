# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce emulate``: a software USRP N210 with the scene on the air."""

import signal
import sys
from contextlib import closing

import click
from gnuradio.wiforce.errors import InputError
from software_n210.air import Cable, Counter
from software_n210.console import Console, LineControl, ZmqControl
from software_n210.engine import Device
from software_n210.faults import GRAMMAR, parse_fault
from software_n210.frontend import DAUGHTERBOARDS
from software_n210.wire import TICK_RATE

from .ranges import FiniteRange

_DEFAULT_DELAY_US = 5.12


@click.command(
    epilog="While it runs it takes lines on standard input, and on --control: "
    "'press SENSOR FORCE_N LOCATION_MM', 'release SENSOR', 'fault TIME KIND ...', "
    "'status', 'stop'; each is answered by a line of JSON."
)
@click.argument("scene", required=False)
@click.option("--bind", default="127.0.0.1", show_default=True, help="Loopback address.")
@click.option(
    "--daughterboard",
    type=click.Choice(list(DAUGHTERBOARDS)),
    default="SBX",
    show_default=True,
    help="Board that the device says it has.",
)
@click.option(
    "--air",
    type=click.Choice(["scene", "cable", "counter"]),
    default="scene",
    show_default=True,
    help="Between the connectors: the scene, a cable, or a count of samples instead.",
)
@click.option(
    "--delay-us",
    type=FiniteRange(0, 1000),
    default=_DEFAULT_DELAY_US,
    show_default=True,
    help="Delay of the device itself, from transmit to receive.",
)
@click.option(
    "--fault",
    "faults",
    multiple=True,
    metavar="'TIME KIND ...'",
    help="Fault at a device time in seconds, or with a leading + after the first received "
    f"sample; may be repeated. Kinds: {GRAMMAR}.",
)
@click.option(
    "--speed",
    type=FiniteRange(0.001, 1000),
    default=1.0,
    show_default=True,
    help="Device seconds per second, at most.",
)
@click.option(
    "--real-time", is_flag=True, help="Lose samples when the host is slow instead of waiting."
)
@click.option("--control", metavar="ENDPOINT", help="Live control by ZMQ: tcp://127.0.0.1:PORT.")
def emulate(scene, bind, daughterboard, air, delay_us, faults, speed, real_time, control):
    """A software USRP N210 for unmodified libuhd, with SCENE on the air."""
    device = Device(
        _air(air, scene, round(delay_us * 1e-6 * TICK_RATE)),
        bind,
        daughterboard,
        speed,
        lossless=not real_time,
        faults=[parse_fault(text) for text in faults],
    )
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


def _air(kind, scene, delay_ticks):
    if kind == "cable":
        return Cable(delay_ticks)
    if kind == "counter":
        return Counter(delay_ticks)
    if scene is None:
        raise InputError("SCENE", "is needed, unless --air says otherwise")
    # Imported when it is needed: a cable must not wait for the scene's mathematics.
    from gnuradio.wiforce.scene import load_scene
    from software_n210.scene_air import SceneAir

    return SceneAir(load_scene(scene), delay_ticks)


def _summary(status):
    lost = {key: value for key, value in status.items() if isinstance(value, int) and value}
    text = ", ".join(f"{key.replace('_', ' ')} {value}" for key, value in lost.items())
    return f"stopped at {status['device_time_s']:.3f} s of device time" + (text and f"; {text}")
