# SPDX-License-Identifier: GPL-3.0-or-later
"""The channel of a scene at sample level: static and moving paths, tags, oscillators, noise.

Received samples are y = sum over paths of the transmit samples, delayed and scaled. A tag's path
is scaled by r(t) = s_1 G_1 + s_2 G_2 + (1 - s_1 - s_2) G_off, with the switches s_i driven by the
tag's own clock; where both are on at once, waves also run through the line from end to end.
:meth:`AirChannel._piece` computes these steps in order.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from ..scene import Scene
from .paths import Levels, modulated_paths, static_taps, tag_paths
from .presses import TouchState
from .radio import (
    AnalogueFrontEnd,
    FreeOscillators,
    GainRipple,
    RadioNoiseSource,
    power_over_noise,
    transmitters,
)
from .random_sources import Fir, Ramp, RandomSources

# Peak of a scene's frame at the ADC, as a part of full scale.
PEAK = 10 ** (-3 / 20)
# Samples processed at once: few calls, and intermediate results stay in the cache.
_PIECE = 32768


class AirChannel:
    """The received samples of a scene, as a stream.

    Frames of ``amplitude``, the root of the mean preamble power, give the scene's levels and a peak
    3 dB below full scale (1.0). ``through`` makes the static path the input itself. Each
    ``antenna`` has its own paths and noise. ``sensors`` are tags by name, to change them while
    running; ``scale`` is the received amplitude per unit of rho.
    """

    def __init__(
        self,
        scene: Scene,
        amplitude: float = 1.0,
        through: bool = False,
        antenna: int = 0,
    ) -> None:
        simulation, rate_hz = scene.simulation, scene.radio.sample_rate_hz
        self._levels, ramp = Levels(scene, amplitude), Ramp(rate_hz)
        self._noise = self._levels.noise(simulation.snr_db)
        sources = RandomSources(simulation.seed, antenna)
        self._noise_rng = sources.noise
        static_level = self._levels.amplitude(simulation.static_clutter_db)
        static = np.ones(1) if through else static_taps(sources.paths, rate_hz)
        static = self._levels.scaled(static, static_level)
        paths = modulated_paths(scene, self._levels, sources, ramp)
        self.sensors, of_tags = tag_paths(scene, self._levels, sources, ramp)
        paths += of_tags
        if through:
            self.scale, peak = 1 / static_level, self._levels.frame_peak()
        else:
            taps = [static, *(taps for taps, _ in paths)]
            noise = self._noise * float(np.sqrt(1 + power_over_noise(simulation)))
            self.scale, peak = PEAK / self._levels.peak(taps, noise), PEAK
        self._static = Fir(self.scale * static)
        self._paths = [(Fir(self.scale * taps), gain) for taps, gain in paths]
        # What acts on samples before the paths, behind them, and behind the noise; in its order.
        self._sending: list[Callable[[int, np.ndarray], np.ndarray]] = []
        self._turning: list[Callable[[int, np.ndarray], None]] = []
        others = transmitters(simulation, sources, rate_hz, self.noise_std)
        self._receiving: list[Callable[[int, np.ndarray], None]] = [each.add for each in others]
        if ripple := simulation.ripple:
            self._turning.append(GainRipple(ripple, ramp, sources.effect("ripple")).modulate)
        oscillators = FreeOscillators(simulation, sources.oscillators, ramp, rate_hz)
        self._turning.append(oscillators.rotate)
        if stated := simulation.front_end:
            front_end = AnalogueFrontEnd(stated, peak, sources.effect("front_end"))
            self._sending.append(front_end.transmit)
            self._receiving.append(front_end.receive)
        self._radio_noise = None
        if of_radio := simulation.radio_noise:
            seeds = sources.effect("radio_noise")
            self._radio_noise = RadioNoiseSource(of_radio, amplitude, ramp, rate_hz, seeds)
            self._sending.append(self._radio_noise.transmit)
            self._turning.append(self._radio_noise.rotate)
        self._memory = max(fir.memory for fir in [self._static, *(fir for fir, _ in self._paths)])
        self._scratch = np.empty((2, _PIECE), np.complex64)
        self.restart(0)

    def restart(self, first_sample: int) -> None:
        """Continue at another sample, counted from time 0 of the scene, with silence before it."""
        self._next = int(first_sample)
        self._history = np.zeros(self._memory, np.complex64)
        if self._radio_noise and first_sample >= self._memory:
            # The transmitter's noise does not pause.
            before = int(first_sample) - self._memory
            self._history = self._radio_noise.transmit(before, self._history)

    def set_snr_db(self, snr_db: float) -> None:
        """Change the noise to the ``snr_db`` of a scene; signal levels stay."""
        self._noise = self._levels.noise(float(snr_db))

    @property
    def noise_std(self) -> float:
        """Standard deviation of the noise in a received sample (complex, full scale 1)."""
        return self._noise * self.scale

    def touch_state(self, time_s: ArrayLike) -> dict[str, TouchState]:
        """State of every sensor, by name, at times in s since sample 0."""
        time_s = np.asarray(time_s, float)
        return {name: tag.pressed.state(time_s) for name, tag in self.sensors.items()}

    def process(self, samples: ArrayLike, first_sample: int) -> np.ndarray:
        """Receive (n,) while samples (n,) are sent, full scale 1, where the last call ended."""
        if first_sample != self._next:
            raise ValueError(f"first_sample: must continue at {self._next}, got {first_sample}")
        sent = np.ascontiguousarray(samples, np.complex64)
        received = np.empty(len(sent), np.complex64)
        for start in range(0, len(sent), _PIECE):
            part = slice(start, min(start + _PIECE, len(sent)))
            self._piece(sent[part], first_sample + start, received[part])
        self._next += len(sent)
        return received

    def _piece(self, samples: np.ndarray, first: int, received: np.ndarray) -> None:
        count = len(samples)
        for send in self._sending:
            samples = send(first, samples)
        sent = np.concatenate([self._history, samples])
        self._history = sent[count:].copy()
        if sent.any():
            path, scratch = self._scratch[:, :count]
            self._static.apply(sent, count, received, scratch)
            for fir, gain in self._paths:
                fir.apply(sent, count, path, scratch)
                path *= gain(first, count)
                received += path
            for turn in self._turning:
                turn(first, received)
        else:
            received[:] = 0
        self._add_noise(received)
        for receive in self._receiving:
            receive(first, received)

    def _add_noise(self, received: np.ndarray) -> None:
        noise = self._scratch[0].view(np.float32)[: 2 * len(received)]
        self._noise_rng.standard_normal(dtype=np.float32, out=noise)
        noise *= np.float32(self.noise_std / np.sqrt(2))
        received.view(np.float32)[:] += noise
