# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce live``: transmit, receive and read with a radio."""

import secrets
from datetime import datetime, timezone

import click
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.io.capture.names import recording_stem
from gnuradio.wiforce.io.files.writers import Rotation, open_writer
from gnuradio.wiforce.io.network import listening_address
from gnuradio.wiforce.io.network.zmq_sockets import (
    ReadingsPublisher,
    ServerKeys,
    endpoint_of,
    is_loopback,
)
from gnuradio.wiforce.io.outputs import STAMP_COLUMNS, Outputs
from gnuradio.wiforce.scene import accepted_suspicions, load_scene

from ..radio.request import RECEIVE_S, DeviceLost, RadioRequest
from ..shell.commands import GroupedHelp
from ..shell.interrupts import FAILED
from ..shell.log import FORMATS, LEVELS, log, rows_on_terminal
from ..shell.options import (
    FiniteRange,
    IntegerRange,
    mcap_output,
    radio_options,
    readings_outputs,
    tracked_presses,
    web_options,
)
from ..shell.provenance import provenance


@click.command(
    cls=GroupedHelp,
    groups={
        "Options": "--scene --args --tx-gain --rx-gain --output --record --web --zmq --duration "
        "--reconnect",
        "Radio": "--driver --tx-args --receive-only --antenna --tx-antenna --bandwidth --reference "
        "--amplitude",
        "Files": "--append --rotate --keep --mcap",
        "Network": "--control --zmq-keys --foxglove --lsl --web-token",
        "Reading": "--tracked --latency",
        "Messages": "--log-level --log-format",
    },
    examples=(
        "live --scene demo --args addr=127.0.0.1 --tx-gain 15 --rx-gain 15",
        "live --scene arm.yaml --driver soapy --args driver=lime -o a.csv",
    ),
)
@radio_options
@readings_outputs()
@click.option("--append", is_flag=True, help="Append to the output instead of replacing it.")
@click.option(
    "--rotate",
    multiple=True,
    metavar="LIMIT",
    help="Rename the output with its date and begin another, every 15min, 6h or 1d of UTC, or when "
    "it reaches 100MB. May be repeated.",
)
@click.option("--keep", type=IntegerRange(1), metavar="FILES", help="Delete older renamed outputs.")
@click.option("--record", metavar="NAME", help="Record to NAME.sigmf-data and NAME.sigmf-meta.")
@click.option(
    "--zmq",
    "zmq_endpoint",
    metavar="ENDPOINT",
    help="Publish readings by ZMQ: PORT or tcp://ADDRESS:PORT.",
)
@click.option(
    "--control",
    metavar="ENDPOINT",
    help="Accept requests (tare, status, stop) by ZMQ: PORT or tcp://ADDRESS:PORT.",
)
@click.option(
    "--zmq-keys",
    type=click.Path(),
    metavar="FOLDER",
    help="Encrypt both, and accept the clients whose keys are in FOLDER (gr-wiforce keys).",
)
@mcap_output
@click.option(
    "--foxglove",
    metavar="[ADDRESS:]PORT",
    help="Serve the same messages to Foxglove, at a port of this machine or of ADDRESS.",
)
@click.option(
    "--lsl",
    is_flag=False,
    flag_value="machine",
    type=click.Choice(["machine", "network"]),
    help="Offer a stream of the Lab Streaming Layer for each sensor, to this machine (default) or "
    "to its network.",
)
@web_options()
@tracked_presses
@click.option(
    "--latency",
    type=click.Choice(list(RECEIVE_S)),
    default="low",
    help="How soon readings come: 'relaxed' takes less processor time and 20 ms more.",
)
@click.option(
    "--duration",
    type=FiniteRange(0, min_open=True),
    help="Seconds to read, from the first frame on. If none is found in that time, and at least "
    "2 s, the exit status is 1. Default: until Ctrl-C.",
)
@click.option(
    "--reconnect", is_flag=True, help="Wait for the device, and open it again when it is lost."
)
@click.option(
    "--log-level",
    type=click.Choice(list(LEVELS)),
    default="info",
    help="Least important messages to write.",
)
@click.option(
    "--log-format",
    type=click.Choice(FORMATS),
    default="auto",
    help="journal: begin messages with <N>, their level for systemd's journal; auto detects it.",
)
def live(
    scene_path,
    args,
    outputs,
    append,
    rotate,
    keep,
    record,
    zmq_endpoint,
    control,
    zmq_keys,
    mcap,
    foxglove,
    lsl,
    web,
    web_token,
    tracked,
    latency,
    duration,
    reconnect,
    log_level,
    log_format,
    **radio,
):
    """Transmit, receive and read with a USRP, or with another radio by --driver soapy.

    It runs until interrupted. SIGUSR1 measures the untouched reference again (tare).
    """
    log.set_up(log_level, log_format)
    scene = load_scene(scene_path)
    if record is not None:
        record = recording_stem(record, "--record")
    keys = _keys_of(zmq_endpoint, control, zmq_keys)
    request = radio_request(args, scene, receive_s=RECEIVE_S[latency], **radio)
    rotation = Rotation.of(rotate, keep)
    metadata = provenance(scene)
    # UTC of its start and six random characters.
    run = f"{datetime.now(timezone.utc):%Y%m%dT%H%M%SZ}-{secrets.token_hex(3)}"
    for text in accepted_suspicions(scene):
        log.warning(text)
    also = (*scene.more_columns, *STAMP_COLUMNS)
    try:
        settings = scene.files, also, append, metadata, rotation
        files = [open_writer(path, *settings) for path in outputs or [None]]
        line = not rows_on_terminal(outputs)
        with Outputs(needs_all=True) as outputs:
            if zmq_endpoint is not None:
                outputs.add(ReadingsPublisher(zmq_endpoint, keys=keys))
                if keys is None and not is_loopback(endpoint_of(zmq_endpoint, "--zmq")):
                    log.warning(
                        f"--zmq {zmq_endpoint}: everybody who reaches this address can read and "
                        "subscribe; --zmq-keys encrypts, and accepts known clients only"
                    )
            _add_optional_outputs(outputs, scene, mcap, foxglove, lsl, metadata, run)
            endpoints = [(control, keys)] if control else []
            if web is not None:
                endpoints.append((_open_page(outputs, web, web_token), None))
            from .run import LiveRun

            return LiveRun(
                scene=scene,
                request=request,
                outputs=outputs,
                files=files,
                name=run,
                endpoints=endpoints,
                duration_s=duration,
                reconnects=reconnect,
                line=line,
                tracked=tracked,
                recording=record,
            ).run()
    except DeviceLost as lost:
        kept = "all readings until then are kept" if outputs.rows else "there are no readings"
        log.error(f"{lost}; {kept}")
        return FAILED


