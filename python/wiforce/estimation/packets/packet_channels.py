# SPDX-License-Identifier: GPL-3.0-or-later
"""Packets of a card to channels that are free of its oscillator and of its receiver chains."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..groups import Array
from .antenna_combination import AntennaCombination
from .antenna_gains import drift_gains, state_gains
from .antenna_states import LEAST_STEP, TAG_STEP, AntennaStates, find_states


@dataclass(frozen=True, eq=False)
class TagParts:
    """What tags add to packets.

    Attributes
    ----------
    reflection : ndarray of complex, shape (n, S)
        Of each tag in each packet, over that of its first end while untouched.
    closed : ndarray, shape (n, 2 S)
        How long each of their ends is closed, from 0 to 1; 0 where it is unknown.
    direct : ndarray of complex, shape (S, K)
        What the static paths hold of an untouched end, in units of them.
    combined : ndarray of complex, shape (S, K (A - 1))
        The same of the combinations without a static path.
    known : ndarray of bool, shape (n,)
        Packets in which this is all that the tags add, but for less than the least step of the
        receiver chains (:data:`.antenna_states.LEAST_STEP`).

    Examples
    --------
    >>> parts = TagParts(
    ...     np.zeros((9, 1)), np.zeros((9, 2)), np.ones((1, 4)), np.ones((1, 4)), np.ones(9, bool)
    ... )
    >>> (parts.reflection @ parts.direct).shape
    (9, 4)
    """

    reflection: Array
    closed: Array
    direct: Array
    combined: Array
    known: Array


@dataclass(frozen=True, eq=False)
class DividedPackets:
    """Packets without what multiplies all antennas, or single ones.

    Attributes
    ----------
    combined : ndarray of complex, shape (n, K (A - 1))
        Combinations of the antennas that hold no static path, in units of the static paths.
    bent : ndarray of complex, shape (n, K (A - 1))
        The same divided by all that packets hold along the static paths, tags included.
    static : ndarray of complex, shape (n, K (A - 1))
        The same without the tags, as far as they are known.
    level : ndarray, shape (n, K)
        Logarithm of the magnitude along the static paths.
    state : ndarray of int, shape (n,)
        Of the receiver chains.

    Examples
    --------
    >>> undivided(np.ones((9, 4, 1))).combined.shape
    (9, 4)
    """

    combined: Array
    bent: Array
    static: Array
    level: Array
    state: Array


def undivided(channel: Array) -> DividedPackets:
    """Packets of an instrument that measures with one oscillator, which need not be divided.

    Parameters
    ----------
    channel : ndarray of complex, shape (n, K, A)

    Returns
    -------
    DividedPackets

    Examples
    --------
    >>> undivided(np.ones((9, 4, 2))).combined.shape
    (9, 8)
    """
    flat = channel.reshape(len(channel), -1)
    return DividedPackets(flat, flat, flat, np.zeros((len(flat), 1)), np.zeros(len(flat), int))


class PacketChannels:
    """Divides the packets of a card by its oscillator and its receiver chains.

    Parameters
    ----------
    channel : ndarray of complex, shape (n, K, A)
    time_s : ndarray, shape (n,)
        Of each packet, rising, from 0, in s.
    untouched : ndarray of bool, shape (n,)
        Packets of the untouched reference.
    subcarrier_hz : ndarray, shape (K,)
        Against the carrier.
    period_s : float
        Length of a group, in s.
    step : float
        Least change of the antennas against each other that is one of the receiver, while no tag is
        known (:func:`.antenna_states.find_states`).

    Attributes
    ----------
    states : AntennaStates
        Of the receiver chains, by the packets without tags as far as these are known.

    Notes
    -----
    An antenna receives H_a = x g_a (S_a + r T_a): the packet's phase, gain and delay x, the state
    and the drift of the receiver chain g_a, the static paths S_a and the tag r T_a. x and g_a are
    measured on S_a + r T_a, as there is nothing else. They are therefore divided out repeatedly:
    first as if tags were weak, then with the tags known from before (:meth:`divide`). Radio
    astronomy calls this self-calibration (T. J. Pearson and A. C. S. Readhead, Annual Review of
    Astronomy and Astrophysics 22 (1984), 97-130).

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> room = rng.standard_normal((16, 2, 2)) @ np.array([1, 1j])
    >>> common = np.exp(2j * np.pi * rng.random(400))
    >>> received = common[:, None, None] * room
    >>> received[100:150, :, 1] *= -1  # the phase between the antennas flips
    >>> time_s, hertz = 0.001 * np.arange(400), 312.5e3 * np.arange(16)
    >>> channels = PacketChannels(received, time_s, time_s < 0.2, hertz, 0.1)
    >>> bool(np.abs(channels.divide().combined).max() < 1e-6)
    True
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
        self._subcarrier_hz, self._period_s = subcarrier_hz, period_s
        states, known = find_states(channel, step), np.ones(len(channel), bool)
        self._combination = self._calibrated(channel, states, known, None)

    def divide(self, tags: TagParts | None = None) -> DividedPackets:
        """Packets without oscillator and receiver chains.

        Parameters
        ----------
        tags : TagParts, optional
            As far as they are known from packets that were divided before.

        Returns
        -------
        DividedPackets
        """
        along: Array | None = None
        across: Array | float = 0.0
        if tags is not None:
            along, across = tags.reflection @ tags.direct, tags.reflection @ tags.combined
            channel = self._received * self._gain
            free = self._combination.without(channel, along, across) / self._gain
            period = (self._time_s / self._period_s).astype(int)
            states = find_states(free, LEAST_STEP, tags.known, tags.closed, period, self.states)
            former = self._combination
            self._combination = self._calibrated(free, states, tags.known, former)
        channel = self._received * self._gain
        combined = bent = self._combination.process(channel)
        if along is not None:
            combined = self._combination.process(channel, along)
        level = np.log(np.maximum(np.abs(self._combination.direct(channel)), 1e-30))
        return DividedPackets(combined, bent, combined - across, level, self.states.label)

    def response(self, tag: Array) -> Array:
        """What packets are divided by because of tags that are not known (n, K) along them."""
        return self._combination.response(tag)

    def _calibrated(
        self,
        free: Array,
        states: AntennaStates,
        known: Array,
        former: AntennaCombination | None,
    ) -> AntennaCombination:
        """Measure what multiplies the antennas on packets of which the tags are known."""
        self.states, own = states, states.label >= 0
        self._gain = state_gains(free, states, self._time_s, self._period_s, known)
        along = self._time_s, self._untouched, self._period_s
        drift = drift_gains(free * self._gain, states.reference, *along, known & own)
        self._gain /= drift[:, None]
        rows = self._untouched & own
        return AntennaCombination(free[rows] * self._gain[rows], self._subcarrier_hz, former)
