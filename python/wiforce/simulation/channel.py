# SPDX-License-Identifier: GPL-3.0-or-later
"""The channel of a scene at sample level: static and moving paths, tags, oscillators, noise.

Received samples are y = sum over paths of the transmit samples, delayed and scaled. A tag's path
is scaled by r(t) = s_1 G_1 + s_2 G_2 + (1 - s_1 - s_2) G_off, with the switches s_i driven by the
tag's own clock; where both are on at once, waves also run through the line from end to end.
:meth:`AirChannel._piece` computes these steps in order.
"""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from .oscillators import FreeOscillators
from .paths import MOVING_PATHS, MovingPath, mean_power, static_taps, tag_taps
from .presses import TouchState
from .streams import Fir, Ramp
from .tag import SwitchedTag

if TYPE_CHECKING:
    from ..scene import Scene
    from ..scene.simulated import Simulation

_Scatterer = TypeVar("_Scatterer")

# Peak of a scene's frame at the ADC, as a part of full scale.
PEAK = 10 ** (-3 / 20)
# Standard deviations of a noise component that count as its peak.
NOISE_PEAK = 4.5
_MOST_PATHS = 64
# Samples processed at once: few calls, and intermediate results stay in the cache.
_PIECE = 32768


class AirChannel:
    """The received samples of a scene, as a stream.

    Sounding frames of the stated amplitude give the scene's ``snr_db`` and clutter levels, and a
    receive peak 3 dB below full scale (1.0).

    Parameters
    ----------
    scene : Scene
        Everything random in it follows from ``scene.simulation.seed``.
    amplitude : float
        Root of the mean preamble power of the transmit samples.
    through : bool
        The static path is the input itself at unit gain and without delay, for use behind
        another channel; levels are then relative to it.
    antenna : int
        Receive antenna, from 0: each has its own paths and noise; tags, moving objects and the
        receiver's oscillator are common.

    Attributes
    ----------
    sensors : dict of str to SwitchedTag
        Tags by sensor name, to change them while running.
    scale : float
        Received amplitude per unit of the signal model's rho.

    Examples
    --------
    >>> from gnuradio.wiforce.scene import load_scene
    >>> scene = load_scene("demo")
    >>> channel = AirChannel(scene)
    >>> received = channel.process(scene.waveform().frame(), first_sample=0)
    >>> received.shape, received.dtype.name, bool(np.abs(received).max() < 1.0)
    ((720,), 'complex64', True)
    """

    def __init__(
        self,
        scene: "Scene",
        amplitude: float = 1.0,
        through: bool = False,
        antenna: int = 0,
    ) -> None:
        simulation = scene.simulation
        self._rate, self._waveform = scene.radio.sample_rate_hz, scene.waveform()
        self._amplitude = amplitude
        self._ramp = Ramp(self._rate)
        averaging_cycles = scene.sensors[0].clock_hz * self._waveform.averaging_s
        self._tag_line = float(0.25 * np.sinc(0.25) * np.sinc(averaging_cycles))
        self._set_noise(simulation.snr_db)

        sources = _RandomSources(simulation.seed, antenna)
        self._noise_rng = sources.noise
        static = np.ones(1) if through else static_taps(sources.paths, self._rate)
        static = self._scaled(static, self._level(simulation.static_clutter_db))
        movers, mover_taps = self._moving_paths(simulation, sources)
        tags, tag_fades = self._tag_paths(scene, sources)
        if through:
            self.scale = 1 / self._level(simulation.static_clutter_db)
        else:
            self.scale = PEAK / self._peak(static, mover_taps, tag_fades)
        self.sensors = {tag.name: tag for tag in tags}
        self._static = Fir(self.scale * static)
        self._movers = self._filtered(mover_taps, movers)
        self._tags = self._filtered(tag_fades, tags)
        self._oscillators = FreeOscillators(
            simulation.carrier_offset_hz,
            simulation.phase_noise_hz,
            sources.oscillators,
            self._ramp,
            self._rate,
        )
        firs = [self._static, *(fir for fir, _ in self._movers + self._tags)]
        self._memory = max(fir.memory for fir in firs)
        self._scratch = np.empty((2, _PIECE), np.complex64)
        self.restart(0)

    def _moving_paths(
        self, simulation: "Simulation", sources: "_RandomSources"
    ) -> tuple[list[MovingPath], list[np.ndarray]]:
        """The moving paths, and the taps of each."""
        if simulation.moving_clutter_db is None:
            return [], []
        hertz = simulation.moving_clutter_hz
        movers = [MovingPath(sources.movers, hertz, i == 0) for i in range(MOVING_PATHS)]
        level = self._level(simulation.moving_clutter_db) / np.sqrt(len(movers))
        taps = [sources.rotated(self._scaled(mover.taps, level)) for mover in movers]
        return movers, taps

    def _tag_paths(
        self, scene: "Scene", sources: "_RandomSources"
    ) -> tuple[list[SwitchedTag], list[np.ndarray]]:
        """The tags, and the taps of the path by way of each."""
        simulation = scene.simulation
        tags, taps = [], []
        for sensor, tag in zip(scene.sensors, simulation.tags, strict=True):
            tags.append(SwitchedTag(scene, sensor, tag, sources.clocks, self._ramp))
            fade = tag_taps(sources.paths, self._waveform, simulation.tag_coherence_hz)
            taps.append(sources.rotated(self._scaled(fade, 10 ** (tag.level_db / 20))))
        return tags, taps

    def _filtered(
        self, taps: Sequence[np.ndarray], scatterers: Sequence[_Scatterer]
    ) -> list[tuple[Fir, _Scatterer]]:
        return [(Fir(self.scale * t), each) for t, each in zip(taps, scatterers, strict=True)]

    def restart(self, first_sample: int) -> None:
        """Continue at another sample, with silence before it.

        Parameters
        ----------
        first_sample : int
            Index of the next sample, counted from time 0 of the scene.
        """
        self._next = int(first_sample)
        self._history = np.zeros(self._memory, np.complex64)

    def set_snr_db(self, snr_db: float) -> None:
        """Change the noise.

        Parameters
        ----------
        snr_db : float
            As in a scene; signal levels stay.
        """
        self._set_noise(float(snr_db))

    @property
    def noise_std(self) -> float:
        """Standard deviation of the noise in a received sample (complex, full scale 1)."""
        return self._noise * self.scale

    def touch_state(self, time_s: ArrayLike) -> dict[str, TouchState]:
        """State of every sensor at given times.

        Parameters
        ----------
        time_s : array_like of float, shape (n,)
            In s since sample 0.

        Returns
        -------
        dict of str to TouchState
            By sensor name.
        """
        time_s = np.asarray(time_s, float)
        return {name: tag.pressed.state(time_s) for name, tag in self.sensors.items()}

    def process(self, samples: ArrayLike, first_sample: int) -> np.ndarray:
        """Receive while samples are sent.

        Parameters
        ----------
        samples : array_like of complex, shape (n,)
            Transmit samples.
        first_sample : int
            Index of the first, counted from time 0 of the scene; each call continues where the
            previous one ended (see :meth:`restart`).

        Returns
        -------
        ndarray of complex64, shape (n,)
            Full scale is 1 per component; not clipped.

        Raises
        ------
        ValueError
            When ``first_sample`` does not continue the stream.
        """
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
        sent = np.concatenate([self._history, samples])
        self._history = sent[count:].copy()
        if sent.any():
            path, scratch = self._scratch[:, :count]
            self._static.apply(sent, count, received, scratch)
            for fir, mover in self._movers:
                fir.apply(sent, count, path, scratch)
                gains = mover.gain(self._ramp.knots(first, count))
                path *= self._ramp.interpolate(gains, first, count)
                received += path
            for fir, tag in self._tags:
                fir.apply(sent, count, path, scratch)
                path *= tag.reflection(first, count)
                received += path
            self._oscillators.rotate(first, received)
        else:
            received[:] = 0
        self._add_noise(received)

    def _add_noise(self, received: np.ndarray) -> None:
        noise = self._scratch[0].view(np.float32)[: 2 * len(received)]
        self._noise_rng.standard_normal(dtype=np.float32, out=noise)
        noise *= np.float32(self.noise_std / np.sqrt(2))
        received.view(np.float32)[:] += noise

    def _scaled(self, taps: np.ndarray, amplitude: float) -> np.ndarray:
        """Taps scaled to an rms amplitude over the occupied subcarriers."""
        return taps * (amplitude / np.sqrt(mean_power(taps, self._waveform)))

    def _level(self, level_db: float | None) -> float:
        """Amplitude that is ``level_db`` above |c1[1] G1|; 0 for None."""
        return 0.0 if level_db is None else self._tag_line * 10 ** (level_db / 20)

    def _set_noise(self, snr_db: float) -> None:
        """sigma of a sample, in units of rho, from snr_db = |c1[1] G1|^2 / sigma_H^2."""
        variance_h = self._tag_line**2 / 10 ** (snr_db / 10)
        self._noise = self._amplitude * np.sqrt(variance_h / self._waveform.channel_noise_gain)

    def _peak(
        self, static: np.ndarray, movers: Sequence[np.ndarray], tags: Sequence[np.ndarray]
    ) -> float:
        """Largest expected magnitude while the scene's own frame is sent, noise included."""
        frame = self._amplitude * np.tile(self._waveform.frame(), 2)
        paths = _padded([static, *movers, *tags])
        total = np.sum([np.abs(np.convolve(frame, taps)) for taps in paths], axis=0)
        return float(total.max() + NOISE_PEAK * self._noise / np.sqrt(2))


class _RandomSources:
    """Generators of a scene's random quantities, one per kind, so that kinds stay independent.

    Antennas other than the first have their own paths and noise, and rotate each path of tags and
    moving objects by a phase of its own.
    """

    def __init__(self, seed: int, antenna: int) -> None:
        seeds = np.random.SeedSequence(seed).spawn(5)
        generators = map(np.random.default_rng, seeds)
        self.paths, self.clocks, self.movers, self.noise, self.oscillators = generators
        self._rotations: Iterator[complex] = iter(np.ones(_MOST_PATHS))
        if antenna:
            own = np.random.SeedSequence(seed, spawn_key=(len(seeds), antenna)).spawn(2)
            self.paths, self.noise = map(np.random.default_rng, own)
            self._rotations = iter(np.exp(2j * np.pi * self.paths.random(_MOST_PATHS)))

    def rotated(self, taps: np.ndarray) -> np.ndarray:
        """The taps of the next path, as this antenna has them."""
        return taps * next(self._rotations)


def _padded(filters: Sequence[np.ndarray]) -> list[np.ndarray]:
    length = max(len(taps) for taps in filters)
    return [np.pad(taps, (0, length - len(taps))) for taps in filters]
