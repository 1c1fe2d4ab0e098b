# SPDX-License-Identifier: GPL-3.0-or-later
"""A stream of samples, and everything that can happen to it on its way to the reader."""

from dataclasses import dataclass, field

import device_times
import numpy as np
import pmt
from gnuradio import wiforce
from press_capture import array_source, run_flowgraph

RATE = 12.5e6
FRAME = 720
GROUP = 625 * FRAME
DURATION_S = 1.44
# By then a reader has clocks (0.4 s) and a reference, and has read something.
STARTED = 12 * GROUP
PRESS = {
    "sensor": "arm",
    "start_s": 0.6,
    "rise_s": 0.01,
    "hold_s": 0.55,
    "force_n": 3.0,
    "end_force_n": 5.0,
    "location_mm": 37.0,
}
SCENE = {
    "sensors": [{"name": "arm", "model": "line-900mhz", "clock_tolerance_ppm": 50}],
    "reference_s": 0.25,
    "simulation": {
        "duration_s": DURATION_S,
        "seed": 4,
        "snr_db": 10,
        "static_clutter_db": 50,
        "clock_offset_ppm": -20,
        "presses": [PRESS],
    },
}


@dataclass
class Stream:
    """Samples as they reach the reader.

    ``codes`` (n, 2); ``times``: items and what ``rx_time`` says of them, in s, by a clock that is
    never set; ``losses``: items and the samples lost before them, as a time tag states; ``set``:
    when the clock was set, in s by itself, and by how much; ``shift_s``: by how much the reader's
    time may be off from the truth's; ``earliest``: no fault before this sample; ``silent``: samples
    of other settings, which no group holds; ``cuts``: items where samples are missing or repeated.
    """

    codes: np.ndarray
    earliest: int = 0
    tags: list = field(default_factory=list)
    times: list = field(default_factory=list)
    losses: list = field(default_factory=list)
    set: list = field(default_factory=list)
    shift_s: float = 0.0
    silent: int = 0
    cuts: list = field(default_factory=list)

    def tag(self, item, key, value):
        self.tags.append((int(item), key, value))

    def time_s(self, item):
        """Time of an item on the device's count, as far as losses are known."""
        lost = sum(count for start, count in self.losses if start <= item)
        return 7.25 + (item + lost) / RATE

    def tag_time(self, item, seconds):
        self.times.append((int(item), seconds))

    def all_tags(self):
        """Tags in the order of their items, with times as the device's clock has them."""
        tags = [device_times.tag_at(*tag) for tag in self.tags]
        for item, s in self.times:
            by_itself_s = s + sum(by for since, by in self.set if s >= since)
            tags.append(device_times.rx_time(item, by_itself_s))
        return sorted(tags, key=lambda tag: tag.offset)

    def cut(self, start, count):
        """Take samples out; tags behind them move up."""
        self.codes = np.concatenate([self.codes[:start], self.codes[start + count :]])
        self._move(start, count, -count)

    def double(self, start, count):
        """Repeat samples; tags behind them move on."""
        again = self.codes[start : start + count]
        self.codes = np.concatenate(
            [self.codes[: start + count], again, self.codes[start + count :]]
        )
        self._move(start, 0, count)

    def _move(self, start, gone, by):
        def moved(marks):
            return [
                (item + by if item >= start + gone else min(item, start), *rest)
                for item, *rest in marks
            ]

        self.tags, self.times, self.losses = map(moved, (self.tags, self.times, self.losses))
        self.cuts = [*moved(self.cuts), (start,)]

    def scale(self, start, count, factor, offset=0.0):
        """What a complex gain and a constant make of a stretch, clipped as a converter does."""
        part = self.codes[start : start + count].astype(np.float32)
        values = part.view(np.complex64)
        values *= factor
        values += offset
        np.rint(part, out=part)
        self.codes[start : start + count] = np.clip(part, -32768, 32767, out=part)


def lost_tagged(stream, rng):
    """An overflow, with the time of the first sample behind it."""
    start, count = _place(stream, rng), int(10 ** rng.uniform(0, 5.7))
    count = min(count, len(stream.codes) - start - 1)
    stream.cut(start, count)
    stream.losses.append((start, count))
    stream.tag_time(start, stream.time_s(start))


def lost_untagged(stream, rng):
    """Samples lost without a time tag."""
    start, count = _place(stream, rng), int(rng.integers(1, 5000))
    stream.cut(start, count)
    stream.shift_s += (count + FRAME) / RATE


def doubled(stream, rng):
    """A packet that comes twice."""
    start, count = _place(stream, rng), int(rng.integers(1, 5000))
    stream.double(start, count)
    stream.shift_s += (count + FRAME) / RATE


