# SPDX-License-Identifier: GPL-3.0-or-later
"""Channel snapshots made by somebody else: a second simulator of packets, and their bound.

It shares no line with the product: own traffic, own tags, own rooms, own receiver.
"""

from dataclasses import dataclass, field

import numpy as np

# What two files of an Intel AX200 hold (examples of CSIKit, MIT): 3 335 packets in 1.0 s and 778 in
# 5.0 s, two antennas, measured packet by packet. ``fast``: 157 us apart with a standard deviation
# of 30 us, a pause of 0.5 to 8 ms after every 24th packet; SNR of a packet 30 and 32 dB, gain
# 0.115 dB rms, three flips of 180 degrees. ``slow``: intervals from 0.3 to 93 ms, median 2.4 ms,
# mean 6.4 ms; SNR 18 and 19 dB, gain 0.3 dB rms; eight flips of 60 ms; one antenna 1 dB stronger
# in a fifth of the packets and 5.9 dB weaker, at 29 degrees, in a tenth; a drift of 3 degrees. A
# flip changes the shape over the subcarriers by a tenth. Gain and phase of one antenna against the
# other change by 0.7 and 0.95 % rms in ``fast``, six times as much at 134 Hz as above 600 Hz.
CARDS = {
    "fast": {
        "snr_db": 30.0,
        "interval_s": 157e-6,
        "jitter": 0.47,
        "pauses": (1 / 24, 0.5e-3, 8e-3),
        "gain_db": (-0.14, 0.0, 0.14),
        "flip_s": 0.34,
        "ripple": 0.1,
    },
    "slow": {
        "snr_db": 18.0,
        "interval_s": 2.4e-3,
        "interval_spread": 1.35,
        "gain_db": (-0.4, 0.0, 0.4),
        "flip_s": 0.55,
        "flip_held_s": 0.06,
        "chain_states": ((0.2, 1.0, 0.0), (0.1, -5.9, 29.0)),
        "drift_deg": 3.0,
        "ripple": 0.1,
    },
}


WINDOW_S = 6.4e-6  # that the receiver takes of each packet


def card_settings(card, line_db, static=0.225, **more):
    """Keywords of a capture by a card, with a tag's first line some dB below the direct path."""
    settings = CARDS[card] | {"lost": 0.0, "repeated": 0.0, "timing_s": 14e-9} | more
    static *= 10 ** (line_db / 20)
    noise = static * 10 ** (-settings.pop("snr_db") / 20)
    return settings | {"static": static, "noise": noise}


def closed(cycles):
    """Whether each switch of a tag is closed at instants of its clock; (..., 2)."""
    first = np.abs((cycles + 0.5) % 1 - 0.5) < 1 / 8
    second = np.abs((2 * cycles) % 1 - 0.5) < 1 / 8
    return np.stack([first, second], axis=-1)


@dataclass
class PacketTag:
    """A tag whose two ends turn by stated angles while it is touched."""

    clock_hz: float
    untouched_deg: tuple = (-108.8043, -108.8043)
    touched_deg: tuple = (24.3249, -62.2787)
    offset_ppm: float = 30.0
    phase: float = 0.3
    level: float = 1.0


