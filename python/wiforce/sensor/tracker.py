# SPDX-License-Identifier: GPL-3.0-or-later
"""Presses followed over time: location constant, force a random walk that starts low.

What the model itself errs by stays the same from reading to reading: it is not averaged away, but
added to what is reported.
"""

import numpy as np

from ..errors import InputError
from ..wiforce_kernels import INVERSION_FLAGS
from .filter_bank import FilterBank
from .inversion import misfit_limit, words_of

# Force's random walk, N per root of a second.
FORCE_WALK_N = 4.0
# A press starts this far above the onset, give or take the same.
START_ABOVE_ONSET_N = 1.1

_COARSE_MM = 0.5
# After so many readings in a row that no location explains, the press is taken for a new one.
_LOST_AFTER = 3
_LOST = 0.99999
_TWO_PLACES_MM = 6.0


class PressTracker:
    """Follows one sensor's presses, reading by reading.

    Parameters
    ----------
    model : SensorModel
    group_period_s : float
        Time from one reading to the next.
    frequency_hz : float, optional
        Carrier; all carriers of the model together when not given.
    force_walk_n : float
        Standard deviation of the change of force in one second; it grows with the root of time.
    start_force_n, start_std_n : float, optional
        What is believed of the force at a press's first reading; by default 1.1 N above the onset,
        give or take 1.1 N.

    Raises
    ------
    InputError
    """

    def __init__(
        self,
        model,
        group_period_s,
        frequency_hz=None,
        force_walk_n=FORCE_WALK_N,
        start_force_n=None,
        start_std_n=START_ABOVE_ONSET_N,
    ):
        if start_force_n is None:
            start_force_n = model.onset_force_n + START_ABOVE_ONSET_N
        settings = {
            "group_period_s": group_period_s,
            "force_walk_n": force_walk_n,
            "start_force_n": start_force_n,
            "start_std_n": start_std_n,
        }
        for name, value in settings.items():
            if not (np.isfinite(value) and value > 0):
                raise InputError(name, "must be positive", value)
        self._inverter = model.inverter(frequency_hz)
        self._forward = self._inverter.forward
        self._walk = force_walk_n**2 * group_period_s
        self._start = (start_force_n, start_std_n)
        self._limit = misfit_limit(self._forward.size, 1 - _LOST)
        self._bank, self._lost = None, 0
        self._coarse = _coarse_grid(self._forward)

    def reset(self):
        """Forgets the press."""
        self._bank, self._lost = None, 0

    def update(self, phases_deg, std_deg, touched=True):
        """Takes one reading.

        Parameters
        ----------
        phases_deg, std_deg : array_like, shape (2,), or (2 C,) with C carriers
            Phases, modulo 360, and the standard deviations of their noise.
        touched : bool
            Whether the line is shorted; False ends the press.

        Returns
        -------
        force_n, force_std_n, location_mm, location_std_mm : float
            NaN when not touched.
        flags : tuple of str
            As those of :class:`~.inversion.Inversion`.
        """
        if not touched:
            self.reset()
            return np.nan, np.nan, np.nan, np.nan, ()
        phases, std = self._checked(phases_deg, std_deg)
        if self._bank is None:
            self._bank = FilterBank(self._forward, self._coarse, *self._start)
        else:
            self._bank.walk(self._walk)
        lost = False
        if np.all(np.isfinite(phases)):
            lost = self._bank.update(phases, std) > self._limit
            self._lost = self._lost + 1 if lost else 0
            if self._lost >= _LOST_AFTER:
                # another press has begun, or this one slides
                self._bank, self._lost = FilterBank(self._forward, self._coarse, *self._start), 0
                self._bank.update(phases, std)
            self._bank = self._bank.close_in()
        return self._report(std, lost)

    def _checked(self, phases_deg, std_deg):
        phases = np.asarray(phases_deg, float)
        if phases.shape != (self._forward.size,):
            rule = f"must have shape ({self._forward.size},)"
            raise InputError("phases_deg", rule, phases.shape)
        std = np.broadcast_to(np.asarray(std_deg, float), phases.shape)
        if not (np.all(std >= 0) and np.all(np.isfinite(std))):
            raise InputError("std_deg", "must be finite and not negative", std.tolist())
        return phases, std

    def _report(self, std, lost):
        bank, weight = self._bank, self._bank.weights()
        force = weight @ bank.mean
        variance = weight @ (bank.variance + (bank.mean - force) ** 2)
        place, spread = bank.place()
        systematic = self._inverter.systematic(force, place)
        variance, spread = variance + systematic[0, 0], spread + systematic[1, 1]
        values = (float(force), float(np.sqrt(variance)), float(place), float(np.sqrt(spread)))
        code = self._inverter.code_of(*values, std)
        if lost:
            code |= INVERSION_FLAGS["inconsistent"]
        if _two_places(bank.curves.location_mm, weight):
            code |= INVERSION_FLAGS["ambiguous"]
        return (*values, words_of(code))

    def systematic(self, force_n, location_mm):
        """See :meth:`~.inversion.Inverter.systematic`."""
        return self._inverter.systematic(force_n, location_mm)

    @property
    def walk_variance(self):
        """Variance that the force gains from one reading to the next."""
        return self._walk

    def bank_about_result(self):
        """Fresh filters on a grid about the location that was found."""
        ends = self._forward.location_mm[[0, -1]]
        return FilterBank(self._forward, self._bank.about_place(*ends), *self._start)

    def code_of(self, values, std):
        """Sum of the flags of force, location and their covariance, ``values`` (6,)."""
        force, place, variance, _, _, spread = values.tolist()
        return self._inverter.code_of(force, np.sqrt(variance), place, np.sqrt(spread), std)


def _coarse_grid(forward):
    first, last = forward.location_mm[[0, -1]]
    return np.linspace(first, last, int(np.ceil((last - first) / _COARSE_MM)) + 1)


def _two_places(location, weight):
    """Whether the location may be at two places with little in between."""
    heavy = location[weight > 0.1 * weight.max()]
    return bool(np.max(np.diff(heavy), initial=0.0) > _TWO_PLACES_MM)