def time_doubled(stream, rng):
    """A true time, again on a later sample."""
    item = _place(stream, rng)
    late = int(rng.integers(1, 100_000))
    stream.tag_time(item, stream.time_s(item))
    stream.tag_time(min(item + late, len(stream.codes) - 1), stream.time_s(item))
    after = min(item + 2 * late, len(stream.codes) - 1)
    stream.tag_time(after, stream.time_s(after))


def time_ahead(stream, rng):
    """A time too late by up to 20 ms, and a true one behind it."""
    item, lie = _place(stream, rng), rng.uniform(0, 0.02)
    stream.tag_time(item, stream.time_s(item) + lie)
    after = min(item + int(rng.integers(1, 100_000)), len(stream.codes) - 1)
    stream.tag_time(after, stream.time_s(after))
    stream.shift_s += lie + FRAME / RATE


def clock_set_anew(stream, rng):
    """The device's clock is set back or far ahead, and tells of two losses then."""
    item = _place(stream, rng)
    stream.set.append((stream.time_s(item), rng.choice([-1.5, 7200.0])))
    for start in np.sort(rng.integers(item, len(stream.codes) - GROUP, 2)):
        stream.cut(start, 5000)
        stream.losses.append((start, 5000))
        stream.tag_time(start, stream.time_s(start))


def time_nonsense(stream, rng):
    """Values that are no time, or one that cannot be."""
    item = _place(stream, rng)
    values = (
        pmt.from_double(3.0),
        pmt.PMT_NIL,
        pmt.make_tuple(pmt.from_uint64(7), pmt.from_double(float("nan"))),
        pmt.make_tuple(pmt.from_uint64(2**63), pmt.from_double(0.5)),
        pmt.make_tuple(pmt.from_uint64(7), pmt.from_double(-1e300)),
        pmt.make_tuple(pmt.from_uint64(0), pmt.from_double(0.0)),
    )
    stream.tag(item, "rx_time", values[rng.integers(len(values))])


def other_rate(stream, rng):
    """The device says that it samples at another rate for a while."""
    start, count = _stretch(stream, rng)
    stream.silent += count
    stream.tag(start, "rx_rate", pmt.from_double(10e6))
    stream.tag(start + count, "rx_rate", pmt.from_double(RATE))
    _noise(stream, start, count, rng)


def retuned(stream, rng):
    """Another carrier for a while; back again the oscillator has a phase of its own."""
    start, count = _stretch(stream, rng)
    stream.silent += count
    stream.tag(0, "rx_freq", pmt.from_double(900e6))
    stream.tag(start, "rx_freq", pmt.from_double(910e6))
    stream.tag(start + count, "rx_freq", pmt.from_double(900e6))
    _noise(stream, start, count, rng)
    stream.scale(start + count, len(stream.codes), np.exp(2j * np.pi * rng.random()))


def reopened(stream, rng):
    """The device is lost and opened again: another phase, and a time by the host's clock."""
    start, frames = _place(stream, rng), int(rng.integers(1, 300))
    count = min(frames * FRAME, len(stream.codes) - start - GROUP)
    late = FRAME * int(rng.integers(0, 90))  # up to 5 ms
    stream.cut(start, count)
    stream.losses.append((start, count + late))
    stream.tag_time(start, stream.time_s(start))
    stream.tag(start, "retuned", pmt.from_uint64(1))
    stream.scale(start, len(stream.codes), np.exp(2j * np.pi * rng.random()))
    stream.shift_s += (late + FRAME) / RATE


def saturated(stream, rng):
    """A stretch so loud that the converter clips."""
    start, count = _stretch(stream, rng)
    stream.scale(start, count, rng.uniform(1.5, 20))


def dc_offset(stream, rng):
    """A constant from some sample on."""
    start = _place(stream, rng)
    constant = rng.uniform(10, 3000) * np.exp(2j * np.pi * rng.random())
    stream.scale(start, len(stream.codes), 1.0, constant)


def dead_air(stream, rng):
    """Zeros for a while."""
    start, count = _stretch(stream, rng)
    stream.codes[start : start + count] = 0


