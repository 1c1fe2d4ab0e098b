# SPDX-License-Identifier: GPL-3.0-or-later
"""Simulated channel snapshots: what a Wi-Fi card would report of each packet of a scene.

The channel of each antenna and subcarrier is a sum of paths; a packet rotates, scales and delays
all antennas alike, and the receiver chain of each antenna has phases and gains of its own.
"""

import io
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np

from ..scene import Scene
from ..scene.effects import PacketFaults
from .paths import Levels
from .random_sources import Ramp, RandomSources
from .tag import SwitchedTag

# Delay spread of a room's echoes (tens of ns indoors: IEEE 802.11-03/940r4, models B to D), their
# number, and the power of all of them relative to the direct path.
_SPREAD_S = 30e-9
_ECHOES = 12
_ECHO_POWER = 1.0
# Doppler shifts of paths by way of moving objects, relative to the highest one.
_DOPPLERS = np.array([1.0, -0.7, 0.4, -0.9])
# Packets of a piece, and time that a repeated packet comes late: as quick as a bus.
_PIECE = 4096
_REPEAT_S = 20e-6
# Corner of the wander between antennas: of an Intel AX200 four fifths lie below 300 Hz.
_WANDER_HZ = 100.0


def write_packets(
    scene: Scene, data: Path, beside: Path, progress: Callable[[int], object] | None
) -> None:
    """Write the channel snapshots of a scene; sensor files as named ``beside``."""
    content = io.BytesIO()  # after an error of a file, its archive prints another
    np.savez(
        content,
        **_packets(scene, progress),
        center_frequency_hz=scene.radio.center_frequency_hz,
        scene=json.dumps(scene.as_dict(beside)),
    )
    data.write_bytes(content.getbuffer())


def _packets(scene: Scene, progress: Callable[[int], object] | None) -> dict[str, np.ndarray]:
    """Times (n,), from about 0, channel (n, K, antennas), and subcarriers (K,) of a scene."""
    assert scene.packets is not None
    own, simulation = scene.packets, scene.simulation
    antennas = scene.environment.receive_antennas
    hertz = (np.arange(own.subcarriers) - (own.subcarriers - 1) / 2) * own.spacing_hz
    shared = RandomSources(simulation.seed, 0)
    tags = [SwitchedTag(scene, i, shared, Ramp(1e6)) for i in range(len(scene.sensors))]
    seeds = shared.effect("packets")
    faults = simulation.packets or PacketFaults()
    time_s = _times(scene, faults.lost, seeds.generator(0))
    rooms = [_Room(scene, RandomSources(simulation.seed, a), hertz) for a in range(antennas)]
    phases = seeds.generator(1).uniform(0, 2 * np.pi, len(_DOPPLERS))
    chains = _chains(faults, time_s, antennas, seeds.generator(4))
    chains[:, 1:] *= _wander(faults, time_s, antennas - 1, seeds.generator(6))
    pieces = []
    for first in range(0, len(time_s), _PIECE):
        piece = time_s[first : first + _PIECE]
        reflections = np.array([tag.reflection_at(piece, own.window_s) for tag in tags])
        turns_freely = scene.environment.reader_clock == "free"
        common = _common(faults, turns_freely, len(piece), hertz, seeds.generator(2, first))
        channels = [room.channel(piece, reflections, phases) for room in rooms]
        common = common[:, :, None] * chains[first : first + _PIECE, None]
        pieces.append((common * np.stack(channels, axis=2)).astype(np.complex64))
        if progress is not None:
            progress(len(piece))
    channel = np.concatenate(pieces)
    time_s, channel = _repeated(faults.repeated, time_s, channel, seeds.generator(3))
    time_s = _stamps(faults, time_s, seeds.generator(5))
    return {"time_s": time_s, "channel": channel, "subcarrier_hz": hertz}


