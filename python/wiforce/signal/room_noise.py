# SPDX-License-Identifier: GPL-3.0-or-later
"""Coloured noise of a room: lines and bands between the tags' lines, as seen by the snapshots."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True, eq=False)
class RoomNoise:
    """Autocovariance of what disturbs a group, in units of the receiver's white noise.

    Attributes
    ----------
    autocovariance : ndarray of float, shape (N,)
        At lags of 0 to N - 1 snapshots, N being the length of a group. White noise alone is
        (1, 0, 0, ...).
    """

    autocovariance: np.ndarray = field(repr=False)

    def covariance(self, mask: np.ndarray | None = None) -> np.ndarray:
        """Covariance matrix of a group's snapshots.

        Returns ndarray of float, shape (n, n).

        Parameters
        ----------
        mask : ndarray of bool, shape (N,), optional
            The snapshots that are present; all of them when not given.
        """
        snapshots = np.arange(len(self.autocovariance))
        if mask is not None:
            snapshots = snapshots[mask]
        return self.autocovariance[np.abs(snapshots[:, None] - snapshots)]


def room_noise(
    frequency_hz: np.ndarray, power: np.ndarray, group_length: int, snapshot_period_s: float
) -> RoomNoise:
    """Noise of a room from the power spectrum of its disturbances.

    Parameters
    ----------
    frequency_hz : ndarray, shape (L,)
        0 or above; the mirrored frequencies are disturbed equally.
    power : ndarray, shape (L,)
        Mean power at +f and -f, each per subcarrier and snapshot in units of the white noise.
    group_length : int
        Snapshots per group, N.
    snapshot_period_s : float
        T, in s.

    Notes
    -----
    c[n] = delta[n] + sum_l 2 p_l cos(2 pi f_l n T).
    """
    lags_s = np.arange(group_length) * snapshot_period_s
    values = 2 * np.asarray(power) @ np.cos(2 * np.pi * np.outer(frequency_hz, lags_s))
    values[0] += 1.0
    return RoomNoise(values)