def tag_off_and_on(stream, rng):
    """The tag is without power for a while: what is left is what stands still."""
    start, count = (x // FRAME * FRAME for x in _stretch(stream, rng))
    frames = stream.codes[: 5000 * FRAME].reshape(-1, FRAME, 2)
    # The tag's clock averages out over whole periods; its constant part is that of clutter.
    still = frames[:5000].mean(axis=0)
    noise = rng.normal(0, 3.0, (count, 2))
    stream.codes[start : start + count] = np.tile(still, (count // FRAME, 1)) + noise
    jump = FRAME * int(rng.integers(1, 600))  # whole frames: only its clock's phase moves
    jump = min(jump, (len(stream.codes) - start - count) // FRAME * FRAME)
    stream.cut(start + count, jump)
    stream.shift_s += jump / RATE


def second_reader(stream, rng):
    """Another reader's preambles over ours, from a clock and a carrier of its own."""
    start, count = _stretch(stream, rng)
    delay, level = int(rng.integers(FRAME)), 10 ** rng.uniform(-3, 0)
    other = stream.codes[:FRAME, 0] + 1j * stream.codes[:FRAME, 1]
    ppm = 10
    other = other[(delay + np.arange(count) * (1 + 1e-6 * ppm)).astype(int) % FRAME]
    turn = np.exp(2j * np.pi * rng.uniform(-3000, 3000) * np.arange(count) / RATE)
    part = stream.codes[start : start + count]
    mixed = part + level * np.stack([(other * turn).real, (other * turn).imag], -1)
    stream.codes[start : start + count] = np.clip(np.rint(mixed), -32768, 32767)


FAULTS = (
    lost_tagged,
    lost_untagged,
    doubled,
    time_doubled,
    time_ahead,
    time_nonsense,
    clock_set_anew,
    other_rate,
    retuned,
    saturated,
    dc_offset,
    dead_air,
    tag_off_and_on,
    second_reader,
)  # fmt: skip
# The golden sequences draw from those above, and would change with their number.
ALL_FAULTS = (*FAULTS, reopened)


def random_faults(seed, among):
    """One to four faults of these."""
    rng = np.random.default_rng([seed, 99])
    count = rng.integers(1, 5)
    return [among[i] for i in rng.integers(len(among), size=count)]


def faulty(codes, rng, faults, earliest=0):
    """The stream of ``codes`` after these faults, none before the sample ``earliest``."""
    stream = Stream(codes.copy(), earliest)
    for fault in faults:
        fault(stream, rng)
    stream.tag_time(0, 7.25)
    if stream.set:
        # The loss that the first time of a new clock tells is known but for whole frames.
        stream.shift_s += (sum(count for _, count in stream.losses) + FRAME) / RATE
    return stream


def _place(stream, rng):
    return int(rng.integers(stream.earliest, len(stream.codes) - GROUP))


def _stretch(stream, rng):
    start = _place(stream, rng)
    return start, min(int(10 ** rng.uniform(2, 6.5)), len(stream.codes) - start - GROUP // 2)


def _noise(stream, start, count, rng):
    level = max(float(stream.codes[:FRAME].std()), 1.0)
    stream.codes[start : start + count] = rng.normal(0, level, (count, 2)).clip(-32768, 32767)


def read(stream):
    """Readings of a Stream, and the reader that gave them."""
    readings = []
    reader = wiforce.reader(SCENE, input_type="sc16", on_reading=readings.append)
    run_flowgraph(array_source(stream.codes, stream.all_tags()), reader)
    return readings, reader


def wrong(reading, shift_s):
    """What an unflagged reading says that cannot be, None when all is well."""
    if reading.flags:
        return None
    half = 0.018 + shift_s
    begin, end = PRESS["start_s"], PRESS["start_s"] + 2 * PRESS["rise_s"] + PRESS["hold_s"]
    touched = begin < reading.time_s + half and reading.time_s - half < end
    untouched = reading.time_s - half < begin + 0.01 or reading.time_s + half > end - 0.01
    if reading.touch is None:
        return "says nothing, without a flag"
    if reading.touch == 0:
        return None if untouched else "touch is missed"
    if not touched:
        return "touch is invented"
    slope = (PRESS["end_force_n"] - PRESS["force_n"]) / PRESS["hold_s"]
    ramps = (begin, begin + PRESS["rise_s"], end - PRESS["rise_s"], end)
    expected = PRESS["force_n"] + slope * (reading.time_s - begin - PRESS["rise_s"])
    allowed = max(0.2, 5 * reading.force_std_n) + slope * shift_s
    # Where the time is off, the group may hold a part of the rise, or of the fall.
    ends = np.interp(reading.time_s + np.array((-half, half)), ramps, (0, 1, 1, 0))
    held = ends.min() if shift_s > 0 else 1
    if not held * expected - allowed <= reading.force_n <= expected + allowed:
        return f"force {reading.force_n:.2f} +- {reading.force_std_n:.2f}, true {expected:.2f}"
    if abs(reading.location_mm - PRESS["location_mm"]) > max(1.0, 5 * reading.location_std_mm):
        return f"location {reading.location_mm:.2f} +- {reading.location_std_mm:.2f}"
    return None
