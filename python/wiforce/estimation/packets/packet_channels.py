# SPDX-License-Identifier: GPL-3.0-or-later
"""Packets of a card to channels free of its oscillator and receiver chains, and their noise."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ...signal.switching import harmonics
from ...signal.weights import TimedTable
from ..groups import Array
from .antenna_states import (
    LEAST_PACKETS,
    LEAST_STEP,
    OWN_SHARE,
    TAG_STEP,
    AntennaStates,
    against_reference,
    find_states,
    find_states_beside_tags,
    neighbours,
)

# Largest part of what a packet holds along the static paths that a tag is.
LARGEST = 0.8
# Amplitude of an antenna against what it was below which it is taken to have failed.
_FAILED = 0.05


def _well_known(count: Array) -> Array:
    """Periods with enough packets, or with the most of all."""
    return np.flatnonzero(count >= min(LEAST_PACKETS, count.max()))


# Rounds in which static paths and the phases of packets are estimated from one another.
_ROUNDS = 4
# Share of rooms in which two standard deviations are exceeded; and the change of the static paths
# that is ignored, -46 dB, above what a press on a tag 50 dB below them causes by itself.
_EXCEEDED, _LEAST_CHANGE = 0.05, 0.005
# Packets of which the static paths are estimated.
_MOST_PACKETS = 4000


def rotation_std_deg(change: float, others: int) -> float:
    """Rotation of all tags by a change of the static paths that packets are divided by, in degrees.

    ``change`` is its power in the combinations over that of the static paths, ``others`` are
    antennas less one. A combination then holds T - (D / S) U, of which neither U nor D along S can
    be measured. Of n directions with Rayleigh fading, one more exceeds t times their mean power
    with probability (1 + t / n)^-n; the result is half of what is exceeded in 5 %.
    """
    exceeded = others * (_EXCEEDED ** (-1 / others) - 1)
    power = max(change - _LEAST_CHANGE**2, 0.0) / others
    return float(np.degrees(np.sqrt(exceeded * power / 2) / 2))


# Delays by which paths by way of a tag differ from the mean of the static ones, in s rms of each
# side: the delay spread of a home (IEEE 802.11-03/940r4, model B). In 400 rooms of 20, 40 and
# 80 MHz, 95 % of the tags then lie inside two standard deviations (docs/wifi.md).
_DELAYS_S = 15e-9
# Subcarriers that hold this much of the mean power or less are empty, as when packets use a part of
# a band: one in a thousand fades as deep.
_EMPTY = 1e-3


class AntennaCombination:
    """Combines the antennas of a receiver to channels without its oscillator, gain and timing.

    A packet is H_a = x (S_a + r T_a), x being its phase, gain and delay. On each subcarrier
    antennas are combined to the A - 1 sums without static path, and divided by x, which the static
    paths of all give; for two antennas that is the numerator of H_1 / H_2 - S_1 / S_2. The tag is
    in x with <S, T> / <S, S>, which bends the result less than a ratio (docs/theory.md, Formulas).

    A single antenna has no such sums: a packet less x times its static paths keeps what has another
    shape over the subcarriers than these, or than their delay.

    ``former`` combined nearly the same packets (n, K, A), its phases are kept. ``static`` (K, A)
    has mean power 1; ``by_subcarrier`` where each is divided by itself, as packets differ by more.
    ``hidden`` is the power of a path along the static ones over a combination's, ``kept_db`` what
    all combinations hold of it.
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
        self._single = channel.shape[2] == 1
        if former is not None:
            if not self._single:
                # The nearest orthogonal directions, by the polar decomposition.
                first, _, last = np.linalg.svd(self._others.conj().swapaxes(1, 2) @ former._others)
                self._others = self._others @ (first @ last)
            along = along * _turn(np.sum(along.conj() * former._along, axis=1))[:, None]
        self._along: Array = along
        direct = np.einsum("nka,ka->nk", scaled, along.conj())
        level = np.sqrt(np.median(np.abs(direct) ** 2, axis=0))
        level /= np.sqrt(np.mean(level**2))
        hertz = subcarrier_hz - np.mean(subcarrier_hz)
        self._hertz = hertz
        self._order, self._beside, self._step_hz = neighbours(hertz)
        # Start from the packet whose gain is the median one.
        middle = int(np.argsort(power.mean(axis=(1, 2)))[len(power) // 2])
        static = level * _turn(direct[middle] if former is None else former._profile)
        for _ in range(_ROUNDS):
            common = self._common(direct, static)
            mean = np.median((direct / common).real, axis=0)
            static = mean + 1j * np.median((direct / common).imag, axis=0)
        common = self._common(direct, static)
        # Packets differ by more than noise, which is alike in all directions.
        residual = direct - common * static
        powers = np.linalg.eigvalsh(residual.conj().T @ residual)
        self.by_subcarrier = not self._single and bool(powers.mean() > 2 * np.median(powers))
        self.hidden, self.kept_db = 1.0, 0.0
        if self._single:
            self.hidden, self.kept_db = _one_antenna(static, hertz)
        # All that is computed of every packet is in single precision, as its channel is.
        self._profile: Array = static.astype(np.complex64)
        self._others = self._others.astype(np.complex64)
        self.static = (along * static[:, None]).astype(np.complex64)
        self._hertz = self._hertz.astype(np.float32)

    def direct(self, channel: Array) -> Array:
        """x (1 + r U), (n, K): packets (n, K, A) along static paths, U a tag's part there."""
        unit = self.static / np.abs(self._profile)[:, None] ** 2
        return np.asarray(np.einsum("nka,ka->nk", channel, unit.conj()))

    def process(self, channel: Array, tag: Array | None = None) -> Array:
        """Packets (n, K, A) to (n, K (A - 1)), or (n, K) of one, with the tags' r U if known."""
        level = np.abs(self._profile)
        direct = self.direct(channel) * level
        static = level if tag is None else level * (1 + tag)
        common = direct / static if self.by_subcarrier else self._common(direct, static)
        if self._single:
            own = level if tag is None else level * self.response(tag)
            received = np.abs(common) > 0
            rest = np.divide(direct, common, out=np.zeros_like(direct), where=received) - own
            # A delay takes one of two components here: without the other one, what remains is
            # linear in the tag's reflection.
            slope = level * (self._hertz - level**2 @ self._hertz / np.sum(level**2))
            rest -= np.multiply.outer(rest @ slope / np.sum(slope**2), slope)
            return np.asarray(rest * received)
        others = np.einsum("nka,kab->nkb", channel, self._others.conj())
        common = common[:, :, None]
        combined = np.divide(others, common, out=np.zeros_like(others), where=np.abs(common) > 0)
        return combined.reshape(len(channel), -1)

    @property
    def shared(self) -> Array:
        """Changes (C, A - 1) of the combinations with gain and phase of each antenna but one."""
        if self._single:
            return np.zeros((len(self.static), 0))
        each = np.einsum("ka,kab->kba", self.static, self._others.conj())[:, :, 1:]
        return np.asarray(each.reshape(-1, each.shape[2]))

    def response(self, tag: Array) -> Array:
        """What :meth:`process` divides packets by because of tags (n, K) that it does not know."""
        level = np.abs(self._profile)
        return 1 + tag if self.by_subcarrier else self._common(level * (1 + tag), level)

    def without(self, channel: Array, tag: Array, combined: Array) -> Array:
        """Packets (n, K, A) without tags, of known :meth:`direct` and :meth:`process`."""
        common = self.direct(channel) / (1 + tag)
        part = tag[:, :, None] * self.static
        if not self._single:
            own = combined.reshape(*tag.shape, -1)
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


def _one_antenna(static: Array, hertz: Array) -> tuple[float, float]:
    """What static paths (K,) hide of a path of any delay: see :attr:`AntennaCombination.hidden`."""
    power = np.abs(static) ** 2
    used = power > _EMPTY * power.mean()
    order, beside, step_hz = neighbours(hertz[used])
    static, hertz = static[used][order], hertz[used][order]
    # Delays count from the mean one of the static paths.
    products = (static[1:] * static[:-1].conj())[beside]
    delay = np.angle(products.sum()) / step_hz
    static = static * np.exp(-1j * delay * hertz)
    power = np.abs(static) ** 2
    alike = 1 / (1 + (2 * np.pi * _DELAYS_S * np.subtract.outer(hertz, hertz)) ** 2)
    slope = (hertz - power @ hertz / power.sum()) * static
    lost = [
        float(np.vdot(each, alike @ each).real / np.vdot(each, each).real) / len(hertz)
        for each in (static, slope)
    ]
    kept = max(1 - sum(lost), 1e-6)
    return lost[0] / kept, 10 * float(np.log10(kept))


@dataclass(frozen=True, eq=False)
class TagParts:
    """What tags add to packets.

    ``uncertain`` is the amplitude of each in ``direct`` that is unknown, empty if none was found;
    ``snr`` is that of a typical end, times the groups in which the tags were found.
    """

    # (3, n, S), of each tag in each packet, over that of its first end while untouched: as clocks
    # and times are known, and if they err either way by as much as they may
    reflection: Array
    closed: Array  # (3, n, 2 S), how long each end is closed then, from 0 to 1; 0 where unknown
    direct: Array  # (S, K), what the static paths hold of an untouched end, in units of them
    combined: Array  # (S, K (A - 1)), the same of the combinations without a static path
    # (n,), packets in which this is all that the tags add, but for less than LEAST_STEP of the
    # receiver chains
    known: Array
    uncertain: tuple[float, ...]
    snr: float

    def change_since(self, former: TagParts | None) -> tuple[float, ...]:
        """Rms over the subcarriers by which ``direct`` has changed, for each of ``uncertain``."""
        change = self.direct - (0 if former is None else former.direct)
        rms = np.sqrt(np.mean(np.abs(change) ** 2, axis=1))
        return tuple(rms.tolist()[: len(self.uncertain)])


@dataclass(frozen=True, eq=False)
class DividedPackets:
    """Packets without what multiplies all antennas, or single ones."""

    time_s: Array  # (n,), rising from the start of the first group
    # (n, K (A - 1)), combinations without a static path, in units of the static paths
    combined: Array
    distorted: Array  # the same divided by what packets hold along the static paths with tags
    static: Array  # the same without the tags, as far as they are known
    level: Array  # (n, K), logarithm of the magnitude along the static paths
    state: Array  # (n,), of the receiver chains

    def groups(self, first: int, stop: int, period_s: float) -> list[tuple[Array, Array]]:
        """Packets of each group from ``first`` on, and their times from its centre."""
        bounds = np.searchsorted(self.time_s, np.arange(first, stop + 1) * period_s)
        centers_s = (np.arange(first, stop) + 0.5) * period_s
        rows = [np.arange(*ends) for ends in pairwise(bounds)]
        return [(own, self.time_s[own] - at) for own, at in zip(rows, centers_s, strict=True)]


def undivided(channel: Array, time_s: Array) -> DividedPackets:
    """Packets (n, K, A) of an instrument with one oscillator, which need not be divided."""
    flat, none = channel.reshape(len(channel), -1), np.zeros((len(channel), 1))
    return DividedPackets(time_s, flat, flat, flat, none, np.zeros(len(flat), int))


class PacketChannels:
    """Divides the packets of a card by its oscillator and its receiver chains.

    An antenna receives H_a = x g_a (S_a + r T_a): x is phase, gain and delay of the packet, g_a
    state and drift of the chain, S_a static paths. x and g_a are measured on S_a + r T_a and
    divided out repeatedly, with tags known from before (:meth:`divide`): self-calibration (T. J.
    Pearson and A. C. S. Readhead, Annual Review of Astronomy and Astrophysics 22 (1984), 97-130).
    ``time_s`` (n,) rises from 0; ``step`` is the least change between antennas that is the
    receiver's.
    """

    def __init__(
        self,
        channel: Array,
        time_s: Array,
        untouched: Array,
        subcarrier_hz: Array,
        period_s: float,
        step: float = TAG_STEP,
    ) -> None:
        self._received, self._time_s, self._untouched = channel, time_s, untouched
        self._subcarrier_hz, self._period = subcarrier_hz, (time_s / period_s).astype(int)
        states = find_states(channel, subcarrier_hz, step)
        self._calibrate(channel, states, np.ones(len(channel), bool), None)

    def divide(self, tags: TagParts | None = None) -> DividedPackets:
        """Packets without oscillator and receiver chains, with tags as known before."""
        along: Array | None = None
        across: Array | float = 0.0
        if tags is not None:
            parts = tags.reflection @ tags.direct, tags.reflection @ tags.combined
            size = np.abs(parts[0])
            parts[0][:] *= np.minimum(1, LARGEST / np.maximum(size, 1e-30))
            channel = self._received * self._gain
            every = [
                self.combination.without(channel, *each) / self._gain
                for each in zip(*parts, strict=True)
            ]
            switches = tags.known, tags.closed, self._period
            states, best = find_states_beside_tags(
                np.array(every), self._subcarrier_hz, LEAST_STEP, *switches
            )
            taken = best, np.arange(len(best))
            free, along, across = np.array(every)[taken], parts[0][taken], parts[1][taken]
            if not (self._untouched & (states.label >= 0)).any():
                states = self.states  # without a packet of the reference, states are none
            self._calibrate(free, states, tags.known, self.combination)
        channel = self._received * self._gain
        combined = distorted = self.combination.process(channel)
        if along is not None:
            combined = self.combination.process(channel, along)
        level = np.log(np.maximum(np.abs(self.combination.direct(channel)), 1e-30))
        free = combined - across
        return DividedPackets(self._time_s, combined, distorted, free, level, self.states.label)

    def _calibrate(
        self, free: Array, states: AntennaStates, known: Array, former: AntennaCombination | None
    ) -> None:
        """Measure what multiplies the antennas on packets of which the tags are known."""
        self.states, own = states, states.label >= 0
        self._gain = self._state_gains(free, known)
        self._gain /= self._drift_gains(free * self._gain, known & own)[:, None]
        rows = self._untouched & own
        channel = free[rows] * self._gain[rows]
        self.combination = AntennaCombination(channel, self._subcarrier_hz, former)

    def _state_gains(self, channel: Array, known: Array) -> Array:
        """Factors (n, K, A) that bring antennas to the most frequent state of the chains.

        ``known`` (n,) packets have no tags left in ``channel`` (n, K, A), others are taken as these
        of their state. Static paths are compared period by period with those of other states at the
        nearest time, so that neither drift nor a press is taken for a property of the state.
        """
        states, period, label = self.states, self._period, self.states.label
        gains = np.ones(channel.shape, np.complex64)
        if states.count < 2:
            return gains
        against = against_reference(channel, states.reference)
        # All packets of a state of which none is known.
        rows = np.flatnonzero((label >= 0) & (known | ~np.isin(label, label[known])))
        where = label[rows], period[rows]
        counts = np.zeros((states.count, period[-1] + 1), int)
        np.add.at(counts, where, 1)
        sums = np.zeros((*counts.shape, *channel.shape[1:]), complex)
        np.add.at(sums, where, against[rows])
        known_sums, known_count = sums[0], counts[0]
        for state in range(1, states.count):
            own, other = _well_known(counts[state]), _well_known(known_count)
            near = other[np.argmin(np.abs(own[:, None] - other), axis=1)]
            mean = sums[state, own] / counts[state, own, None, None]
            known_mean = known_sums[near] / known_count[near, None, None]
            weight = 1 / (1 / counts[state][own] + 1 / known_count[near])
            product = np.einsum("p,pka,pka->ka", weight, mean.conj(), known_mean)
            power = np.einsum("p,pka->ka", weight, np.abs(mean) ** 2)
            gain = np.divide(product, power, out=np.ones_like(product), where=power > 0)
            gains[label == state] = gain
            known_sums = known_sums + gain * sums[state]
            known_count = known_count + counts[state]
        return gains

    def _drift_gains(self, channel: Array, known: Array) -> Array:
        """Slow changes (n, A) of gain and phase between antennas, which turn a tag as a press does.

        Antennas are to be divided by them; 1 where untouched or nothing drifts. Means of ``known``
        packets against the reference antenna are compared with the untouched ones: what is the same
        on all subcarriers is of the receiver, what is not is of the room and left in.
        """
        gains = np.ones((len(channel), channel.shape[2]), complex)
        rows, time_s, reference = np.flatnonzero(known), self._time_s, self.states.reference
        untouched = self._untouched[rows]
        if not untouched.any():
            return gains
        _, first = np.unique(self._period[rows], return_index=True)
        count = np.diff(np.append(first, len(rows)))
        # A few packets show the tags instead of their means.
        usable = count >= 0.5 * np.median(count)
        at_s = (np.add.reduceat(time_s[rows], first) / count)[usable]
        against = against_reference(channel[rows], reference)
        for antenna in range(channel.shape[2]):
            products = against[:, :, antenna]
            untouched_mean = products[untouched].mean(axis=0)
            mean = (np.add.reduceat(products, first, axis=0) / count[:, None])[usable]
            power = max(float(np.sum(np.abs(untouched_mean) ** 2)), 1e-300)
            gain = mean @ untouched_mean.conj() / power
            change = np.abs(gain - 1) ** 2
            own = np.sum(np.abs(mean - gain[:, None] * untouched_mean) ** 2, axis=1) / power
            drifts = change.max() > LEAST_STEP**2 and own.sum() < OWN_SHARE * change.sum()
            if antenna == reference or not drifts or np.abs(gain).min() < _FAILED:
                continue
            along = np.interp(time_s, at_s, gain.real) + 1j * np.interp(time_s, at_s, gain.imag)
            gains[:, antenna] = along
        return gains


# Frequencies beside a tone, in resolutions of a group, at which a tag has nothing.
_BESIDE = (-2, -1, 1, 2)
# Values by which noise is measured: their number gives its power to 1 / sqrt(4096), 1.6 %.
_VALUES = 4096


def shared_noise(
    packets: DividedPackets, shared: Array, known: Array, table: TimedTable
) -> tuple[Array, Array]:
    """Noise of the packets' combinations at the tags' lines: whitening and precision (C, C).

    Antennas wander against each other, an Intel AX200's by 0.5 deg rms mostly below 300 Hz, 15 dB
    above the noise of all subcarriers. Noise D + B P B^H, with D by subcarrier and B in span of
    ``shared`` (C, A - 1), is transformed to D, as weights by subcarrier presume; both are measured
    beside the tones. The first matrix is that of row vectors.
    """
    parts = _beside_tones(packets, known, table)
    each = np.eye(len(shared))
    if not parts:
        return each, each
    noise = np.concatenate(parts)
    own = np.maximum(np.mean(np.abs(noise) ** 2, axis=0), 1e-300)
    if not shared.shape[1]:
        return each, each / own
    for _ in range(2):
        level = np.sqrt(own)
        white, basis = noise / level, np.linalg.qr(shared / level[:, None])[0]
        along = white @ basis.conj()
        rest = white - along @ basis.T
        kept = 1 - np.sum(np.abs(basis) ** 2, axis=1)
        own = own * np.mean(np.abs(rest) ** 2, axis=0) / np.maximum(kept, 1e-3)
    # A press that changes inside a group, or a step of the room, is no noise of the others.
    count = np.array([len(each) for each in parts])
    group = np.repeat(np.arange(len(parts)), count)
    size = np.sqrt(np.bincount(group, np.sum(np.abs(along) ** 2, axis=1)) / count)
    along /= np.maximum(size / np.maximum(np.median(size), 1e-300), 1)[group, None]
    powers, vectors = np.linalg.eigh(along.T @ along.conj() / len(along))
    # What independent noise leaves along them is no reason to weigh them less.
    factors = 1 / np.sqrt(np.maximum(powers, 1))
    turned = basis @ vectors
    across = (turned.conj() * (1 - factors)) @ turned.T
    whiten = each - level[:, None] ** -1 * across * level
    return whiten, (whiten / own) @ whiten.conj().T


def _beside_tones(packets: DividedPackets, known: Array, table: TimedTable) -> list[Array]:
    """Noise (N, C) of groups beside the tones, by a tag's power in each."""
    period_s = table.group_period_s
    groups = packets.groups(0, int(packets.time_s[-1] // period_s) + 1, period_s)
    whole = [(rows, times_s) for rows, times_s in groups if len(rows)]
    chosen = [each for each in whole if known[each[0]].all()] or whole
    lines = [tone for tone in table.tones if tone.frequency_hz > 0]
    orders = [[abs(line) for _, line in tone.owners] for tone in lines]
    power = np.array([np.sum(harmonics(order) ** 2) for order in orders])
    power = np.concatenate([power[::-1], power]) / power.sum()
    found = []
    each = len(_BESIDE) * len(power)
    shifts_hz = [steps / period_s for steps in _BESIDE]
    for rows, times_s in chosen[:: -(-len(chosen) * each // _VALUES)]:
        own = packets.state[rows] >= 0
        # What is left of a tag, of which little is known while it is weak, is no noise: its tones
        # are solved for as well.
        weights = table.beside(times_s[own], packets.state[rows[own]], shifts_hz)
        level, static = np.sqrt(power * np.count_nonzero(own))[:, None], packets.static[rows[own]]
        if weights:
            found.append(np.concatenate([level * w.apply(static.astype(complex)) for w in weights]))
    return found
