# SPDX-License-Identifier: GPL-3.0-or-later
"""An hour of signal through the reader: `build/run python3 tests/robustness/soak.py [SECONDS]`.

Plays a capture without its start again and again, whole phase groups of it, with the device's time
in order and an overflow in every round. Prints memory, descriptors, threads and errors once a
minute of signal; exits with 1 when one of them has grown.
"""

import os
import sys
import tempfile
from collections import Counter
from pathlib import Path

import device_times
import faults
import numpy as np
from gnuradio import gr, wiforce
from gnuradio.wiforce.scene import load_scene
from gnuradio.wiforce.simulation.simulator import simulate

MOST_GROWTH_KB = 5000
PERIOD = 25 * faults.GROUP  # a whole number of tag periods at an offset of 0 ppm
LOST = 12_345  # in every round


class endless_source(gr.sync_block):
    """A capture whose later part is repeated, so many samples in all."""

    def __init__(self, codes, total):
        gr.sync_block.__init__(self, "endless_source", in_sig=None, out_sig=[(np.int16, 2)])
        self._codes, self._total = codes, total
        self._at = self._sent = self._device = 0

    def work(self, input_items, output_items):
        out = output_items[0]
        if self._device >= self._total:
            return -1
        if self._at == len(self._codes):
            self._at = len(self._codes) - PERIOD + LOST
            self._device += LOST
            self._tag()
        elif self._sent == 0:
            self._tag()
        count = min(len(out), len(self._codes) - self._at)
        out[:count] = self._codes[self._at : self._at + count]
        self._at += count
        self._sent += count
        self._device += count
        return count

    def _tag(self):
        time = device_times.value(self._device / faults.RATE)
        self.add_item_tag(0, self.nitems_written(0), device_times.KEY, time)


class Watch:
    """Notes what the process holds, and how good its readings are, minute by minute."""

    def __init__(self):
        self.minutes, self._errors, self._flags = [], [], Counter()

    def take(self, reading):
        if reading.touch == 1 and not reading.flags:
            self._errors.append(abs(reading.location_mm - faults.PRESS["location_mm"]))
        self._flags[" ".join(reading.flags)] += 1
        if reading.time_s >= 60 * (len(self.minutes) + 1):
            self._note()

    def _note(self):
        lines = Path("/proc/self/status").read_text().splitlines()
        held = {line.split(":")[0]: line.split()[1] for line in lines if len(line.split()) > 1}
        files, threads = len(os.listdir("/proc/self/fd")), int(held["Threads"])
        error = float(np.median(self._errors)) if self._errors else float("inf")
        self.minutes.append((int(held["VmRSS"]), files, threads, error))
        print(
            f"{len(self.minutes)} min: {held['VmRSS']} kB, {files} descriptors, {threads} threads,"
        )
        print(f"    location {error:.4f} mm off, {dict(self._flags)}", flush=True)
        self._errors, self._flags = [], Counter()

    def faults(self):
        """What has grown since the first minute."""
        first, last = self.minutes[0], self.minutes[-1]
        found = []
        if last[0] - first[0] > MOST_GROWTH_KB:
            found.append(f"memory grew by {last[0] - first[0]} kB")
        if last[1:3] != first[1:3]:
            found.append(f"descriptors and threads {first[1:3]} -> {last[1:3]}")
        if not last[3] < first[3] + 0.02:
            found.append(f"error {first[3]:.4f} -> {last[3]:.4f} mm")
        return found


def main(seconds=3600):
    scene = {**faults.SCENE, "simulation": {**faults.SCENE["simulation"], "clock_offset_ppm": 0}}
    with tempfile.TemporaryDirectory() as folder:
        simulate(load_scene(scene), Path(folder) / "press")
        codes = np.fromfile(Path(folder) / "press.sigmf-data", "<i2").reshape(-1, 2)
    watch = Watch()
    reader = wiforce.reader(scene, input_type="sc16", on_reading=watch.take)
    flowgraph = gr.top_block()
    source = endless_source(codes, seconds * faults.RATE)  # GNU Radio keeps no reference
    flowgraph.connect(source, reader)
    flowgraph.run()
    if reader.failure is not None:
        raise reader.failure
    print(reader.counts)
    found = watch.faults()
    print("; ".join(found) or "nothing grew")
    return bool(found)


if __name__ == "__main__":
    sys.exit(main(*map(float, sys.argv[1:])))
