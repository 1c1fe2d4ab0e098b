# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce live``: transmit, receive and read with a UHD device."""

import os
import signal
import threading

import click
from gnuradio.wiforce.errors import OutputError
from gnuradio.wiforce.io.readings import open_writer
from gnuradio.wiforce.io.zmq_sockets import (
    ReadingsPublisher,
    Replies,
    answer_words,
    endpoint_of,
)
from gnuradio.wiforce.scene import load_scene

from .ranges import FiniteRange

_LOOK_S = 0.1
# Between two looks, however many a peer sends.
_REQUESTS_A_LOOK = 100


def radio_options(command):
    """The options by which a device is opened; the same for every command that does."""
    for option in reversed(
        [
            click.option(
                "--scene", "scene_path", required=True, help="Scene file, or a shipped scene."
            ),
            click.option("--args", required=True, help="UHD device, as addr=192.168.10.2."),
            click.option("--tx-gain", type=float, metavar="DB", help="Default: the device's own."),
            click.option("--rx-gain", type=float, metavar="DB", help="Default: the device's own."),
            click.option("--antenna", help="Receive antenna, for example RX2."),
            click.option("--tx-antenna", help="Transmit antenna, for example TX/RX."),
            click.option("--reference", help="Clock source: internal, external, ..."),
            click.option(
                "--amplitude",
                type=FiniteRange(0, 1, min_open=True),
                default=0.5,
                show_default=True,
                help="Of what is transmitted: root of the mean preamble power over full scale.",
            ),
        ]
    ):
        command = option(command)
    return command


@click.command()
@radio_options
@click.option("-o", "--output", type=click.Path(), help="OUT.csv or OUT.jsonl; CSV on stdout.")
@click.option("--record", metavar="NAME", help="Record to NAME.sigmf-data and NAME.sigmf-meta.")
@click.option("--zmq", "zmq_endpoint", metavar="ENDPOINT", help="Publish readings: PORT or tcp://.")
@click.option(
    "--control",
    metavar="ENDPOINT",
    help="Take requests (tare, status, stop) by ZMQ: PORT or tcp://.",
)
@click.option("--tracked", is_flag=True, help="Follow each press over time.")
@click.option("--duration", type=FiniteRange(0, min_open=True), help="Seconds; else until ^C.")
def live(scene_path, args, output, record, zmq_endpoint, control, tracked, duration, **radio):
    """Transmit, receive and read with a UHD device, until interrupted.

    SIGUSR1 takes the untouched reference anew (tare).
    """
    from .live_session import DeviceLost

    scene = load_scene(scene_path)
    for endpoint, option in ((zmq_endpoint, "--zmq"), (control, "--control")):
        if endpoint is not None:
            endpoint_of(endpoint, option)
    amplitude = radio.pop("amplitude")
    try:
        with open_writer(output) as writer:
            opened = open_radio(args, scene, **radio)
            with _Outputs(writer, zmq_endpoint) as outputs:
                session = _make_session(scene, opened, outputs, amplitude, tracked, record)
                outputs.start_s = lambda: session.start_s
                _run(session, args, outputs, control, duration)
    except DeviceLost as lost:
        leave(lost)


def open_radio(args, scene, tx_gain, rx_gain, antenna, tx_antenna, reference):
    """The device as a command's options want it; warns of oscillators that do not lock."""
    from .radio import Radio

    radio = Radio(args, scene, tx_gain, rx_gain, tx_antenna, antenna, reference)
    for way in radio.unlocked():
        click.echo(f"gr-wiforce: warning: the {way} oscillator does not lock", err=True)
    return radio


def _make_session(scene, radio, outputs, amplitude, tracked, record):
    from .live_session import LiveSession

    return LiveSession(scene, radio, outputs.take, amplitude, tracked, record)


class _Outputs:
    """Where readings go: a file, and ZMQ when asked for."""

    def __init__(self, writer, zmq_endpoint):
        self._writer = writer
        self._publisher = None
        self.start_s = lambda: None
        self.seen = lambda reading: None
        if zmq_endpoint is not None:
            self._publisher = ReadingsPublisher(zmq_endpoint)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        if self._publisher is not None:
            self._publisher.close()

    def begin(self):
        """From here on the file holds this run's readings and no others."""
        self._writer.begin()

    def take(self, reading):
        """Write and publish one reading."""
        self._writer.write(reading)
        self.seen(reading)
        if self._publisher is not None:
            start_s = self.start_s()
            time_s = None if start_s is None else round(start_s + reading.time_s, 6)
            self._publisher.publish(reading, time_s)


def _run(session, args, outputs, control, duration):
    """Run the session until it is told to stop.

    Raises
    ------
    DeviceLost
        When that ended it; all readings have been given.
    """
    from .live_session import DeviceLost
    from .watch import Watch

    ended = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: ended.set())
    signal.signal(signal.SIGUSR1, lambda *_: session.reader.tare())
    watch = Watch(session, args)
    outputs.seen = watch.note
    requests = _requests(control, session, watch, ended) if control else None
    try:
        outputs.begin()
        session.start()
        while not ended.wait(_LOOK_S) and session.failure is None:
            watch.look()
            if requests is not None:
                requests.serve(_REQUESTS_A_LOOK)
            if duration and session.time_s >= duration:
                break
        session.stop()
    except DeviceLost:
        session.reader.finish()
        raise
    finally:
        watch.finish()
        if requests is not None:
            requests.close()
    if session.failure is not None:
        raise session.failure
    click.echo(f"gr-wiforce: read {watch.summary()}", err=True)
    if session.recorder is not None and session.recorder.failure is not None:
        raise OutputError("--record", f"ends before its time ({session.recorder.failure.strerror})")


def leave(error):
    """End at once: with the device gone UHD's blocks throw while they are stopped, and abort."""
    click.echo(f"gr-wiforce: {error}", err=True)
    os._exit(1)


def _requests(control, session, watch, ended):
    def tare():
        session.reader.tare()
        return {}

    def stop():
        ended.set()
        return {}

    answer = answer_words({"tare": tare, "status": watch.status, "stop": stop})
    return Replies(control, answer)
