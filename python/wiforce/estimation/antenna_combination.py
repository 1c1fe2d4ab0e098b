# SPDX-License-Identifier: GPL-3.0-or-later
"""Several antennas of one receiver: the part of their channels that is free of its oscillator."""

from __future__ import annotations

import numpy as np

from .groups import Array

# Rounds in which static paths and the phases of packets are estimated from one another.
_ROUNDS = 4
# Correlation of a packet with the static paths below which its phases over the subcarriers are not
# those of a delay; noise of -10 dB leaves 0.95.
_COHERENT = 0.9
# Packets of which the static paths are estimated.
_MOST_PACKETS = 4000

# Steps of one antenna's gain against the others', in nepers, that are larger than what a tag does
# to the mean power of a packet, and packets with the same gain from which on it is measured.
_LEAST_STEP, _LEAST_ALIKE = np.log(10) / 20 * 0.3, 20


def without_gain_steps(channel: Array) -> Array:
    """Undo steps of the gain of single antennas, which the common factor of a packet does not hold.

    Parameters
    ----------
    channel : ndarray of complex, shape (n, K, A)

    Returns
    -------
    ndarray of complex, shape (n, K, A)
        Each antenna with the gain and phase against the first one that most packets have.

    Notes
    -----
    The gain of an antenna against the first one is the ratio of their powers over all
    subcarriers. Its levels are distinguished by gaps of 0.3 dB or more. Packets of one level are
    brought to the most frequent one by a complex factor, measured over all of them: a tag, which
    is open and closed in any of them alike, does not change it. Rare levels stay as they are, and
    their packets are left out later.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> channel = rng.standard_normal((400, 8, 2)) * 0.01 + np.array([1.0, 2.0])
    >>> channel[:, :, 1] *= rng.choice([1.0, 1.12], 400)[:, None]
    >>> level = without_gain_steps(channel)
    >>> bool(np.ptp(np.abs(level[:, :, 1]).mean(axis=1)) < 0.1)
    True
    """
    power = np.sum(np.abs(channel) ** 2, axis=1)
    levels = 0.5 * np.log(np.maximum(power, 1e-300) / np.maximum(power[:, :1], 1e-300))
    corrected = channel
    for antenna in range(1, channel.shape[2]):
        order = np.argsort(levels[:, antenna])
        breaks = np.flatnonzero(np.diff(levels[order, antenna]) > _LEAST_STEP) + 1
        clusters = np.split(order, breaks)
        if len(clusters) == 1:
            continue
        if corrected is channel:
            corrected = channel.copy()
        clusters.sort(key=len, reverse=True)
        usual = _against_first(channel, clusters[0], antenna)
        for rows in clusters[1:]:
            if len(rows) >= _LEAST_ALIKE:
                own = _against_first(channel, rows, antenna)
                corrected[rows, :, antenna] *= np.vdot(own, usual) / np.vdot(own, own)
    return corrected


def _against_first(channel: Array, rows: Array, antenna: int) -> Array:
    """Mean of an antenna against the first one in some packets, on each subcarrier; shape (K,)."""
    first, other = channel[rows, :, 0], channel[rows, :, antenna]
    size = np.mean(np.abs(first) ** 2, axis=1, keepdims=True)
    return np.asarray(np.mean(other * first.conj() / np.maximum(size, 1e-300), axis=0))


