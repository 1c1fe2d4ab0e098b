# SPDX-License-Identifier: GPL-3.0-or-later
"""Both streams of a radio: frames out, samples to the reader."""

import socket
import time
from collections.abc import Callable

from gnuradio import gr, wiforce
from gnuradio.wiforce.blocks.sample_streams import sample_sender
from gnuradio.wiforce.wiforce_kernels import exit_on_terminate

from .clock_comparison import ClockComparison
from .radio import Radio
from .request import LOST_STATUS, DeviceLost, RadioRequest
from .stream_start import start_flowgraph

# How far ahead the common start is set. A busy machine may miss it; then the next one is tried.
_START_LEADS_S = (0.5, 1.5, 4.0)
_START_GRACE_S = 1.0
# Without a common start, frames are on the air for this long before samples are received: more
# than what the buffers of drivers and devices hold.
_TRANSMIT_AHEAD_S = 0.5
_LOOK_S = 0.02
_BUFFER_SAMPLES = 1 << 18
_MOST_RECEIVE_SAMPLES = _BUFFER_SAMPLES // 2
_RECEIVE_TIMEOUT_S = 0.1
_COLLECTED_S = 10e-3  # pieces of this length or more are collected by the driver
_UNTIMED_S = 0.1  # a bound of the time that samples take until they are counted
# A shorter silence, of a network that restarts for example, is a gap: the device keeps its phases.
_SILENCE_S = 5.0


class RadioStreams:
    """Transmits sounding frames with a radio, and sends the samples that it receives.

    ``samples``: where samples are sent. ``aligned``: whether the samples begin with a frame.
    """

    def __init__(self, radio: Radio, request: RadioRequest, samples: socket.socket):
        # GNU Radio reports failures of blocks itself; the reader gets them from here.
        gr.logging().set_default_level(gr.log_levels.off)
        self._radio, self._request = radio, request
        # Short pieces are collected by the sender from single packets, long ones by the driver.
        packets = request.receive_s < _COLLECTED_S
        interval_s = request.receive_s if packets else 0.0
        antennas = request.antennas
        self._sender = sample_sender(samples, interval_s, radio.accepts_time, antennas)
        self._reception = gr.top_block("gr-wiforce receiver", catch_exceptions=True)
        self._transmission = self._reception
        if not radio.starts_together:
            self._transmission = gr.top_block("gr-wiforce transmitter", catch_exceptions=True)
        exit_on_terminate(LOST_STATUS)  # instead of the handler that the flowgraph has installed
        together = min(int(request.receive_s * request.sample_rate_hz), _MOST_RECEIVE_SAMPLES)
        radio.collect(0 if packets else together, _RECEIVE_TIMEOUT_S)
        radio.source.set_min_output_buffer(_BUFFER_SAMPLES)
        if radio.sink is not None:
            source = wiforce.sounding_source(amplitude=request.amplitude, **request.frames)
            self._transmitted = source  # a flowgraph deletes a block that has no name
            self._transmission.connect(source, radio.sink)
        self._alignment = None
        # Frames of a free-running transmitter are followed by the reader.
        self.aligned = request.aligned and not radio.starts_together and antennas == 1
        if self.aligned:
            self._alignment = wiforce.frame_alignment(**request.frames)
            self._reception.connect(radio.source, self._alignment, self._sender)
        else:
            for antenna in range(antennas):
                self._reception.connect((radio.source, antenna), (self._sender, antenna))
        self._received, self._sent = _Progress(), _Progress()
        self._ended_before = False
        self._clocks = ClockComparison(_clock_of(radio, self._sender, request.sample_rate_hz))

    def clock(self) -> tuple[float, float] | None:
        """Offset of UTC from the samples' clock and its uncertainty, in s; None when not due."""
        # Whether samples come with times is known when they come.
        if not self._radio.starts_together and self._sender.sent == 0:
            return None
        found = self._clocks.look()
        return found and (found[0], found[1] + (0.0 if self._radio.has_time else _UNTIMED_S))

    def start(self, stopped: Callable[[], bool]) -> None:
        """Start both streams, at one device time where the driver can.

        ``stopped``: whether to give up. Raises DeviceLost when no samples are received.;
        DeviceUnusable when a driver does not start to stream.
        """
        request = self._request
        if self._transmission is not self._reception and self._radio.sink is not None:
            own = request.tx_args is not None
            option, args = ("--tx-args", request.tx_args) if own else ("--args", request.args)
            start_flowgraph(self._transmission, stopped, option, args)
            if not self._passes(_TRANSMIT_AHEAD_S, stopped):
                return
        for lead_s in _START_LEADS_S:
            start_s = self._radio.start_together(lead_s)
            start_flowgraph(self._reception, stopped, "--args", request.args)
            while self._sender.sent == 0 and self._radio.time_s < start_s + _START_GRACE_S:
                if stopped():
                    return
                time.sleep(_LOOK_S)
            if self._sender.sent:
                return
            self._reception.stop()
            self._reception.wait()
            self._sender.ended = False
        if self._alignment is not None and self._alignment.searches:
            raise DeviceLost("receives no sounding frames any more")
        raise DeviceLost("sends no samples; check its network and power")

    def _passes(self, seconds, stopped):
        """Let time pass; False when stopped meanwhile."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if stopped():
                return False
            time.sleep(_LOOK_S)
        return True

    def check(self) -> None:
        """Find out whether the device is still there.

        Raises DeviceLost when it has gone.
        """
        if self._ended_before:
            raise DeviceLost("cannot be reached any more")
        self._ended_before = self._sender.ended
        if self._sender.waiting:
            self._received.moved()
        unreceived_s = self._received.still_s(self._sender.sent)
        if unreceived_s > _SILENCE_S:
            raise DeviceLost(f"has sent no samples for {_SILENCE_S:g} s")
        if self._radio.sink is None:
            return
        unsent_s = self._sent.still_s(self._radio.sink.nitems_read(0))
        # A device that has gone does neither; its samples are what is missed.
        if unsent_s > _SILENCE_S and unreceived_s < _SILENCE_S / 2:
            raise DeviceLost(f"has not transmitted for {_SILENCE_S:g} s")

    def stop(self) -> None:
        """Stop both streams; all samples received so far are sent."""
        self._reception.stop()
        self._reception.wait()
        self._transmission.stop()
        self._transmission.wait()


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


def _clock_of(radio, sender, rate_hz):
    """Gives the time of the samples that arrive now; by their number without a device's clock."""
    # It must not refer to the streams: they would not be freed, nor the device closed.
    return lambda: radio.time_s if radio.has_time else sender.sent / rate_hz
