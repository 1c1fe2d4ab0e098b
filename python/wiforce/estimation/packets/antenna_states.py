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
# Standard deviations by which a state may hold fewer packets with open switches than their share of
# all packets. One state of 700 holds still fewer by chance.
_FEWER_STDS = 3.0
# Largest change of the shape over the subcarriers that a card makes. An Intel AX200 changes it by
# 0.12 when the phase between its antennas flips; packets of another sender, whose paths are
# others, differ by 0.3 to 1.
_SAME_PATHS = 0.25
# What packets are that have a label of -1.
FOREIGN = (
    "packet whose antennas differ from those of the others by more than gain and phase, as from "
    "another sender"
)
# Largest share of a lasting change of the receiver that differs from subcarrier to subcarrier.
OWN_SHARE = 0.1
# Directions in which states are looked for, and packets that these are computed from.
_DIRECTIONS, _MOST_PACKETS = 3, 4000
# Turns in which states and tags of a group are fitted at most; three to five are usual.
_TURNS = 10


@dataclass(frozen=True)
class AntennaStates:
    """State of the receiver chains in each packet.

    ``label`` (n,) is 0 for the most frequent state and -1 for packets of other paths, such as
    another sender's; ``reference`` is the strongest antenna, against which the others change.
    """

    label: Array
    reference: int

    @property
    def count(self) -> int:
        """Number of states."""
        return int(self.label.max(initial=-1)) + 1

    @property
    def foreign(self) -> int:
        """Number of packets of other paths."""
        return int(np.count_nonzero(self.label < 0))


def find_states(
    channel: Array,
    step: float,
    known: Array | None = None,
    closed: Array | None = None,
    period: Array | None = None,
    former: AntennaStates | None = None,
) -> AntennaStates:
    """Find the states that the receiver chains of a card take, from channels (n, K, A).

    ``step`` is the least change of the antennas against each other that makes a state, relative to
    their static paths. States are found in the ``known`` packets (n,); the others get the nearest
    one. ``closed`` (n, 2 S) is how long each end of each tag is closed in a packet, ``period`` (n,)
    the group of each packet, in which tags are constant. States of ``former`` were found while less
    was known of the tags, and are divided further.

    What one antenna receives against another one is free of the packet's phase and gain, and within
    a state it varies by noise and tags alone. What follows the tags' switches is fitted and
    removed. Packets are divided where a principal component of the rest takes values that are
    apart, the farthest ones first.
    """
    reference = int(np.argmax(np.median(np.sum(np.abs(channel) ** 2, axis=1), axis=0)))
    label = np.zeros(len(channel), int)
    if channel.shape[2] == 1:
        return AntennaStates(label, reference)
    others = np.delete(np.arange(channel.shape[2]), reference)
    against = against_reference(channel, reference)[:, :, others].reshape(len(channel), -1)
    if known is None or np.count_nonzero(known) < LEAST_PACKETS:
        known = np.ones(len(channel), bool)
    rows, own = np.flatnonzero(known), np.zeros(np.count_nonzero(known), int)
    if former is not None:
        # A flip that is not yet known would be fitted as a tag.
        own = np.unique(former.label[rows], return_inverse=True)[1]
    while True:
        units = _units(against[rows], own)
        relative = against[rows] * units[own]
        if closed is not None and period is not None:
            _remove_tags(relative, own, closed[rows], period[rows])
        apart = _division(relative, own, step)
        if apart is None:
            break
        own[apart] = own.max() + 1
    tagless = relative / units[own]
    own = _merged(tagless, own, step)
    if closed is not None:
        # Divisions were made while those after them were still taken for a tag.
        own = _without_tags(tagless, own, closed[rows])
        own = _nearest(tagless, np.arange(len(rows)), own, np.arange(len(rows)))
    own = _without_room(against[rows].reshape(len(rows), -1, len(others)), own)
    own = np.unique(own, return_inverse=True)[1]
    label[rows] = own
    label[~known] = _nearest(against, rows, own, np.flatnonzero(~known))
    if closed is not None and period is not None:
        means = _means(against[rows], own)
        for group in np.unique(period[~known]):
            unknown = np.flatnonzero(~known & (period == group))
            label[unknown] = _beside_tags(against[unknown], means, label[unknown], closed[unknown])
    return AntennaStates(_ordered(against, label), reference)


def against_reference(channel: Array, reference: int) -> Array:
    """H_a conj(H_reference), free of phase and gain of the packets; (n, K, A).

    In units of the reference antenna's mean power in the packet.
    """
    first = channel[:, :, reference]
    power = np.mean(np.abs(first) ** 2, axis=1)
    weight = first.conj() / np.maximum(power, 1e-30)[:, None]
    return np.asarray(channel * weight[:, :, None])