def _times(scene: Scene, lost: float, rng: np.random.Generator) -> np.ndarray:
    """Times of the packets that are received, the first one at 0; a share is ``lost``."""
    assert scene.packets is not None
    interval_s, duration_s = scene.packets.interval_s, scene.simulation.duration_s
    # The interval is that of packets received: more are sent where some are lost.
    sent_s = interval_s * (1 - lost)
    count = int(duration_s / sent_s * 1.2) + 100
    if scene.packets.gaps == "regular":
        times = np.arange(count) * sent_s
    else:
        times = np.concatenate([[0.0], np.cumsum(rng.exponential(sent_s, count))])
    received = rng.random(len(times)) >= lost
    received[0] = True
    return times[received & (times < duration_s)]


def _common(
    faults: PacketFaults,
    turns_freely: bool,
    count: int,
    hertz: np.ndarray,
    rng: np.random.Generator,
) -> np.ndarray:
    """Factor of each packet and subcarrier that all antennas share; shape (count, K)."""
    phase = rng.uniform(0, 2 * np.pi, count) if turns_freely else np.zeros(count)
    gain_db = faults.gain_step_db * rng.integers(-1, 2, count)
    delay_s = faults.timing_offset_s * rng.standard_normal(count)
    turned = phase[:, None] - 2 * np.pi * np.outer(delay_s, hertz)
    common: np.ndarray = 10 ** (gain_db[:, None] / 20) * np.exp(1j * turned)
    return common


def _chains(
    faults: PacketFaults, time_s: np.ndarray, antennas: int, rng: np.random.Generator
) -> np.ndarray:
    """Factor of each antenna by itself in each packet; shape (n, antennas)."""
    chains = np.ones((len(time_s), antennas), complex)
    for antenna in range(1, antennas if faults.flips_per_s else 0):
        gaps_s = rng.exponential(
            1 / faults.flips_per_s, int(2 * time_s[-1] * faults.flips_per_s) + 20
        )
        jumps = np.cumsum(rng.integers(1, faults.flip_phases, len(gaps_s)))
        turns = np.append(0, jumps)[np.searchsorted(np.cumsum(gaps_s), time_s, side="right")]
        chains[:, antenna] = np.exp(2j * np.pi * turns / faults.flip_phases)
    steps = rng.integers(-1, 2, chains.shape)
    return np.asarray(chains * 10 ** (faults.antenna_gain_step_db / 20 * steps))


def _wander(
    faults: PacketFaults, time_s: np.ndarray, antennas: int, rng: np.random.Generator
) -> np.ndarray:
    """Slow factor of antennas, a process of first order; shape (n, antennas)."""
    values = np.zeros((len(time_s), 2 * antennas))
    if faults.antenna_wander_db or faults.antenna_wander_deg:
        kept = np.exp(-2 * np.pi * _WANDER_HZ * np.diff(time_s, prepend=-np.inf))
        fresh = np.sqrt(1 - kept**2)[:, None] * rng.standard_normal(values.shape)
        for n, own in enumerate(fresh):
            values[n] = own + (kept[n] * values[n - 1] if n else 0)
    gain_db, phase_deg = np.split(values, 2, axis=1)
    exponent = faults.antenna_wander_db * np.log(10) / 20 * gain_db
    factors: np.ndarray = np.exp(exponent + 1j * np.radians(faults.antenna_wander_deg) * phase_deg)
    return factors


