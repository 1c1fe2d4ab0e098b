#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Press two simulated sensors at the same time and read both with one reader.

The same as two_sensors.grc, without a window.
"""

from command_line import start
from gnuradio import blocks, gr, wiforce

FORCES_N = (3.0, 5.0)
LOCATIONS_MM = (33.0, 52.0)
CLOCK_OFFSETS_PPM = (40.0, -65.0)
DURATION_S = 1.6


class TwoSensors(gr.top_block):
    def __init__(self):
        gr.top_block.__init__(self, "two_sensors", catch_exceptions=False)
        scene = wiforce.load_scene("tabletop_two")
        rate, frame_length = scene.radio.sample_rate_hz, scene.sounding.frame_length
        self.sounder = wiforce.sounding_source(frame_length=frame_length, sample_rate=rate)
        self.stop_after = blocks.head(gr.sizeof_gr_complex, int(DURATION_S * rate))
        self.tags = [
            wiforce.backscatter_tag(
                model="line-900mhz",
                clock_hz=sensor.clock_hz,
                clock_offset_ppm=offset_ppm,
                snr_db=20,
                static_clutter_db=50,
                sample_rate=rate,
                frame_length=frame_length,
                seed=n,
            )
            for n, (sensor, offset_ppm) in enumerate(
                zip(scene.sensors, CLOCK_OFFSETS_PPM, strict=True)
            )
        ]
        self.reader = wiforce.reader(scene, on_reading=self.on_reading)
        self.connect(self.sounder, self.stop_after, *self.tags, self.reader)
        self.pressed = False

    def on_reading(self, reading):
        if reading.touch:
            print(
                f"{reading.time_s:6.3f} s  {reading.sensor:5}  {reading.force_n:5.2f} N  "
                f"at {reading.location_mm:5.2f} mm  {' '.join(reading.flags)}"
            )
        if not self.pressed and reading.time_s > 0.7:
            self.pressed = True
            for tag, force_n, location_mm in zip(self.tags, FORCES_N, LOCATIONS_MM, strict=True):
                tag.set_location_mm(location_mm)
                tag.set_force_n(force_n)


if __name__ == "__main__":
    start(lambda: TwoSensors().run())