def _keys_of(zmq_endpoint, control, folder):
    """Keys for both endpoints, or None; requests without keys are taken on loopback only."""
    options = {"--zmq": zmq_endpoint, "--control": control}
    given = {name: endpoint_of(text, name) for name, text in options.items() if text is not None}
    if folder is None:
        if not is_loopback(given.get("--control", "tcp://127.0.0.1:0")):
            rule = "needs --zmq-keys for an address beyond loopback"
            raise InputError("--control", rule, control)
        return None
    if not given:
        raise InputError("--zmq-keys", "needs --zmq or --control", folder)
    return ServerKeys.load(folder)


def _add_optional_outputs(outputs, scene, mcap, foxglove, lsl, metadata, run):
    """Add the outputs whose libraries few users have (``io/optional.py``)."""
    if mcap is not None:
        from gnuradio.wiforce.io.files.mcap_file import McapWriter

        outputs.add(McapWriter(mcap, scene.files, metadata, scene.reading_names))
    if foxglove is not None:
        from gnuradio.wiforce.io.network.foxglove_server import FoxgloveServer

        outputs.add(FoxgloveServer(foxglove, scene.reading_names))
        host, _ = listening_address(foxglove, "--foxglove")
        if not is_loopback(f"tcp://{host}:0"):
            log.warning(f"--foxglove {foxglove}: everybody who reaches this address can read")
    if lsl is not None:
        from gnuradio.wiforce.io.network.lsl_outlets import LslOutlets

        version, described = metadata["wiforce:version"], metadata["wiforce:scene"]
        details = {"run": run, "version": version, "scene": described}
        surfaces = scene.surface.names if scene.surface is not None else ()
        network, period_s = lsl == "network", scene.group_period_s
        outputs.add(LslOutlets(scene.sensor_names, period_s, network, details, surfaces=surfaces))


def _open_page(outputs, web, token):
    """Serve the page; gives the endpoint of its requests."""
    from ..web.address import PageAddress
    from ..web.live_page import LivePage

    address = PageAddress.of(web, token)
    page = LivePage(address, log.warning)
    outputs.add(page)
    log.info(address.notice)
    return page.control


def radio_request(args, scene, tx_gain, rx_gain, **settings):
    """The radio that a command's options ask for."""
    if scene.packets:
        rule = "must have no packets: a radio gives samples, and only `read` takes packets"
        raise InputError("--scene", f"{rule} from files")
    for name, value in {"args": args, **settings}.items():
        try:
            str(value).encode()  # drivers take UTF-8
        except UnicodeEncodeError:  # Python keeps other bytes as lone surrogates
            option = f"--{name.replace('_', '-')}"
            raise InputError(option, "must be text in UTF-8", value) from None
    _check_transmitter(scene, settings)
    return RadioRequest.of_scene(
        scene,
        args,
        tx_gain_db=tx_gain,
        rx_gain_db=rx_gain,
        rx_antenna=settings.pop("antenna"),
        **settings,
    )


def _check_transmitter(scene, settings):
    """Refuse a transmitter on a clock of its own, unless the scene says so."""
    shares = scene.environment.reader_clock == "shared"
    needs = "needs reader_clock: free and receive_antennas: 2 under environment in the scene"
    if settings["receive_only"]:
        if settings["tx_args"] is not None:
            raise InputError("--receive-only", "must be given without --tx-args")
        if shares:
            raise InputError("--receive-only", needs)
    elif settings["tx_args"] is not None and shares:
        if settings["reference"] in (None, "internal"):
            rule = f"{needs}, or one clock for both devices (--reference external)"
            raise InputError("--tx-args", rule, settings["tx_args"])
