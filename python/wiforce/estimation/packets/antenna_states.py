# SPDX-License-Identifier: GPL-3.0-or-later
"""States of a card's receiver chains: phases that flip, and gains of single antennas that step."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..groups import Array

# Changes of the antennas against each other, relative to their static paths: what no tag does (one
# whose first line is 20 dB below the direct path, at 10 cm, changes each antenna by 0.44), and the
# least that matters, 0.3 dB or 2 degrees.
TAG_STEP, LEAST_STEP = 1.0, 0.035
# Packets that a state needs: its static path is then known to a fifth of the noise of a packet.
LEAST_PACKETS = 20
# Two states are apart when a quarter of the step between their medians is nearly empty: it holds
# this share of the smaller one's packets at most, against a quarter of them where one normal or
# uniform distribution is divided. Divisions are tried at this many of the widest gaps.
_BETWEEN, _CANDIDATES = 0.1, 16
# Largest share of a state's step that is not a gain, a phase and a delay: two files of an Intel
# AX200 have up to 0.004; tags of which the delays differ by 15 ns have 0.02 and more over 5 MHz.
_FLAT = 0.01
# What the parts are that packets are divided into.
_STATE, _PART, _OTHER = range(3)
# Largest change of the shape over the subcarriers that a card makes. An Intel AX200 changes it by
# 0.12 when the phase between its antennas flips; packets of another sender, whose paths are
# others, differ by 0.3 to 1.
_SAME_PATHS = 0.25
# Largest share of a lasting change of the receiver that differs from subcarrier to subcarrier.
OWN_SHARE = 0.1
# Directions in which states are looked for, and packets that these are computed from.
_DIRECTIONS, _MOST_PACKETS = 3, 4000
# Degrees of freedom of the noise of packets, of which a few in a hundred are four standard
# deviations or more from all states; turns in which its size is measured; and the gain of a
# log-likelihood that is none.
_FREEDOM, _TURNS, _ALIKE = 4.0, 20, 1e-3


@dataclass(frozen=True)
class AntennaStates:
    """Receiver chains in each packet: ``label`` (n,), 0 the most frequent, -1 of other paths.

    ``reference`` is the strongest antenna, against which the others change.
    """

    label: Array
    reference: int

    @property
    def count(self) -> int:
        """Number of states."""
        return int(self.label.max(initial=-1)) + 1

    @property
    def notes(self) -> list[str]:
        """That packets are of other paths, a sentence; none without such."""
        foreign = int(np.count_nonzero(self.label < 0))
        why = "differ from those of the others by more than gain and phase, as from another sender"
        return [f"left out {foreign} x packet whose antennas {why}"] if foreign else []


def find_states(channel: Array, subcarrier_hz: Array, step: float) -> AntennaStates:
    """Find the states that the receiver chains of a card take, from channels (n, K, A).

    Antennas against each other are free of the packet's phase and gain. Packets are divided where a
    principal component takes values that are apart by a ``step``, relative to the static paths.
    What differs by more than gain, phase and delay is of a tag, the room or another sender.
    """
    count = len(channel)
    no_tags = np.ones(count, bool), np.zeros((1, count, 0)), np.zeros(count, int)
    return find_states_beside_tags(channel[None], subcarrier_hz, step, *no_tags)[0]


def find_states_beside_tags(
    channel: Array,
    subcarrier_hz: Array,
    step: float,
    known: Array,
    closed: Array,
    period: Array,
) -> tuple[AntennaStates, Array]:
    """States as of :func:`find_states`, and which errors of clocks and times packets show (n,).

    ``channel`` (E, n, K, A) is without tags, as far as they are ``known`` (n,), for E errors of
    clocks and times, none first; ``closed`` (E, n, 2 S) is how long each end is closed in a packet
    then, ``period`` (n,) the group of each packet, in which tags are constant. States are looked
    for in packets in which all ends are open at any of the errors, and the others compared with
    them: a wrong one would confirm a wrong clock.
    """
    count = len(closed[0])
    flat = channel.reshape(-1, *channel.shape[2:])
    reference = int(np.argmax(np.median(np.sum(np.abs(flat) ** 2, axis=1), axis=0)))
    against = others_against(flat, reference)
    best, label = np.zeros(count, int), np.zeros(count, int)
    if not against.shape[1]:
        return AntennaStates(label, reference), best
    against = against.reshape(len(closed), count, -1)
    found = np.isin(period, period[closed.any(axis=(0, 2))])
    rows = np.flatnonzero(found & ~closed.any(axis=(0, 2)))
    if len(rows) < LEAST_PACKETS:
        rows = np.arange(count)
    means, label = _means_and_labels(against[0, rows], against[0], subcarrier_hz, step)
    if len(means) == 1 or not closed.any():
        return AntennaStates(_numbered(label), reference), best
    best = np.argmin(np.min([np.linalg.norm(against - m, axis=2) for m in means], axis=0), axis=0)
    taken = best, np.arange(count)
    against, closed = against[taken], closed[taken]
    ours = label >= 0
    label[ours] = _nearest_mean(against[ours], means)
    own = label[rows[ours[rows]]]
    noise = against[rows[ours[rows]]] - means[own]
    mixture = _Mixture(means, noise, np.bincount(own, minlength=len(means)) / len(own))
    for group in np.unique(period[closed.any(axis=1) & ours]):
        packets = np.flatnonzero((period == group) & ours)
        largest = LEAST_STEP / 2 if known[packets].all() else TAG_STEP
        label[packets] = mixture.states(against[packets], closed[packets], largest)
    return AntennaStates(_numbered(label), reference), best


def _means_and_labels(
    some: Array, against: Array, subcarrier_hz: Array, step: float
) -> tuple[Array, Array]:
    """Means (states, C) of packets (m, C), and the nearest of each (n,), -1 of other paths."""
    own = np.zeros(len(some), int)
    while True:
        apart = _division(some * _units(some, own)[own], own, step)
        if apart is None:
            break
        own[apart] = own.max() + 1
    own = _merged(some, own, step)
    means = _means(some, own)
    kind = _kinds(some, own, means, subcarrier_hz)
    label = np.where(kind[_nearest_mean(against, means)] == _OTHER, -1, 0)
    means = means[kind == _STATE]
    label[label == 0] = _nearest_mean(against[label == 0], means)
    return means, label


def against_reference(channel: Array, reference: int) -> Array:
    """H_a conj(H_reference) over the reference's mean power, free of packets' phases; (n, K, A)."""
    first = channel[:, :, reference]
    power = np.mean(np.abs(first) ** 2, axis=1)
    weight = first.conj() / np.maximum(power, 1e-30)[:, None]
    return np.asarray(channel * weight[:, :, None])


def others_against(channel: Array, reference: int) -> Array:
    """:func:`against_reference` of all antennas but the reference, (n, K (A - 1))."""
    others = np.delete(np.arange(channel.shape[2]), reference)
    return against_reference(channel, reference)[:, :, others].reshape(len(channel), -1)


def neighbours(subcarrier_hz: Array) -> tuple[Array, Array, float]:
    """Order (K,) of subcarriers, which of the rising ones have a next one beside, and its step."""
    order = np.argsort(subcarrier_hz)
    steps = np.diff(subcarrier_hz[order])
    step_hz = float(np.min(steps))
    return order, np.flatnonzero(steps < 1.01 * step_hz), step_hz


def _units(against: Array, label: Array) -> Array:
    """Factors to units of the static path of each state, without its phases; (states, C)."""
    units = np.empty((label.max() + 1, against.shape[1]), against.dtype)
    for state in range(len(units)):
        own = against[label == state]
        some = own[:: max(1, len(own) // _MOST_PACKETS)]
        _, vectors = np.linalg.eigh(some.conj().T @ some)
        size = np.median(np.linalg.norm(own, axis=1))
        units[state] = np.exp(1j * np.angle(vectors[:, -1])) / max(size, 1e-30)
    return units


def _division(relative: Array, label: Array, step: float) -> Array | None:
    """Packets that are farthest apart from the rest of their state, by more than a step."""
    best, widest = None, step
    for state in range(label.max() + 1):
        rows = np.flatnonzero(label == state)
        if len(rows) >= 2 * LEAST_PACKETS:
            for found, apart in _parts(relative[rows]):
                if found > widest:
                    widest, best = found, rows[apart]
    return best


def _parts(relative: Array) -> Iterator[tuple[float, Array]]:
    """Divisions of a state's packets: the step between two parts, and the smaller part."""
    values = np.hstack([relative.real, relative.imag])
    values -= np.median(values, axis=0)
    some = values[:: max(1, len(values) // _MOST_PACKETS)]
    _, vectors = np.linalg.eigh(some.T @ some)
    for score in (values @ vectors[:, : -_DIRECTIONS - 1 : -1]).T:
        order = np.argsort(score)
        ranked = score[order]
        gaps = np.diff(ranked)[LEAST_PACKETS - 1 : len(ranked) - LEAST_PACKETS]
        for middle in np.argsort(gaps)[: -_CANDIDATES - 1 : -1] + LEAST_PACKETS:
            step = _middle(ranked[middle:]) - _middle(ranked[:middle])
            center = (ranked[middle - 1] + ranked[middle]) / 2
            between = np.subtract(*ranked.searchsorted([center + step / 8, center - step / 8]))
            if between <= _BETWEEN * min(middle, len(ranked) - middle):
                yield step, order[:middle] if 2 * middle < len(order) else order[middle:]


def _middle(ranked: Array) -> float:
    """Median of sorted values."""
    count = len(ranked)
    return float(ranked[(count - 1) // 2] + ranked[count // 2]) / 2


def _merged(against: Array, label: Array, step: float) -> Array:
    """Labels without states nearer than a step: tags may divide one far from the middle."""
    while True:
        label = np.unique(label, return_inverse=True)[1]
        means = _means(against, label)
        apart = np.linalg.norm(means[:, None] - means, axis=2) / np.linalg.norm(means, axis=1)
        np.fill_diagonal(apart, np.inf)
        one, other = np.unravel_index(np.argmin(apart), apart.shape)
        if apart[one, other] >= step:
            return label
        label = np.where(label == one, other, label)


def _means(against: Array, label: Array) -> Array:
    """Mean of the packets (n, C) of each state, (states, C)."""
    return np.array([against[label == state].mean(axis=0) for state in range(label.max() + 1)])


def _nearest_mean(against: Array, means: Array) -> Array:
    """State of each packet (n, C) whose mean is nearest."""
    distance = [np.linalg.norm(against - mean, axis=1) for mean in means]
    return np.asarray(np.argmin(distance, axis=0))


def _kinds(against: Array, label: Array, means: Array, subcarrier_hz: Array) -> Array:
    """Kinds of parts, (parts,): states (gain, phase and delay of one), other paths, neither."""
    count = np.bincount(label)
    noise = np.bincount(label, np.sum(np.abs(against - means[label]) ** 2, axis=1)) / count
    kind = np.full(len(means), _OTHER)
    order = np.argsort(-count, kind="stable")
    kind[order[0]] = _STATE
    # Share of a profile that the most frequent one has.
    size = np.linalg.norm(means, axis=1)
    share = np.abs(means.conj() @ means[order[0]]) / np.maximum(size * size[order[0]], 1e-300)
    alike = 1 - share**2 <= _SAME_PATHS**2
    for part in order[1:]:
        kind[part] = _PART if alike[part] else _OTHER
        for state in np.flatnonzero(kind == _STATE):
            step, own = _own_change(means[state], means[part], subcarrier_hz)
            known = noise[state] / count[state] + noise[part] / count[part]
            if alike[part] and own - known < _FLAT * step:
                kind[part] = _STATE
    return kind


def _own_change(former: Array, mean: Array, subcarrier_hz: Array) -> tuple[float, float]:
    """Power of a change of antennas (C,), and of what of it is not gain, phase and delay."""
    hertz = (subcarrier_hz - subcarrier_hz.mean())[:, None]
    former, mean = (each.reshape(len(hertz), -1) for each in (former, mean))
    product = mean * former.conj()
    weight, slope = np.abs(product), np.zeros(product.shape[1])
    for _ in range(_TURNS):
        turned = product * np.exp(-1j * hertz * slope)
        phase = np.angle(turned * turned.sum(axis=0).conj())
        slope = slope + np.sum(weight * hertz * phase, axis=0) / np.sum(weight * hertz**2, axis=0)
    turn = np.exp(1j * hertz * slope)
    power = np.maximum(np.sum(np.abs(former) ** 2, axis=0), 1e-300)
    factor = np.sum(product * turn.conj(), axis=0) / power
    step, own = mean - former, mean - factor * turn * former
    return float(np.sum(np.abs(step) ** 2)), float(np.sum(np.abs(own) ** 2))


class _Mixture:
    """States of packets beside tags of which only the switches are known.

    ``means`` (states, C) without tags, ``noise`` (m, C) of packets and ``share`` (states,), in
    units of the noise of what distinguishes states, which has Student's t distribution (D. Peel and
    G. J. McLachlan, Statistics and Computing 10 (2000), 339-348).
    """

    def __init__(self, means: Array, noise: Array, share: Array) -> None:
        self._basis = np.linalg.svd(means - means[0], full_matrices=False)[2][: len(means) - 1]
        own, size = self._flat(noise), np.median(np.linalg.norm(means, axis=1))
        self._wide, self._share = own.shape[1], share
        weights = np.ones(len(own))
        for _ in range(_TURNS):
            spread = (own.T * weights) @ own / len(own) + 1e-12 * size**2 * np.eye(self._wide)
            power, vectors = np.linalg.eigh(spread)
            self._whiten = vectors / np.sqrt(power)
            weights = self._weights(np.sum((own @ self._whiten) ** 2, axis=1))
        self._means = self._flat(means) @ self._whiten
        self._size, self._power = size, power

    def states(self, against: Array, closed: Array, largest: float) -> Array:
        """Most likely state of the packets (n, C) of a group, in which tags are constant."""
        packets = self._flat(against) @ self._whiten
        # Two standard deviations of what an end adds are the largest step that it may cause.
        self._prior = 2 * (2 / (largest * self._size)) ** 2 * self._power
        best = self._fit(packets, closed, np.zeros((closed.shape[1], self._wide)))
        # Where all packets of a closed end are taken to a wrong state, the tag compensates for it.
        for end in np.flatnonzero(closed.any(axis=0)):
            own, start = closed[:, end] > 0, best[1].copy()
            start[end] = 0
            center = np.median(packets[own] - closed[own] @ start, axis=0)
            for mean in self._means:
                start[end] = center - mean
                best = max(best, self._fit(packets, closed, start), key=lambda each: each[0])
        return np.asarray(np.argmax(best[2], axis=1))

    def _flat(self, values: Array) -> Array:
        """Real coordinates (n, D) of values (n, C) in what distinguishes states."""
        own = values @ self._basis.conj().T
        return np.hstack([own.real, own.imag])

    def _weights(self, distance: Array) -> Array:
        """Weights of packets at squared distances from their mean, as of Student's t."""
        return np.asarray((_FREEDOM + self._wide) / (_FREEDOM + distance))

    def _fit(self, packets: Array, closed: Array, tag: Array) -> tuple[float, Array, Array]:
        """Log posterior, tag (2 S, D) and probabilities (n, states) of EM from a tag."""
        former, share = -np.inf, self._share
        prior = np.multiply.outer(self._prior, np.eye(len(tag)))
        while True:
            rest: Array = packets - closed @ tag
            heavy = self._weights(np.sum((rest[:, None] - self._means) ** 2, axis=2))
            likely = share * heavy ** ((_FREEDOM + self._wide) / 2)
            sums = likely.sum(axis=1, keepdims=True)
            likely /= sums
            posterior = float(np.sum(np.log(sums)) + self._share @ np.log(share))
            posterior -= float(np.sum(self._prior * tag**2)) / 2
            if not posterior - former > _ALIKE:
                return posterior, tag, likely
            # One packet's worth of what is known of the shares: a group may lack a state.
            former, share = posterior, (likely.sum(axis=0) + self._share) / (len(packets) + 1)
            heavy *= likely
            each = heavy.sum(axis=1, keepdims=True)
            right = closed.T @ (packets * each - heavy @ self._means)
            normal = closed.T @ (closed * each) + prior
            tag = np.linalg.solve(normal, right.T[:, :, None])[:, :, 0].T


def _numbered(label: Array) -> Array:
    """Labels by their frequency, but for -1."""
    own = label >= 0
    rank = np.argsort(np.argsort(-np.bincount(label[own]), kind="stable"), kind="stable")
    return np.where(own, rank[label], -1)
