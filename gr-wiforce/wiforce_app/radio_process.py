# SPDX-License-Identifier: GPL-3.0-or-later
"""The process that uses a UHD device, on behalf of a :class:`radio_link.RadioLink`.

UHD and its blocks may abort or hang when a device disappears. In a process of their own they
cannot end the reader. It is given two sockets: one for samples, and one on which it takes lines of
text and reports events as lines of JSON.
"""

import contextlib
import json
import os
import select
import signal
import socket
import sys
import time

from gnuradio.wiforce.errors import InputError

from .device_lock import DeviceLock
from .radio_request import LOST_STATUS, DeviceAbsent, DeviceLost, RadioRequest
from .reaction_time import shorten_pauses
from .run_clock import ClockComparison

# How far ahead the common start is set. A busy machine may miss it; then the next one is tried.
_START_LEADS_S = (0.5, 1.5, 4.0)
_START_GRACE_S = 1.0
_LOOK_S = 0.02
_BUFFER_SAMPLES = 1 << 18
_MOST_RECEIVE_SAMPLES = _BUFFER_SAMPLES // 2
_RECEIVE_TIMEOUT_S = 0.1
_COLLECTED_S = 10e-3  # pieces of this length or more are collected by UHD
# A shorter silence, of a network that restarts for example, is a gap: the device keeps its phases.
_SILENCE_S = 5.0


class _Control:
    """Lines from the reader, events to it."""

    def __init__(self, control):
        self._control = control
        self._rest = b""

    def line(self, timeout_s):
        """The next line; None when there is none in time.

        Raises
        ------
        EOFError
            When the reader has gone.
        """
        deadline = time.monotonic() + timeout_s
        while b"\n" not in self._rest:
            remaining_s = max(deadline - time.monotonic(), 0)
            if not select.select([self._control], [], [], remaining_s)[0]:
                return None
            data = self._control.recv(65536)
            if not data:
                raise EOFError
            self._rest += data
        line, _, self._rest = self._rest.partition(b"\n")
        return line.decode()

    def report(self, event, **fields):
        """Report an event."""
        with contextlib.suppress(OSError):
            self._control.sendall(json.dumps({"event": event, **fields}).encode() + b"\n")


class _Progress:
    """How long a count has not changed."""

    def __init__(self):
        self._count, self._changed_s = None, 0.0

    def still_s(self, count):
        if count != self._count:
            self._count = count
            self.moved()
            return 0.0
        return time.monotonic() - self._changed_s

    def moved(self):
        self._changed_s = time.monotonic()


class _Streams:
    """Both streams of a radio: frames out, samples to the reader."""

    def __init__(self, radio, request, samples):
        from gnuradio import gr, wiforce
        from gnuradio.wiforce.blocks.sample_sender import sample_sender
        from gnuradio.wiforce.wiforce_kernels import exit_on_terminate

        # GNU Radio reports failures of blocks itself; the reader gets them from here.
        gr.logging().set_default_level(gr.log_levels.off)
        self._radio = radio
        self._transmitted = wiforce.sounding_source(amplitude=request.amplitude, **request.sounding)
        # Short pieces are collected by the sender from single packets, long ones by UHD.
        packets = request.receive_s < _COLLECTED_S
        self._sender = sample_sender(samples, request.receive_s if packets else 0.0)
        self._flowgraph = gr.top_block("gr-wiforce radio", catch_exceptions=True)
        exit_on_terminate(LOST_STATUS)  # instead of the handler that the flowgraph has installed
        radio.source.set_recv_timeout(_RECEIVE_TIMEOUT_S, packets)
        if not packets:
            together = int(request.receive_s * request.sample_rate_hz)
            radio.source.set_max_noutput_items(min(together, _MOST_RECEIVE_SAMPLES))
        radio.source.set_min_output_buffer(_BUFFER_SAMPLES)
        self._flowgraph.connect(self._transmitted, radio.sink)
        self._flowgraph.connect(radio.source, self._sender)
        self._received, self._sent = _Progress(), _Progress()
        self._ended_before = False
        self._clocks = ClockComparison(lambda: radio.time_s)

    def report_clock(self, reader):
        """Report the offset of UTC from the device's clock when it is due."""
        if (found := self._clocks.look()) is not None:
            reader.report("clock", offset_s=found[0], uncertainty_s=found[1])

    def start(self, stopped):
        """Start both streams at one device time, unless `stopped()` says otherwise meanwhile."""
        for lead_s in _START_LEADS_S:
            start_s = self._radio.start_together(lead_s)
            self._flowgraph.start()
            while self._sender.sent == 0 and self._radio.time_s < start_s + _START_GRACE_S:
                if stopped():
                    return
                time.sleep(_LOOK_S)
            if self._sender.sent:
                return
            self._flowgraph.stop()
            self._flowgraph.wait()
            self._sender.ended = False
        raise DeviceLost("sends no samples; check its network and power")

    def check(self):
        """Raise DeviceLost when the device has gone."""
        if self._ended_before:
            raise DeviceLost("cannot be reached any more")
        self._ended_before = self._sender.ended
        if self._sender.waiting:
            self._received.moved()
        unreceived_s = self._received.still_s(self._sender.sent)
        unsent_s = self._sent.still_s(self._radio.sink.nitems_read(0))
        if unreceived_s > _SILENCE_S:
            raise DeviceLost(f"has sent no samples for {_SILENCE_S:g} s")
        # A device that has gone does neither; its samples are what is missed.
        if unsent_s > _SILENCE_S and unreceived_s < _SILENCE_S / 2:
            raise DeviceLost(f"has not transmitted for {_SILENCE_S:g} s")

    def stop(self):
        """Stop both streams; all samples received so far are sent."""
        self._flowgraph.stop()
        self._flowgraph.wait()


