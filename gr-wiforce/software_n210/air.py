# SPDX-License-Identifier: GPL-3.0-or-later
"""What lies between the transmit and the receive connector: a cable, or a counter for tests."""

from collections import deque

import numpy as np
from gnuradio.wiforce.errors import InputError

from .dsp import FULL_SCALE
from .wire import TICK_RATE


class SampleHistory:
    """Recent samples on the device's time line; what was never there is zero."""

    def __init__(self):
        self._segments = deque()

    def append(self, tick, spacing, samples):
        """Add samples that start at `tick`, one every `spacing` ticks."""
        self._segments.append((tick, spacing, samples))

    def forget(self, tick):
        """Drop what ended before `tick`."""
        while self._segments:
            start, spacing, samples = self._segments[0]
            if start + (len(samples) + 1) * spacing > tick:
                break
            self._segments.popleft()

    def take(self, tick, spacing, count):
        """`count` samples from `tick` on, one every `spacing` ticks: the nearest there is."""
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


class Tuning:
    """Carriers and gains of the device, from its front end and its converters.

    Parameters
    ----------
    front_end : FrontEnd
    tx_dsp : DspRegisters
    """

    def __init__(self, front_end, tx_dsp):
        self._front_end = front_end
        self._tx_dsp = tx_dsp

    @property
    def tx_carrier_hz(self):
        return self._front_end.tx_lo_hz + self._tx_dsp.frequency_hz

    def rx_carrier_hz(self, rx_dsp):
        return self._front_end.rx_lo_hz - rx_dsp.frequency_hz

    @property
    def reference_gain_db(self):
        """Gain in the middle of the board's range, either way."""
        return self._front_end.reference_gain_db

    @property
    def tx_gain_db(self):
        return self._front_end.tx_gain_db

    @property
    def rx_gain_db(self):
        return self._front_end.rx_gain_db

    def to_receive_carrier(self, samples, chain, tick, spacing):
        """Transmit baseband as it appears at a receive chain's carrier; complex64.

        A signal outside the receive band vanishes; one that lies across its edge is not cut.
        """
        offset_hz = self.tx_carrier_hz - self.rx_carrier_hz(chain.dsp)
        if offset_hz == 0:
            return samples
        bandwidth_hz = TICK_RATE / chain.dsp.ticks_per_sample
        if abs(offset_hz) >= (bandwidth_hz + TICK_RATE / self._tx_dsp.ticks_per_sample) / 2:
            return np.zeros_like(samples)
        turns_per_tick = offset_hz / TICK_RATE
        turns = turns_per_tick * tick % 1 + turns_per_tick * spacing * np.arange(len(samples))
        return (samples * np.exp(2j * np.pi * turns)).astype(np.complex64)


class Cable:
    """Transmit joined to receive by a cable whose attenuator leaves unit gain at 0 dB and 0 dB.

    Parameters
    ----------
    delay_ticks : int
        From transmit to receive, as the device's own filters have it.

    Attributes
    ----------
    tuning : Tuning
    clock : DeviceClock
        Both are set by the device that it is joined to.
    """

    def __init__(self, delay_ticks):
        self._delay = delay_ticks
        self._sent = SampleHistory()
        self.tuning = None
        self.clock = None

    def restart(self):
        """Forget the last session."""
        self._sent = SampleHistory()

    def forget(self, tick):
        """Nothing before `tick` will be received any more."""
        self._sent.forget(tick - self._delay)

    def transmit(self, tick, spacing, samples):
        """Samples that leave the device from `tick` on; complex64, 1.0 at full scale."""
        self._sent.append(tick, spacing, samples * amplitude(self.tuning.tx_gain_db))

    def receive(self, chain, tick, spacing, count):
        """Samples that arrive from `tick` on; complex64, 1.0 at full scale."""
        samples = self._sent.take(tick - self._delay, spacing, count)
        samples = self.tuning.to_receive_carrier(samples, chain, tick, spacing)
        return samples * amplitude(self.tuning.rx_gain_db)

    def status(self):
        """What there is to say beyond the device's own status."""
        return {}

    def check_sensor(self, sensor):
        """Raises InputError: there is no sensor on a cable."""
        raise InputError("sensor", "needs a scene on the air", sensor)

    def press(self, sensor, *_):
        self.check_sensor(sensor)

    def release(self, sensor, *_):
        self.check_sensor(sensor)


class Counter(Cable):
    """Receives a count of samples of device time, so that a host can check every one.

    I holds the lower, Q the upper 16 bits of device time in samples.

    Parameters
    ----------
    delay_ticks : int
        As for a cable.
    """

    def receive(self, chain, tick, spacing, count):
        number = np.arange(count, dtype=np.int64) + self.clock.to_time(tick) // spacing
        parts = np.stack((number, number >> 16), axis=1).astype(np.int16)
        return (parts.astype(np.float32) / np.float32(FULL_SCALE)).view(np.complex64).reshape(-1)


def amplitude(db):
    """Amplitude ratio of a level in dB; float32."""
    return np.float32(10 ** (db / 20))
