# SPDX-License-Identifier: GPL-3.0-or-later
"""Readings of a sensor in the hands of a person, without a radio."""

import numpy as np
from gnuradio.wiforce.io.readings import Reading
from gnuradio.wiforce.sensor import load_sensor

GROUP_S = 0.036
GROUPS = 14


class HandHeldSensor:
    """A sensor whose readings are those of its model, with noise.

    ``force_n``, ``location_mm``: what presses it; a force of 0 releases it; ``slips_mm``: distance
    by which the press slips in the middle of the next readings; ``flags``: of one group in the
    middle of the next readings.
    """

    groups = GROUPS

    def __init__(self, model="line-900mhz", noise_deg=0.1, seed=1):
        self.model = load_sensor(model) if isinstance(model, str) else model
        self._rng, self._noise_deg = np.random.default_rng(seed), noise_deg
        self.force_n, self.location_mm = 0.0, 40.0
        self.slips_mm, self.flags = 0.0, ()

    def readings(self, count=GROUPS):
        """The readings of the next groups."""
        places = np.full(count, self.location_mm)
        places[count // 2 :] += self.slips_mm
        phases = self.model.phases_deg(np.full(count, self.force_n), places)
        phases = phases + self._noise_deg * self._rng.standard_normal(phases.shape)
        touch = int(self.force_n >= self.model.onset_force_n)
        found = [
            Reading(
                GROUP_S * i,
                "arm",
                touch,
                phase1_deg=first,
                phase2_deg=second,
                flags=self.flags if i == count // 2 else (),
            )
            for i, (first, second) in enumerate(phases.tolist())
        ]
        self.slips_mm, self.flags = 0.0, ()
        return found

    def collect(self, idle):
        idle()
        return self.readings()

    def idle(self):
        pass

    def wait_for_reference(self, idle):
        idle()
