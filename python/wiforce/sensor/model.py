# SPDX-License-Identifier: GPL-3.0-or-later
"""What every sensor model can do, whatever stands behind its phases."""

from dataclasses import dataclass, field

import numpy as np

from ..angles import wrap_deg
from ..errors import InputError
from . import line

# A carrier given within this fraction of a calibrated one is taken for it: 0.1 % changes 2 beta L
# of an 80 mm line by 0.2 deg at 900 MHz.
CARRIER_TOLERANCE = 1e-3


@dataclass(frozen=True)
class SensorModel:
    """A sensor: force and location to the phases of its two ends.

    Subclasses give ``_short_deg`` (phases of the pressed line, not wrapped), ``_model_std_deg``
    (one sigma of what calibration left open) and ``_untouched_deg``.

    Attributes
    ----------
    name : str
    length_mm : float
    frequencies_hz : tuple of float
        Carriers the model holds.
    onset_force_n : float
        Force at which the line is first shorted; below it the sensor shows its untouched phases.
    force_span_n, location_span_mm : (float, float)
        What the calibration covers. A reading outside is flagged ``extrapolated``.
    provenance : dict
        ``source``, ``date``, ``assumed`` (list of str).
    """

    name: str
    length_mm: float
    frequencies_hz: tuple
    onset_force_n: float
    force_span_n: tuple
    location_span_mm: tuple
    provenance: dict = field(default_factory=dict, compare=False)

    def carrier_index(self, frequency_hz=None):
        """Index of a carrier; ``None`` stands for the only one.

        Raises
        ------
        InputError
            For a carrier the model does not hold, or None where it holds several.
        """
        if frequency_hz is None:
            if len(self.frequencies_hz) > 1:
                raise InputError(
                    self.name, f"holds several carriers, frequency_hz must be one of {self._held()}"
                )
            return 0
        held = np.asarray(self.frequencies_hz)
        near = int(np.argmin(np.abs(held - frequency_hz)))
        if not abs(held[near] - frequency_hz) <= CARRIER_TOLERANCE * held[near]:
            raise InputError(
                self.name, f"carrier must be within 0.1 % of {self._held()}", frequency_hz
            )
        return near

    def _held(self):
        return " or ".join(f"{f / 1e6:g} MHz" for f in self.frequencies_hz)

    def untouched_deg(self, frequency_hz=None):
        """(psi_1, psi_2) of the untouched sensor, in (-180, 180]."""
        psi = wrap_deg(self._untouched_deg(self.carrier_index(frequency_hz)))
        return float(psi[0]), float(psi[1])

    def phases_deg(self, force_n, location_mm, frequency_hz=None):
        """psi_1, psi_2 for forces and locations, in (-180, 180].

        Parameters
        ----------
        force_n, location_mm : array_like
            Broadcast against each other. Below ``onset_force_n`` the sensor is untouched.

        Returns
        -------
        ndarray, shape (..., 2)
        """
        carrier = self.carrier_index(frequency_hz)
        force, location = np.broadcast_arrays(
            np.asarray(force_n, float), np.asarray(location_mm, float)
        )
        pressed = self._short_deg(np.maximum(force, self.onset_force_n), location, carrier)
        touched = (force >= self.onset_force_n)[..., None]
        return wrap_deg(np.where(touched, pressed, self._untouched_deg(carrier)))


@dataclass(frozen=True)
class LineModel(SensorModel):
    """A sensor evaluated by physics: a line, a contact law, a constant per port.

    Attributes
    ----------
    contact : line.ContactLaw
    permittivity : float
        Effective relative permittivity of the line.
    port_offset_deg : (float, float)
    """

    contact: line.ContactLaw = None
    permittivity: float = 1.0
    port_offset_deg: tuple = (0.0, 0.0)

    def _untouched_deg(self, carrier):
        psi = line.open_phase_deg(self.length_mm, self.frequencies_hz[carrier], self.permittivity)
        return psi + np.asarray(self.port_offset_deg)

    def _short_deg(self, force, location, carrier):
        distance = line.shorting_points_mm(self.contact, force, location, self.length_mm)
        psi = line.short_phase_deg(distance, self.frequencies_hz[carrier], self.permittivity)
        return psi + np.asarray(self.port_offset_deg)

    def _model_std_deg(self, force, location, carrier):
        return np.zeros((*np.shape(force), 2))
