# SPDX-License-Identifier: GPL-3.0-or-later
"""What every sensor model can do, whatever stands behind its phases."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from ..errors import InputError
from ..io.text.schema import Derived, Mapping, declared, key, plain
from ..io.text.values import (
    LARGEST,
    Choice,
    Date,
    KeyPath,
    Number,
    Scope,
    Text,
    Texts,
)
from ..io.text.values import Array as Numbers
from ..signal.carrier import CARRIER_TOLERANCE, same_carrier, wrap_deg
from . import line
from .line import LEAST, LEAST_FREQUENCY_HZ, MAX_FORCE_N, MAX_LENGTH_MM, MAX_PERMITTIVITY
from .splines import Array

if TYPE_CHECKING:
    from .inversion import Inversion, Inverter
    from .tracker import PressTracker

# Standard deviations within which phases may be those of another state.
_SIGMAS = 3.0
_LEAST_CARRIER_HZ = 1e6  # anything lower was meant in another unit
# A model is not transferred further than this fraction of its carrier: the phase of a cable or
# connector is known modulo 360 deg only, so further away nothing about it is known.
MAX_TRANSFER = 0.1


def check_onset(where: object, onset_n: float, highest_n: float) -> None:
    """Refuse an onset unless the line is shorted within the calibrated forces."""
    if onset_n >= highest_n:
        rule = f"must be below the highest calibrated force, {highest_n:g}"
        raise InputError(where, rule, onset_n)


@declared
class Provenance:
    """Where a sensor model comes from."""

    source: str = key(Text(limit=2000), doc="The data that the model was made from.")
    date: str = key(Date(), doc="When it was made.")
    assumed: list[str] = key(
        Texts(),
        derived=Derived("an empty list", lambda scope: []),
        doc="What was assumed because the data did not contain it.",
    )
    suspicions: list[str] = key(
        Texts(),
        derived=Derived("an empty list", lambda scope: []),
        doc="Likely mistakes in the data that whoever calibrated has accepted; `plan` and `read` "
        "repeat them.",
    )


class _ProvenanceMapping(Mapping):
    """A provenance as a dictionary, with ``suspicions`` only where there are some."""

    def _read(self, value: Any, where: KeyPath, scope: Scope) -> dict[str, Any]:
        found = plain(Provenance, super()._read(value, where, scope))
        return {name: each for name, each in found.items() if each or name != "suspicions"}

    def plain(self, value: Any) -> dict[str, Any]:
        return dict(value)


def _check_location_span(span: tuple[float, float], scope: Scope) -> str | None:
    if span[0] < span[1] <= scope["length_mm"]:
        return None
    return f"must be two rising numbers from 0 to {scope['length_mm']:g}"


@declared
class SensorModel:
    """A sensor: force and location to the phases of its two ends; what its file holds.

    Subclasses give ``short_deg`` (phases of the pressed line, not wrapped), ``_model_std_deg``
    (one sigma of what calibration left open), ``_untouched_deg`` and ``_scaled`` (what changes at
    another carrier). ``frequencies_hz`` are the carriers that the model holds.

    Examples
    --------
    >>> from gnuradio.wiforce.sensor import load_sensor
    >>> load_sensor("line-900mhz").phases_deg(4.0, 40.0).round(1).tolist()
    [106.6, 106.6]
    """

    name: str = key(Text(), doc="Name of the sensor.")
    kind: str = key(
        Choice(words=("line", "curves")),
        doc="`line`: a physical model. `curves`: calibrated curves.",
    )
    length_mm: float = key(
        Number(unit="mm", low=0, above=True, high=MAX_LENGTH_MM), doc="Length of the line."
    )
    onset_force_n: float = key(
        Number(unit="N", low=LEAST, high=MAX_FORCE_N),
        doc="Force at which the line is first shorted, below the highest calibrated force.",
    )
    force_span_n: tuple[float, float] = key(
        Numbers(shape=(2,), unit="N", low=0, high=MAX_FORCE_N, as_tuple=True),
        check=lambda span, _: None if span[0] < span[1] else "must be two rising numbers",
        doc="Lowest and highest calibrated force. Readings outside are flagged `extrapolated`.",
    )
    location_span_mm: tuple[float, float] = key(
        Numbers(shape=(2,), unit="mm", low=0, high=MAX_LENGTH_MM, as_tuple=True),
        check=_check_location_span,
        doc="First and last calibrated location, from port 1.",
    )
    permittivity: float = key(
        Number(low=1, high=MAX_PERMITTIVITY),
        doc="Effective relative permittivity of the line; 1 for a line in air.",
    )
    provenance: dict[str, Any] = key(
        _ProvenanceMapping(of=Provenance),
        doc="`source`, `date` and, as lists of str, `assumed` and `suspicions`.",
        compare=False,
    )
    transferred_from_hz: float | None = key(
        Number(unit="Hz", low=LEAST_FREQUENCY_HZ, high=LARGEST, optional=True),
        doc="Carrier of the calibration, where `gr-wiforce transfer` made the file.",
    )
    transfer_std_deg: float | None = key(
        Number(unit="deg", low=0, high=180, optional=True),
        doc="Standard deviation of each phase that the transfer adds.",
    )
    ruler_std_mm: float | None = key(
        Number(unit="mm", low=0, high=MAX_LENGTH_MM, optional=True),
        doc="Standard deviation of the calibrated locations; enters that of every location read.",
    )

    @cached_property
    def frequencies_hz(self) -> tuple[float, ...]:
        """Carriers that the model holds."""
        raise NotImplementedError

    def carrier_index(self, frequency_hz: float | None = None) -> int:
        """Index of a carrier that the model must hold; ``None`` stands for the only one."""
        if frequency_hz is None:
            if len(self.frequencies_hz) > 1:
                raise InputError(
                    self.name, f"holds several carriers, frequency_hz must be one of {self._held()}"
                )
            return 0
        held = np.asarray(self.frequencies_hz)
        near = int(np.argmin(np.abs(held - frequency_hz)))
        if not same_carrier(frequency_hz, held[near]):
            raise self.carrier_error(frequency_hz, CARRIER_TOLERANCE)
        return near

    def carrier_error(self, frequency_hz: float, within: float = MAX_TRANSFER) -> InputError:
        """The error to raise for a carrier that is too far from those the model holds."""
        rule = f"carrier must be within {100 * within:g} % of {self._held()}"
        hint = "; give Hz, as 915e6" if frequency_hz < _LEAST_CARRIER_HZ else ""
        return InputError(self.name, f"{rule}, got {frequency_hz / 1e6:g} MHz{hint}")

    def at_carrier(self, frequency_hz: float) -> SensorModel:
        """The model at a carrier at most 10 % from its own: itself, or transferred and kept."""
        if any(same_carrier(frequency_hz, held_hz) for held_hz in self.frequencies_hz):
            return self
        if frequency_hz not in self._transferred:
            self._transferred[frequency_hz] = self.transferred(frequency_hz)
        return self._transferred[frequency_hz]

    def transferred(self, frequency_hz: float, name: str | None = None) -> SensorModel:
        """The model at another carrier only, its phases scaled from the nearest one, at most 10 %
        away.

        A calibrated one states the uncertainty, a ``line`` model is evaluated there.
        """
        held = np.asarray(self.frequencies_hz, float)
        nearest = int(np.argmin(np.abs(held - frequency_hz)))
        from_hz = float(held[nearest])
        if not abs(frequency_hz - from_hz) <= MAX_TRANSFER * from_hz:
            raise self.carrier_error(frequency_hz)
        assumed = (
            f"phases at {frequency_hz / 1e6:g} MHz are those at {from_hz / 1e6:g} MHz times "
            f"{frequency_hz / from_hz:.6g}: the contact touches the line at the same millimetres"
        )
        known = self.provenance.get("assumed", ())
        return replace(
            self,
            name=name or self.name,
            provenance=self.provenance | {"assumed": [*known, assumed]},
            **self._scaled(nearest, float(frequency_hz)),
        )

    def _held(self) -> str:
        return " or ".join(f"{f / 1e6:g} MHz" for f in self.frequencies_hz)

    @property
    def calibrated(self) -> tuple[Array, Array, Array]:
        """Locations (n,), rising, and least and highest calibrated force there, linear between."""
        low, high = (np.full(2, force) for force in self.force_span_n)
        return np.array(self.location_span_mm, float), low, high

    def in_span(self, force_n: ArrayLike, location_mm: ArrayLike) -> Array:
        """Whether force and location lie within what was calibrated; broadcast, bool."""
        force, location = np.asarray(force_n, float), np.asarray(location_mm, float)
        places, low, high = self.calibrated
        inside = (location >= places[0]) & (location <= places[-1])
        above = force >= np.interp(location, places, low)
        return inside & above & (force <= np.interp(location, places, high))

    def model_std_deg(
        self, force_n: ArrayLike, location_mm: ArrayLike, frequency_hz: float | None = None
    ) -> Array:
        """One sigma of what calibration and transfer left open in psi_1, psi_2; (..., 2)."""
        carrier = self.carrier_index(frequency_hz)
        force, location = np.broadcast_arrays(
            np.asarray(force_n, float), np.asarray(location_mm, float)
        )
        return self.carrier_std_deg(np.maximum(force, self.onset_force_n), location, carrier)

    def carrier_std_deg(self, force: Array, location: Array, carrier: int) -> Array:
        """As :meth:`model_std_deg`, for forces above the onset and a carrier's index."""
        calibrated = self._model_std_deg(force, location, carrier)
        return np.hypot(calibrated, self.transfer_std_deg or 0.0)

    def untouched_deg(self, frequency_hz: float | None = None) -> tuple[float, float]:
        """(psi_1, psi_2) of the untouched sensor, in (-180, 180]."""
        psi = wrap_deg(self._untouched_deg(self.carrier_index(frequency_hz)))
        return float(psi[0]), float(psi[1])

    def phases_deg(
        self, force_n: ArrayLike, location_mm: ArrayLike, frequency_hz: float | None = None
    ) -> Array:
        """psi_1, psi_2 for forces and locations, in (-180, 180].

        Parameters
        ----------
        force_n, location_mm : array_like
            Broadcast against each other. Below ``onset_force_n`` the sensor is untouched.

        Returns
        -------
        ndarray, shape (..., 2)
            NaN where the force is.
        """
        carrier = self.carrier_index(frequency_hz)
        # Not broadcast before: what depends on one of them is computed once for each of it.
        force, location = np.asarray(force_n, float), np.asarray(location_mm, float)
        pressed = self.short_deg(np.maximum(force, self.onset_force_n), location, carrier)
        untouched = (force < self.onset_force_n)[..., None]
        return wrap_deg(np.where(untouched, self._untouched_deg(carrier), pressed))

    def invert(
        self,
        phases_deg: ArrayLike,
        std_deg: ArrayLike | None = None,
        location_mm: ArrayLike | None = None,
        frequency_hz: float | None = None,
    ) -> Inversion:
        """Inverts the phases of touched readings to force and location.

        Parameters
        ----------
        phases_deg : array_like, shape (n, 2) or (n, 2 C)
            psi_1, psi_2, modulo 360; of all C carriers one after the other where the model holds
            several and ``frequency_hz`` is not given.
        std_deg : array_like, optional
            Standard deviation of each phase's noise; broadcast. 1 deg by default.
        location_mm : array_like, optional
            Location, where it is known, NaN elsewhere; broadcast over n.
        frequency_hz : float, optional
            Carrier at which the phases were measured.

        Returns
        -------
        Inversion

        Raises
        ------
        InputError
            For a wrong shape, a negative standard deviation or a location outside the model.

        Notes
        -----
        One call for many readings costs much less than a call for each; values are the same.
        docs/sensors.md describes the estimator.

        Examples
        --------
        >>> from gnuradio.wiforce.sensor import load_sensor
        >>> sensor = load_sensor("line-900mhz-calibrated")
        >>> found = sensor.invert(sensor.phases_deg([3.0, 5.0], [30.0, 45.0]), std_deg=0.2)
        >>> found.force_n.round(2), found.location_mm.round(2), found.flags
        (array([3., 5.]), array([30., 45.]), [(), ()])
        """
        return self.inverter(frequency_hz).invert(phases_deg, std_deg, location_mm)

    def inverter(self, frequency_hz: float | None = None) -> Inverter:
        """The :class:`~.inversion.Inverter` at one carrier, or at all together; kept for reuse."""
        found = self._inverters.get(frequency_hz)
        if found is None:
            from .inversion import Inverter

            if frequency_hz is None:
                carriers = tuple(range(len(self.frequencies_hz)))
            else:
                carriers = (self.carrier_index(frequency_hz),)
            found = self._inverters.get(carriers) or Inverter(self, carriers)
            self._inverters[carriers] = self._inverters[frequency_hz] = found
        return found

    def short_deg(self, force: Array, location: Array, carrier: int) -> Array:
        """Phases of the pressed line, deg, not wrapped; (..., 2)."""
        raise NotImplementedError

    def _untouched_deg(self, carrier: int) -> Array:
        raise NotImplementedError

    def _model_std_deg(self, force: Array, location: Array, carrier: int) -> Array:
        raise NotImplementedError

    def _scaled(self, index: int, frequency_hz: float) -> dict[str, Any]:
        raise NotImplementedError

    def noise_deg(self, frequency_hz: float | None = None) -> tuple[float, ...]:
        """Scatter of the calibrated phases of both ends; none without a calibration."""
        self.carrier_index(frequency_hz)
        return (0.0, 0.0)

    def tracker(self, group_period_s: float, frequency_hz: float | None = None) -> PressTracker:
        """A :class:`~.tracker.PressTracker` of this sensor."""
        from .tracker import PressTracker

        return PressTracker(self, group_period_s, frequency_hz)

    @cached_property
    def _inverters(self) -> dict[Any, Inverter]:
        return {}

    @cached_property
    def newest(self) -> dict[str, Any]:
        """What was last made of the sensor elsewhere and takes long, for reuse."""
        return {}

    @cached_property
    def _transferred(self) -> dict[float, SensorModel]:
        return {}


