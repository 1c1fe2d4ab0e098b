# SPDX-License-Identifier: GPL-3.0-or-later
"""The channel of a scene between the device's connectors, at absolute levels."""

import numpy as np
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.simulation.channel import AirChannel
from gnuradio.wiforce.simulation.radio import Adc

from .frontend import FULL_SCALE, REFERENCE_GAIN_DB, Cable, SampleHistory, amplitude
from .wire import TICK_RATE

# A sounding waveform of this amplitude (its mean preamble power is the square), at the board's
# middle gains, gives the levels of the scene.
REFERENCE_AMPLITUDE = 0.5
_CARRIER_TOLERANCE = 1e-6


class SceneAir(Cable):
    """Applies the channel of a scene to the transmitted signal; see docs/radios.md.

    At another rate or carrier than the scene's only noise is received.
    Time 0 is the first sample of the first stream after the device is opened, in each session.
    ``reference_s`` is the signal at its begin that a reader takes for the untouched sensor.
    """

    def __init__(self, scene, delay_ticks):
        super().__init__(delay_ticks)
        self._scene, self.reference_s = scene, scene.reference_s
        self._spacing = round(TICK_RATE / scene.radio.sample_rate_hz)
        self._adc = Adc(scene.simulation.adc_bits)
        self.restart()

    def restart(self):
        super().restart()
        self._channel = AirChannel(self._scene)  # an InputError for one that cannot be simulated
        self._received = SampleHistory()
        self._origin, self._next = None, 0

    def forget(self, tick):
        super().forget(tick)
        self._received.forget(tick)

    def transmit(self, tick, spacing, samples):
        level = amplitude(self.front_end.tx_gain_db - REFERENCE_GAIN_DB)
        self._sent.append(tick, spacing, samples * np.float32(level / REFERENCE_AMPLITUDE))

    def receive(self, chain, tick, spacing, count):
        if chain.stream_start is None:
            return np.zeros(count, np.complex64)
        self._continue_at(chain, tick, spacing)
        self._advance(chain, tick + (count - 1) * spacing, spacing)
        return self._received.take(tick, spacing, count)

    def sensor(self, name):
        if name not in self._channel.sensors:
            known = ", ".join(self._channel.sensors)
            raise InputError("sensor", f"must be one of the scene's ({known})", name)
        return self._channel.sensors[name]

    @property
    def time_s(self):
        """Time of the next sample that is received."""
        return self._next * self._spacing / TICK_RATE

    def status(self):
        """Current force, location and touch of each sensor."""
        states = self._channel.touch_state([self.time_s])
        return {"sensors": {name: _plain(state) for name, state in states.items()}}

    def _continue_at(self, chain, tick, spacing):
        """Continue the channel at `tick`."""
        if self._origin is None:
            self._origin = chain.stream_start
        position = -(-(tick - self._origin) // spacing)
        if position != self._next:
            self._channel.restart(position)
            self._next = position

    def _is_tuned(self, spacing):
        """Whether rate and transmit carrier are the scene's, but for rounding."""
        wanted_hz = self._scene.radio.center_frequency_hz
        offset_hz = abs(self.front_end.tx_carrier_hz - wanted_hz)
        return spacing == self._spacing and offset_hz <= _CARRIER_TOLERANCE * wanted_hz

    def _advance(self, chain, last_tick, spacing):
        """Run the channel until it covers `last_tick`."""
        count = (last_tick - self._origin) // spacing + 1 - self._next
        if count <= 0:
            return
        tick = self._origin + self._next * spacing
        sent = self._sent.take(tick - self._delay, spacing, count)
        if not self._is_tuned(spacing):
            sent[:] = 0
        received = self._channel.process(sent, self._next)
        received = self.front_end.to_receive_carrier(received, chain, tick, spacing)
        codes = self._adc.codes(received * amplitude(self.front_end.rx_gain_db - REFERENCE_GAIN_DB))
        samples = codes.astype(np.float32) / np.float32(FULL_SCALE)
        self._received.append(tick, spacing, samples.view(np.complex64))
        self._next += count


def _plain(state):
    """A touch state as plain values."""
    location_mm = float(state.location_mm[0])
    return {
        "touch": bool(state.touch[0]),
        "force_n": float(state.force_n[0]),
        "location_mm": None if np.isnan(location_mm) else location_mm,
    }
