# SPDX-License-Identifier: GPL-3.0-or-later
"""What the receiver chains of a card multiply its antennas with, state by state and slowly."""

from __future__ import annotations

import numpy as np

from ..groups import Array
from .antenna_states import (
    LEAST_PACKETS,
    LEAST_STEP,
    OWN_SHARE,
    AntennaStates,
    against_reference,
)

# Amplitude of an antenna against what it was below which it is taken to have failed.
_FAILED = 0.05


def state_gains(
    channel: Array, states: AntennaStates, time_s: Array, period_s: float, known: Array
) -> Array:
    """Factors that bring antennas to what they are in the most frequent state of the chains.

    Parameters
    ----------
    channel : ndarray of complex, shape (n, K, A)
        Without tags, as far as they are known.
    states : AntennaStates
        Of the packets.
    time_s : ndarray, shape (n,)
        Of each packet, rising, from 0, in s.
    period_s : float
        Time in which the room and a press are taken as constant, in s.
    known : ndarray of bool, shape (n,)
        Packets without tags, which the others of their state are treated as.

    Returns
    -------
    ndarray of complex, shape (n, K, A)
        1 for the most frequent state and the reference antenna.

    Notes
    -----
    The static paths in a state, period by period, are compared with those in the other states at
    the nearest time, so that neither a slow drift nor a press in part of a recording is taken for a
    property of the state.

    Examples
    --------
    >>> states = AntennaStates(np.repeat([0, 1], 50), reference=0)
    >>> channel = np.ones((100, 4, 2)) * np.array([1.0, 1j])
    >>> channel[50:, :, 1] *= -1
    >>> gains = state_gains(channel, states, 0.01 * np.arange(100), 0.5, np.ones(100, bool))
    >>> gains[60, 0].tolist()
    [(1+0j), (-1+0j)]
    """
    gains = np.ones(channel.shape, np.complex64)
    if states.count < 2:
        return gains
    against = against_reference(channel, states.reference)
    period = (time_s / period_s).astype(int)
    means, counts = [], []
    for state in range(states.count):
        own = states.label == state
        rows = np.flatnonzero(own & known if (own & known).any() else own)
        count = np.bincount(period[rows], minlength=period[-1] + 1)
        sums = np.zeros((len(count), *channel.shape[1:]), complex)
        np.add.at(sums, period[rows], against[rows])
        means.append(sums)
        counts.append(count)
    known_sums, known_count = means[0], counts[0]
    for state in range(1, states.count):
        own, other = _well_known(counts[state]), _well_known(known_count)
        near = other[np.argmin(np.abs(own[:, None] - other), axis=1)]
        mean = means[state][own] / counts[state][own, None, None]
        usual = known_sums[near] / known_count[near, None, None]
        weight = 1 / (1 / counts[state][own] + 1 / known_count[near])
        product = np.einsum("p,pka,pka->ka", weight, mean.conj(), usual)
        power = np.einsum("p,pka->ka", weight, np.abs(mean) ** 2)
        gain = np.divide(product, power, out=np.ones_like(product), where=power > 0)
        gains[states.label == state] = gain
        known_sums = known_sums + gain * means[state]
        known_count = known_count + counts[state]
    return gains


def _well_known(count: Array) -> Array:
    """Periods with enough packets, or with the most of all."""
    return np.flatnonzero(count >= min(LEAST_PACKETS, count.max()))


def drift_gains(
    channel: Array,
    reference: int,
    time_s: Array,
    untouched: Array,
    period_s: float,
    known: Array,
) -> Array:
    """Slow changes of gain and phase between antennas, which turn a tag as a press does.

    Parameters
    ----------
    channel : ndarray of complex, shape (n, K, A)
    reference : int
        Antenna against which the others change.
    time_s : ndarray, shape (n,)
        Of each packet, rising, from 0, in s.
    untouched : ndarray of bool, shape (n,)
        Packets of the reference, in which the gains are 1.
    period_s : float
        Time over which gains are averaged: the length of a group.
    known : ndarray of bool, shape (n,)
        Packets without tags, in which gains are measured.

    Returns
    -------
    ndarray of complex, shape (n, A)
        By which the antennas are to be divided; 1 where nothing drifts.

    Notes
    -----
    The static paths against the reference antenna, averaged over the packets of a period, are
    compared with those of the untouched reference. A change that is the same on all subcarriers is
    one of the receiver; one of the room differs between subcarriers and is left in.

    Examples
    --------
    >>> rng, time_s = np.random.default_rng(1), np.linspace(0, 20, 2000)
    >>> room = rng.standard_normal((8, 2, 2)) @ np.array([1, 1j])
    >>> drifting = np.tile(room, (2000, 1, 1))
    >>> drifting[:, :, 1] *= np.exp(0.01j * time_s)[:, None]
    >>> gains = drift_gains(drifting, 0, time_s, time_s < 2, 0.5, np.ones(2000, bool))
    >>> bool(np.abs(drifting / gains[:, None] / room - 1).max() < 0.02)
    True
    """
    gains = np.ones((len(channel), channel.shape[2]), complex)
    rows = np.flatnonzero(known)
    if not (untouched & known).any():
        return gains
    _, first = np.unique((time_s[rows] / period_s).astype(int), return_index=True)
    count = np.diff(np.append(first, len(rows)))
    # A few packets show the tags instead of their means.
    usable = count >= 0.5 * np.median(count)
    at_s = (np.add.reduceat(time_s[rows], first) / count)[usable]
    against = against_reference(channel[rows], reference)
    for antenna in range(channel.shape[2]):
        products = against[:, :, antenna]
        usual = products[untouched[rows]].mean(axis=0)
        mean = (np.add.reduceat(products, first, axis=0) / count[:, None])[usable]
        power = max(float(np.sum(np.abs(usual) ** 2)), 1e-300)
        gain = mean @ usual.conj() / power
        change = np.abs(gain - 1) ** 2
        own = np.sum(np.abs(mean - gain[:, None] * usual) ** 2, axis=1) / power
        drifts = change.max() > LEAST_STEP**2 and own.sum() < OWN_SHARE * change.sum()
        if antenna == reference or not drifts or np.abs(gain).min() < _FAILED:
            continue
        along = np.interp(time_s, at_s, gain.real) + 1j * np.interp(time_s, at_s, gain.imag)
        gains[:, antenna] = along
    return gains
