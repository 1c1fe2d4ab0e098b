# SPDX-License-Identifier: GPL-3.0-or-later
"""Changes of the ends' channels against their reference, and their average over subcarriers.

The reference is the untouched sensor, or the group before. A press rotates and scales all
subcarriers of an end alike; what else is in the channel has a profile of its own.
"""

from __future__ import annotations

import numpy as np

from ...signal.waveform import Waveform
from ...wiforce_kernels import conjugate_difference, profile_check
from ..groups import Array, Groups

# Delays relative to the tag's own at which a room reflects: 45 m before, 75 m behind.
_DELAYS_S = np.linspace(-0.15e-6, 0.25e-6, 81)
# Delay profiles whose singular value is smaller than this share of the largest are left out.
_LEAST_SINGULAR = 0.05


def image_of(channel: Array, waveform: Waveform) -> Array:
    """Mirror image (..., K) by an IQ imbalance: conj(H[-k]) conj(X[-k]) / X[k]; 0 without -k."""
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


class ReferenceMean:
    """Mean of the channels V of 2S ends over groups, each weighted by 1 over its variance.

    ``mean`` (2S, K), 0 where there is none; ``precision`` (2S,) and ``precisions`` (2S, K), less
    where a narrow-band transmitter interfered, are sums of 1 over the variance. ``gain`` (2S,) is
    the variance of the mean over that of H, infinite where there is none, ``excess`` (2S, K) the
    share by which interference raised it, None if nowhere.
    """

    def __init__(self, ends: int) -> None:
        none = np.zeros((ends, 1))
        self._set(none + 0j, np.zeros(ends), none)

    def _set(self, mean: Array, precision: Array, precisions: Array) -> None:
        self.mean, self.precision, self.precisions = mean, precision, precisions
        self.complete = bool((precision > 0).all())  # every end was received
        none = np.full(precision.shape, np.inf)
        self.gain = np.divide(1, precision, out=none, where=precision > 0)
        excess = np.divide(
            precision[:, None], precisions, out=np.ones_like(precisions), where=precisions > 0
        )
        self.excess = excess - 1 if (excess > 1 + 1e-9).any() else None

    def add(self, group: Groups, received: Array) -> None:
        """Add the ``received`` ends (2S,) of a single group."""
        rise = 1.0 if group.noise_rise is None else group.noise_rise
        own = np.where(received, 1 / group.gain[0], 0)
        weights = own[:, None] / rise
        precisions = self.precisions + weights
        share = np.divide(weights, precisions, out=np.zeros_like(precisions), where=weights > 0)
        mean = self.mean + share * (group.ends[0] - self.mean)
        self._set(mean, self.precision + own, precisions)

    def replace(self, other: ReferenceMean) -> Array:
        """Take over all ends that another mean holds, and give them, (2S,)."""
        held = other.precision > 0
        self._set(
            np.where(held[:, None], other.mean, self.mean),
            np.where(held, other.precision, self.precision),
            np.where(held[:, None], other.precisions, self.precisions),
        )
        return held


