# SPDX-License-Identifier: GPL-3.0-or-later
"""Options that several commands share, and the type of their numbers."""

import math
import os
from pathlib import Path

import click
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.io.files import OUTPUTS_HELP

from ..radio.request import DRIVERS
from .log import log


class _Finite:
    """Refuses nan and inf, which the types of click accept."""

    name = "number"  # click says: 'x' is not a valid float range

    def convert(self, value, param, ctx):
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value!r} is not a finite number.", param, ctx)
        return number


class Number(_Finite, click.types.FloatParamType):
    """A finite float."""


class FiniteRange(_Finite, click.FloatRange):
    """A finite float within limits."""


class IntegerRange(click.IntRange):
    """An integer within limits."""

    name = "integer"


def _sensor_file(_, __, output):
    if output is not None and Path(output).suffix.lower() not in (".yaml", ".yml"):
        raise InputError(output, "sensor file must end in .yaml or .yml")
    return output


def scene_names(_, __, typed):
    """Complete the name of a shipped scene, or of a file."""
    from gnuradio.wiforce.scene import shipped_scenes

    return _names(shipped_scenes(), typed)


def sensor_names(_, __, typed):
    """Complete the name of a shipped sensor, or of a file."""
    from gnuradio.wiforce.sensor import shipped_sensors

    return _names(shipped_sensors(), typed)


def _names(known, typed):
    from click.shell_completion import CompletionItem

    found = [CompletionItem(name) for name in known if name.startswith(typed)]
    return found or [CompletionItem(typed, type="file")]


CARRIER_HZ = FiniteRange(0, 1e12, min_open=True)

capture_scene = click.option(
    "--scene",
    "scene_path",
    type=click.Path(),
    shell_complete=scene_names,
    help="Scene file, or name of a shipped scene. Default: the scene in the capture's metadata.",
)
sample_type = click.option(
    "--datatype",
    type=click.Choice(["ci16_le", "cf32_le"]),
    help="Type of the samples, for a raw file without metadata.",
)


def _different_files(_, __, outputs):
    known = set()
    for output in outputs:
        path = os.path.realpath(output)
        if path in known:
            raise InputError(output, "must be given once as output")
        known.add(path)
    return outputs


def readings_outputs(of_many=""):
    """The option for files of readings, which may be repeated; ``of_many`` captures, if any."""
    return click.option(
        "-o",
        "--output",
        "outputs",
        type=click.Path(),
        multiple=True,
        callback=_different_files,
        help=f"{OUTPUTS_HELP}; may be repeated. {of_many}Default: CSV on standard output.",
    )


sensor_output = click.option(
    "-o",
    "--output",
    required=True,
    type=click.Path(),
    callback=_sensor_file,
    help="SENSOR.yaml to write.",
)
mcap_output = click.option(
    "--mcap",
    type=click.Path(),
    metavar="FILE",
    help="Also write ROS 2 messages, for Foxglove, PlotJuggler and rosbag2: to FILE.mcap or, where "
    "FILE is a folder, to a new file in it.",
)
client_keys = click.option(
    "--zmq-keys",
    type=click.Path(),
    metavar="PATH",
    help="Keys of this client, where the reader has --zmq-keys: NAME.key_secret with server.key "
    "beside it, or their folder.",
)
tracked_presses = click.option("--tracked", is_flag=True, help="Track each press over time.")

_ARGS_HELP = "Device arguments: addr=192.168.10.2; with --driver soapy: driver=lime."
_GAIN_HELP = "Default: a third of a USRP's range; with soapy the device's own."


class _DeviceArguments(click.types.StringParamType):
    """Text; where it is missing, the message has an example."""

    def get_missing_message(self, param, *_):
        return _ARGS_HELP


