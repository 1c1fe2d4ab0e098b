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
# Share of rooms in which two standard deviations are exceeded; and the change of the static paths
# that is ignored, -46 dB, above what a press on a tag 50 dB below them causes by itself.
_EXCEEDED, _LEAST_CHANGE = 0.05, 0.005
# Packets of which the static paths are estimated.
_MOST_PACKETS = 4000

# Steps of one antenna's gain against the others', in nepers, that are larger than what a tag does
# to the mean power of a packet, and packets with the same gain from which on it is measured.
_LEAST_STEP, _LEAST_ALIKE = np.log(10) / 20 * 0.3, 20

# Drift of an antenna's complex gain against the first one that is undone: 2 deg or 0.3 dB, three
# times what a press did on an antenna that received the tag 40 dB below the static path; where no
# more than this share of the change differs from subcarrier to subcarrier. Below this amplitude an
# antenna is taken to have failed.
_LEAST_DRIFT, _OWN_SHARE, _FAILED = np.radians(2.0), 0.1, 0.05


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


def without_drift(channel: Array, time_s: Array, untouched: Array, period_s: float) -> Array:
    """Undo slow changes of gain and phase between antennas, which turn a tag as a press does.

    Parameters
    ----------
    channel : ndarray of complex, shape (n, K, A)
    time_s : ndarray, shape (n,)
        Of each packet, rising, from 0, in s.
    untouched : ndarray of bool, shape (n,)
        Packets of the reference, in which the gains are what they are brought to.
    period_s : float
        Time over which gains are averaged: the length of a group.

    Returns
    -------
    ndarray of complex, shape (n, K, A)
        The same array where nothing drifts.

    Notes
    -----
    The static paths against the first antenna, averaged over the packets of a period, are compared
    with those of the reference. A change that is the same on all subcarriers is one of the
    receiver; one of the room differs between subcarriers and is left in.

    Examples
    --------
    >>> rng, time_s = np.random.default_rng(1), np.linspace(0, 20, 2000)
    >>> room = rng.standard_normal((8, 2, 2)) @ np.array([1, 1j])
    >>> drifting = np.tile(room, (2000, 1, 1))
    >>> drifting[:, :, 1] *= np.exp(0.01j * time_s)[:, None]
    >>> steady = without_drift(drifting, time_s, time_s < 2, 0.5)
    >>> bool(np.abs(steady / room - 1).max() < 0.02 < np.abs(drifting / room - 1).max())
    True
    """
    period = (time_s / period_s).astype(int)
    _, first = np.unique(period, return_index=True)
    count = np.diff(np.append(first, len(time_s)))
    center_s = np.add.reduceat(time_s, first) / count
    # A few packets show the tags instead of their means.
    usable = count >= 0.5 * np.median(count)
    corrected = channel
    for antenna in range(1, channel.shape[2]):
        products = channel[:, :, antenna] * channel[:, :, 0].conj()
        size = np.mean(np.abs(channel[:, :, 0]) ** 2, axis=1, keepdims=True)
        products = products / np.maximum(size, 1e-300)
        usual = products[untouched].mean(axis=0)
        mean = (np.add.reduceat(products, first, axis=0) / count[:, None])[usable]
        power = float(np.sum(np.abs(usual) ** 2))
        gain = mean @ usual.conj() / max(power, 1e-300)
        change = np.abs(gain - 1) ** 2
        own = np.sum(np.abs(mean - gain[:, None] * usual) ** 2, axis=1) / max(power, 1e-300)
        drifts = change.max() > _LEAST_DRIFT**2 and own.sum() < _OWN_SHARE * change.sum()
        if not drifts or np.abs(gain).min() < _FAILED:
            continue
        if corrected is channel:
            corrected = channel.copy()
        at_s = center_s[usable]
        along = np.interp(time_s, at_s, gain.real) + 1j * np.interp(time_s, at_s, gain.imag)
        corrected[:, :, antenna] /= along[:, None]
    return corrected


def _against_first(channel: Array, rows: Array, antenna: int) -> Array:
    """Mean of an antenna against the first one in some packets, on each subcarrier; shape (K,)."""
    first, other = channel[rows, :, 0], channel[rows, :, antenna]
    size = np.mean(np.abs(first) ** 2, axis=1, keepdims=True)
    return np.asarray(np.mean(other * first.conj() / np.maximum(size, 1e-300), axis=0))


def rotation_std_deg(change: Array, others: int) -> Array:
    """Rotation of all tags by a change of the static paths that packets are divided by.

    Parameters
    ----------
    change : ndarray, shape (G,)
        Power of the change in the combinations without a static path, over that of the static
        paths.
    others : int
        Combinations of a subcarrier: antennas less one.

    Returns
    -------
    ndarray, shape (G,)
        Standard deviation in degrees.

    Notes
    -----
    Where static paths change by D, a combination holds T - (D / S) U in place of the tag's T, with
    the tag's part U along the static paths S. U cannot be measured, and neither can the part of D
    along S, since phase and gain of a packet are the same. Of n directions with independent
    Rayleigh fading, another one holds t times their mean power or more with a probability of
    (1 + t / n)^-n (:func:`.planning.packet_plan.tag_ratios`). The result is half of what is
    exceeded in 5 %; half of its power changes phases.

    Examples
    --------
    >>> rotation_std_deg(np.array([0.0, 1e-6, 1e-3]), 1).round(2).tolist()
    [0.0, 0.0, 2.76]
    """
    exceeded = others * (_EXCEEDED ** (-1 / others) - 1)
    power = np.maximum(change - _LEAST_CHANGE**2, 0) / others
    std: Array = np.degrees(np.sqrt(exceeded * power / 2) / 2)
    return std


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