class ConjugateDifference:
    """V conj(V_ref) of every end, scaled so that the weighted subcarrier average is R.

    V_ref is the untouched reference in groups 0 to ``reference_groups``, or the group before
    (``against_previous``; paper, section 3.3). Absent groups are not replaced by later ones, in
    which the sensor may be touched; an end received in none takes its first ones, and is marked
    late. With ``waveform``, mirror images are removed, and deviations from the profile raise the
    variance.
    """

    def __init__(
        self,
        ends: int,
        reference_groups: int,
        against_previous: bool = False,
        waveform: Waveform | None = None,
    ) -> None:
        self.reference_groups = reference_groups
        self._against_previous = against_previous
        self._ends = ends
        self._profile = ProfileCheck(waveform, ends) if waveform is not None else None
        self._no_step = np.ones(ends, complex)
        self._holding = not against_previous
        self._held: list[Groups] = []
        # The reference of a tare, while it is measured, and the first group behind it.
        self._next: ReferenceMean | None = None
        self._next_stop: int | None = None
        self._begin(reference_groups)

    def _begin(self, stop: int | None) -> None:
        """Begin the reference that ends before group ``stop``; None for the next ones."""
        self._reference = ReferenceMean(self._ends)
        self._late = np.zeros(self._ends, bool)
        self._stop = None if stop is None else np.full(self._ends, stop)
        self._begins = True
        self._step_of_reference = np.full(self._ends, np.nan + 0j)
        if self._profile is not None:
            self._profile.reset()

    def tare(self) -> None:
        """Measure a new untouched reference in the groups that follow, for the ends received in
        them.

        They are still compared with the former one. Without effect while the first is measured.
        """
        if self._against_previous:
            self._begin(None)
        elif not self._holding:
            self._next, self._next_stop = ReferenceMean(self._ends), None

    def begin_at(self, index: int) -> None:
        """Measure the first reference from the group of this index on, instead of group 0."""
        self._begin(index + self.reference_groups)

    def discard(self) -> None:
        """Give up the new reference that is being measured, and keep the former one."""
        self._next = None

    @property
    def measuring(self) -> bool:
        """Whether a tare is being measured."""
        return self._next is not None

    @property
    def started(self) -> bool:
        """Whether the first reference has ended; a tare is possible from then on."""
        return not self._holding

    def completes(self, index: int) -> bool:
        """Whether the reference that is being measured ends before the group of this index."""
        return self.measuring and self._next_stop is not None and index >= self._next_stop

    def process(self, groups: Groups) -> Groups:
        """Replace ``ends`` by ``changes``; groups are held back until the reference is complete."""
        ready: list[Groups] = []
        while len(groups):
            part = groups if self._next is None else self._measured(self._next, groups[:1])
            if self._settled(part):
                ready.append(self._compare(part, np.zeros((len(part), self._ends), bool)))
            else:
                part = part[:1]
                ready.append(self._learn(part))
            if len(part) == len(groups):
                break
            groups = groups[len(part) :]
        return Groups.concatenate(ready)

    def flush(self) -> Groups:
        """Give the groups held back, compared with the part of the reference received so far."""
        held, self._held = Groups.concatenate(self._held), []
        if not len(held):
            return held
        self._holding = False
        return self._compare(held, held.in_reference)

    def _settled(self, groups: Groups) -> bool:
        """Whether the reference is complete and not changed by these groups."""
        return (
            not (self._holding or self._against_previous or self._begins)
            and self._reference.complete
            and self._stop is not None
            and groups.index.tolist()[0] >= max(self._stop.tolist())
        )

    def _measured(self, new: ReferenceMean, group: Groups) -> Groups:
        """A single group while a new reference is measured: a part of it, or the first behind."""
        index = int(group.index[0])
        if self.completes(index):
            self._adopt(new, index)
            return group
        if self._next_stop is None:
            self._next_stop = index + self.reference_groups
        new.add(group, _received(group))
        return group.having(in_tare=np.ones(1, bool))

    def _adopt(self, new: ReferenceMean, index: int) -> None:
        """Replace the reference of all ends that the new one holds, from group ``index`` on."""
        self._next = None
        former = self._reference.mean
        received = self._reference.replace(new)
        if not received.any():
            return
        power = np.sum(np.abs(former) ** 2, axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            step = np.sum(self._reference.mean * former.conj(), axis=1) / power
        self._step_of_reference = np.where(received, step, 1.0)
        self._late &= ~received
        if self._stop is not None:
            self._stop = np.where(received, np.minimum(self._stop, index), self._stop)
        self._begins = True
        if self._profile is not None:
            self._profile.reset()

    def _learn(self, group: Groups) -> Groups:
        """Process a single group that may be part of the reference."""
        step = self._step_of_reference if self._begins else self._no_step
        group = group.having(new_reference=np.array([self._begins]), reference_step=step[None])
        self._begins = False
        index, received = int(group.index[0]), _received(group)
        stop = self._reference_end(index, received)
        if self._against_previous:
            return self._step(group, received)
        learning = received & (index < stop)
        self._reference.add(group, learning)
        self._held.append(group.having(in_reference=learning[None]))
        complete = np.all((self._reference.precision > 0) & (index + 1 >= stop))
        if self._holding and not complete and len(self._held) < 2 * self.reference_groups:
            return group[:0]
        return self.flush()

    def _reference_end(self, index: int, received: Array) -> Array:
        """First group after each end's reference; ends received later get a later reference."""
        stop = self._stop
        if stop is None:
            stop = np.full(self._ends, index + self.reference_groups)
        late = received & (self._reference.precision == 0) & (index >= stop)
        self._late |= late
        self._stop = np.where(late, index + self.reference_groups, stop)
        return self._stop

    def _step(self, group: Groups, received: Array) -> Groups:
        """Compare a group with the previous one, and keep it for the next."""
        former = self._reference
        first = former.precision == 0
        reference = np.where(first[:, None], group.ends[0], former.mean)
        reference_gain = np.where(first, group.gain[0], former.gain)
        last = ReferenceMean(self._ends)
        last.add(group.having(noise_rise=None), received)
        # Here the noise of the reference is another one in each group.
        both = group.having(gain=group.gain + np.where(first, 0, reference_gain))
        former.replace(last)
        return self._difference(both, (first & received)[None], reference, reference_gain)

    def _compare(self, groups: Groups, in_reference: Array) -> Groups:
        groups = self._with_noise_of_reference(groups)
        return self._difference(groups, in_reference, self._reference.mean, self._reference.gain)

    def _with_noise_of_reference(self, groups: Groups) -> Groups:
        """Groups with more noise where interference raised that of the whole reference."""
        excess = self._reference.excess
        if groups.noise_rise is None or excess is None:
            return groups
        with np.errstate(divide="ignore", invalid="ignore"):
            share = 1 / (groups.gain * self._reference.precision)
        share = np.where(np.isfinite(share), share, 0)
        more = np.einsum("ge,ek->gk", share, excess) / self._ends
        return groups.having(noise=groups.noise * (1 + more / groups.noise_rise))

    def _difference(
        self, groups: Groups, in_reference: Array, reference: Array, reference_gain: Array
    ) -> Groups:
        count = len(groups)
        check = None if self._profile is None else self._profile.by(reference)
        arrays = conjugate_difference(
            groups.ends,
            groups.gain,
            groups.noise,
            groups.noise_rise,
            reference,
            reference_gain,
            check,
        )
        restarts, steps = groups.new_reference, groups.reference_step
        if restarts is None:
            restarts = np.zeros(count, bool)
            steps = self._no_step[None].repeat(count, axis=0)
        return groups.having(
            ends=None,
            new_reference=restarts,
            reference_step=steps,
            in_reference=in_reference,
            late_reference=self._late[None].repeat(count, axis=0),
            **arrays,
        )


def _received(group: Groups) -> Array:
    """Which ends (2S,) of a single group were received."""
    received = np.isfinite(group.gain[0])
    if group.locked is not None:
        # While a tag is silent its ends are still solved for, and are noise.
        received &= np.repeat(group.locked[0], 2)
    return received


class SubcarrierAverage:
    """R_i = sum_k w_k X_i,k with w_k = 1 / sigma_k^2, and std(arg R) = sqrt(var(R) / 2) / |R|.

    var(R) = g (1 + g_ref K / E) / E with E = sum_k |V_ref|^2 / sigma_k^2. The noise of the
    reference is an error of the untouched phases, which the press filter knows.
    """

    def process(self, groups: Groups) -> Groups:
        """Replace ``changes`` by ``ratios`` and ``phase_std_deg``, infinite without reference."""
        if not len(groups):
            return groups
        # Noise of a group that is not finite, or none, leaves no ratio.
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            weights = 1 / groups.noise
            precision = weights.sum(axis=1, keepdims=True)
            ratios = np.einsum("gek,gk->ge", groups.changes, weights) / precision
            energy = groups.reference_power * precision
            rise = 1 + groups.reference_gain * (weights.shape[1] / energy)
            # Half of the noise lies along the phase.
            std = np.degrees(np.sqrt(groups.gain * rise / energy / 2)) / np.abs(ratios)
        std[~((energy > 0) & (np.abs(ratios) > 0))] = np.inf
        return groups.having(changes=None, ratios=ratios, phase_std_deg=std)
