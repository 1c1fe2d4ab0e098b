# SPDX-License-Identifier: GPL-3.0-or-later
"""Time that passes as signal is played, for a reader that is faster than its device would be."""

import time
from functools import partial

_PAUSE_S = 2e-4


class PlayedTime:
    """Stands in for the module ``time`` where the live reader asks for it.

    ``utc_offset_s``: what is added for UTC; changes when somebody sets the host's clock.
    """

    CLOCK_BOOTTIME = time.CLOCK_BOOTTIME

    def __init__(self):
        self.now_s, self.utc_offset_s = 1000.0, 1.8e9

    def monotonic(self):
        return self.now_s

    def time(self):
        return self.now_s + self.utc_offset_s

    def clock_gettime(self, _):
        return self.now_s

    def sleep(self, _):
        time.sleep(_PAUSE_S)

    def __getattr__(self, name):
        return getattr(time, name)

    def install(self, link, on_health):
        """Let the live reader use this time, and a device of ours.

        ``link``: makes what stands in for a RadioLink; ``on_health``: called with the RunHealth of
        each run.
        """
        from gnuradio.wiforce.blocks import sample_streams
        from gnuradio.wiforce.io.files import writers
        from wiforce_app.live import health, live, monitor, radio_keeper, service_manager, session

        for module in (sample_streams, session, health):
            module.time = self
        made_health = health.RunHealth

        def run_health(*arguments, **options):
            made = made_health(*arguments, **options, now=self.monotonic)
            on_health(made)
            return made

        health.RunHealth = run_health
        radio_keeper.RadioKeeper = partial(radio_keeper.RadioKeeper, link=link, now=self.monotonic)
        monitor.SessionMonitor = partial(monitor.SessionMonitor, now=self.monotonic)
        service_manager.ServiceReport = partial(service_manager.ServiceReport, now=self.monotonic)
        writers.RotatingWriter = partial(writers.RotatingWriter, now=self.time)
        # These pauses are in the time of the machine.
        live._LOOK_S = health._LOOK_S = 0.03
