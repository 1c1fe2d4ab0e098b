# SPDX-License-Identifier: GPL-3.0-or-later
"""Readings of a sensor in the hands of a person, without a radio."""

import numpy as np
from gnuradio.wiforce.io.readings import Reading
from gnuradio.wiforce.sensor import load_sensor

GROUP_S = 0.036
GROUPS = 14


class HandHeldSensor:
    """A sensor whose readings are those of its model, with noise.

    ``force_n``, ``location_mm``: what presses it; a force of 0 releases it; ``flags``: of one group
    in the middle of the next readings.
    """

    groups = GROUPS

    def __init__(self, noise_deg=0.1):
        self.model = load_sensor("line-900mhz")
        self._rng, self._noise_deg = np.random.default_rng(1), noise_deg
        self.force_n, self.location_mm, self.flags = 0.0, 40.0, ()

    def readings(self):
        """The readings of the next groups."""
        noise = self._noise_deg * self._rng.standard_normal((GROUPS, 2))
        phases = self.model.phases_deg(self.force_n, self.location_mm) + noise
        touch = int(self.force_n >= self.model.onset_force_n)
        found = [
            Reading(
                GROUP_S * i,
                "arm",
                touch,
                phase1_deg=first,
                phase2_deg=second,
                flags=self.flags if i == GROUPS // 2 else (),
            )
            for i, (first, second) in enumerate(phases.tolist())
        ]
        self.flags = ()
        return found

    def collect(self, idle):
        idle()
        return self.readings()

    def idle(self):
        pass

    def wait_for_reference(self, idle):
        idle()