def run(control: socket.socket, samples: socket.socket) -> None:
    """Open the device that is asked for, and stream until the reader stops it.

    Parameters
    ----------
    control, samples : socket.socket
        Connected to the reader.
    """
    reader = _Control(control)
    try:
        _serve(reader, samples)
    except InputError as error:
        rule = str(error).removeprefix(f"{error.where}: ")
        reader.report("refused", kind=type(error).__name__, where=error.where, rule=rule)
    except (DeviceLost, RuntimeError) as error:  # UHD raises RuntimeError
        reason = str(error) if isinstance(error, DeviceLost) else "does not answer any more"
        reader.report("lost", reason=reason)
        _exit(samples, LOST_STATUS)  # UHD's blocks cannot be stopped without their device
    except EOFError:
        pass  # the reader has gone


def _serve(reader, samples):
    from .radio import Radio

    request = RadioRequest.from_json(_wait_for_line(reader))
    lock = DeviceLock(request.args)
    radio = _opened(Radio, request)
    lock.take_serial(radio.serial)
    streams = _Streams(radio, request, samples)
    streams.report_clock(reader)  # before there are readings, which are stamped with UTC
    reader.report(
        "opened", hardware=radio.hardware, settings=radio.settings(), unlocked=radio.unlocked()
    )
    shorten_pauses()
    _wait_for_line(reader)  # start
    stopping = []

    def stopped():
        if not stopping:
            try:
                line = reader.line(0)
            except EOFError:
                line = "stop"
            stopping.extend([line] if line else [])
        return bool(stopping)

    streams.start(stopped)
    reader.report("started")
    # When the reader has been killed, both sockets are closed: the device must be stopped then.
    while not stopped():
        streams.check()
        streams.report_clock(reader)
        time.sleep(_LOOK_S)
    streams.stop()
    samples.close()
    reader.report("stopped")
    del streams, radio  # UHD closes the device here
    lock.release()


def _opened(radio, request):
    """The radio; UHD waits 0.1 s for answers, which a busy network may exceed once."""
    try:
        return radio(request)
    except DeviceAbsent:
        return radio(request)


def _wait_for_line(reader):
    while (line := reader.line(1.0)) is None:
        pass
    return line


def _exit(samples, status):
    samples.close()
    os._exit(status)


def main():
    """Run with the sockets whose descriptors are the arguments."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGUSR1):
        signal.signal(number, signal.SIG_IGN)  # meant for the reader, which ends this process
    control, samples = (socket.socket(fileno=int(text)) for text in sys.argv[1:3])
    run(control, samples)


if __name__ == "__main__":
    main()