_OF_A_RADIO = (
    click.option("--args", required=True, type=_DeviceArguments(), help=_ARGS_HELP),
    click.option(
        "--driver",
        type=click.Choice(list(DRIVERS)),
        default="uhd",
        help="Library that opens the device: UHD, or SoapySDR for other radios.",
    ),
    click.option(
        "--tx-args", help="Device arguments of the transmitter, where that is another device."
    ),
    click.option(
        "--receive-only",
        is_flag=True,
        help="Transmit nothing: the frames come from a transmitter of their own.",
    ),
    click.option("--tx-gain", type=Number(), metavar="DB", help=_GAIN_HELP),
    click.option("--rx-gain", type=Number(), metavar="DB", help=_GAIN_HELP),
    click.option("--antenna", help="Receive antenna, for example RX2."),
    click.option("--tx-antenna", help="Transmit antenna, for example TX/RX."),
    click.option(
        "--bandwidth",
        "bandwidth_hz",
        type=FiniteRange(0, min_open=True),
        metavar="HZ",
        help="Of the device's filters. Default: the device's own.",
    ),
    click.option("--reference", help="Clock source: internal, external, ..."),
    click.option(
        "--amplitude",
        type=FiniteRange(0, 1, min_open=True),
        default=0.5,
        help="Transmit amplitude: root of the mean preamble power over full scale.",
    ),
)


def _scene(required):
    return click.option(
        "--scene",
        "scene_path",
        required=required,
        shell_complete=scene_names,
        help="Scene file, or name of a shipped scene.",
    )


def _all(*options):
    """Add options to a command, in this order."""

    def add(command):
        for option in reversed(options):
            command = option(command)
        return command

    return add


def _ignore_scheduler(context, _parameter, address):
    if address is not None and not context.resilient_parsing:
        text = "--scheduler is ignored, and will be refused: this machine's cores are used (--jobs)"
        log.warning(f"{text}; examples/many_captures is for several machines")


# Options that open a device; the others for a command that can do without one.
radio_options = _all(_scene(True), *_OF_A_RADIO)
optional_radio_options = _all(
    _scene(False), click.option("--args", help=_ARGS_HELP), *_OF_A_RADIO[1:]
)
csi_options = _all(
    click.option(
        "--csi-tool",
        metavar="TOOL",
        help="The CSI tool that has written the file: intel, atheros, esp32 or "
        "nexmon/CHIP/MHZ. Default: found by the file.",
    ),
    click.option(
        "--mac",
        help="Sender whose packets are used, for esp32 and nexmon. Default: the most frequent one.",
    ),
    click.option(
        "--second-antenna",
        type=click.Path(),
        metavar="FILE",
        help="Lines of a second ESP32 on the same crystal (esp-crab).",
    ),
)
worker_options = _all(
    click.option(
        "--jobs",
        type=IntegerRange(1),
        help="Number of parallel processes. Default: one per core.",
    ),
    # Of release 1.0.
    click.option("--scheduler", hidden=True, expose_value=False, callback=_ignore_scheduler),
)


def csi_file(tool, mac, second):
    """Arguments of ``open_csi`` by these options; None without any."""
    if tool is not None:
        from gnuradio.wiforce.io.csi_tools import check_tool

        check_tool(tool, mac, second)
    given = {"tool": tool, "mac": mac, "second": second}
    return given if any(given.values()) else None


def web_options(required=False):
    """The options of a page in the browser; ``required``: whether the command does nothing else."""
    return _all(
        click.option(
            "--web",
            required=required,
            metavar="[ADDRESS:]PORT",
            help="Show readings in browsers, at a port of this machine or of ADDRESS.",
        ),
        click.option(
            "--web-token",
            metavar="TOKEN",
            envvar="GR_WIFORCE_WEB_TOKEN",
            show_envvar=True,
            help="What a browser must present to open the page, 16 letters and digits or more. "
            "Default: a random one beyond this machine, none on it.",
        ),
    )


def refuse(options, rule):
    """Refuse those options, values by name, that were given."""
    for option, value in options.items():
        if value:
            raise click.UsageError(f"{option} {rule}")


def refuse_scenes(given):
    """Refuse the name of a shipped scene where a capture is meant."""
    for name in given:
        if os.path.exists(name) or os.path.exists(name + ".sigmf-meta"):
            continue
        from gnuradio.wiforce.scene import shipped_scenes  # not for the start of the command

        if name in shipped_scenes():
            raise InputError(name, "is a scene and not a capture; give it by --scene")
