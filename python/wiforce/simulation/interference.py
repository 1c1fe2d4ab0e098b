# SPDX-License-Identifier: GPL-3.0-or-later
"""Other transmitters: when they are on the air, and what the receiver gets of them."""

from collections.abc import Iterator
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from .random_sources import RandomSources, Seeds

if TYPE_CHECKING:
    from ..scene.simulated import Simulation


# Transmissions are drawn for a cell of time on its own, so that a stream can start anywhere.
# A cell holds at least this many of the longest transmission: what its end cuts off is little.
_LONGEST_PER_CELL = 100
_SHORTEST_CELL_S = 1.0
# Samples of a signal that are generated together.
_BLOCK = 8192
_KEPT_CELLS = 3
_KEPT_BLOCKS = 8
# Channels of a hopper in the sample rate.
_HOPPER_CHANNELS = 64
# Counters of Seeds: what is drawn.
_TIMES, _SIGNAL = 0, 1


class Transmitter:
    """A transmitter that is on the air for a ``share`` of the time, as received.

    Gaussian noise over a ``bandwidth``, a share of the sample rate drawn for each transmission;
    ``gain`` is amplitude and phase. Durations are uniform, pauses exponential. Narrow-band noise is
    the sum of blocks with sine windows that overlap by half, of constant power.
    """

    def __init__(
        self,
        seeds: Seeds,
        sample_rate_hz: float,
        share: float,
        shortest_s: float,
        longest_s: float,
        gain: complex,
        bandwidth: float = 1.0,
    ) -> None:
        self._seeds, self._bandwidth = seeds, bandwidth
        self._gain = np.complex64(gain / np.sqrt(2))  # of a component of unit variance
        self._durations = shortest_s * sample_rate_hz, longest_s * sample_rate_hz
        self._share = share
        self._mean_pause = sum(self._durations) / 2 * (1 - share) / share
        cell_s = max(_SHORTEST_CELL_S, _LONGEST_PER_CELL * longest_s)
        self._cell = round(cell_s * sample_rate_hz)
        self._transmissions = lru_cache(_KEPT_CELLS)(self._drawn_transmissions)
        self._noise = lru_cache(_KEPT_BLOCKS)(self._drawn_noise)
        self._band = lru_cache(_KEPT_BLOCKS)(self._drawn_band)

    def add(self, first_sample: int, received: np.ndarray) -> None:
        """Add what is received to samples."""
        for start, stop, centre in self._during(first_sample, first_sample + len(received)):
            position = start
            while position < stop:
                block, inside = divmod(position, _BLOCK)
                count = min(_BLOCK - inside, stop - position)
                signal = self._signal(block, centre)[inside : inside + count]
                received[position - first_sample : position - first_sample + count] += signal
                position += count

    def _during(self, first: int, end: int) -> Iterator[tuple[int, int, int]]:
        """Transmissions between two samples: first sample, end, and centre in bins of a block."""
        for index in range(first // self._cell, (end - 1) // self._cell + 1):
            cell = self._transmissions(index)
            for start, stop, centre in cell[(cell[:, 0] < end) & (cell[:, 1] > first)]:
                yield max(int(start), first), min(int(stop), end), int(centre)

    def _drawn_transmissions(self, index: int) -> np.ndarray:
        """Transmissions of a cell; shape (n, 3)."""
        rng = self._seeds.generator(_TIMES, index)
        low, high = self._durations
        most = int(2 * self._cell / (self._mean_pause + low)) + 64
        durations = rng.uniform(low, high, most)
        pauses = rng.exponential(self._mean_pause, most)
        if rng.random() < self._share:  # it is on the air when the cell begins
            pauses[0] = 0
            durations[0] *= rng.random()
        starts = np.cumsum(pauses + np.r_[0, durations[:-1]])
        reach = (1 - self._bandwidth) / 2
        centres = np.rint(rng.uniform(-reach, reach, most) * 2 * _BLOCK)
        times = np.minimum(np.rint([starts, starts + durations]), self._cell)
        cell = np.column_stack([*(index * self._cell + times), centres]).astype(np.int64)
        return cell[cell[:, 0] < cell[:, 1]]

    def _signal(self, block: int, centre: int) -> np.ndarray:
        """The samples of a block, for a transmission about a centre frequency."""
        if self._bandwidth == 1.0:
            return self._noise(block)
        return self._band(block, centre)[_BLOCK:] + self._band(block + 1, centre)[:_BLOCK]

    def _drawn_noise(self, block: int) -> np.ndarray:
        rng = self._seeds.generator(_SIGNAL, block)
        normal = rng.standard_normal(2 * _BLOCK, dtype=np.float32)
        return normal.view(np.complex64) * self._gain

    def _drawn_band(self, block: int, centre: int) -> np.ndarray:
        """Windowed narrow-band noise over a block and the one before; shape (2 blocks,)."""
        size = 2 * _BLOCK
        bins = max(1, round(self._bandwidth * size))
        rng = self._seeds.generator(_SIGNAL, block, centre % size)
        spectrum = np.zeros(size, complex)
        normal = rng.standard_normal((bins, 2)) @ [1, 1j]
        spectrum[(centre - bins // 2 + np.arange(bins)) % size] = normal
        window = np.sin(np.pi * (np.arange(size) + 0.5) / size)
        signal = np.fft.ifft(spectrum) * np.sqrt(size) * window
        return signal.astype(np.complex64) * self._gain


def transmitters(
    simulation: "Simulation", sources: RandomSources, sample_rate_hz: float, noise_std: float
) -> list[Transmitter]:
    """The other transmitters of a scene, whose receiver has ``noise_std`` in a sample."""
    found = []
    for name, bandwidth in _others(simulation):
        stated = getattr(simulation, name)
        gain = sources.rotated(np.ones(1))[0] * noise_std * 10 ** (stated.level_db / 20)
        times = stated.share, stated.shortest_s, stated.longest_s
        seeds = sources.effect(name)
        found.append(Transmitter(seeds, sample_rate_hz, *times, gain, bandwidth))
    return found


def power_over_noise(simulation: "Simulation") -> float:
    """Power in a sample, relative to the receiver's noise, while all other transmitters are on."""
    return sum(
        (
            bandwidth * 10 ** (getattr(simulation, name).level_db / 10)
            for name, bandwidth in _others(simulation)
        ),
        start=0.0,
    )


def _others(simulation: "Simulation") -> Iterator[tuple[str, float]]:
    """Names and bandwidths of the transmitters that a scene states."""
    if simulation.bursts:
        yield "bursts", 1.0
    if simulation.hopper:
        yield "hopper", simulation.hopper.subcarriers / _HOPPER_CHANNELS
