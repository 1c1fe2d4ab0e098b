#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Press a simulated sensor and print its readings.

The same as press_simulation.grc, without a window.
"""

from gnuradio import blocks, channels, gr, wiforce

# Time (s), force (N) and location (mm from port 1). The first 0.5 s are the untouched reference.
PRESSES = [(0.8, 3.0, 33.0), (1.6, 5.5, 47.0), (2.4, 0.0, 47.0)]
DURATION_S = 3.0


class PressSimulation(gr.top_block):
    def __init__(self):
        gr.top_block.__init__(self, "press_simulation", catch_exceptions=False)
        scene = wiforce.load_scene("tabletop")
        self.sample_rate = scene.radio.sample_rate_hz
        frame_length = scene.sounding.frame_length
        self.sounder = wiforce.sounding_source(
            frame_length=frame_length, sample_rate=self.sample_rate
        )
        self.stop_after = blocks.head(gr.sizeof_gr_complex, int(DURATION_S * self.sample_rate))
        self.room = channels.channel_model(taps=[0.9, 0.2 - 0.3j, 0, 0.1j])
        self.tag = wiforce.backscatter_tag(
            model="line-900mhz",
            clock_hz=scene.sensors[0].clock_hz,
            snr_db=20,
            static_clutter_db=50,
            sample_rate=self.sample_rate,
            frame_length=frame_length,
        )
        self.reader = wiforce.reader(scene, on_reading=self.on_reading)
        self.connect(self.sounder, self.stop_after, self.room, self.tag, self.reader)
        self.to_come = list(PRESSES)

    def on_reading(self, reading):
        if reading.touch:
            print(
                f"{reading.time_s:6.3f} s  {reading.force_n:5.2f} N  "
                f"at {reading.location_mm:5.2f} mm  {' '.join(reading.flags)}"
            )
        else:
            print(f"{reading.time_s:6.3f} s  not touched  {' '.join(reading.flags)}")
        if self.to_come and reading.time_s > self.to_come[0][0]:
            _, force_n, location_mm = self.to_come.pop(0)
            print(f"          press: {force_n} N at {location_mm} mm")
            self.tag.set_location_mm(location_mm)
            self.tag.set_force_n(force_n)


if __name__ == "__main__":
    PressSimulation().run()
