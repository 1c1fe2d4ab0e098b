# SPDX-License-Identifier: GPL-3.0-or-later
"""Readings of random presses by a receiver or a stream reader, and how many of them are wrong."""

from collections import Counter
from functools import lru_cache

import numpy as np
from gnuradio import wiforce
from gnuradio.wiforce.estimation.capture.folded_groups import SnapshotGroup
from gnuradio.wiforce.estimation.groups import Groups
from gnuradio.wiforce.receiver import Receiver
from gnuradio.wiforce.receiver.stream import StreamReader
from press_sequences import FAMILIES, REFERENCE_S, SNAPSHOT_S, Sequence, off_states

CLOCKS_HZ = 1000.0, 1400.0
# How often a tag turns, as the scene says: at any time, or while it is touched.
TURNS_PER_S, TOUCHED_TURNS_PER_S = 0.3, 0.5
# A reading is wrong if it is off by more than each of these; and far off by so many standard
# deviations.
_STDS, _FORCE_N, _LOCATION_MM, _ONSET_MARGIN_N, _FAR_STDS = 5.0, 0.3, 1.0, 0.3, 20.0
_STATIC_DB = 50.0  # static path over the tag's line 1
_LEAST_RECEIVED = 0.1  # share of a group for which a tag is on that is received in it
_BATCHES = 1, 3, 16, 28, 100


@lru_cache
def plan_of(sensors, snapshots, turns_per_s=None, effects=()):
    off = off_states(effects)
    named = [
        {"name": f"s{i}", "model": "line-900mhz-calibrated", "clock_hz": CLOCKS_HZ[i]}
        | ({"turns_per_s": turns_per_s} if turns_per_s else {})
        | ({"off_reflection": [[end.real, end.imag] for end in off]} if off is not None else {})
        # In error they are known as by default.
        | ({} if "in error" in effects else {"off_reflection_std": 0.0})
        for i in range(sensors)
    ]
    return wiforce.plan({"phase_group": {"snapshots": snapshots}, "sensors": named})


def _plan(sequence):
    effects = FAMILIES.get(sequence.family, ())
    turns = TURNS_PER_S if "turn" in sequence.family else None
    if "turned touches" in effects:
        turns = TOUCHED_TURNS_PER_S
    return plan_of(len(sequence.tags), sequence.snapshots, turns, effects)


class AsSeparated:
    """In place of a receiver's separation: groups that have been separated."""

    acquisition_groups = 0

    def process(self, groups):
        return groups

    def flush(self):
        return Groups([])


def _separated(sequence, plan):
    """Groups with the channels of the ends, and noise, and the static path."""
    rng = np.random.default_rng(1)
    k = plan.waveform.subcarriers
    channel = _channel(sequence, k)
    gain = np.exp(sequence.receiver)
    ends = np.concatenate(
        [(tag.ratios * gain[..., None]).mean(axis=1) for tag in sequence.tags], axis=1
    )
    variance = 2 * len(k) * np.radians(sequence.noise_deg) ** 2
    shape = sequence.groups, len(ends[0]), len(k)
    noise = rng.standard_normal((2, *shape)) * np.sqrt(variance / 2)
    on = np.stack([tag.on >= _LEAST_RECEIVED for tag in sequence.tags], axis=1)
    static = 10 ** (_STATIC_DB / 20) * gain.mean(axis=1)[:, None] * np.exp(-0.03j * k)
    static = static + np.sqrt(variance / 2) * (
        rng.standard_normal(static.shape) + 1j * rng.standard_normal(static.shape)
    )
    return Groups(
        np.arange(sequence.groups),
        np.zeros((sequence.groups, len(plan.table.tones), len(k))),
        ends=channel * ends[:, :, None] + noise[0] + 1j * noise[1],
        gain=np.where(np.repeat(on, 2, axis=1), 1.0, np.inf),
        noise=np.full((sequence.groups, len(k)), variance),
        snr_db=np.full((sequence.groups, len(ends[0])), 10.0),
        locked=on,
        overlapping=np.zeros((sequence.groups, len(sequence.tags)), bool),
        retuned=np.zeros(sequence.groups, bool),
        static=static,
    )


def _channel(sequence, k):
    """Channels of the untouched ends over the subcarriers ``k``; shape (2 * sensors, K)."""
    delays = np.linspace(0.02, 0.06, 2 * len(sequence.tags))
    strengths = np.tile(sequence.strengths, len(sequence.tags))
    return strengths[:, None] * np.exp(-2j * np.pi * np.outer(delays, k / 5.12))


