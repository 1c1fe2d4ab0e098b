# SPDX-License-Identifier: GPL-3.0-or-later
"""The Cramer-Rao bound of a phase reading."""

import numpy as np

from .switching import switch_averages
from .weights import clutter_basis


def phase_bound_deg(
    ends,
    noise,
    clocks,
    times_s,
    averaging_s,
    clutter_hz=0.0,
    reference_groups=np.inf,
    snapshot_period_s=None,
    mask=None,
):
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
    clocks : sequence of (clock_hz, phase)
        Actual fs of each tag and its phase in radians at time 0.
    times_s : ndarray, shape (N,)
        Time of every snapshot of the group, evenly spaced.
    averaging_s : float
        Ta of the waveform.
    clutter_hz : float
        Bandwidth of what moves; 0 leaves only the mean unknown.
    reference_groups : float
        R; infinity for a reference without noise.
    snapshot_period_s : float, optional
        T, when it cannot be had from ``times_s``.
    mask : ndarray of bool, shape (N,), optional
        Snapshots present.

    Returns
    -------
    ndarray, shape (2S,)
        Degrees. For one tag and ideal edges about
        (180/pi) sqrt((1 + 1/R) / (2 gamma K N q)), q = 1/6.

    Notes
    -----
    Fisher information of phases, amplitudes, clock phases and offsets; its inverse's diagonal.
    """
    period = snapshot_period_s or times_s[1] - times_s[0]
    clutter = clutter_basis(len(times_s), period, clutter_hz)
    waveforms, channels = _derivatives(ends, clocks, times_s, averaging_s)
    if mask is not None:
        waveforms, clutter = waveforms[mask], np.linalg.qr(clutter[mask])[0]
    waveforms = waveforms - clutter @ (clutter.T @ waveforms)
    correlation = waveforms.T @ waveforms
    information = np.zeros((len(channels), len(channels)))
    for a, terms_a in enumerate(channels):
        for b, terms_b in enumerate(channels):
            for column_a, channel_a in terms_a:
                for column_b, channel_b in terms_b:
                    overlap = np.sum((channel_a.conj() * channel_b).real / noise)
                    information[a, b] += 2 * overlap * correlation[column_a, column_b]
    scale = 1 / np.sqrt(np.diag(information))
    covariance = np.linalg.inv(information * np.outer(scale, scale)) * np.outer(scale, scale)
    variance = np.diag(covariance)[: len(ends)] * (1 + 1 / reference_groups)
    return np.degrees(np.sqrt(variance))


def _derivatives(ends, clocks, times_s, averaging_s, step=1e-5):
    """Derivatives of the signal by phases, amplitudes, clock phases and offsets.

    Returns the waveforms as columns, and for every parameter its (column, channel) terms.
    """
    columns, slopes = [], []
    for clock_hz, phase in clocks:
        phases = phase + 2 * np.pi * clock_hz * times_s
        half = np.pi * clock_hz * averaging_s
        columns.append(switch_averages(phases, half))
        upper, lower = (switch_averages(phases + sign * step, half) for sign in (1, -1))
        slopes.append((upper - lower) / (2 * step))
    elapsed = (times_s - times_s.mean())[:, None]
    count = len(ends)
    waveforms = np.hstack(columns + slopes + [slope * elapsed for slope in slopes])
    parameters = [[(i, 1j * ends[i])] for i in range(count)]
    parameters += [[(i, ends[i])] for i in range(count)]
    for kind in (1, 2):
        for tag in range(len(clocks)):
            first = kind * count + 2 * tag
            parameters.append([(first, ends[2 * tag]), (first + 1, ends[2 * tag + 1])])
    return waveforms, parameters