def _stamps(faults: PacketFaults, time_s: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Times as the card reports them."""
    stamps = time_s + faults.stamp_jitter_s * rng.standard_normal(len(time_s))
    for at in rng.integers(1, max(len(time_s), 2), faults.clock_steps):
        stamps[at:] -= rng.uniform(1.0, 10.0)
    if faults.stamp_resolution_s:
        stamps = np.rint(stamps / faults.stamp_resolution_s) * faults.stamp_resolution_s
    return stamps


def _repeated(
    share: float, time_s: np.ndarray, channel: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """A share of the packets once more, shortly after themselves."""
    again = rng.random(len(time_s)) < share
    order = np.sort(np.concatenate([np.arange(len(time_s)), np.flatnonzero(again)]))
    second = np.concatenate([[False], np.diff(order) == 0])
    times = time_s[order]
    later = np.append(time_s[1:], np.inf)[order]
    times = np.where(second, np.minimum(times + _REPEAT_S, later), times)
    return times, channel[order]


class _Room:
    """The paths to one antenna."""

    def __init__(self, scene: Scene, sources: RandomSources, hertz: np.ndarray) -> None:
        simulation, rng, levels = scene.simulation, sources.paths, Levels(scene, 1.0)
        self._noise_rng = sources.noise
        self._noise = levels.noise(simulation.snr_db)
        static = levels.amplitude(simulation.static_clutter_db)
        self._static = _scaled(_echoes(rng, hertz, 1.0), static)
        self._tags = [
            _scaled(_tag_path(rng, hertz, simulation.tag_coherence_hz), 10 ** (tag.level_db / 20))
            for tag in simulation.tags
        ]
        level = levels.amplitude(simulation.moving_clutter_db) / np.sqrt(len(_DOPPLERS))
        self._moving = [_scaled(_echoes(rng, hertz, 0.0), level) for _ in _DOPPLERS]
        self._doppler_hz = simulation.moving_clutter_hz * _DOPPLERS

    def channel(
        self, time_s: np.ndarray, reflections: np.ndarray, phases: np.ndarray
    ) -> np.ndarray:
        """Channel with noise at some times, shape (n, K), from the tags' reflections."""
        channel = self._static + sum(
            np.multiply.outer(r, path) for r, path in zip(reflections, self._tags, strict=True)
        )
        for path, hertz, phase in zip(self._moving, self._doppler_hz, phases, strict=True):
            if path.any():
                turns = np.exp(1j * (2 * np.pi * hertz * time_s + phase))
                channel = channel + np.multiply.outer(turns, path)
        noise = self._noise_rng.standard_normal((*channel.shape, 2)) @ np.array([1, 1j])
        received: np.ndarray = channel + self._noise / np.sqrt(2) * noise
        return received


def _scaled(path: np.ndarray, amplitude: float) -> np.ndarray:
    """A path scaled to an rms amplitude over the subcarriers."""
    scaled: np.ndarray = path * (amplitude / np.sqrt(np.mean(np.abs(path) ** 2)))
    return scaled


def _echoes(rng: np.random.Generator, hertz: np.ndarray, direct: float) -> np.ndarray:
    """A direct path, and echoes with exponential delays and random phases; shape (K,)."""
    delays_s = rng.exponential(_SPREAD_S, _ECHOES)
    echoes = rng.standard_normal((_ECHOES, 2)) @ np.array([1, 1j])
    echoes *= np.sqrt(_ECHO_POWER / (2 * _ECHOES))
    phase = np.exp(2j * np.pi * rng.random())
    return direct * phase + np.exp(-2j * np.pi * np.outer(hertz, delays_s)) @ echoes


def _tag_path(
    rng: np.random.Generator, hertz: np.ndarray, coherence_hz: float | None
) -> np.ndarray:
    """Path by way of a tag: a single delay, or Rayleigh fading of a coherence bandwidth."""
    if coherence_hz is None:
        delay_s = rng.exponential(_SPREAD_S)
        return np.exp(2j * np.pi * (rng.random() - hertz * delay_s))
    # Half the correlation remains at the coherence bandwidth of an exponential delay profile.
    delays_s = rng.exponential(1 / (2 * np.pi * coherence_hz) * np.sqrt(3), _ECHOES)
    taps = rng.standard_normal((_ECHOES, 2)) @ np.array([1, 1j])
    fading: np.ndarray = np.exp(-2j * np.pi * np.outer(hertz, delays_s)) @ taps
    return fading
