# SPDX-License-Identifier: GPL-3.0-or-later
"""Several antennas of one receiver: the part of their channels that is free of its oscillator."""

from __future__ import annotations

import numpy as np

from ..groups import Array

# Rounds in which static paths and the phases of packets are estimated from one another.
_ROUNDS = 4
# Share of rooms in which two standard deviations are exceeded; and the change of the static paths
# that is ignored, -46 dB, above what a press on a tag 50 dB below them causes by itself.
_EXCEEDED, _LEAST_CHANGE = 0.05, 0.005
# Packets of which the static paths are estimated.
_MOST_PACKETS = 4000


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
    former : AntennaCombination, optional
        Of nearly the same packets: the arbitrary phases and directions are chosen as there.

    Attributes
    ----------
    static : ndarray of complex, shape (K, A)
        Static paths, with a mean power of 1 per subcarrier and an arbitrary common phase.
    by_subcarrier : bool
        Whether each subcarrier is divided by itself, because packets differ by more than a phase,
        a gain, a delay and noise.

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

    def __init__(
        self, channel: Array, subcarrier_hz: Array, former: AntennaCombination | None = None
    ) -> None:
        channel = channel[:: max(1, len(channel) // _MOST_PACKETS)].astype(complex)
        power = np.sum(np.abs(channel) ** 2, axis=2, keepdims=True)
        scaled = channel / np.sqrt(np.maximum(power.mean(axis=1, keepdims=True), 1e-300))
        spread = np.einsum("nka,nkb->kab", scaled, scaled.conj())
        _, vectors = np.linalg.eigh(spread)
        self._others: Array = vectors[:, :, :-1]
        along: Array = vectors[:, :, -1]
        if former is not None:
            # The nearest orthogonal directions, by the polar decomposition.
            first, _, last = np.linalg.svd(self._others.conj().swapaxes(1, 2) @ former._others)
            self._others = self._others @ (first @ last)
            along = along * _turn(np.sum(along.conj() * former._along, axis=1))[:, None]
        self._along: Array = along
        direct = np.einsum("nka,ka->nk", scaled, along.conj())
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
        static = level * _turn(direct[middle] if former is None else former._profile)
        for _ in range(_ROUNDS):
            common = self._common(direct, static)
            mean = np.median((direct / common).real, axis=0)
            static = mean + 1j * np.median((direct / common).imag, axis=0)
        common = self._common(direct, static)
        self.by_subcarrier = _differs(direct - common * static)
        # All that is computed of every packet is in single precision, as its channel is.
        self._profile: Array = static.astype(np.complex64)
        self._others = self._others.astype(np.complex64)
        self.static = (along * static[:, None]).astype(np.complex64)
        self._hertz = self._hertz.astype(np.float32)

    def direct(self, channel: Array) -> Array:
        """What packets hold along the static paths.

        Parameters
        ----------
        channel : ndarray of complex, shape (n, K, A)

        Returns
        -------
        ndarray of complex, shape (n, K)
            In units of the static paths: x (1 + r U), where U is what they hold of a tag.
        """
        unit = self.static / np.abs(self._profile)[:, None] ** 2
        return np.asarray(np.einsum("nka,ka->nk", channel, unit.conj()))

    def process(self, channel: Array, tag: Array | None = None) -> Array:
        """Combine the antennas of some packets.

        Parameters
        ----------
        channel : ndarray of complex, shape (n, K, A)
        tag : ndarray of complex, shape (n, K), optional
            The tags' part r U of :meth:`direct`, where it is known.

        Returns
        -------
        ndarray of complex, shape (n, K (A - 1))
            In units of the static paths. 0 where nothing is received.
        """
        level = np.abs(self._profile)
        direct = self.direct(channel) * level
        static = level if tag is None else level * (1 + tag)
        common = direct / static if self.by_subcarrier else self._common(direct, static)
        others = np.einsum("nka,kab->nkb", channel, self._others.conj())
        common = common[:, :, None]
        combined = np.divide(others, common, out=np.zeros_like(others), where=np.abs(common) > 0)
        return combined.reshape(len(channel), -1)

    def response(self, tag: Array) -> Array:
        """What :meth:`process` divides packets by because of tags that it does not know.

        Parameters
        ----------
        tag : ndarray of complex, shape (n, K)
            Their part of :meth:`direct`.

        Returns
        -------
        ndarray of complex, shape (n, K)
        """
        level = np.abs(self._profile)
        return 1 + tag if self.by_subcarrier else self._common(level * (1 + tag), level)

    def without(self, channel: Array, tag: Array, combined: Array) -> Array:
        """Packets without tags.

        Parameters
        ----------
        channel : ndarray of complex, shape (n, K, A)
        tag : ndarray of complex, shape (n, K)
            Their part of :meth:`direct`.
        combined : ndarray of complex, shape (n, K (A - 1))
            Their part of what :meth:`process` gives.

        Returns
        -------
        ndarray of complex, shape (n, K, A)
        """
        common = self.direct(channel) / (1 + tag)
        own = combined.reshape(*tag.shape, -1)
        part = tag[:, :, None] * self.static
        part = part + np.einsum("nkb,kab->nka", own, self._others)
        return np.asarray(channel - common[:, :, None] * part)

    def _common(self, direct: Array, static: Array) -> Array:
        """Phase, gain and delay of each packet by static paths (n, K) or (K,); shape (n, K)."""
        ratio = direct * static.conj()
        ordered = ratio[:, self._order]
        pairs = (ordered[:, 1:] * ordered[:, :-1].conj())[:, self._beside]
        slope = np.angle(pairs.sum(axis=1)) / self._step_hz
        weights = np.abs(static) ** 2
        total = weights.sum(axis=-1)
        lever = weights * (self._hertz - (weights @ self._hertz / total)[..., None])
        leverage = lever @ self._hertz
        for _ in range(2):
            turned = ratio * np.exp(-1j * np.multiply.outer(slope, self._hertz))
            phase = np.angle(turned * turned.sum(axis=1, keepdims=True).conj())
            slope = slope + np.sum(phase * lever, axis=-1) / leverage
        turn = np.exp(1j * np.multiply.outer(slope, self._hertz))
        level = np.sum(ratio * turn.conj(), axis=1) / total
        common: Array = level[:, None] * turn
        return common


def _turn(values: Array) -> Array:
    """Factors of magnitude 1 with the phases of some values."""
    return np.exp(1j * np.angle(values))


def _differs(residual: Array) -> bool:
    """Whether packets differ by more than noise, which is alike in all directions."""
    powers = np.linalg.eigvalsh(residual.conj().T @ residual)
    return bool(powers.mean() > 2 * np.median(powers))
