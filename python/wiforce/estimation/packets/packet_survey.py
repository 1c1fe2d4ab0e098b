# SPDX-License-Identifier: GPL-3.0-or-later
"""What packets of a card show without a scene: their noise, and the clock of a tag."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...signal.switching import harmonics
from ..groups import Array
from .antenna_states import AntennaStates, neighbours, others_against

# Clocks that are looked for (docs/wifi.md recommends 50 to 200 Hz), and lines of each that are
# looked at.
_CLOCKS_HZ, _LINES = (50.0, 400.0), 6
# Longest stretch that is transformed at once, in s, in which a clock 100 ppm off stays within a
# bin, and stretches that are averaged.
_STRETCH_S, _MOST_STRETCHES = 1.0, 8
# Step of frequency, and the grid to which times are rounded: 0.3 dB of the highest line.
_STEP_HZ, _GRID_HZ = 0.25, 16384.0
# Width of the neighbourhood whose median is the noise of a line, in Hz, and what is left out below.
_FLOOR_HZ, _SLOWEST_HZ = 30.0, 15.0
# Standard deviations above those of all other clocks at which a tag counts as seen: 4 000 clocks
# are tried, and the largest of as many normal values lies at 3.7.
_SEEN_STDS = 8.0
# Shapes over the subcarriers that packets have: that of the room, and two that cards add (an Intel
# AX200, whose SNR of 26 dB with one of them is 31 dB with two, and stays so with more).
_SHAPES = 3
# Information q_1 of a group (docs/theory.md, formulas).
_INFORMATION = 0.158


@dataclass(frozen=True)
class TagLines:
    """Lines of a tag's clock in packets."""

    clock_hz: float
    line_db: float  # power of the first line against the direct path
    snr_db: float  # of the first line in one packet and channel, the ``snr_db`` of a scene
    stds: float  # standard deviations by which it exceeds all other clocks

    def phase_std_deg(self, packets: int, channels: int) -> float:
        """Deviation of a group's phases by noise; channels are subcarriers x (antennas - 1)."""
        gamma = 10 ** (self.snr_db / 10) / harmonics(1)[0] ** 2
        return float(np.degrees(1 / np.sqrt(2 * gamma * channels * packets * _INFORMATION)))


def snapshot_snr_db(channel: Array, subcarrier_hz: Array) -> list[float]:
    """SNR of one packet, of each antenna, in dB, from channels (n, K, A).

    By the smaller eigenvalues of products of neighbouring subcarriers, in which phase and delay of
    a packet are one phase; an SNR s leaves s^2 / (2 s + 1) of them.
    """
    order, beside, _ = neighbours(subcarrier_hz)
    found = []
    for own in np.moveaxis(channel.astype(complex)[:, order], 2, 0):
        products = own[:, beside + 1] * own[:, beside].conj()
        products /= np.maximum(np.linalg.norm(products, axis=1, keepdims=True), 1e-300)
        power = np.linalg.eigvalsh(products.conj().T @ products)
        noise = len(power) * float(np.mean(power[: max(len(power) - _SHAPES, 1)]))
        ratio = max(float(power.sum()) - noise, 1e-12) / max(noise, 1e-12)
        found.append(10 * float(np.log10(ratio + np.sqrt(ratio**2 + ratio))))
    return found


def phase_std_deg(channel: Array, states: AntennaStates) -> float:
    """Deviation over packets of the mean phase between antennas beside their states, in degrees."""
    own = states.label >= 0
    others = _relative(channel[own], states, states.label[own]).reshape(
        np.count_nonzero(own), channel.shape[1], -1
    )
    phases = np.angle(others.sum(axis=1))
    return float(np.degrees(phases.std(axis=0).min()))