@dataclass
class PacketCapture:
    """What a receiver reports, and what it should be read as.

    Levels are relative to a tag whose switched reflection has amplitude 1.
    """

    tags: list
    seed: int = 1
    duration_s: float = 16.0
    touched_s: tuple = (6.0, 15.5)
    interval_s: float = 1e-3
    lost: float = 0.1
    repeated: float = 0.02
    antennas: int = 2
    subcarriers: int = 52
    spacing_hz: float = 312.5e3
    static: float = 125.0  # 55 dB over the tag's first line
    noise: float = 0.71  # -10 dB against that line
    gain_db: tuple = (-6.0, -3.0, 0.0, 3.0)
    timing_s: float = 30e-9
    jitter: float | None = None  # share of the interval; None for exponential gaps
    chain_gain_db: float = 0.0
    drift_deg: float = 0.0  # by which the last antenna's phase swings to and fro, in 17 s
    change_db: float = -np.inf  # of a path that is there from touched_s on, against the static ones
    lamp: float = 0.0  # amplitude of a path that a lamp modulates, on mains of 60.01 Hz
    walker: float = 0.0  # amplitude of a path by way of a person, with a Doppler up to 20 Hz
    stamp_s: float = 0.0  # standard deviation of the errors of the times that are reported
    stamp_grid_s: float = 0.0  # reported times are multiples of this
    clock_back_s: float = 0.0  # by which the clock of the times steps back in the middle
    flip_s: float = 0.0  # mean time after which the last antenna's phase jumps
    flip_phases: int = 2  # that it takes, evenly spaced
    flip_held_s: float = 0.0  # mean time after which it jumps back; 0 for that after which it jumps
    ripple: float = 0.0  # change of the shape over the subcarriers by a flip
    chain_states: tuple = ()  # of the last antenna: share of the packets, gain in dB, degrees
    interval_spread: float = 0.0  # of the logarithm of the intervals; interval_s is their median
    wander: float = 0.0  # rms change of the last antenna's gain and phase, mostly below 150 Hz
    pauses: tuple = ()  # share of the intervals that are pauses; shortest and longest in s
    strangers: float = 0.0  # share of packets that come by other paths
    time_s: np.ndarray = field(init=False, repr=False)
    channel: np.ndarray = field(init=False, repr=False)
    subcarrier_hz: np.ndarray = field(init=False, repr=False)

    def __post_init__(self):
        rng = np.random.default_rng(self.seed)
        self.time_s = self._times(rng)
        k = np.arange(self.subcarriers) - self.subcarriers // 2
        self.subcarrier_hz = k * self.spacing_hz
        shape = self.subcarriers, self.antennas
        self.room = self.static * self._paths(rng, 9, 40e-9, shape, first=1.2)
        self.ways = [tag.level * self._paths(rng, 3, 15e-9, shape, first=2.0) for tag in self.tags]
        states = self.switches(self.time_s)
        received = np.tile(self.room, (len(self.time_s), 1, 1)).astype(complex)
        since = self.time_s - self.time_s[0]
        touched = (since >= self.touched_s[0]) & (since < self.touched_s[1])
        if np.isfinite(self.change_db):
            size = self.static * 10 ** (self.change_db / 20)
            later = since >= self.touched_s[0] - 0.3
            received += size * later[:, None, None] * self._paths(rng, 3, 40e-9, shape, first=1.0)
        for tag, way, own in zip(self.tags, self.ways, states, strict=True):
            for end in (0, 1):
                degrees = np.where(touched, tag.touched_deg[end], tag.untouched_deg[end])
                reflected = own[:, end] * np.exp(1j * np.radians(degrees))
                received += reflected[:, None, None] * way
        burning = np.abs(np.sin(2 * np.pi * 60.01 * since))
        received += (
            self.lamp * burning[:, None, None] * self._paths(rng, 3, 30e-9, shape, first=1.0)
        )
        walking = np.exp(2j * np.pi * 20 * np.sin(since))
        received += self.walker * walking[:, None, None] * self._paths(rng, 3, 30e-9, shape, 1.0)
        noise = rng.normal(size=(*received.shape, 2)) @ np.array([1, 1j])
        received += self.noise / np.sqrt(2) * noise
        if self.drift_deg:
            swing = np.radians(self.drift_deg) * np.sin(2 * np.pi * since / 17)
            received[:, :, -1] *= np.exp(1j * swing)[:, None]
        if self.flip_s:
            turns = self._turns(rng, since)
            received[:, :, -1] *= np.exp(2j * np.pi * turns / self.flip_phases)[:, None]
            if self.ripple:
                wave = np.cos(2 * np.pi * (np.arange(shape[0]) / shape[0] + rng.random()))
                flipped = np.flatnonzero(turns % self.flip_phases)
                received[flipped, :, -1] *= 1 + self.ripple * np.sqrt(2) * wave
        if self.wander:
            received[:, :, -1] *= np.exp(self.wander * self._wander(rng, since))[:, None]
        for share, gain_db, degrees in self.chain_states:
            own = rng.random(len(since)) < share
            received[own, :, -1] *= 10 ** (gain_db / 20) * np.exp(1j * np.radians(degrees))
        if self.strangers:
            others = rng.random(len(since)) < self.strangers
            received[others] = self.static * self._paths(rng, 9, 40e-9, shape, first=1.2)
        received *= self._packet_factors(rng)
        if self.chain_gain_db:
            steps = rng.integers(-1, 2, (len(received), 1, shape[1]))
            received *= 10 ** (self.chain_gain_db / 20 * steps)
        repeats = np.flatnonzero(rng.random(len(received)) < self.repeated)
        again = np.sort(np.r_[np.arange(len(received)), repeats])
        self.time_s, self.channel = self.time_s[again], received[again].astype(np.complex64)
        if self.stamp_s:
            self.time_s = np.sort(self.time_s + self.stamp_s * rng.normal(size=len(self.time_s)))
        if self.stamp_grid_s:
            self.time_s = np.rint(self.time_s / self.stamp_grid_s) * self.stamp_grid_s
        if self.clock_back_s:
            self.time_s[len(self.time_s) // 2 :] -= self.clock_back_s

    def _times(self, rng):
        count = int(1.3 * self.duration_s / self.interval_s)
        if self.interval_spread:
            times = np.cumsum(rng.lognormal(np.log(self.interval_s), self.interval_spread, count))
        elif self.jitter is None:
            times = np.cumsum(rng.exponential(self.interval_s, count))
        else:
            times = (np.arange(count) + self.jitter * rng.random(count)) * self.interval_s
        if self.pauses:
            share, shortest, longest = self.pauses
            pauses = np.exp(rng.uniform(np.log(shortest), np.log(longest), count))
            times = times + np.cumsum(pauses * (rng.random(count) < share))
        times = times[rng.random(count) >= self.lost]
        return 1000.0 + times[times < self.duration_s] - times[0]

    def _turns(self, rng, since):
        """How often the phase has jumped by its smallest step before each packet."""
        jumps = rng.random(len(since)) < np.gradient(since) / self.flip_s
        steps = rng.integers(1, self.flip_phases, len(since))
        if not self.flip_held_s:
            return np.cumsum(jumps * steps)
        back = rng.random(len(since)) < np.gradient(since) / self.flip_held_s
        turns = np.zeros(len(since), int)
        for n in range(1, len(since)):
            held = turns[n - 1]
            turns[n] = (0 if back[n] else held) if held else jumps[n] * steps[n]
        return turns

    def _wander(self, rng, since):
        """Gain and phase of an Ornstein-Uhlenbeck process of 150 Hz, each of rms 1."""
        kept = np.exp(-2 * np.pi * 150 * np.diff(since, prepend=since[0] - 1.0))
        steps = rng.normal(size=(len(since), 2)) @ [1, 1j] * np.sqrt(1 - kept**2)
        walk = np.zeros(len(since), complex)
        for n in range(len(since)):
            walk[n] = kept[n] * walk[n - 1] + steps[n]
        return walk

    def _paths(self, rng, count, spread_s, shape, first):
        """Rays with delays of their own and phases of each antenna; rms 1."""
        total = np.zeros(shape, complex)
        for ray in range(count):
            delay = rng.exponential(spread_s)
            size = first if ray == 0 else np.exp(-delay / spread_s) * rng.rayleigh(0.6)
            turns = np.exp(2j * np.pi * rng.random(shape[1]))
            total += size * np.exp(-2j * np.pi * self.subcarrier_hz * delay)[:, None] * turns
        return total / np.sqrt(np.mean(np.abs(total) ** 2))

    def _packet_factors(self, rng):
        count = len(self.time_s)
        gain = 10 ** (rng.choice(self.gain_db, count) / 20)
        phase = 2 * np.pi * rng.random(count)
        delay = self.timing_s * rng.normal(size=count)
        turn = phase[:, None] - 2 * np.pi * delay[:, None] * self.subcarrier_hz
        return (gain[:, None] * np.exp(1j * turn))[:, :, None]

    def switches(self, time_s):
        """How long each switch of each tag is closed in the window of each packet; (tags, n, 2)."""
        steps = (np.arange(33) - 16) / 33 * WINDOW_S
        found = []
        for tag in self.tags:
            rate = tag.clock_hz * (1 + 1e-6 * tag.offset_ppm)
            cycles = rate * (time_s[:, None] - 1000.0 + steps) + tag.phase
            found.append(closed(cycles).mean(axis=1))
        return np.array(found)

    def save(self, path, **more):
        arrays = {"time_s": self.time_s, "channel": self.channel}
        np.savez(path, **{**arrays, "subcarrier_hz": self.subcarrier_hz, **more})

    def bound_deg(self, period_s, reference_groups):
        """Smallest standard deviation of the phases' changes in each group; (groups, tags, 2).

        What a packet multiplies all antennas of a subcarrier with is unknown, so that the part of
        the tags that lies along the static paths is lost; what remains is the projection of the
        other part on the switches' waveforms without their means. Clocks are taken as known, which
        makes the bound smaller. Of a single antenna, a phase, a gain and a delay of each packet are
        unknown.
        """
        if self.antennas == 1:
            return self._bound_of_one_deg(period_s, reference_groups)
        along = self.room / np.linalg.norm(self.room, axis=1, keepdims=True)
        left = []
        for way in self.ways:
            left.append(way - np.sum(along.conj() * way, axis=1, keepdims=True) * along)
        ends = np.repeat(np.array([way.ravel() for way in left]), 2, axis=0)
        found = []
        for waves in self._waves(period_s):
            information = (ends.conj() @ ends.T).real * (waves.T @ waves) / self.noise**2
            variance = np.diag(np.linalg.inv(information)) / 2 * (1 + 1 / reference_groups)
            found.append(np.degrees(np.sqrt(variance)).reshape(-1, 2))
        return np.array(found)

    def _bound_of_one_deg(self, period_s, reference_groups):
        """The same for one antenna: what moves as phase, gain or delay do is lost, a real space."""
        static = self.room[:, 0]
        weight = np.abs(static) ** 2
        delay = (self.subcarrier_hz - self.subcarrier_hz @ weight / weight.sum()) * static
        lost, _ = np.linalg.qr(
            np.stack([self._real(v) for v in (static, 1j * static, 1j * delay)]).T
        )
        parts = []
        for way in self.ways:
            for direction in (way[:, 0], 1j * way[:, 0]):
                parts.append(self._real(direction) - lost @ (lost.T @ self._real(direction)))
        # Real and imaginary part of the reflection of each end of each tag.
        parts = np.array(parts).reshape(len(self.ways), 1, 2, -1).repeat(2, axis=1)
        parts = parts.reshape(4 * len(self.ways), -1)
        found = []
        for waves in self._waves(period_s):
            waves = waves.repeat(2, axis=1)
            covariance = np.linalg.inv((parts @ parts.T) * (waves.T @ waves) * 2 / self.noise**2)
            for end in range(2 * len(self.ways)):
                tag, own = self.tags[end // 2], slice(2 * end, 2 * end + 2)
                degrees = np.radians([tag.touched_deg[end % 2], tag.untouched_deg[end % 2]])
                turn = np.stack([-np.sin(degrees), np.cos(degrees)])
                variance = np.einsum("xa,xy,ya->a", turn, covariance[own, own], turn)
                found.append(variance @ [1, 1 / reference_groups])
        return np.degrees(np.sqrt(found)).reshape(-1, len(self.ways), 2)

    def _waves(self, period_s):
        """The switches' waveforms without their means in each group, (packets, ends)."""
        unique = np.unique(self.time_s)
        for group in range(int(self.duration_s / period_s)):
            inside = (unique - unique[0]) // period_s == group
            waves = self.switches(unique[inside]).transpose(1, 0, 2).reshape(inside.sum(), -1)
            yield waves - waves.mean(axis=0)

    @staticmethod
    def _real(values):
        return np.concatenate([values.real, values.imag])