class AntennaCombination:
    """Combines the antennas of a receiver to channels without its oscillator, gain and timing.

    Parameters
    ----------
    channel : ndarray of complex, shape (n, K, A)
        Channels of packets that static paths dominate, A of at least 2.
    subcarrier_hz : ndarray, shape (K,)
        Against the carrier.

    Attributes
    ----------
    static : ndarray of complex, shape (K, A)
        Static paths, with a mean power of 1 per subcarrier and an arbitrary common phase.
    by_subcarrier : bool
        Whether each subcarrier is divided by itself, because packets differ by more than a phase,
        a gain and a delay.

    Notes
    -----
    A packet is received as H_a = x (S_a + r T_a), with a factor x that all antennas share: phase
    and gain of the packet, and a phase that is linear over the subcarriers by its sampling time.
    On each subcarrier the antennas are combined to the A - 1 sums that contain no static path, and
    these are divided by x, which the static paths of all subcarriers and antennas give. For two
    antennas this is the numerator of the ratio H_1 / H_2 - S_1 / S_2. Since it contains no static
    path, an error of x changes nothing but the tag, in proportion. The tag itself is in x with
    <S, T> / <S, S>, which bends the result as the ratio of two antennas does
    (:func:`.antennas.curvature_deg`), but less, as no faded subcarrier is divided by.

    Each antenna weighs as much as it receives, and so does each subcarrier.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> hertz, static = 1e6 * np.arange(4), np.ones((4, 1)) * np.array([1.0, 0.5j])
    >>> common = np.exp(2j * np.pi * (rng.random((300, 1)) + 1e-7 * rng.random((300, 1)) * hertz))
    >>> tag = 0.01 * rng.integers(0, 2, (300, 1, 1))
    >>> received = common[:, :, None] * (static + tag)
    >>> combined = AntennaCombination(received, hertz).process(received)
    >>> combined.shape, bool(np.std(combined[tag[:, 0, 0] > 0, 0]) < 1e-6)
    ((300, 4), True)
    """

    def __init__(self, channel: Array, subcarrier_hz: Array) -> None:
        channel = channel[:: max(1, len(channel) // _MOST_PACKETS)].astype(complex)
        power = np.sum(np.abs(channel) ** 2, axis=2, keepdims=True)
        scaled = channel / np.sqrt(np.maximum(power.mean(axis=1, keepdims=True), 1e-300))
        spread = np.einsum("nka,nkb->kab", scaled, scaled.conj())
        _, vectors = np.linalg.eigh(spread)
        self._others = vectors[:, :, :-1]
        direct = np.einsum("nka,ka->nk", scaled, vectors[:, :, -1].conj())
        level = np.sqrt(np.median(np.abs(direct) ** 2, axis=0))
        level /= np.sqrt(np.mean(level**2))
        self._order = np.argsort(subcarrier_hz)
        hertz = subcarrier_hz - np.mean(subcarrier_hz)
        self._hertz, self._level = hertz, level
        steps = np.diff(hertz[self._order])
        self._step_hz = float(np.min(steps))
        self._beside = steps < 1.01 * self._step_hz
        # Start from the packet whose gain is the median one.
        middle = int(np.argsort(power.mean(axis=(1, 2)))[len(power) // 2])
        static = level * np.exp(1j * np.angle(direct[middle]))
        for _ in range(_ROUNDS):
            common = self._common(direct, static)
            mean = np.median((direct / common).real, axis=0)
            static = mean + 1j * np.median((direct / common).imag, axis=0)
        self._profile = static
        self.static = vectors[:, :, -1] * static[:, None]
        common = self._common(direct, static)
        match = np.abs(np.sum(direct * (common * static).conj(), axis=1))
        match /= np.linalg.norm(direct, axis=1) * np.linalg.norm(common * static, axis=1)
        self.by_subcarrier = bool(np.median(match) < _COHERENT)

    def process(self, channel: Array) -> Array:
        """Combine the antennas of some packets.

        Parameters
        ----------
        channel : ndarray of complex, shape (n, K, A)

        Returns
        -------
        ndarray of complex, shape (n, K (A - 1))
            In units of the static paths. 0 where nothing is received.
        """
        unit = self.static / np.abs(self._profile)[:, None]
        direct = np.einsum("nka,ka->nk", channel, unit.conj())
        if self.by_subcarrier:
            common = direct / np.abs(self._profile)
        else:
            common = self._common(direct, np.abs(self._profile))
        others = np.einsum("nka,kab->nkb", channel, self._others.conj())
        common = common[:, :, None]
        combined = np.divide(others, common, out=np.zeros_like(others), where=np.abs(common) > 0)
        return combined.reshape(len(channel), -1)

    def _common(self, direct: Array, static: Array) -> Array:
        """Factor x of each packet on each subcarrier, shape (n, K), by the static paths."""
        ratio = direct * static.conj()
        ordered = ratio[:, self._order]
        pairs = (ordered[:, 1:] * ordered[:, :-1].conj())[:, self._beside]
        slope = np.angle(pairs.sum(axis=1)) / self._step_hz
        weights = np.abs(static) ** 2
        for _ in range(2):
            turned = ratio * np.exp(-1j * np.multiply.outer(slope, self._hertz))
            phase = np.angle(turned * turned.sum(axis=1, keepdims=True).conj())
            center = np.sum(weights * self._hertz) / weights.sum()
            lever = weights * (self._hertz - center)
            slope = slope + phase @ lever / np.sum(lever * (self._hertz - center))
        turn = np.exp(1j * np.multiply.outer(slope, self._hertz))
        level = np.sum(ratio * turn.conj(), axis=1, keepdims=True) / weights.sum()
        common: Array = level * turn
        return common
