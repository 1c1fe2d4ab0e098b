# SPDX-License-Identifier: GPL-3.0-or-later
"""What a calibration is good for, in a sentence."""

from dataclasses import dataclass

import numpy as np

from . import line
from .curves import CurveModel

_FORCES, _LOCATIONS = 5, 9
_QUIET_DEG = 1e-3  # phases without noise of their own
_LIMITS = {
    "noise": "the noise of the phases in the table",
    "locations": "the distance between the calibrated locations",
    "form": "curves that do not follow the data",
    "hysteresis": "hysteresis between loading and unloading",
    "ruler": "the accuracy of the ruler",
    "transfer": "the transfer from another carrier",
}


@dataclass(frozen=True)
class Verdict:
    """Errors that a calibration leaves when the phases have no noise.

    Attributes
    ----------
    frequency_hz : float
        Carrier.
    force_std_n, location_std_mm : float
        Standard deviations: medians over the calibrated span.
    force_span_n, location_span_mm : tuple of float
    limit : str
        Their largest cause.
    flagged : float
        Share of the span in which readings are flagged.
    """

    frequency_hz: float
    force_std_n: float
    location_std_mm: float
    force_span_n: tuple[float, float]
    location_span_mm: tuple[float, float]
    limit: str
    flagged: float

    def __str__(self) -> str:
        low, high = self.location_span_mm
        text = (
            f"{self.force_std_n:.2g} N and {self.location_std_mm:.2g} mm between {low:g} and "
            f"{high:g} mm, {self.force_span_n[0]:.3g} to {self.force_span_n[1]:.3g} N; limited by "
            f"{self.limit}"
        )
        return text + (f"; {self.flagged:.0%} of this span is flagged" if self.flagged else "")


def verdict(model: CurveModel) -> list[Verdict]:
    """The errors of each carrier of a calibrated model, and what limits them."""
    return [_of_carrier(model, index) for index in range(len(model.carriers))]


def _of_carrier(model: CurveModel, index: int) -> Verdict:
    frequency_hz = model.carriers[index].frequency_hz
    force, location = (
        grid.ravel()
        for grid in np.meshgrid(
            np.linspace(model.force_span_n[0], model.force_span_n[1], _FORCES),
            np.linspace(model.location_span_mm[0], model.location_span_mm[1], _LOCATIONS),
        )
    )
    phases = model.phases_deg(force, location, frequency_hz)
    found = model.invert(phases, _QUIET_DEG, frequency_hz=frequency_hz)
    known = np.isfinite(found.force_std_n) & np.isfinite(found.location_std_mm)
    clear = known & np.array([not flags for flags in found.flags])
    used = clear if clear.any() else known
    parts = model.variance_parts_deg2(np.maximum(force, model.onset_force_n), location, index)
    per_mm = line.round_trip_deg_per_mm(frequency_hz, model.permittivity)
    parts["ruler"] = np.square((model.ruler_std_mm or 0.0) * per_mm)
    parts["transfer"] = np.square(model.transfer_std_deg or 0.0)
    largest = max(parts, key=lambda name: float(np.mean(parts[name])))
    return Verdict(
        frequency_hz,
        float(np.median(found.force_std_n[used])),
        float(np.median(found.location_std_mm[used])),
        model.force_span_n,
        model.location_span_mm,
        _LIMITS[largest],
        float(1 - clear.mean()),
    )