def _shape(against: Array) -> Array:
    """What antennas receive in packets of one state, unless it is several; norm 1."""
    some = against[:: max(1, len(against) // _MOST_PACKETS)]
    _, vectors = np.linalg.eigh(some.conj().T @ some)
    return np.asarray(vectors[:, -1].conj())


def _units(against: Array, label: Array) -> Array:
    """Factors to units of the static path of each state, without its phases; (states, C)."""
    units = np.empty((label.max() + 1, against.shape[1]), against.dtype)
    for state in range(len(units)):
        own = against[label == state]
        size = np.median(np.linalg.norm(own, axis=1))
        units[state] = np.exp(-1j * np.angle(_shape(own))) / max(size, 1e-30)
    return units


def _remove_tags(relative: Array, label: Array, closed: Array, period: Array) -> None:
    """Remove what follows the tags' switches, period by period, in place."""
    starts = np.flatnonzero(np.diff(period, prepend=-1))
    for rows in np.split(np.arange(len(period)), starts[1:]):
        _, of = np.unique(label[rows], return_inverse=True)
        constants = np.eye(of.max() + 1)[of]
        columns = np.hstack([closed[rows], constants])
        found = np.linalg.lstsq(columns, relative[rows], rcond=1e-6)[0]
        relative[rows] -= closed[rows] @ found[: closed.shape[1]]


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
    """Labels without states that are nearer to one another than a step.

    A division is measured to the middle of all that is left. Where that is several states, a tag
    may divide one of them that is far from this middle.
    """
    while True:
        states = np.unique(label)
        means = np.array([against[label == state].mean(axis=0) for state in states])
        apart = np.linalg.norm(means[:, None] - means, axis=2) / np.linalg.norm(means, axis=1)
        np.fill_diagonal(apart, np.inf)
        one, other = np.unravel_index(np.argmin(apart), apart.shape)
        if apart[one, other] >= step:
            return np.unique(label, return_inverse=True)[1]
        label = np.where(label == states[one], states[other], label)


def _without_tags(against: Array, label: Array, closed: Array) -> Array:
    """Labels without states that a tag makes, of which some groups are not known well.

    A receiver does not know of the switches of a tag: in each of its states they are all open as
    often as in every other one. What is farther apart than any tag's change remains.
    """
    open_ = ~(closed > 0).any(axis=1)
    share = open_.mean()
    while True:
        count, of_open = np.bincount(label), np.bincount(label, open_)
        spread = np.sqrt(count * share * (1 - share))
        few = of_open < count * share - _FEWER_STDS * spread
        means = np.array([against[label == state].mean(axis=0) for state in range(len(count))])
        apart = np.linalg.norm(means[:, None] - means, axis=2) / np.linalg.norm(means, axis=1)
        np.fill_diagonal(apart, np.inf)
        few &= apart.min(axis=1) < TAG_STEP
        few[count.argmax()] = False
        if not few.any():
            return label
        # The smallest one first: what it joins may be right then.
        state = int(np.where(few, count, len(label) + 1).argmin())
        label = np.where(label == state, apart[state].argmin(), label)
        label = np.unique(label, return_inverse=True)[1]


def _nearest(against: Array, rows: Array, label: Array, others: Array) -> Array:
    """State nearest to each of some other packets."""
    return _nearest_mean(against[others], _means(against[rows], label))


def _means(against: Array, label: Array) -> Array:
    """Mean of the packets (n, C) of each state, (states, C)."""
    return np.array([against[label == state].mean(axis=0) for state in range(label.max() + 1)])


def _nearest_mean(against: Array, means: Array) -> Array:
    """State of each packet (n, C) whose mean is nearest."""
    distance = [np.linalg.norm(against - mean, axis=1) for mean in means]
    return np.asarray(np.argmin(distance, axis=0))


def _beside_tags(against: Array, means: Array, label: Array, closed: Array) -> Array:
    """State of the packets of a group (n, C), of whose tags little is known.

    Tags and states are fitted in turns: a wrong state would be taken for a part of the tag, and the
    tag for a step between states.
    """
    inverse = np.linalg.pinv(closed, rcond=1e-6)
    for _ in range(_TURNS):
        tag = closed @ (inverse @ (against - means[label]))
        new = _nearest_mean(against - tag, means)
        if np.array_equal(new, label):
            break
        label = new
    return label


def _without_room(against: Array, label: Array) -> Array:
    """Labels of states that are the receiver's; a change of the room remains in one state.

    A receiver changes from one packet to the next, by the same factor on all subcarriers, or to
    and fro; a change that differs from subcarrier to subcarrier and never returns may be one of
    the room.
    """
    label = label.copy()
    means = np.array([against[label == state].mean(axis=0) for state in range(label.max() + 1)])
    lasting = np.array([_majority(label == state) for state in range(len(means))])
    starts = np.where(lasting.any(axis=1), np.argmax(lasting, axis=1), 0)
    for state in np.argsort(starts, kind="stable"):
        start = starts[state]
        if start < LEAST_PACKETS:
            continue  # the first one, or one that alternates with others all the time
        before = np.arange(start - LEAST_PACKETS, start)
        former = np.bincount(label[before]).argmax()
        after = np.arange(start, min(start + LEAST_PACKETS, len(label)))
        after, before = after[label[after] == state], before[label[before] == former]
        step = means[state] - means[former]
        size = np.sum(np.abs(step) ** 2)
        jump = against[after].mean(axis=0) - against[before].mean(axis=0)
        sudden = np.vdot(step, jump).real > 0.5 * size
        power = np.maximum(np.sum(np.abs(means[former]) ** 2, axis=0), 1e-300)
        factor = np.sum(means[former].conj() * means[state], axis=0) / power
        own = np.sum(np.abs(means[state] - factor * means[former]) ** 2)
        returns = lasting[former, start:].any()
        if not (sudden and (returns or own < OWN_SHARE * size)):
            label[label == state] = former
    return label


def _majority(own: Array) -> Array:
    """Where a state begins to be that of most packets; ndarray of bool, shape (n,)."""
    inside = np.convolve(own, np.ones(LEAST_PACKETS), "full")[LEAST_PACKETS - 1 :]
    return own & (inside > LEAST_PACKETS / 2)


def _ordered(against: Array, label: Array) -> Array:
    """Labels by their frequency, -1 for states of other paths than the first one's."""
    states, count = np.unique(label, return_counts=True)
    order = states[np.argsort(-count, kind="stable")]
    found = np.full(len(label), -1)
    first, number = _shape(against[label == order[0]]), 0
    for state in order:
        match = np.abs(np.vdot(first, _shape(against[label == state])))
        if 1 - match**2 <= _SAME_PATHS**2:
            found[label == state] = number
            number += 1
    return found
