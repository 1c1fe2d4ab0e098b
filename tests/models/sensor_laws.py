# SPDX-License-Identifier: GPL-3.0-or-later
"""Sensors that the package knows nothing of, and plain inversions to hold it against.

A press at l with force F shorts the line from l - a_1 to l + a_2. How far the short reaches
towards either end is a law of force times a law of location: full on the near side, fading to a
fifth on the far side.
"""

from dataclasses import dataclass

import numpy as np

LENGTH_MM = 80.0
ONSET_N = 0.9
CALIBRATED_MM = (20.0, 30.0, 40.0, 50.0, 60.0)
PRESSED_MM = (25.0, 33.0, 45.0, 55.0)
_FAR = 0.22

REACH_MM = {
    # all move about 4.8 mm on the near side from 2 to 8 N
    "power": lambda force: 16.3 * (ONSET_N ** (-1 / 3) - force ** (-1 / 3)),
    "log": lambda force: 3.46 * np.log(force / ONSET_N),
    "saturating": lambda force: 8.2 * (1 - np.exp(-(force - ONSET_N) / 3.0)),
}
# 1 on the near side, 0 on the far side; x is the distance beyond the middle.
FADES = {
    "late": lambda x, fade: 1 / (1 + np.exp((x - 2 * fade) / fade)),
    "even": lambda x, fade: 1 / (1 + np.exp(2 * x / fade)),
    "slow": lambda x, fade: 1 / (1 + np.exp((x - fade) / fade)),
    "kinked": lambda x, fade: np.exp(-np.maximum(x, 0) / fade),
    "straight": lambda x, fade: np.clip(0.5 - x / (4 * fade), 0, 1),
}


@dataclass(frozen=True)
class OwnLaw:
    """A contact law: reach by force, fade by location over ``fade_mm``."""

    reach: str
    fade: str
    fade_mm: float

    def phases_deg(self, force_n, location_mm, frequency_hz):
        """psi_1, psi_2, not wrapped; shape (..., 2)."""
        force, location = np.broadcast_arrays(np.asarray(force_n, float), location_mm)
        beyond = location - LENGTH_MM / 2
        reach = REACH_MM[self.reach](force)
        fade = FADES[self.fade]
        a_1 = reach * (_FAR + (1 - _FAR) * fade(beyond, self.fade_mm))
        a_2 = reach * (_FAR + (1 - _FAR) * fade(-beyond, self.fade_mm))
        two_beta = 2 * 360 * frequency_hz / 299_792_458 / 1000
        d = np.stack([location - a_1, LENGTH_MM - location - a_2], axis=-1)
        return 180 - two_beta * d


# The far end's movement fades over 5, 8 and 12 mm.
LAWS = (
    OwnLaw("power", "late", 5.0),
    OwnLaw("log", "even", 8.0),
    OwnLaw("saturating", "slow", 12.0),
)


def untouched_deg(frequency_hz):
    return -2 * 360 * frequency_hz / 299_792_458 / 1000 * LENGTH_MM


def vna_rows(law, frequency_hz, forces, noise_deg, rng, locations=CALIBRATED_MM):
    """Rows of a VNA calibration as text: header first, untouched rows, then every press."""
    rows = ["freq_mhz,location_mm,port,force_n,phase_deg"]
    mhz = frequency_hz / 1e6
    for port in (1, 2):
        phase = untouched_deg(frequency_hz) + noise_deg * rng.standard_normal()
        rows.append(f"{mhz:.3f},,{port},0,{wrap(phase):.4f}")
    for location in locations:
        phases = law.phases_deg(forces, location, frequency_hz)
        phases = phases + noise_deg * rng.standard_normal(phases.shape)
        for port in (1, 2):
            for force, phase in zip(forces, phases[:, port - 1], strict=True):
                rows.append(f"{mhz:.3f},{location:g},{port},{force:.4f},{wrap(phase):.4f}")
    return rows


def wrap(angle):
    return (np.asarray(angle) + 180.0) % 360.0 - 180.0


@dataclass(frozen=True)
class LawResult:
    """Errors of readings of one law at one carrier, by location."""

    force_error: dict
    location_error: dict
    force_std: dict
    location_std: dict

    def pooled(self, name):
        return np.concatenate(list(getattr(self, name).values()))

    def coverage(self, what):
        """Part of the truth within two standard deviations; ``force`` or ``location``."""
        error, std = self.pooled(f"{what}_error"), self.pooled(f"{what}_std")
        return float(np.mean(error <= 2 * std))


def read_law(model, law, frequency_hz, count, phase_noise_deg, rng, locations=PRESSED_MM):
    """Presses of 2 to 8 N at locations that were not calibrated, read by ``model``."""
    result = LawResult({}, {}, {}, {})
    for location in locations:
        forces = rng.uniform(2, 8, count)
        phases = law.phases_deg(forces, location, frequency_hz)
        phases = wrap(phases + phase_noise_deg * rng.standard_normal(phases.shape))
        found = model.invert(phases, phase_noise_deg, frequency_hz=frequency_hz)
        result.force_error[location] = np.abs(found.force_n - forces)
        result.location_error[location] = np.abs(found.location_mm - location)
        result.force_std[location] = found.force_std_n
        result.location_std[location] = found.location_std_mm
    return result
