# SPDX-License-Identifier: GPL-3.0-or-later
"""The Cramer-Rao bound of a phase reading."""

from collections.abc import Sequence

import numpy as np

from .lines import clutter_basis
from .switching import switch_averages_and_slopes


def phase_bound_deg(
    ends: np.ndarray,
    noise: np.ndarray,
    clocks: Sequence[tuple[float, float]],
    times_s: np.ndarray,
    averaging_s: float,
    clutter_hz: float = 0.0,
    reference_groups: float = np.inf,
    snapshot_period_s: float | None = None,
    mask: np.ndarray | None = None,
    clutter: np.ndarray | None = None,
) -> np.ndarray:
    """Smallest standard deviation of any unbiased estimate of the ends' phase changes.

    The change is measured in one group against ``reference_groups`` untouched ones. Unknown are
    the channel of every end and subcarrier, the amplitude change of every end, static channel and
    clutter (projected out), and each clock's phase and offset within the group.

    Parameters
    ----------
    ends : ndarray of complex, shape (2S, K)
        a_k D_i: the ends as seen on each subcarrier.
    noise : ndarray, shape (K,)
        Variance of the noise in H.
    clocks : sequence of (clock_hz, phase), length S
        Actual fs of each tag in Hz and its phase in radians at time 0.
    times_s : ndarray, shape (N,)
        Time of every snapshot of the group in s; evenly spaced unless ``clutter`` is given.
    averaging_s : float
        Ta of the waveform, in s.
    clutter_hz : float
        Highest Doppler frequency of anything that moves; 0 leaves only the mean unknown.
    reference_groups : float
        R; infinity for a reference without noise.
    snapshot_period_s : float, optional
        T in s, when ``times_s`` holds a single snapshot.
    mask : ndarray of bool, shape (N,), optional
        True where a snapshot is present; all are by default.
    clutter : ndarray of float, shape (N, order), optional
        Orthonormal basis of what is projected out at these times, instead of ``clutter_hz``.

    Returns
    -------
    ndarray of float, shape (2S,)
        In degrees.

    Notes
    -----
    The diagonal of the inverse Fisher information of phases, amplitudes, clock phases and clock
    offsets. For one tag and ideal edges it is about
    (180/pi) sqrt((1 + 1/R) / (2 gamma K N q)) with q = 1/6 and gamma = |a_k D_i|^2 / noise. See
    S. M. Kay, Fundamentals of Statistical Signal Processing: Estimation Theory, 1993, chapter 3.

    Examples
    --------
    One tag at 0 dB on 62 subcarriers, in a group of 625 snapshots:

    >>> times_s = np.arange(625) * 57.6e-6
    >>> phase_bound_deg(np.ones((2, 62)), np.ones(62), [(1000.0, 0.3)], times_s, 20.48e-6).round(2)
    array([0.52, 0.53])
    """
    if clutter is None:
        period = snapshot_period_s or times_s[1] - times_s[0]
        clutter = clutter_basis(len(times_s), period, clutter_hz)
    clock_hz, phase = np.array(clocks)[:, :, None].swapaxes(0, 1)
    half_window = np.pi * clock_hz[:, 0] * averaging_s
    courses = switch_averages_and_slopes(phase + 2 * np.pi * clock_hz * times_s, half_window)
    waves, slopes = (course.swapaxes(0, 1).reshape(len(times_s), -1) for course in courses)
    elapsed = (times_s - times_s.mean())[:, None]
    # Changes of phase and amplitude of each end, of its clock's phase, and of that with time.
    waveforms = np.hstack([waves, waves, slopes, slopes * elapsed])
    if mask is not None:
        waveforms, clutter = waveforms[mask], np.linalg.qr(clutter[mask])[0]
    waveforms = waveforms - clutter @ (clutter.T @ waveforms)
    count = len(ends)
    factors = np.repeat([1j, 1, 1, 1], count)
    overlap = np.tile((ends.conj() / noise) @ ends.T, (4, 4)) * np.outer(factors.conj(), factors)
    information = 2 * (waveforms.T @ waveforms) * overlap.real
    # Both ends of a tag have the same clock.
    sums = np.vstack([np.eye(2 * count, 4 * count), np.zeros((count, 4 * count))])
    sums[2 * count :, 2 * count :] = np.kron(np.eye(count), [1, 1])
    information = sums @ information @ sums.T
    # Where no snapshot meets an edge, a clock's phase changes nothing: it costs nothing either.
    felt = np.flatnonzero(np.diag(information) > 0)
    information = information[np.ix_(felt, felt)]
    scale = 1 / np.sqrt(np.diag(information))
    covariance = np.linalg.inv(information * np.outer(scale, scale)) * np.outer(scale, scale)
    variance = np.diag(covariance)[: len(ends)] * (1 + 1 / reference_groups)
    return np.degrees(np.sqrt(variance))