def by_receiver(sequence):
    """Readings of groups that are separated already."""
    plan = _plan(sequence)
    groups, receiver = _separated(sequence, plan), Receiver(plan)
    receiver.separation = AsSeparated()
    readings = []
    for batch, tare in _batches(sequence):
        if tare is not None:
            receiver.tare(force=tare)
        readings += receiver.process(groups[batch][sequence.received[batch]])
    return readings + receiver.finish(sequence.groups)


def _batches(sequence):
    """Slices of any length, and whether a tare is asked for before each, and forced."""
    rng, begin, tares = np.random.default_rng(2), 0, list(sequence.tares)
    while begin < sequence.groups:
        tare = tares.pop(0)[1] if tares and tares[0][0] <= begin else None
        end = min(begin + int(rng.choice(_BATCHES)), sequence.groups)
        if tares:
            end = min(end, max(tares[0][0], begin + 1))
        yield slice(begin, end), tare
        begin = end


def by_stream(sequence):
    """Readings of channel snapshots, with the tags' clocks and the survey of the room."""
    reader = StreamReader(_plan(sequence))
    snapshots = _Snapshots(sequence, reader.plan.waveform)
    readings = []
    for batch, tare in _batches(sequence):
        if tare is not None:
            reader.tares.request(tare)
        received = np.flatnonzero(sequence.received[batch]) + batch.start
        readings += reader.process([snapshots.group(int(index)) for index in received])
    return readings + reader.finish()


class _Snapshots:
    """Folded frames of a static path and of the tags' switches, with noise."""

    def __init__(self, sequence, waveform):
        self._sequence, self._waveform = sequence, waveform
        self._rng = np.random.default_rng(3)
        k = waveform.subcarriers
        self._channel = _channel(sequence, k)
        line = np.sin(np.pi / 4) / np.pi  # first line of pulses a quarter of the clock long
        self._static = line * 10 ** (_STATIC_DB / 20) * np.exp(-0.03j * k)
        # The mean over a group of N snapshots and all subcarriers has the noise that is asked for.
        # Both ends are separated at about the variance of white noise over the power of line 1.
        self._noise = np.sqrt(2 * len(k) * sequence.snapshots) * line
        self._noise *= np.radians(sequence.noise_deg)

    def group(self, index):
        """The folded frames of one group."""
        sequence, waveform = self._sequence, self._waveform
        n = sequence.snapshots
        begin = (index * n + np.arange(n)) * SNAPSHOT_S
        point = np.arange(n) * sequence.receiver.shape[1] // n
        channel = np.repeat(self._static[None], n, axis=0)
        for i, tag in enumerate(sequence.tags):
            if tag.on[index]:
                on = _on_time(begin, waveform.averaging_s, CLOCKS_HZ[i] * (1 + 20e-6))
                ends = on * tag.ratios[index, point]
                channel = channel + ends @ self._channel[2 * i : 2 * i + 2]
        channel = channel * np.exp(sequence.receiver[index, point])[:, None]
        noise = self._rng.standard_normal((2, *channel.shape)) * self._noise / np.sqrt(2)
        spectrum = np.zeros((n, waveform.symbol_length), complex)
        sent = np.fft.fft(waveform.symbol)[waveform.bins]
        spectrum[:, waveform.bins] = (channel + noise[0] + 1j * noise[1]) * sent
        folded = np.fft.ifft(spectrum, axis=1).astype(np.complex64)
        everything = np.ones(n, bool)
        return SnapshotGroup(index, folded, everything, everything)


def _on_time(begin, duration, clock_hz):
    """Parts of windows in which each switch is on; (n, 2).

    Switch 1 is on for a quarter of the clock around its beginning, switch 2, at twice the clock,
    for an eighth around each odd quarter.
    """

    def until(cycles, centre, period, width):
        x = (cycles - centre + width / 2) / period
        return (np.floor(x) + np.minimum((x - np.floor(x)) * period / width, 1)) * width

    first, last = (begin * clock_hz + 0.3, (begin + duration) * clock_hz + 0.3)
    parts = [
        until(last, *pulses) - until(first, *pulses)
        for pulses in ((0.0, 1.0, 0.25), (0.25, 0.5, 0.125))
    ]
    return np.stack(parts, axis=1) / (duration * clock_hz)


def _ranges(values):
    """Lowest, highest and mean of the values (G, N) of each group."""
    return list(zip(values.min(axis=1), values.max(axis=1), values.mean(axis=1), strict=True))


