# SPDX-License-Identifier: GPL-3.0-or-later
"""The streams of a device: their start, their clock, and the samples."""

import math
import socket
import threading
import time
from collections.abc import Callable
from functools import partial

from gnuradio import blocks, gr, wiforce
from gnuradio.wiforce.blocks.sample_streams import sample_sender
from gnuradio.wiforce.blocks.sounding import frame_samples
from gnuradio.wiforce.blocks.usrp import device_time_of, timed_frames
from gnuradio.wiforce.wiforce_kernels import exit_on_terminate

from .radio import Radio
from .request import LOST_STATUS, DeviceLost, DeviceUnusable, RadioRequest

# The device's clock is compared again after this time: 25 ppm of it are 0.25 ms.
_EVERY_S = 10.0
_QUERIES = 3


class ClockComparison:
    """Compares the clocks of host and device now and then.

    The mean of the host's time before and after an answer is its UTC, half of the difference the
    uncertainty, to which that of the host's clock adds.
    """

    def __init__(
        self,
        device_time: Callable[[], float],
        utc: Callable[[], float] = time.time,
        now: Callable[[], float] = time.monotonic,
    ):
        self._device_time, self._utc, self._now = device_time, utc, now
        self._compared_s = -float("inf")

    def look(self) -> tuple[float, float] | None:
        """Offset of UTC and uncertainty in s by the quickest answer; None within ten seconds."""
        if self._now() - self._compared_s < _EVERY_S:
            return None
        self._compared_s = self._now()
        best = None
        for _ in range(_QUERIES):
            before_s = self._utc()
            try:
                device_s = self._device_time()
            except RuntimeError:  # UHD's, when the device does not answer
                return None
            half_s = (self._utc() - before_s) / 2
            if half_s >= 0 and (best is None or half_s < best[1]):
                best = before_s + half_s - device_s, half_s
        return best


# Drivers start a stream within a second or two, by the documentation of their modules.
_LIMIT_S = 10.0
_LOOK_S = 0.02


def start_flowgraph(
    flowgraph: gr.top_block,
    stopped: Callable[[float], bool],
    option: str,
    args: str,
    limit_s: float = _LIMIT_S,
) -> None:
    """Start a flowgraph, or raise DeviceUnusable in bounded time, when it cannot be freed.

    GNU Radio waits for ever for the thread of a block that threw while it started.
    """
    started, errors = threading.Event(), []

    def start():
        try:
            flowgraph.start()
        except Exception as error:
            errors.append(error)
        started.set()

    threading.Thread(target=start, daemon=True).start()
    deadline = time.monotonic() + limit_s
    while not started.wait(_LOOK_S):
        reason = ""
        if time.monotonic() > deadline:
            reason = f"its driver has not started to stream within {limit_s:g} s"
        elif stopped(0.0):
            reason = "stopped before its driver started to stream"
        if reason:
            raise DeviceUnusable(option, f"must name a device that can stream ({reason})", args)
    if errors:
        raise errors[0]


# How far ahead the common start is set. A busy machine may miss it; then the next one is tried.
_START_LEADS_S = (0.5, 1.5, 4.0)
_START_GRACE_S = 1.0
# Without a common start, frames are on the air for this long before samples are received: more
# than what the buffers of drivers and devices hold.
_TRANSMIT_AHEAD_S = 0.5
_BUFFER_SAMPLES = 1 << 18
_MOST_RECEIVE_SAMPLES = _BUFFER_SAMPLES // 2
_RECEIVE_TIMEOUT_S = 0.1
# What a float of 1 is in 16-bit integers: codes of 12 bits are received as multiples of 16. The
# largest one to transmit must become less than 1, which would be 2048 where codes end at 2047.
_RECEIVED_SCALE, _SENT_SCALE = 32768.0, 32768.0 * 2048 / 2047
_UNTIMED_S = 0.1  # a bound of the time that samples take until they are counted
# A shorter silence, of a network that restarts for example, is a gap: the device keeps its phases.
_SILENCE_S = 5.0


