# SPDX-License-Identifier: GPL-3.0-or-later
"""The air of a scene at sample level: static and moving paths, tags, noise.

Received samples are y = sum over paths of the transmit samples, delayed and scaled. A tag's path
is scaled by r(t) = s_1 G_1 + s_2 G_2 + (1 - s_1 - s_2) G_off, with the switches s_i driven by the
tag's own clock; where both are on at once, waves also run through the line from end to end. The
walk of a piece of signal is :meth:`AirChannel._piece`.
"""

import numpy as np

from .oscillators import FreeOscillators
from .paths import MOVING_PATHS, Fir, MovingPath, Ramp, mean_power, static_taps, tag_taps
from .tag import SwitchedTag

PEAK = 10 ** (-3 / 20)  # of full scale: where a scene's transmit frame peaks at the ADC
NOISE_PEAK = 4.5  # standard deviations of a noise component that count as its peak
_MOST_PATHS = 64
_PIECE = 32768  # samples worked on at once: few calls, and still in the cache


class AirChannel:
    """What is on the air of a scene, as a stream of samples.

    Sounding frames of the stated amplitude give the scene's ``snr_db`` and clutter levels, and a
    receive peak 3 dB below full scale (1.0).

    Parameters
    ----------
    scene : Scene
        Everything random in it follows from ``scene.simulation.seed``.
    amplitude : float
        Root of the mean preamble power of the transmit samples.
    through : bool
        The static path is the input itself at unit gain and without delay, for use behind a
        channel of one's own; levels then count from there.
    antenna : int
        Receive antenna: each has paths and noise of its own; tags, what moves and the receiver's
        oscillator are the same.

    Attributes
    ----------
    sensors : dict
        Name to :class:`tag.SwitchedTag`, for what can be changed while running.
    scale : float
        Received amplitude per unit of the signal model's rho.
    """

    def __init__(self, scene, amplitude=1.0, through=False, antenna=0):
        simulation = scene.simulation
        self._rate, self._waveform = scene.radio.sample_rate_hz, scene.waveform()
        self._amplitude = amplitude
        self._ramp = Ramp(self._rate)
        self._tag_line = (
            0.25 * np.sinc(0.25) * np.sinc(scene.sensors[0].clock_hz * self._waveform.averaging_s)
        )
        self._set_noise(simulation.snr_db)

        chances = _Chances(simulation.seed, antenna)
        self._noise_rng = chances.noise
        static = np.ones(1) if through else static_taps(chances.paths, self._rate)
        static = self._scaled(static, self._level(simulation.static_clutter_db))
        movers, mover_taps = self._moving_paths(simulation, chances)
        tags, tag_fades = self._tag_paths(scene, chances)
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
            chances.oscillators,
            self._ramp,
            self._rate,
        )
        firs = [self._static, *(fir for fir, _ in self._movers + self._tags)]
        self._memory = max(fir.memory for fir in firs)
        self._scratch = np.empty((2, _PIECE), np.complex64)
        self.restart(0)

    def _moving_paths(self, simulation, chances):
        """What moves, and the taps of each."""
        if simulation.moving_clutter_db is None:
            return [], []
        hertz = simulation.moving_clutter_hz
        movers = [MovingPath(chances.movers, hertz, i == 0) for i in range(MOVING_PATHS)]
        level = self._level(simulation.moving_clutter_db) / np.sqrt(len(movers))
        taps = [chances.turned(self._scaled(mover.taps, level)) for mover in movers]
        return movers, taps

    def _tag_paths(self, scene, chances):
        """The tags, and the taps of each one's path."""
        simulation = scene.simulation
        tags, taps = [], []
        for sensor, tag in zip(scene.sensors, simulation.tags, strict=True):
            tags.append(SwitchedTag(scene, sensor, tag, chances.clocks, self._ramp))
            fade = tag_taps(chances.paths, self._waveform, simulation.tag_coherence_hz)
            taps.append(chances.turned(self._scaled(fade, 10 ** (tag.level_db / 20))))
        return tags, taps

    def _filtered(self, taps, scatterers):
        return [(Fir(self.scale * t), what) for t, what in zip(taps, scatterers, strict=True)]

    def restart(self, first_sample):
        """Begin anew at a sample: the air holds nothing that was sent before."""
        self._next = int(first_sample)
        self._history = np.zeros(self._memory, np.complex64)

    def set_snr_db(self, snr_db):
        """Change the noise to another ``snr_db`` (scene's definition); signals stay."""
        self._set_noise(float(snr_db))

    @property
    def noise_std(self):
        """Standard deviation of the noise in a received sample (complex, full scale 1)."""
        return self._noise * self.scale

    def touch_state(self, time_s):
        """Name of each sensor to its ``TouchState`` at the given times (s since sample 0)."""
        time_s = np.asarray(time_s, float)
        return {name: tag.pressed.state(time_s) for name, tag in self.sensors.items()}

    def process(self, samples, first_sample):
        """The received samples while these are sent.

        Parameters
        ----------
        samples : array_like of complex, shape (n,)
            Transmit samples.
        first_sample : int
            Index of the first, counted from time 0 of the scene; each call goes on where the
            last one ended (see :meth:`restart`).

        Returns
        -------
        ndarray of complex64, shape (n,)
            Full scale is 1 per component; not clipped.
        """
        if first_sample != self._next:
            raise ValueError(f"first_sample: must go on at {self._next}, got {first_sample}")
        samples = np.ascontiguousarray(samples, np.complex64)
        received = np.empty(len(samples), np.complex64)
        for start in range(0, len(samples), _PIECE):
            part = slice(start, min(start + _PIECE, len(samples)))
            self._piece(samples[part], first_sample + start, received[part])
        self._next += len(samples)
        return received

    def _piece(self, samples, first, received):
        count = len(samples)
        sent = np.concatenate([self._history, samples])
        self._history = sent[count:].copy()
        if sent.any():
            path, scratch = self._scratch[:, :count]
            self._static.apply(sent, count, received, scratch)
            for fir, mover in self._movers:
                fir.apply(sent, count, path, scratch)
                gains = mover.gain(self._ramp.knots(first, count))
                path *= self._ramp.draw(gains, first, count)
                received += path
            for fir, tag in self._tags:
                fir.apply(sent, count, path, scratch)
                path *= tag.reflection(first, count)
                received += path
            self._oscillators.turn(first, received)
        else:
            received[:] = 0
        self._add_noise(received)

    def _add_noise(self, received):
        noise = self._scratch[0].view(np.float32)[: 2 * len(received)]
        self._noise_rng.standard_normal(dtype=np.float32, out=noise)
        noise *= np.float32(self.noise_std / np.sqrt(2))
        received.view(np.float32)[:] += noise

    def _scaled(self, taps, amplitude):
        """Taps brought to an rms amplitude over the occupied subcarriers."""
        return taps * (amplitude / np.sqrt(mean_power(taps, self._waveform)))

    def _level(self, level_db):
        """Amplitude of what is ``level_db`` above |c1[1] G1|; 0 for None."""
        return 0.0 if level_db is None else self._tag_line * 10 ** (level_db / 20)

    def _set_noise(self, snr_db):
        """sigma of a sample, in units of rho, from snr_db = |c1[1] G1|^2 / sigma_H^2."""
        variance_h = self._tag_line**2 / 10 ** (snr_db / 10)
        self._noise = self._amplitude * np.sqrt(variance_h / self._waveform.channel_noise_gain)

    def _peak(self, static, movers, tags):
        """Largest magnitude to expect when the scene's own frame is sent, noise included."""
        frame = self._amplitude * np.tile(self._waveform.frame(), 2)
        total = sum(np.abs(np.convolve(frame, taps)) for taps in _padded([static, *movers, *tags]))
        return total.max() + NOISE_PEAK * self._noise / np.sqrt(2)


class _Chances:
    """What is drawn at random in a scene: a source for each kind, so that none disturbs another.

    Another antenna than the first has paths and noise of its own, and turns what the tags and
    what moves send to it by a phase each.
    """

    def __init__(self, seed, antenna):
        seeds = np.random.SeedSequence(seed).spawn(5)
        generators = map(np.random.default_rng, seeds)
        self.paths, self.clocks, self.movers, self.noise, self.oscillators = generators
        self._turns = iter(np.ones(_MOST_PATHS))
        if antenna:
            own = np.random.SeedSequence(seed, spawn_key=(len(seeds), antenna)).spawn(2)
            self.paths, self.noise = map(np.random.default_rng, own)
            self._turns = iter(np.exp(2j * np.pi * self.paths.random(_MOST_PATHS)))

    def turned(self, taps):
        """The taps of the next path, as this antenna has them."""
        return taps * next(self._turns)


def _padded(filters):
    length = max(len(taps) for taps in filters)
    return [np.pad(taps, (0, length - len(taps))) for taps in filters]