@declared
class LineModel(SensorModel):
    """A sensor by physics: a line and its permittivity, a contact law, a constant per port."""

    kind: str = key(Choice(words=("line",)), default="line", doc="A physical model.")
    frequencies_hz: tuple[float, ...] = key(
        Numbers(shape=(None,), unit="Hz", low=LEAST_FREQUENCY_HZ, as_tuple=True),
        doc="Carriers that the model holds.",
    )
    port_offset_deg: tuple[float, float] = key(
        Numbers(shape=(2,), unit="deg", as_tuple=True), doc="Constant phase per port."
    )
    contact: line.ContactLaw = key(
        Mapping(of=line.ContactLaw), doc="How the beam touches the line."
    )

    def _untouched_deg(self, carrier: int) -> Array:
        psi = line.open_phase_deg(self.length_mm, self.frequencies_hz[carrier], self.permittivity)
        return psi + np.array(self.port_offset_deg)

    def short_deg(self, force: Array, location: Array, carrier: int) -> Array:
        distance = self.contact.shorting_points_mm(
            force, location, self.length_mm, self.onset_force_n
        )
        psi = line.short_phase_deg(distance, self.frequencies_hz[carrier], self.permittivity)
        return psi + np.asarray(self.port_offset_deg)

    def _model_std_deg(self, force: Array, location: Array, carrier: int) -> Array:
        return np.zeros((*np.shape(force), 2))

    def _scaled(self, index: int, frequency_hz: float) -> dict[str, Any]:
        """Fields that change at another carrier."""
        ratio = frequency_hz / self.frequencies_hz[index]
        offsets = tuple(ratio * offset for offset in self.port_offset_deg)
        return {"frequencies_hz": (frequency_hz,), "port_offset_deg": offsets}