class RadioStreams:
    """Transmits sounding frames with a radio, and sends the samples that it receives."""

    def __init__(self, radio: Radio, request: RadioRequest, samples: socket.socket):
        # GNU Radio reports failures of blocks itself; the reader gets them from here.
        gr.logging().set_default_level(gr.log_levels.off)
        self._radio, self._request = radio, request
        together = min(int(request.receive_s * request.sample_rate_hz), _MOST_RECEIVE_SAMPLES)
        # The sender collects what a driver hands over in single packets.
        collected = radio.collect(together, _RECEIVE_TIMEOUT_S)
        interval_s = 0.0 if collected else together / request.sample_rate_hz
        antennas = request.antennas
        self._sender = sample_sender(samples, interval_s, radio.accepts_time, antennas)
        self._reception = gr.top_block("gr-wiforce receiver", catch_exceptions=True)
        self._transmission = self._reception
        if not radio.starts_together:
            self._transmission = gr.top_block("gr-wiforce transmitter", catch_exceptions=True)
        exit_on_terminate(LOST_STATUS)  # instead of the handler that the flowgraph has installed
        radio.source.set_min_output_buffer(_BUFFER_SAMPLES)
        self._start_s, self._frames = [0.0], None
        if radio.sink is not None:
            self._frames = self._source_of(radio, request)
            conversion = []
            if radio.item_type != "sc16":
                conversion = [blocks.interleaved_short_to_complex(True, False, _SENT_SCALE)]
            self._transmission.connect(self._frames, *conversion, radio.sink)
        self._alignment = None
        # Whether the samples begin with a frame. Those of a free transmitter the reader follows.
        self.aligned = request.aligned and not radio.starts_together and antennas == 1
        if self.aligned:
            self._alignment = wiforce.frame_alignment(**request.frames)
            self._reception.connect(self._received_of(0), self._alignment, self._sender)
        else:
            for antenna in range(antennas):
                self._reception.connect(self._received_of(antenna), (self._sender, antenna))
        self._received, self._sent = Progress(), Progress()
        self._ended_before = False
        self._clocks = ClockComparison(_clock_of(radio, self._sender, request.sample_rate_hz))

    def _received_of(self, antenna):
        """The port of an antenna's samples as 16-bit integers."""
        port = self._radio.source, antenna
        if self._radio.item_type == "sc16":
            return port
        integers = blocks.complex_to_interleaved_short(True, _RECEIVED_SCALE)
        self._reception.connect(port, integers)
        return integers, 0

    def _source_of(self, radio, request):
        """The frames to transmit, with their times where both ends start at one."""
        if not radio.starts_together:
            return wiforce.sounding_source(amplitude=request.amplitude, **request.frames)
        start_s, frames = self._start_s, request.frames
        # It must not refer to the streams: they would not be freed, nor the device closed.
        return timed_frames(
            lambda: (math.floor(start_s[0]), start_s[0] % 1.0),
            partial(device_time_of, radio.source),
            frame_samples(frames["waveform"].frame(), request.amplitude, frames["item_type"]),
            request.sample_rate_hz,
        )

    @property
    def underflow_s(self) -> float:
        """Seconds in which nothing was transmitted."""
        # Frames without times are sent whenever the device takes them.
        return getattr(self._frames, "skipped_s", 0.0)

    def clock(self) -> tuple[float, float] | None:
        """Offset of UTC from the samples' clock and its uncertainty, in s; None when not due."""
        # Whether samples come with times is known when they come.
        if not self._radio.starts_together and self._sender.sent == 0:
            return None
        found = self._clocks.look()
        return found and (found[0], found[1] + (0.0 if self._radio.has_time else _UNTIMED_S))

    def start(self, stopped: Callable[[float], bool]) -> None:
        """Start both streams, at one device time if possible, unless ``stopped`` within a time.

        Raises DeviceLost when no samples are received, DeviceUnusable as :func:`start_flowgraph`.
        """
        request = self._request
        if self._transmission is not self._reception and self._radio.sink is not None:
            start_flowgraph(self._transmission, stopped, *request.transmitter)
            if stopped(_TRANSMIT_AHEAD_S):
                return
        for lead_s in _START_LEADS_S:
            start_s = self._start_s[0] = self._radio.start_together(lead_s)
            start_flowgraph(self._reception, stopped, "--args", request.args)
            while self._sender.sent == 0 and self._radio.time_s < start_s + _START_GRACE_S:
                if stopped(_LOOK_S):
                    return
            if self._sender.sent:
                return
            self._reception.stop()
            self._reception.wait()
            self._sender.ended = False
        if self._alignment is not None and self._alignment.searches:
            raise DeviceLost("receives no sounding frames any more")
        raise DeviceLost("sends no samples; check its network and power")

    def check(self) -> None:
        """Raise DeviceLost when the device has gone."""
        if self._ended_before:
            raise DeviceLost("cannot be reached any more")
        self._ended_before = self._sender.ended
        if self._sender.waiting:
            self._received.moved()
        unreceived_s = self._received.still_s(self._sender.sent)
        if unreceived_s > _SILENCE_S:
            raise DeviceLost.silent(_SILENCE_S)
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


class Progress:
    """How long a count has not changed while this process ran: at most 0.2 s of each look."""

    def __init__(self, now: Callable[[], float] = time.monotonic):
        self._now = now
        self._count: int | None = None
        self._still_s, self._looked_s = 0.0, now()

    def still_s(self, count: int) -> float:
        """Seconds since the count was another one, or :meth:`moved` was called."""
        passed_s, self._looked_s = self._now() - self._looked_s, self._now()
        if count != self._count:
            self._count = count
            self.moved()
        else:
            self._still_s += min(passed_s, 10 * _LOOK_S)
        return self._still_s

    def moved(self) -> None:
        self._still_s = 0.0


def _clock_of(radio, sender, rate_hz):
    """Gives the time of the samples that arrive now; by their number without a device's clock."""
    # It must not refer to the streams: they would not be freed, nor the device closed.
    return lambda: radio.time_s if radio.has_time else sender.sent / rate_hz
