# SPDX-License-Identifier: GPL-3.0-or-later
"""Samples of a receive stream to VRT packets, and the faults that act on packets."""

import numpy as np

from ..wire import RX_HEADER_WORDS, RX_OVERHEAD_WORDS, rx_error, rx_header, rx_trailer

_DEFAULT_SAMPLES_PER_PACKET = 363  # what fits the driver's frames of 1472 bytes


class PacketStream:
    """Collects samples into packets of equal size and numbers the packets.

    ``clock``: converts ticks to the device time that packets carry; ``stream_id``: used until the
    driver writes another. ``dropped_packets``: packets that were numbered but not sent, because of
    a fault.
    """

    def __init__(self, clock, stream_id):
        self.samples_per_packet = _DEFAULT_SAMPLES_PER_PACKET
        self.dropped_packets = 0
        self._clock = clock
        self._stream_id = stream_id
        self._packet_count = 0
        self._lose = 0
        self._swap = False
        self._ready = []
        self.discard()

    @property
    def pending(self):
        """Number of samples that do not fill a packet yet."""
        return len(self._partial)

    def discard(self):
        """Drop the samples that do not fill a packet yet."""
        self._partial = np.empty((0, 2), ">i2")
        self._first_tick, self._spacing = 0, 1

    def restart(self, stream_id):
        """Number packets from 0 under another stream id."""
        self._stream_id = stream_id
        self._packet_count = 0

    def lose(self, packets):
        """Number the next packets but do not send them, like a network that drops them."""
        self._lose += packets

    def swap(self):
        """Exchange the next two packets."""
        self._swap = True

    def append(self, samples, tick, spacing, end_of_burst=False):
        """Send all full packets; at the end of a burst also what remains.

        ``samples`` (N, 2); ``tick``: tick of the first sample; ``spacing``: ticks between samples;
        ``end_of_burst``: the last packet is marked as the last of its burst.
        """
        self._first_tick, self._spacing = tick - self.pending * spacing, spacing
        if self.pending:
            samples = np.concatenate((self._partial, samples))
        size = self.samples_per_packet
        full = len(samples) // size
        if end_of_burst and full and full * size == len(samples):
            full -= 1  # the last packet must be left, to carry the mark
        self._partial = samples[full * size :]
        if full:
            self._send(samples[: full * size], size, tick=self._first_tick)
            self._first_tick += full * size * spacing
        if end_of_burst:
            self.flush(end_of_burst=True)

    def flush(self, end_of_burst=False):
        """Send what remains as one short packet."""
        if self.pending:
            samples, self._partial = self._partial, self._partial[:0]
            self._send(samples, len(samples), self._first_tick, end_of_burst)

    def error(self, code, tick):
        """Send an error packet, which takes no number of its own."""
        packet = rx_error(self._packet_count, self._stream_id, self._clock.to_time(tick), code)
        self._ready.append((packet, len(packet)))

    def take(self):
        """Packets to send, which leave the stream; list of (bytes, packet size)."""
        ready, self._ready = self._ready, []
        return ready

    def _send(self, samples, size, tick, end_of_burst=False):
        """Packets of one size, built as one array."""
        packets = len(samples) // size
        numbers = np.arange(packets)
        times = self._clock.to_time(tick) + numbers * size * self._spacing
        block = np.empty((packets, size + RX_OVERHEAD_WORDS), ">u4")
        block[:, 0] = rx_header(0, size) | ((self._packet_count + numbers) & 15) << 16
        block[:, 1] = self._stream_id
        block[:, 2] = times >> 32
        block[:, 3] = times & 0xFFFFFFFF
        block[:, RX_HEADER_WORDS:-1].view(">i2")[:] = samples.reshape(packets, 2 * size)
        block[:, -1] = rx_trailer(end_of_burst)
        self._packet_count += packets
        self._emit(block)

    def _emit(self, block):
        lost = min(self._lose, len(block))
        self._lose -= lost
        self.dropped_packets += lost
        block = block[lost:]
        if self._swap and len(block) > 1:
            block[[0, 1]] = block[[1, 0]]
            self._swap = False
        if len(block):
            self._ready.append((block.tobytes(), block.shape[1] * 4))