# Presses that a reading is compared with: finer steps than the 20 deg that separate neighbours
# change nothing where standard deviations are large enough for the question to arise.
_FORCES, _LOCATIONS = 12, 41


def touch_of(
    model: SensorModel,
    phases_deg: np.ndarray,
    std_deg: float,
    frequency_hz: float | None = None,
) -> np.ndarray:
    """Touched (1), untouched (0) or either (-1) phases (n, 2), within three standard deviations."""
    phases = np.asarray(phases_deg, float)
    untouched = np.array(model.untouched_deg(frequency_hz))
    away = np.abs(wrap_deg(phases - untouched))
    touch = np.where(np.all(away <= _SIGMAS * std_deg, axis=-1), 0, 1)
    # Presses all over the line, up to the highest calibrated force.
    forces = np.geomspace(model.onset_force_n, model.force_span_n[1], _FORCES)
    places = np.linspace(*model.location_span_mm, _LOCATIONS)
    pressed = model.phases_deg(forces[:, None], places, frequency_hz).reshape(-1, 2)
    if np.max(np.abs(wrap_deg(pressed - untouched)), axis=1).min() > 2 * _SIGMAS * std_deg:
        return touch
    for row in np.flatnonzero(touch == 0):
        away = np.max(np.abs(wrap_deg(pressed - phases[row])), axis=1)
        if away.min() <= _SIGMAS * std_deg:
            touch[row] = -1
    return touch