def find_tag(channel: Array, time_s: Array, states: AntennaStates) -> TagLines | None:
    """Clock of the strongest tag in packets (n, K, A), by harmonics over their floor."""
    own = states.label >= 0
    time_s, label = time_s[own], states.label[own]
    values = _relative(channel[own], states, label)
    edges = np.flatnonzero(np.diff(((time_s - time_s[0]) / _STRETCH_S).astype(int))) + 1
    stretches = [rows for rows in np.split(np.arange(len(time_s)), edges) if len(rows) >= 64]
    stretches = sorted(stretches, key=len, reverse=True)[:_MOST_STRETCHES]
    if not stretches:
        return None
    bins = np.arange(round(_SLOWEST_HZ / _STEP_HZ), round(_LINES * _CLOCKS_HZ[1] / _STEP_HZ))
    power = np.zeros(len(bins))
    for rows in stretches:
        times_s = time_s[rows] - time_s[rows[0]]
        power += _spectrum(times_s, _without_states(values[rows], label[rows]))[bins]
    # Packets are stored in single precision: what does not exceed its rounding is no line.
    rounding = sum(map(len, stretches)) * np.finfo(np.float32).eps ** 2
    noise = np.maximum(_running_median(power, round(_FLOOR_HZ / _STEP_HZ)), rounding)
    clocks = np.arange(*_CLOCKS_HZ, _STEP_HZ / _LINES)
    lines = np.rint(np.multiply.outer(clocks, np.arange(1, _LINES + 1)) / _STEP_HZ).astype(int)
    lines -= bins[0]
    ratio = power / noise
    score = np.log(np.maximum(ratio[lines], 1e-3)).sum(axis=1)
    score -= np.median(score)
    best = int(np.argmax(score))
    # 1.4826 median deviations are a standard deviation of normal values.
    stds = float(score[best] / max(1.4826 * float(np.median(np.abs(score))), 1e-12))
    first = lines[best, 0]
    excess = float(power[first] - noise[first])
    if stds < _SEEN_STDS or excess <= noise[first]:
        return None
    counts = np.array([len(rows) for rows in stretches])
    line = excess / float(np.sum(counts**2))
    snr = line / (float(noise[first]) / float(np.sum(counts)))
    return TagLines(
        float(clocks[best]), 10 * float(np.log10(line)), 10 * float(np.log10(snr)), stds
    )


def _spectrum(times_s: Array, values: Array) -> Array:
    """Power at multiples of the step of frequency, the mean of both signs and all channels."""
    index = np.rint(times_s * _GRID_HZ).astype(int)
    power = np.zeros(round(_GRID_HZ / _STEP_HZ))
    for own in values.T:
        grid = np.bincount(index, own.real, len(power)) + 1j * np.bincount(
            index, own.imag, len(power)
        )
        power += np.abs(np.fft.fft(grid)) ** 2
    return np.asarray(power + np.roll(power[::-1], 1)) / (2 * values.shape[1])


def _relative(channel: Array, states: AntennaStates, label: Array) -> Array:
    """What a tag changes, in units of the static paths; shape (n, channels)."""
    if channel.shape[2] == 1:
        return np.asarray(channel[:, :, 0])
    against = others_against(channel, states.reference)
    for state in np.unique(label):
        rows = label == state
        mean = against[rows].mean(axis=0)
        against[rows] *= np.exp(-1j * np.angle(mean)) / np.sqrt(np.mean(np.abs(mean) ** 2))
    return against


def _without_states(values: Array, label: Array) -> Array:
    """Values without the mean of each state."""
    values = values.copy()
    for state in np.unique(label):
        values[label == state] -= values[label == state].mean(axis=0)
    return values


def _running_median(values: Array, width: int) -> Array:
    """Median of the values around each, over blocks of a width."""
    blocks = max(len(values) // width, 1)
    centers = np.linspace(0, len(values) - 1, blocks)
    medians = [np.median(part) for part in np.array_split(values, blocks)]
    return np.asarray(np.interp(np.arange(len(values)), centers, medians))
