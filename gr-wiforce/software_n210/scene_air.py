# SPDX-License-Identifier: GPL-3.0-or-later
"""The channel of a scene between the device's connectors, at absolute levels."""

import numpy as np
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.simulation.channel import AirChannel
from gnuradio.wiforce.simulation.radio import Adc

from .frontend import FULL_SCALE, REFERENCE_GAIN_DB, Cable, amplitude
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
        self._next = 0

    def transmit(self, tick, spacing, samples):
        level = amplitude(self.front_end.tx_gain_db - REFERENCE_GAIN_DB)
        self._sent.append(tick, spacing, samples * np.float32(level / REFERENCE_AMPLITUDE))

    def receive(self, chain, tick, spacing, count):
        if chain.stream_start is None:
            return np.zeros(count, np.complex64)
        position = -(-(tick - chain.stream_start) // spacing)
        if position != self._next:
            self._channel.restart(position)
        self._next = position + count
        sent = self._sent.take(tick - self._delay, spacing, count)
        if not self._is_tuned(spacing):
            sent[:] = 0
        received = self._channel.process(sent, position)
        received = self.front_end.to_receive_carrier(received, chain, tick, spacing)
        codes = self._adc.codes(received * amplitude(self.front_end.rx_gain_db - REFERENCE_GAIN_DB))
        return (codes.astype(np.float32) / np.float32(FULL_SCALE)).view(np.complex64)

    def sensor(self, name):
        if name not in self._channel.sensors:
            known = ", ".join(self._channel.sensors)
            raise InputError("sensor", f"must be one of the scene's ({known})", name)
        return self._channel.sensors[name]

    def beyond_calibration(self, name, force_n, location_mm):
        """Where a reader's model was not calibrated for a press, a sentence; empty elsewhere."""
        for sensor in self._scene.sensors:
            model = sensor.load_model(self._scene)
            if sensor.name == name and not np.all(model.in_span([force_n], location_mm)):
                return (
                    f"{force_n:g} N at {location_mm:g} mm leave the span that the model of {name} "
                    "was calibrated for; the force is in newtons"
                )
        return ""

    def status(self):
        """Force, location and touch of each sensor at the next sample that is received."""
        states = self._channel.touch_state([self._next * self._spacing / TICK_RATE])
        return {"sensors": {name: _plain(state) for name, state in states.items()}}

    def _is_tuned(self, spacing):
        """Whether rate and transmit carrier are the scene's, but for rounding."""
        wanted_hz = self._scene.radio.center_frequency_hz
        offset_hz = abs(self.front_end.tx_carrier_hz - wanted_hz)
        return spacing == self._spacing and offset_hz <= _CARRIER_TOLERANCE * wanted_hz


def _plain(state):
    """A touch state as plain values."""
    location_mm = float(state.location_mm[0])
    return {
        "touch": bool(state.touch[0]),
        "force_n": float(state.force_n[0]),
        "location_mm": None if np.isnan(location_mm) else location_mm,
    }
