# SPDX-License-Identifier: GPL-3.0-or-later
"""A cable between the connectors, and the samples that were sent."""

from collections import deque

import numpy as np
from gnuradio.wiforce.errors import InputError


class SampleHistory:
    """Recent samples on the device's time line; zero where there are none."""

    def __init__(self):
        self._segments = deque()

    def append(self, tick, spacing, samples):
        """Add samples that start at `tick`, one every `spacing` ticks."""
        self._segments.append((tick, spacing, samples))

    def forget(self, tick):
        """Drop samples that ended before `tick`."""
        while self._segments:
            start, spacing, samples = self._segments[0]
            if start + (len(samples) + 1) * spacing > tick:
                break
            self._segments.popleft()

    def take(self, tick, spacing, count):
        """`count` samples from `tick` on, every `spacing` ticks: the nearest sample each."""
        out = np.zeros(count, np.complex64)
        for start, step, samples in self._segments:
            if step == spacing:
                first = (tick - start + step // 2) // step
                low, high = max(0, -first), min(count, len(samples) - first)
                if low < high:
                    out[low:high] = samples[first + low : first + high]
            else:
                index = (tick - start + step // 2 + np.arange(count) * spacing) // step
                inside = (index >= 0) & (index < len(samples))
                out[inside] = samples[index[inside]]
        return out


class Cable:
    """A cable between the connectors, of unit gain at 0 dB each, with the device's own delay.

    ``front_end`` is that of the device that it is connected to.
    """

    def __init__(self, delay_ticks):
        self._delay = delay_ticks
        self._sent = SampleHistory()
        self.front_end = None

    def restart(self):
        """Forget the last session."""
        self._sent = SampleHistory()

    def forget(self, tick):
        """Drop samples that cannot be received after `tick` any more."""
        self._sent.forget(tick - self._delay)

    def transmit(self, tick, spacing, samples):
        """Take samples that are transmitted from `tick` on; complex64, 1.0 at full scale."""
        self._sent.append(tick, spacing, samples * amplitude(self.front_end.tx_gain_db))

    def receive(self, chain, tick, spacing, count):
        """Samples that are received from `tick` on; complex64, 1.0 at full scale."""
        samples = self._sent.take(tick - self._delay, spacing, count)
        samples = self.front_end.to_receive_carrier(samples, chain, tick, spacing)
        return samples * amplitude(self.front_end.rx_gain_db)

    def status(self):
        """State beyond the device's own, as plain values."""
        return {}

    def sensor(self, name):
        """A sensor on the air; InputError for another name."""
        raise InputError("sensor", "requires --air scene", name)


def amplitude(db):
    """Amplitude ratio of a level in dB; float32."""
    return np.float32(10 ** (db / 20))
