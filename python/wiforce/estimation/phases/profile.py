# SPDX-License-Identifier: GPL-3.0-or-later
"""An end's channel over the subcarriers, compared with that of the untouched sensor.

A press rotates and scales all subcarriers of an end alike. What else is in the channel has a
profile of its own: the mirror image of an unbalanced receiver one that is known, and everything
that comes over the air one that consists of a few delays.
"""

from __future__ import annotations

import math

import numpy as np

from ...signal.waveform import Waveform
from ..group_tones import power_of
from ..groups import Array

# Delays relative to the tag's own at which a room reflects: 45 m before, 75 m behind.
_DELAYS_S = np.linspace(-0.15e-6, 0.25e-6, 81)
# Delay profiles whose singular value is smaller than this share of the largest are left out.
_LEAST_SINGULAR = 0.05
# An image whose profile is this similar to the channel itself (squared correlation) is not
# separable from it.
_SIMILAR = 0.25
# An image is removed as far as its power exceeds this many times that of noise (James and Stein,
# 1961), and corrected to second order from the higher one on.
_SHRINKAGE = 2.0
_SIGNIFICANT_IMAGE = 25.0
# Standard deviations by which residual power must exceed that of noise: in a single group, and in
# the mean of the last groups.
_GROUP_STDS = 5.0
_MEAN_STDS = 4.0
_MEAN_GROUPS = 8


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
        self._of_reference: _ReferenceProfiles | None = None
        self._ends = ends
        self.reset()

    def reset(self) -> None:
        """Forget the groups so far, for a new reference."""
        self._mean, self._groups = [1.0] * self._ends, [0] * self._ends

    def process(
        self,
        ends: Array,
        reference: Array,
        weights: Array,
        gain: Array,
        noise: Array,
        raised: Array | None = None,
    ) -> tuple[Array, Array]:
        """Remove the image from V (G, 2S, K), and compare what remains with the reference.

        Returns V without its image, and the factor (G, 2S), at least 1, by which the variance of R
        exceeds that of noise. ``reference`` (2S, K) is 0 for an end without one; the weights (G, K)
        sum to 1; ``gain`` (G, 2S) is the variance of V - R V_ref over that of H, infinite where an
        end was not received; ``noise`` (G, K) is the variance of H. Subcarriers that ``raised``
        (``Groups.noise_rise``) count less when profiles are compared.
        """
        profiles = self._profiles(reference)
        image = profiles.image
        power, image_power, overlap = profiles.means(weights)
        # Along the reference and its image.
        weighted = (ends * weights[:, None]).swapaxes(0, 1)
        along, along_image = (weighted @ profiles.adjoint).T
        with np.errstate(divide="ignore", invalid="ignore"):
            similar = overlap / power
            # Power of the image without what is similar to the reference, and the level of that.
            own_power: Array = image_power - power_of(similar) * power
            level = (along_image - similar.conj() * along) / own_power
            level_noise = gain * ((weights**2 * noise).sum(axis=1) / own_power.T).T
            level_power = power_of(level)
            # Where there is no image, removing the noise along its profile would only add noise.
            level = level * np.maximum(0, 1 - _SHRINKAGE * level_noise / level_power)
            separable = (own_power > (1 - _SIMILAR) * power) & np.isfinite(level)
            level = np.where(separable, level, 0)
            ratio = along / power - level * similar
            # The reference holds an image of its own: to second order R = a + conj(nu) b for
            # levels a of the reference and b = nu (conj(R) - R) of the image.
            second = level_power / (2j * ratio.imag)
            known = separable & (level_power > _SIGNIFICANT_IMAGE * level_noise)
            second = np.where(known & (level_power < 0.1 * np.abs(ratio.imag)), second, 0)
            ends = ends - level[:, :, None] * image + second[:, :, None] * reference
            ratio = np.where(np.isfinite(ratio), ratio, 0) + second
            residual = ends - ratio[:, :, None] * reference
            cost = np.where(level != 0, power / own_power, 1.0)
            if raised is not None:
                residual = residual / np.sqrt(raised)[:, None]
                noise = noise / raised
            other = power_of(residual.swapaxes(0, 1) @ profiles.other_adjoint)
            count = other.shape[2]
            ratios = (other / (noise @ profiles.other_powers)).sum(axis=2) / (count * gain.T)
        return ends, cost * self._factors(ratios, count**-0.5)

    def _factors(self, ratios: Array, spread: float) -> Array:
        """Factors (G, 2S) by the power on other delay profiles over the noise (2S, G)."""
        factors = np.empty(ratios.shape)
        for end, row in enumerate(ratios.tolist()):
            factors[end] = self._end_factors(end, row, spread)
        return factors.T

    def _end_factors(self, end: int, ratios: list[float], spread: float) -> list[float]:
        """Factors of one end in a batch: its ratios, where these are more than noise."""
        mean, groups, factors = self._mean[end], self._groups[end], []
        for ratio in ratios:
            known = math.isfinite(ratio)
            if known:
                groups += 1
                count = min(groups, _MEAN_GROUPS)
                mean += (min(ratio, 4 * max(mean, 1.0)) - mean) / count
            count = min(max(groups, 1), _MEAN_GROUPS)
            factor = mean if mean > 1 + _MEAN_STDS * spread * count**-0.5 else 1.0
            if known and ratio > 1 + _GROUP_STDS * spread:
                factor = max(factor, ratio)
            factors.append(factor)
        self._mean[end], self._groups[end] = mean, groups
        return factors

    def _profiles(self, reference: Array) -> _ReferenceProfiles:
        """What depends on the reference alone."""
        known = self._of_reference
        if known is None or not (
            known.reference is reference or np.array_equal(known.reference, reference)
        ):
            image, other = image_of(reference, self._waveform), self._other_profiles(reference)
            known = self._of_reference = _ReferenceProfiles(reference, image, other)
        return known

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


class _ReferenceProfiles:
    """The reference of 2S ends, its image (2S, K), and other delay profiles (2S, K, D)."""

    def __init__(self, reference: Array, image: Array, other: Array) -> None:
        self.reference, self.image = reference, image
        self.adjoint = np.stack([reference, image], axis=2).conj()
        self.other_adjoint, self.other_powers = other.conj(), power_of(other)
        products = power_of(reference), power_of(image), image * reference.conj()
        self._products = np.stack(products).swapaxes(1, 2)

    def means(self, weights: Array) -> tuple[Array, Array, Array]:
        """Weighted powers of reference and image, and their correlation; (G, 2S) each."""
        power, image_power, overlap = weights @ self._products
        return power.real, image_power.real, overlap