class Score:
    """Counts readings of sequences; ``wrong`` describes those that are."""

    def __init__(self):
        self.counts, self.wrong, self.far = Counter(), [], []

    def add(self, sequence, readings):
        ranges = [(_ranges(tag.force), _ranges(tag.location)) for tag in sequence.tags]
        for reading in readings:
            number, at = int(reading.sensor[1:]), reading.group
            force, location = (of[at] for of in ranges[number])
            self._judge(sequence, reading, force, location, sequence.tags[number].on[at])

    def _judge(self, sequence, reading, force, location, on):
        (low_n, high_n, _), (low_mm, high_mm, mean_mm) = force, location
        onset, flags = sequence.truth.onset_force_n, set(reading.flags) - {"reference"}
        read, steady = not flags and reading.touch is not None, (low_n, low_mm) == (high_n, high_mm)
        seen = bool(on == 1 and sequence.received[reading.group])
        untouched = seen and high_n == 0 and reading.time_s > REFERENCE_S
        pressed = seen and steady and low_n > onset + _ONSET_MARGIN_N
        counted = {
            "unflagged": read,
            "untouched": untouched,
            "untouched, read": read and untouched and reading.touch == 0,
            "pressed": pressed,
            "pressed, read": read and pressed and reading.touch == 1,
        }
        if counted["pressed, read"] and reading.force_n is not None:
            counted["pressed, inside"] = abs(reading.force_n - low_n) < 2 * reading.force_std_n
        self.counts.update([what for what, is_so in counted.items() if is_so])
        if not read:
            if pressed:
                self.counts.update(f"flag {flag}" for flag in flags)
            return
        missed = reading.touch == 0 and low_n > onset + _ONSET_MARGIN_N
        wrong = missed or (reading.touch == 1 and high_n < onset - _ONSET_MARGIN_N)
        far = missed
        if reading.touch == 1 and reading.force_n is not None and not wrong:
            off_n = max(low_n - reading.force_n, reading.force_n - high_n)
            off_mm = max(low_mm - reading.location_mm, reading.location_mm - high_mm)
            stds = max(
                (off > least) * off / std
                for off, least, std in (
                    (off_n, _FORCE_N, reading.force_std_n),
                    (off_mm, _LOCATION_MM, reading.location_std_mm),
                )
            )
            wrong, far = stds > _STDS, stds > _FAR_STDS
        if wrong:
            text = f"{low_n:.2f} N to {high_n:.2f} N at {mean_mm:.1f} mm"
            self.wrong.append(f"{text}, read as {reading}")
        if far:
            self.far.append(self.wrong[-1])

    def share(self, what, of):
        """One count as a part of another."""
        return self.counts[what] / max(self.counts[of], 1)

    def row(self):
        """Shares that are read, in percent, and counts, for --csv."""
        shares = [100 * self.share(f"{what}, read", what) for what in ("pressed", "untouched")]
        counts = self.counts["unflagged"], len(self.wrong), len(self.far)
        return ",".join([f"{share:.1f}" for share in shares] + [str(count) for count in counts])

    def __str__(self):
        return (
            f"pressed {100 * self.share('pressed, read', 'pressed'):5.1f} %, "
            f"untouched {100 * self.share('untouched, read', 'untouched'):5.1f} % read; "
            f"{len(self.wrong)} of {self.counts['unflagged']} wrong "
            f"({len(self.wrong) / max(self.counts['unflagged'], 1):.1e}), {len(self.far)} far off, "
            f"{100 * self.share('pressed, inside', 'pressed, read'):.1f} % inside 2 std"
        )


def score(seeds, snapshots, family, read=by_receiver):
    """The score of some sequences of a family."""
    found = Score()
    for seed in seeds:
        sequence = Sequence(seed, snapshots, family)
        before = len(found.wrong)
        found.add(sequence, read(sequence))
        found.wrong[before:] = [f"seed {seed}: {text}" for text in found.wrong[before:]]
    return found


def main():
    """python3 sequence_readings.py SEEDS N_g[,N_g...] [FAMILY ...] [--stream] [-v | --csv]"""
    import sys
    import time

    words = [word for word in sys.argv[1:] if not word.startswith("-")]
    for snapshots in map(int, words[1].split(",")):
        for family in words[2:] or FAMILIES:
            began = time.monotonic()
            read = by_stream if "--stream" in sys.argv else by_receiver
            found = score(range(int(words[0])), snapshots, family, read)
            flags = {k[5:]: v for k, v in found.counts.items() if k.startswith("flag ")}
            took = time.monotonic() - began
            if "--csv" in sys.argv:
                print(f"{snapshots},{family},{words[0]},{found.row()}", flush=True)
                continue
            print(f"{snapshots:5d} {family:16s} {found}; {took:.0f} s", flags, flush=True)
            if "-v" in sys.argv:
                print("\n".join(found.wrong))


if __name__ == "__main__":
    main()
