# SPDX-License-Identifier: GPL-3.0-or-later
"""An end's channel over the subcarriers, compared with that of the untouched sensor.

A press rotates and scales all subcarriers of an end alike. What else is in the channel has a
profile of its own: the mirror image of an unbalanced receiver one that is known, and everything
that comes over the air one that consists of a few delays.
"""

from __future__ import annotations

import numpy as np

from ...signal.waveform import Waveform
from ...wiforce_kernels import profile_check
from ..groups import Array

# Delays relative to the tag's own at which a room reflects: 45 m before, 75 m behind.
_DELAYS_S = np.linspace(-0.15e-6, 0.25e-6, 81)
# Delay profiles whose singular value is smaller than this share of the largest are left out.
_LEAST_SINGULAR = 0.05


def image_of(channel: Array, waveform: Waveform) -> Array:
    """Profile (..., K) of a channel's mirror image by an unbalanced (IQ) receiver.

    Of y = mu x + nu conj(x) the second part is received on subcarrier k as nu conj(H[-k])
    conj(X[-k]) / X[k]; 0 where -k is not occupied.
    """
    reference, mirrored = waveform.reference, waveform.mirrored
    factors = np.where(mirrored >= 0, reference[mirrored].conj() / reference, 0)
    return np.asarray(channel[..., mirrored].conj() * factors)


class ProfileCheck:
    """Removes the image from the channels of 2S ends, and compares the rest with the reference."""

    def __init__(self, waveform: Waveform, ends: int) -> None:
        self._waveform = waveform
        frequency_hz = waveform.subcarriers * waveform.spacing_hz
        delays = np.exp(-2j * np.pi * np.outer(frequency_hz, _DELAYS_S))
        profiles, singular, _ = np.linalg.svd(delays, full_matrices=False)
        self._delays = profiles[:, singular > _LEAST_SINGULAR * singular[0]]
        self._subcarriers = waveform.subcarriers
        self._reference: Array | None = None
        self._kernel = profile_check(ends, len(frequency_hz))

    def reset(self) -> None:
        """Forget the groups so far, for a new reference."""
        self._kernel.reset()

    def by(self, reference: Array) -> profile_check:
        """What compares with the ``reference`` (2S, K), which is 0 for an end without one."""
        known = self._reference
        if known is None or not (known is reference or np.array_equal(known, reference)):
            image, other = image_of(reference, self._waveform), self._other_profiles(reference)
            self._kernel.set_reference(reference, image, other.swapaxes(1, 2).conj())
            self._reference = reference
        return self._kernel

    def _other_profiles(self, reference: Array) -> Array:
        """Orthonormal delay profiles around each end's delay, orthogonal to its channel."""
        profiles = []
        for channel in reference:
            step = np.vdot(channel[:-1], channel[1:])
            ramp = np.exp(1j * np.angle(step) * self._subcarriers) if step else 1.0
            columns = self._delays * np.reshape(ramp, (-1, 1))
            # A Householder reflection turns the channel's own profile into the first one. (Singular
            # vectors would be arbitrary, since the profiles are orthonormal already.)
            own = columns.conj().T @ channel
            profiles.append(columns @ np.linalg.qr(own[:, None], mode="complete")[0][:, 1:])
        return np.stack(profiles)
