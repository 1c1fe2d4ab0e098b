# SPDX-License-Identifier: GPL-3.0-or-later
"""What an end's channel is compared with: the untouched sensor, or the group before."""

from dataclasses import replace

import numpy as np

from ..errors import InputError

# Part of an end's energy, beside so many times its noise, that may differ from the reference's
# course over the subcarriers.
_ALIKE, _NOTABLE = 0.2, 3.0


def subcarrier_weights(noise):
    """Maximum-ratio weights w_k = 1 / sigma_k^2, scaled to sum to 1; shape (K,)."""
    weights = 1 / np.asarray(noise, float)
    return weights / weights.sum()


class ConjugateDifference:
    """V conj(V_ref) of every end, scaled so that the weighted subcarrier average is R.

    R_i = sum_k w_k V_i conj(V_ref,i) / sum_k w_k |V_ref,i|^2. The paper (section 3.3) takes the
    group before for V_ref; here that is a setting, and the untouched sensor the default.

    Parameters
    ----------
    ends : int
    bins : ndarray of int
        Occupied FFT bins.
    reference_groups : int
        Length of the untouched reference from group 0 on, at least 1. Groups that are absent or
        given up are not made good by later ones, in which the sensor may be touched. An end of
        which there is none takes the first groups in which it comes, and they are marked late:
        nothing in them tells an untouched sensor from one that is pressed steadily.
    against : str
        ``untouched`` or ``previous``.

    Raises
    ------
    InputError
        For another word or fewer than one reference group.
    """

    def __init__(self, ends, bins, reference_groups, against="untouched"):
        if against not in ("untouched", "previous"):
            raise InputError("against", "must be 'untouched' or 'previous'", against)
        if reference_groups < 1:
            raise InputError("reference_groups", "must be at least 1", reference_groups)
        self.bins = np.asarray(bins)
        self.reference_groups = reference_groups
        self.previous_mode = against == "previous"
        self._ends = ends
        self._holding = not self.previous_mode
        self._held = []
        self.tare()
        self._stop = np.full(ends, reference_groups)

    def tare(self):
        """Takes the untouched reference anew from the groups that follow."""
        self._sum = np.zeros((self._ends, len(self.bins)), complex)
        self._precision = np.zeros(self._ends)
        self._late = np.zeros(self._ends, bool)
        self._stop = None
        self._begins = True

    def process(self, state, vectors):
        """Takes one group of vectors (2S, 64); gives the groups that are ready.

        At the start groups are held back until the reference is complete, at most twice its
        length, so that every group is compared with the whole of it.

        Returns
        -------
        list of (GroupState, ndarray of complex, shape (2S, 64))
        """
        values = np.asarray(vectors)[:, self.bins]
        state = replace(state, new_reference=self._begins)
        self._begins = False
        if self.previous_mode:
            return [self._against_previous(state, values)]
        self._held.append((state, values, self._learn(state, values)))
        complete = np.all((self._precision > 0) & (state.group + 1 >= self._stop))
        if self._holding and not complete and len(self._held) < 2 * self.reference_groups:
            return []
        return self.flush()

    def flush(self):
        """Gives the groups held back, against the reference as far as it has come."""
        held, self._held, self._holding = self._held, [], False
        with np.errstate(divide="ignore", invalid="ignore"):
            gain = 1 / self._precision
            reference = np.where(self._precision > 0, self._sum.T * gain, 0).T
        return [self._difference(*item, reference, gain) for item in held]

    def _learn(self, state, values):
        there = self._arrived(state)
        learning = there & (state.group < self._stop)
        self._sum[learning] += values[learning] / state.gain[learning, None]
        self._precision[learning] += 1 / state.gain[learning]
        return learning

    def _arrived(self, state):
        """Ends that are there; those that come after the time of their reference get another."""
        there = np.isfinite(state.gain)
        if self._stop is None:
            self._stop = np.full(self._ends, state.group + self.reference_groups)
        late = there & (self._precision == 0) & (state.group >= self._stop)
        self._late |= late
        self._stop = np.where(late, state.group + self.reference_groups, self._stop)
        return there

    def _against_previous(self, state, values):
        there = self._arrived(state)
        first = self._precision == 0
        reference = np.where(first[:, None], values, self._sum)
        gain = np.where(first, state.gain, 1 / np.where(first, 1, self._precision))
        self._sum = np.where(there[:, None], values, self._sum)
        self._precision = np.where(there, 1 / state.gain, self._precision)
        return self._difference(state, values, first & there, reference, gain)

    def _difference(self, state, values, in_reference, reference, reference_gain):
        weights = subcarrier_weights(state.noise)
        power = np.abs(reference) ** 2 @ weights
        # Noise in the reference adds to its power and would make |R| come out small.
        noise = np.where(np.isfinite(reference_gain), reference_gain, 0) * (weights @ state.noise)
        power = np.where(self._precision > 0, np.maximum(power - noise, 0.05 * power), 0.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            products = values * reference.conj() / power[:, None]
        vectors = np.zeros((self._ends, 64), complex)
        vectors[:, self.bins] = np.where(power[:, None] > 0, products, 0)
        state = replace(
            state,
            in_reference=in_reference,
            late_reference=self._late.copy(),
            reshaped=self._reshaped(state, values, vectors, power, weights),
            reference_power=power,
            reference_gain=reference_gain,
        )
        return state, vectors

    def _reshaped(self, state, values, vectors, power, weights):
        """Ends whose channel runs differently over the subcarriers than the reference does.

        A press turns all subcarriers alike. What else it takes, V - R V_ref, is noise, unless the
        tag was moved or frames are no longer where they were.
        """
        energy = np.abs(values) ** 2 @ weights
        alike = np.abs(vectors[:, self.bins] @ weights) ** 2 * power
        noise = np.where(np.isfinite(state.gain), state.gain, 0) * (weights @ state.noise)
        return energy - alike > _ALIKE * energy + _NOTABLE * noise
