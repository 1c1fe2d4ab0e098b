#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Press a simulated sensor and print its readings.

The same as press_simulation.grc, without a window.
"""

import numpy as np
from command_line import start
from gnuradio import blocks, channels, gr, wiforce

# Time (s), force (N) and location (mm from port 1). The first 0.5 s are the untouched reference.
PRESSES = [(0.8, 3.0, 33.0), (1.6, 5.5, 47.0), (2.4, 0.0, 47.0)]
DURATION_S = 3.0


class SimulatedSensor:
    """What a receiver hears of a sensor that is pressed: sounder, room and tag."""

    def __init__(self, scene, clock_offset_ppm=0.0):
        rate, frame_length = scene.radio.sample_rate_hz, scene.sounding.frame_length
        self.sounder = wiforce.sounding_source(frame_length=frame_length, sample_rate=rate)
        self.stop_after = blocks.head(gr.sizeof_gr_complex, int(DURATION_S * rate))
        self.room = channels.channel_model(taps=[0.9, 0.2 - 0.3j, 0, 0.1j])
        self.tag = wiforce.backscatter_tag(
            model="line-900mhz",
            clock_hz=scene.sensors[0].clock_hz,
            clock_offset_ppm=clock_offset_ppm,
            snr_db=20,
            static_clutter_db=50,
            sample_rate=rate,
            frame_length=frame_length,
        )
        self.finger = Finger(self.tag, rate)
        self.blocks = [self.sounder, self.stop_after, self.room, self.finger, self.tag]


class Finger(gr.sync_block):
    """Passes samples on to a tag, and presses its sensor when the time of a press has come."""

    def __init__(self, tag, sample_rate):
        gr.sync_block.__init__(self, "finger", [np.complex64], [np.complex64])
        self._tag, self._sample_rate = tag, sample_rate
        self._to_come = list(PRESSES)

    def work(self, input_items, output_items):
        output_items[0][:] = input_items[0]
        time_s = self.nitems_written(0) / self._sample_rate
        if self._to_come and time_s >= self._to_come[0][0]:
            _, force_n, location_mm = self._to_come.pop(0)
            self._tag.set_location_mm(location_mm)
            self._tag.set_force_n(force_n)
        return len(output_items[0])


def print_reading(reading):
    if reading.touch:
        print(
            f"{reading.time_s:6.3f} s  {reading.force_n:5.2f} N  "
            f"at {reading.location_mm:5.2f} mm  {' '.join(reading.flags)}"
        )
    else:
        print(f"{reading.time_s:6.3f} s  not touched  {' '.join(reading.flags)}")


def main():
    flowgraph = gr.top_block("press_simulation", catch_exceptions=False)
    scene = wiforce.load_scene("tabletop")
    simulated = SimulatedSensor(scene)
    reader = wiforce.reader(scene, on_reading=print_reading)
    flowgraph.connect(*simulated.blocks, reader)
    flowgraph.run()


if __name__ == "__main__":
    start(main)
