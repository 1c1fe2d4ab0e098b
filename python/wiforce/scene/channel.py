# SPDX-License-Identifier: GPL-3.0-or-later
"""The air of a scene at sample level: static and moving paths, tags, noise; and the ADC.

Received samples are y = sum over paths of the transmit samples, delayed and scaled. A tag's path
is scaled by r(t) = s_1 G_1 + s_2 G_2 + (1 - s_1 - s_2) G_off, with the switches s_i driven by the
tag's own clock; where both are on at once, waves also run through the line from end to end. The
walk of a piece of signal is :meth:`AirChannel._piece`.
"""

import numpy as np

from .oscillators import FreeOscillators
from .paths import MOVING_PATHS as _MOVING_PATHS
from .paths import Fir, MovingPath, Ramp, mean_power, static_taps, tag_taps
from .presses import PressedSensor
from .switching import SWITCHES, SwitchingClock, switch_states

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
        Name to :class:`TagOnAir`, for what can be changed while running.
    scale : float
        Received amplitude per unit of the signal model's rho.
    """

    def __init__(self, scene, amplitude=1.0, through=False, antenna=0):
        simulation, waveform = scene.simulation, scene.waveform()
        seeds = np.random.SeedSequence(simulation.seed).spawn(5)
        generators = map(np.random.default_rng, seeds)
        paths_rng, clocks_rng, movers_rng, noise_rng, oscillators_rng = generators
        turn = np.ones(_MOST_PATHS)  # of each path to this antenna against that to the first
        if antenna:
            own = np.random.SeedSequence(simulation.seed, spawn_key=(len(seeds), antenna)).spawn(2)
            paths_rng, noise_rng = map(np.random.default_rng, own)
            turn = np.exp(2j * np.pi * paths_rng.random(_MOST_PATHS))
        self._rate = scene.radio.sample_rate_hz
        self._ramp = Ramp(self._rate)
        self._noise_rng = noise_rng
        self._waveform, self._amplitude = waveform, amplitude

        clock_hz = scene.sensors[0].clock_hz
        self._tag_line = 0.25 * np.sinc(0.25) * np.sinc(clock_hz * waveform.averaging_s)
        static = np.ones(1) if through else static_taps(paths_rng, self._rate)
        static = _scaled(static, waveform, self._level(simulation.static_clutter_db))
        movers = (
            [
                MovingPath(movers_rng, simulation.moving_clutter_hz, i == 0)
                for i in range(_MOVING_PATHS)
            ]
            if simulation.moving_clutter_db is not None
            else []
        )
        mover_level = self._level(simulation.moving_clutter_db) / np.sqrt(max(len(movers), 1))
        mover_taps = [_scaled(mover.taps, waveform, mover_level) for mover in movers]
        if antenna:
            mover_taps = [taps * t for taps, t in zip(mover_taps, turn, strict=False)]
        tags = [
            TagOnAir(scene, sensor, tag, clocks_rng, self._ramp)
            for sensor, tag in zip(scene.sensors, simulation.tags, strict=True)
        ]
        tag_fades = [
            _scaled(
                tag_taps(paths_rng, waveform, simulation.tag_coherence_hz),
                waveform,
                10 ** (tag.level_db / 20),
            )
            for tag in simulation.tags
        ]
        if antenna:
            tag_fades = [taps * t for taps, t in zip(tag_fades, turn[len(movers) :], strict=False)]
        self.sensors = {tag.name: tag for tag in tags}

        self._set_noise(simulation.snr_db)
        if through:
            self.scale = 1 / self._level(simulation.static_clutter_db)
        else:
            self.scale = PEAK / self._peak(static, mover_taps, tag_fades)
        self._static = Fir(self.scale * static)
        self._movers = [
            (Fir(self.scale * taps), mover) for taps, mover in zip(mover_taps, movers, strict=True)
        ]
        self._tags = [
            (Fir(self.scale * taps), tag) for taps, tag in zip(tag_fades, tags, strict=True)
        ]
        self._oscillators = FreeOscillators(
            simulation.carrier_offset_hz,
            simulation.phase_noise_hz,
            oscillators_rng,
            self._ramp,
            self._rate,
        )
        firs = [self._static, *(fir for fir, _ in self._movers + self._tags)]
        self._memory = max(fir.memory for fir in firs)
        self._scratch = np.empty((2, _PIECE), np.complex64)
        self.restart(0)

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


class TagOnAir:
    """A tag in the air: its clock, its switches, the sensor that they show.

    Attributes
    ----------
    name : str
    clock : SwitchingClock
    pressed : PressedSensor
    on : bool
        False takes the tag off the air.
    """

    def __init__(self, scene, sensor, tag, rng, ramp):
        self.name, self.on = sensor.name, True
        self._rate, self._ramp = scene.radio.sample_rate_hz, ramp
        simulation = scene.simulation
        last_ppm = tag.clock_offset_ppm + tag.clock_drift_ppm_per_s * simulation.duration_s
        phase = rng.random()
        if tag.clock_phase_deg is not None:
            phase = tag.clock_phase_deg / 360
        self.clock = SwitchingClock(
            sensor.clock_hz,
            tag.clock_offset_ppm,
            tag.clock_drift_ppm_per_s,
            max(sensor.clock_tolerance_ppm, abs(tag.clock_offset_ppm), abs(last_ppm)),
            phase,
        )
        self._switches, self._delay_s = SWITCHES[tag.clock2_duty], tag.clock2_delay_s
        self._off = np.array(sensor.off_reflection)
        self._turn = np.exp(2j * np.pi * rng.random())
        self.pressed = PressedSensor(
            scene.load_model(tag.truth_model),
            [press for press in simulation.presses if press.sensor == sensor.name],
            [move for move in simulation.moves if move.sensor == sensor.name],
            scene.radio.center_frequency_hz,
        )

    def reflection(self, first, count):
        """r / rho of the samples; complex64, shape (count,)."""
        if not self.on:
            return np.zeros(count, np.complex64)
        first_on, second_on = switch_states(
            self.clock, self._switches, self._delay_s, first, count, self._rate
        )
        both_on = first_on * second_on
        times = self._ramp.knots(first, count)
        ends = self.pressed.reflections(times)
        path = self._turn * self.pressed.motion(times)
        # Against the off state, which is taken with the rest of the time.
        states = [first_on, second_on]
        values = [ends[:, 0] - self._off[0], ends[:, 1] - self._off[1]]
        if both_on.any():
            states.append(both_on)
            values.append(self.pressed.through(times) + self._off.mean())
        if self._off.any():
            states.append(np.ones_like(first_on))
            values.append(self._off.mean())
        values = [np.atleast_1d(value * path).astype(np.complex64) for value in values]
        return self._sum(states, values, first, count)

    def _sum(self, states, values, first, count):
        """Sum of the states times their values: constants, or values at the knots."""
        if all(len(value) == 1 for value in values):
            parts = np.concatenate(values).view(np.float32).reshape(-1, 2)
            return (np.stack(states).T @ parts).view(np.complex64).ravel()
        total = np.zeros(count, np.complex64)
        for state, value in zip(states, values, strict=True):
            total += state * (value if len(value) == 1 else self._ramp.draw(value, first, count))
        return total


class Adc:
    """An analogue-to-digital converter: rounds, clips, and left-justifies its codes in 16 bits.

    Parameters
    ----------
    bits : int or None
        None rounds to 16 bits.
    """

    def __init__(self, bits):
        self.bits = bits or 16
        self._half = 2 ** (self.bits - 1)

    def codes(self, samples):
        """Codes of complex samples (full scale 1 per component); int16, shape (2 n,), I Q I Q."""
        parts = np.ascontiguousarray(samples, np.complex64).view(np.float32) * self._half
        np.rint(parts, out=parts)
        np.minimum(parts, self._half - 1, out=parts)
        np.maximum(parts, -self._half, out=parts)
        return parts.astype(np.int16) << (16 - self.bits)


def _scaled(taps, waveform, amplitude):
    """Taps brought to an rms amplitude over the occupied subcarriers."""
    return taps * (amplitude / np.sqrt(mean_power(taps, waveform)))


def _padded(filters):
    length = max(len(taps) for taps in filters)
    return [np.pad(taps, (0, length - len(taps))) for taps in filters]
