# SPDX-License-Identifier: GPL-3.0-or-later
"""What an end's channel is compared with: the untouched sensor, or the group before."""

from __future__ import annotations

import numpy as np

from ..errors import InputError
from .groups import Array, Groups

# Part of an end's energy, beside so many times its noise, that may differ from the reference's
# course over the subcarriers.
_ALIKE, _NOTABLE = 0.2, 3.0


def subcarrier_weights(noise: Array) -> Array:
    """Maximum-ratio weights w_k = 1 / sigma_k^2, scaled to sum to 1; shape (..., K) as ``noise``.

    Examples
    --------
    >>> subcarrier_weights(np.array([1.0, 3.0])).tolist()
    [0.75, 0.25]
    """
    weights = 1 / np.asarray(noise, float)
    return weights / weights.sum(axis=-1, keepdims=True)


class ConjugateDifference:
    """V conj(V_ref) of every end, scaled so that the weighted subcarrier average is R.

    R_i = sum_k w_k V_i conj(V_ref,i) / sum_k w_k |V_ref,i|^2. The paper (section 3.3) takes the
    group before for V_ref; here that is a setting, and the untouched sensor the default.

    Parameters
    ----------
    ends : int
    reference_groups : int
        Length of the untouched reference from group 0 on, at least 1. Groups of it that are absent
        or discarded are not replaced by later ones, in which the sensor may be touched. An end
        that is in none of them takes the first groups in which it is there, and they are marked
        late: nothing in them tells an untouched sensor from one that is pressed steadily.
    against : str
        ``untouched`` or ``previous``.

    Raises
    ------
    InputError
        For another word or fewer than one reference group.
    """

    def __init__(self, ends: int, reference_groups: int, against: str = "untouched") -> None:
        if against not in ("untouched", "previous"):
            raise InputError("against", "must be 'untouched' or 'previous'", against)
        if reference_groups < 1:
            raise InputError("reference_groups", "must be at least 1", reference_groups)
        self.reference_groups = reference_groups
        self._against_previous = against == "previous"
        self._ends = ends
        self._holding = not self._against_previous
        self._held: list[Groups] = []
        self._sum: Array | None = None
        self.tare()
        self._stop = np.full(ends, reference_groups)

    def tare(self) -> None:
        """Take the untouched reference anew from the groups that follow."""
        self._sum = None
        self._precision = np.zeros(self._ends)
        self._late = np.zeros(self._ends, bool)
        self._stop: Array | None = None
        self._begins = True

    def process(self, groups: Groups) -> Groups:
        """Take a batch; give the groups that are ready.

        At the start groups are held back until the reference is complete, at most twice its
        length, so that every group is compared with the whole of it.

        Returns
        -------
        Groups
            With ``changes`` and what is known of the reference; without ``ends``.
        """
        ready = []
        for row in range(len(groups)):
            rest = groups[row:]
            if self._settled(rest):
                ready.append(self._compare(rest, np.zeros((len(rest), self._ends), bool)))
                break
            ready.append(self._learn(rest[:1]))
        return Groups.concatenate(ready)

    def flush(self) -> Groups:
        """Give the groups held back, against the reference as far as it has come."""
        held, self._held = Groups.concatenate(self._held), []
        if not len(held):
            return held
        self._holding = False
        return self._compare(held, held.in_reference)

    def _settled(self, groups: Groups) -> bool:
        """Whether the reference is complete and these groups change nothing about it."""
        return (
            not self._holding
            and not self._against_previous
            and not self._begins
            and bool(np.all(self._precision > 0))
            and self._stop is not None
            and bool(np.all(groups.index[0] >= self._stop))
        )

    def _learn(self, group: Groups) -> Groups:
        """A single group from which the reference may be learned."""
        assert group.ends is not None and group.gain is not None
        if self._sum is None:
            self._sum = np.zeros(group.ends.shape[1:], complex)
        group = group.having(new_reference=np.array([self._begins]))
        self._begins = False
        index, values, gain = int(group.index[0]), group.ends[0], group.gain[0]
        there = self._arrived(index, gain)
        if self._against_previous:
            return self._step(group, there)
        learning = there & (index < self._stop)
        self._sum[learning] += values[learning] / gain[learning, None]
        self._precision[learning] += 1 / gain[learning]
        self._held.append(group.having(in_reference=learning[None]))
        complete = np.all((self._precision > 0) & (index + 1 >= self._stop))
        if self._holding and not complete and len(self._held) < 2 * self.reference_groups:
            return group[:0]
        return self.flush()

    def _arrived(self, index: int, gain: Array) -> Array:
        """Ends that are there; those that come after the time of their reference get another."""
        there = np.isfinite(gain)
        if self._stop is None:
            self._stop = np.full(self._ends, index + self.reference_groups)
        late = there & (self._precision == 0) & (index >= self._stop)
        self._late |= late
        self._stop = np.where(late, index + self.reference_groups, self._stop)
        return there

    def _step(self, group: Groups, there: Array) -> Groups:
        """Compare a group with the one before, and keep it for the next."""
        assert group.ends is not None and group.gain is not None and self._sum is not None
        values, gain = group.ends[0], group.gain[0]
        first = self._precision == 0
        reference = np.where(first[:, None], values, self._sum)
        reference_gain = np.where(first, gain, 1 / np.where(first, 1, self._precision))
        self._sum = np.where(there[:, None], values, self._sum)
        self._precision = np.where(there, 1 / gain, self._precision)
        return self._difference(group, (first & there)[None], reference, reference_gain)

    def _compare(self, groups: Groups, in_reference: Array | None) -> Groups:
        assert groups.ends is not None and in_reference is not None
        if self._sum is None:  # a tare, and no group since
            self._sum = np.zeros(groups.ends.shape[1:], complex)
        with np.errstate(divide="ignore", invalid="ignore"):
            gain = 1 / self._precision
            reference = np.where(self._precision > 0, self._sum.T * gain, 0).T
        return self._difference(groups, in_reference, reference, gain)

    def _difference(
        self, groups: Groups, in_reference: Array, reference: Array, reference_gain: Array
    ) -> Groups:
        count = len(groups)
        weights = subcarrier_weights(groups.noise)
        # The weighted mean of the noise itself: K over the sum of 1 / sigma_k^2.
        mean_noise = np.sum(weights * groups.noise, axis=1)[:, None]
        power = weights @ (np.abs(reference) ** 2).T
        # Noise in the reference adds to its power and would make |R| come out small.
        noise = np.where(np.isfinite(reference_gain), reference_gain, 0) * mean_noise
        power = np.where(self._precision > 0, np.maximum(power - noise, 0.05 * power), 0.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            changes = groups.ends * (reference.conj() / power[:, :, None])
        changes = np.where(power[:, :, None] > 0, changes, 0)
        # A press turns all subcarriers alike. What else it takes, V - R V_ref, is noise, unless
        # the tag was moved or frames are no longer where they were.
        energy = np.einsum("gek,gk->ge", groups.ends.real**2 + groups.ends.imag**2, weights)
        alike = np.abs(np.einsum("gek,gk->ge", changes, weights)) ** 2 * power
        own_noise = np.where(np.isfinite(groups.gain), groups.gain, 0) * mean_noise
        return groups.having(
            ends=None,
            changes=changes,
            new_reference=groups.new_reference
            if groups.new_reference is not None
            else np.zeros(count, bool),
            in_reference=in_reference,
            late_reference=np.tile(self._late, (count, 1)),
            reshaped=energy - alike > _ALIKE * energy + _NOTABLE * own_noise,
            reference_power=power,
            reference_gain=np.tile(reference_gain, (count, 1)),
        )
