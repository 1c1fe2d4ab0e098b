# SPDX-License-Identifier: GPL-3.0-or-later
"""Signals that are played again and again: a sensor that is pressed in known ways, at 1.25 Msps.

The simulator makes a few loops without noise, which is added afresh whenever they are played. All
loops have the same room and the same clock of the tag, and are a whole number of its periods long.
So one may follow another wherever the sensor is untouched in both.
"""

from dataclasses import dataclass

import numpy as np
from gnuradio.wiforce.scene import load_scene
from gnuradio.wiforce.simulation.channel import AirChannel
from gnuradio.wiforce.simulation.simulator import capture

RATE_HZ = 1.25e6
FRAME = 320
SLOT_S = 2.56  # with one press, or none: 10 000 frames
SLOT = round(SLOT_S * RATE_HZ)
PRESS_S, RELEASE_S = 0.5, 1.9  # of the press in a slot
_CLOCK_HZ = 400
_RISE_S = 0.1
_SNR_DB, _NO_NOISE_DB = 20, 100
_FULL_SCALE = 32768
# Steps in which the truth is stated.
TRUTH_S = 1e-3


def scene_of(presses=(), length_s=10.0, snapshots=125, offset_ppm=0.0):
    """A scene at a tenth of the usual rate; a sensor that the reader knows by its calibration."""
    return {
        "radio": {"center_frequency_hz": 900e6, "sample_rate_hz": RATE_HZ},
        "sounding": {"frame_length": FRAME},
        "phase_group": {"snapshots": snapshots},
        "sensors": [{"name": "arm", "model": "line-900mhz-calibrated", "clock_hz": _CLOCK_HZ}],
        "reference_s": 0.5,
        "simulation": {
            "truth_model": "line-900mhz",
            "duration_s": length_s,
            "snr_db": _SNR_DB,
            "static_clutter_db": 50,
            "clock_offset_ppm": offset_ppm,
            "presses": list(presses),
        },
    }


@dataclass
class Loop:
    """Samples without noise, and the truth about them.

    ``codes`` (n, 2); ``force_n``, ``location_mm`` (m,): every ``TRUTH_S``; a force of 0 where
    nothing presses.
    """

    codes: np.ndarray
    force_n: np.ndarray
    location_mm: np.ndarray


class Loops:
    """Loops of one room, and what is received of it without the tag.

    ``pressed``: number of loops with presses, besides one without any; ``slots``: length of a loop:
    with 16, the clock of the tag is off by 61 ppm, with 4 not at all; ``rng``: chooses the presses.
    ``loops``: the first one is untouched; ``silence`` (FRAME, 2): a frame without the tag;
    ``noise_codes``: standard deviation of the noise in I, in codes; ``onset_n``: force from which
    on the line is shorted.
    """

    def __init__(self, pressed, slots, rng):
        self.length = slots * SLOT
        self._length_s = slots * SLOT_S
        # A whole number of periods: one more than those of a clock that is right.
        self._offset_ppm = {16: 1e6 / 16384, 4: 0.0}[slots]
        self.loops = [self._loop([])]
        for _ in range(pressed):
            self.loops.append(self._loop([_press(slot, rng) for slot in range(slots)]))
        channel = self._channel([])
        channel.sensors["arm"].on = False
        self.silence = next(self._codes([], channel))[-FRAME:].copy()
        self.noise_codes = AirChannel(self._scene([])).noise_std * _FULL_SCALE / np.sqrt(2)
        model = load_scene(self._scene([])).load_model("line-900mhz")
        self.onset_n = model.onset_force_n

    def truth(self, loop, position):
        """Force and location at positions of a loop, in samples."""
        at = np.asarray(position) // round(TRUTH_S * RATE_HZ)
        return self.loops[loop].force_n[at], self.loops[loop].location_mm[at]

    def _scene(self, presses):
        return load_scene(scene_of(presses, self._length_s, offset_ppm=self._offset_ppm))

    def _channel(self, presses):
        channel = AirChannel(self._scene(presses))
        channel.set_snr_db(_NO_NOISE_DB)
        return channel

    def _codes(self, presses, channel):
        for piece in capture(self._scene(presses), channel, "ci16_le"):
            yield piece.reshape(-1, 2)

    def _loop(self, presses):
        channel = self._channel(presses)
        codes = np.concatenate(list(self._codes(presses, channel)))
        assert len(codes) == self.length
        times = (np.arange(round(self._length_s / TRUTH_S)) + 0.5) * TRUTH_S
        state = channel.touch_state(times)["arm"]
        return Loop(codes, state.force_n, state.location_mm)


def _press(slot, rng):
    force, last = rng.uniform(1.5, 7.0, 2)
    return {
        "sensor": "arm",
        "start_s": slot * SLOT_S + PRESS_S,
        "rise_s": _RISE_S,
        "hold_s": RELEASE_S - PRESS_S - 2 * _RISE_S,
        "force_n": round(float(force), 3),
        "end_force_n": round(float(last), 3),
        "location_mm": round(float(rng.uniform(22, 58)), 2),
    }


class Noise:
    """White noise that is not repeated: sums of two stretches of a pool, at random places."""

    POOL = 1 << 18

    def __init__(self, std_codes, rng):
        self._rng = rng
        pool = rng.standard_normal((self.POOL, 2), np.float32) * np.float32(std_codes / np.sqrt(2))
        self._pool = np.round(pool).astype(np.int16)

    def add(self, codes, out):
        """Codes and noise, into another array."""
        count = len(codes)
        first, second = self._rng.integers(0, self.POOL - count, 2)
        np.add(codes, self._pool[first : first + count], out=out)
        (np.add if self._rng.random() < 0.5 else np.subtract)(
            out, self._pool[second : second + count], out=out
        )
