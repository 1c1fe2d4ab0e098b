# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce live``: transmit, receive and read with a UHD device."""

import os
import signal
import threading

import click
from gnuradio.wiforce.errors import OutputError
from gnuradio.wiforce.io.capture_files import recording_stem
from gnuradio.wiforce.io.writers import open_writer
from gnuradio.wiforce.io.zmq_sockets import (
    ReadingsPublisher,
    Replies,
    answer_words,
    endpoint_of,
)
from gnuradio.wiforce.scene import load_scene

from .options import FiniteRange, radio_options, readings_output, tracked_presses

_LOOK_S = 0.1
# So that a flood of requests does not delay the warnings.
_REQUESTS_A_LOOK = 100


@click.command()
@radio_options
@readings_output
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
@tracked_presses
@click.option(
    "--latency",
    type=click.Choice(["low", "relaxed"]),
    default="low",
    show_default=True,
    help="How soon readings come: 'relaxed' takes less processor time and 20 ms more.",
)
@click.option(
    "--duration", type=FiniteRange(0, min_open=True), help="Seconds to read. Default: until Ctrl-C."
)
def live(
    scene_path, args, output, record, zmq_endpoint, control, tracked, latency, duration, **radio
):
    """Transmit, receive and read with a UHD device, until interrupted.

    SIGUSR1 measures the untouched reference again (tare).
    """
    from .live_session import DeviceLost

    scene = load_scene(scene_path)
    if record is not None:
        record = recording_stem(record, "--record")
    for endpoint, option in ((zmq_endpoint, "--zmq"), (control, "--control")):
        if endpoint is not None:
            endpoint_of(endpoint, option)
    amplitude = radio.pop("amplitude")
    try:
        with open_writer(output, scene.files) as writer:
            opened = open_radio(args, scene, **radio)
            with _Outputs(writer, zmq_endpoint) as outputs:
                session = _make_session(scene, opened, outputs, amplitude, tracked, record, latency)
                outputs.start_s = lambda: session.start_s
                _run(session, args, outputs, control, duration)
    except DeviceLost as lost:
        leave(lost)


def open_radio(args, scene, tx_gain, rx_gain, antenna, tx_antenna, reference):
    """Open the device with a command's options; warns of oscillators that do not lock."""
    from .radio import Radio

    radio = Radio(args, scene, tx_gain, rx_gain, tx_antenna, antenna, reference)
    for direction in radio.unlocked():
        text = f"the {direction} oscillator does not lock; readings may drift"
        click.echo(f"gr-wiforce: warning: {text}", err=True)
    return radio


def _make_session(scene, radio, outputs, amplitude, tracked, record, latency):
    from .live_session import LiveSession

    return LiveSession(scene, radio, outputs.take, amplitude, tracked, record, latency)


class _Outputs:
    """The outputs of a run: a file and, optionally, ZMQ."""

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
        """Start the file, whose former content is replaced."""
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
    """Run the session until a signal, a request or `duration` ends it.

    Raises
    ------
    DeviceLost
        When the device is gone; all readings have been written.
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
        session.read_rest()
        raise
    finally:
        watch.finish()
        if requests is not None:
            requests.close()
    if session.failure is not None:
        raise session.failure
    click.echo(f"gr-wiforce: read {watch.summary()}", err=True)
    if session.recorder is not None and session.recorder.failure is not None:
        raise OutputError(
            "--record", f"the recording is incomplete ({session.recorder.failure.strerror})"
        )


def leave(error):
    """End the process at once: UHD's blocks abort when they are stopped without their device."""
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
