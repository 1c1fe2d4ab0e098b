# SPDX-License-Identifier: GPL-3.0-or-later
"""Puts a tag into files of channel snapshots, and states what their noise allows of it.

build/run python3 tests/models/tags_in_files.py FILE.npz [--line-db 22] [--seeds 1 2] prints, for
each tag, the bound in degrees and N, and how the groups were read. Phase, gain, delay, noise, flips
and times of the packets are the file's own. The figures of docs/wifi.md are those of examples of
CSIKit: rx_8_211206_161457 with --reference-s 0.4, rx_8_211206_152319, and rx_8_211217_191036 with
--period-s 1 --reference-s 8 --repeats 4 --line-db 22.
"""

import argparse
import tempfile
import warnings
from pathlib import Path

import numpy as np
from gnuradio import wiforce
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.estimation.packets.antenna_states import (
    LEAST_STEP,
    against_reference,
    find_states,
)
from gnuradio.wiforce.io.capture.channel_snapshots import open_snapshots
from packet_simulator import PacketTag, closed

FORCE_N, LOCATION_MM, CLOCK_HZ, SENSOR = 4.0, 35.0, 134.0, "line-2440mhz"
FIRST_LINE = 0.225  # amplitude of the first line of a switched reflection of amplitude 1
# Powers of the lines of a switch that is closed for a quarter of the time, and frequencies beside
# them, in resolutions of a group, at which a tag has nothing.
LINE_POWERS = np.sinc(np.arange(1, 7) / 4) ** 2
BESIDE = np.array([-3, -2, 2, 3])


class TagInFile:
    """A tag that is touched after ``reference_s`` and a group, in a file's own packets.

    ``line_db`` is by how much its first line is weaker than the direct path; ``repeats`` joins the
    packets to themselves to make a short file longer.
    """

    def __init__(self, path, line_db, seed, period_s, reference_s, repeats=1):
        rng = np.random.default_rng(seed)
        recording = open_snapshots(path)
        self.hertz, self.received = recording.subcarrier_hz, recording.channel
        self.time_s = recording.time_s - recording.time_s[0]
        span_s = self.time_s[-1] + np.median(np.diff(self.time_s))
        self.time_s = np.concatenate([self.time_s + n * span_s for n in range(repeats)])
        self.period_s, self.reference_s = period_s, reference_s
        self.size = 10 ** (-line_db / 20) / FIRST_LINE
        turns = np.exp(2j * np.pi * rng.random(2))
        delays = np.multiply.outer(self.hertz, rng.exponential(15e-9, 2))
        self.way = self.size * turns * np.exp(-2j * np.pi * delays)  # over the static path
        tag = PacketTag(CLOCK_HZ, phase=rng.random())
        rate = tag.clock_hz * (1 + 1e-6 * tag.offset_ppm)
        self.closed = closed(rate * self.time_s + tag.phase).astype(float)
        self.touched = self.time_s >= reference_s + period_s
        turned = np.where(self.touched[:, None], tag.touched_deg, tag.untouched_deg)
        reflected = np.sum(self.closed * np.exp(1j * np.radians(turned)), axis=1)
        whole = np.tile(self.received, (repeats, 1, 1))
        self.channel = whole * (1 + reflected[:, None, None] * self.way)
        self.untouched, self.pressed = (
            np.exp(1j * np.radians(each)) for each in (tag.untouched_deg, tag.touched_deg)
        )

    def scene(self):
        """The scene, as somebody would write it who knows the tag and the file."""
        interval_s = float(np.mean(np.diff(self.time_s)))
        return {
            "packets": {"interval_s": interval_s},
            "radio": {"center_frequency_hz": 2.44e9},
            "phase_group": {"snapshots": round(self.period_s / interval_s)},
            "reference_s": self.reference_s,
            "sensors": [{"name": "tag", "model": SENSOR, "clock_hz": CLOCK_HZ}],
        }

    def readings(self):
        """What is read of it; a frame, or the sentence of a refusal."""
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "packets.npz"
            arrays = {"time_s": self.time_s, "channel": self.channel.astype(np.complex64)}
            np.savez(path, **arrays, subcarrier_hz=self.hertz)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                return wiforce.read(path, self.scene())

    def jitter(self):
        """Standard deviations of packets by what the file holds at the tag's lines: of the phase
        between the antennas, in rad, and of the logarithms of the gain between them and of the one
        that they share. White noise of as much has as much there; of what wanders, packets that
        follow each other show a third.
        """
        states = find_states(self.received, self.hertz, LEAST_STEP)
        gain = np.mean(np.log(np.abs(self.received[:, :, states.reference])), axis=1)
        against = against_reference(self.received, states.reference)[:, :, 1 - states.reference]
        values = np.zeros((3, len(gain)))
        for state in range(states.count):
            own = states.label == state
            mean = against[own].mean(axis=0)
            beside = np.log(against[own] @ mean.conj() / np.vdot(mean, mean))
            values[:, own] = beside.imag, beside.real, gain[own] - np.median(gain[own])
        time_s = self.time_s[: len(gain)]
        group = (time_s // self.period_s).astype(int)
        density = np.zeros(3)
        for line, power in enumerate(LINE_POWERS, 1):
            found = []
            for rows in (np.flatnonzero(group == n) for n in range(group[-1])):
                hertz = CLOCK_HZ * line + BESIDE / self.period_s
                turns = np.exp(-2j * np.pi * np.outer(time_s[rows], hertz))
                centered = values[:, rows] - values[:, rows].mean(axis=1, keepdims=True)
                found.append(np.abs(centered @ turns) ** 2 / len(rows))
            # The median of an exponential distribution is ln 2; of outliers there are few.
            density += power * np.median(np.concatenate(found, axis=1), axis=1) / np.log(2)
        return np.sqrt(density / sum(LINE_POWERS))

    def noise(self):
        """Static paths (2 K,) in units of the noise, and the inverse of its covariance (2 K, 2 K).

        Neighbouring subcarriers of an AX200 have noise alike, and in directions that paths of
        ordinary delays take it is two to five times the mean.
        """
        own = find_states(self.received, self.hertz, LEAST_STEP).label == 0
        packets = self.received[own].transpose(0, 2, 1).reshape(np.sum(own), -1)
        scaled = packets / np.linalg.norm(packets, axis=1, keepdims=True)
        count = packets.shape[1]
        static = np.linalg.eigh(scaled.T @ scaled.conj())[1][:, -1] * np.sqrt(count)
        hertz = np.tile(self.hertz, 2) / np.abs(self.hertz).max()
        antenna = np.repeat([1.0, -1.0], count // 2)
        # In phase, gain and delay of a packet and in the ratio of its antennas noise is not seen.
        hidden = np.stack([np.ones(count), antenna, hertz, hertz * antenna], axis=1)
        hidden = np.linalg.qr(static[:, None] * hidden)[0]
        rest = packets - packets @ hidden.conj() @ hidden.T
        rest /= (packets @ static.conj() / count)[:, None]
        group = (self.time_s[: len(own)][own] // self.period_s).astype(int)
        for each in np.unique(group):  # what is slower than a group is no noise of it
            rest[group == each] -= rest[group == each].mean(axis=0)
        covariance = rest.T @ rest.conj() / len(rest)
        # The largest is a bend of all subcarriers that changes from packet to packet.
        mean = np.linalg.eigvalsh(covariance)[hidden.shape[1] : -1].mean()
        covariance = covariance / mean + hidden @ hidden.conj().T
        return static / np.sqrt(mean), np.linalg.inv(covariance)

    def bounds(self):
        """Smallest standard deviations of the groups after the first touched one: (G, 2) in
        degrees, (G,) in N.

        The Cramer-Rao bound of H_a = x (S_a + r T_a) in the noise of the file, with S and T of each
        subcarrier and antenna, r of both ends in every group, and phase and delay of every packet
        unknown. Clocks, states of the receiver and the size to expect of T are known, and
        gains and antennas vary from packet to packet by as much as they do in the file.
        """
        static, precision = self.noise()
        way = static * self.way.T.ravel()
        count, group = len(static), (self.time_s // self.period_s).astype(int)
        first = int(np.ceil(self.reference_s / self.period_s)) + 2  # the first is touched in part
        groups = np.arange(first, group[-1])
        size = 4 * count + 2 + 4 * len(groups)
        # The noise is 1; T is as large as it is; what nothing determines is held weakly.
        prior = np.full(size, 1e-9)
        prior[2 * count : 4 * count] = 2 / np.mean(np.abs(way) ** 2)
        information = np.diag(prior)
        antenna = np.repeat([0.0, 1.0], count // 2)
        hertz = np.tile(self.hertz, 2)
        phase, ratio, gain = 1 / np.maximum(self.jitter(), 1e-6) ** 2
        beside = np.diag([gain, 0, 0, phase, ratio])
        change = self.untouched, self.pressed
        for which in [-1, *range(len(groups))]:
            own = ~self.touched if which < 0 else group == groups[which]
            reflection = change[which >= 0]
            for end in (-1, 0, 1):
                closed = self.closed[own]
                packets = np.sum(closed[:, end] > 0 if end >= 0 else closed.sum(axis=1) == 0)
                r = reflection[end] if end >= 0 else 0.0
                received = static + r * way
                slopes = np.zeros((count, size), complex)
                each = np.arange(count)
                slopes[each, each], slopes[each, count + each] = 1, 1j
                slopes[each, 2 * count + each], slopes[each, 3 * count + each] = r, 1j * r
                at = 4 * count if which < 0 else 4 * count + 2 + 4 * which + 2 * max(end, 0)
                if end >= 0 and (which >= 0 or end == 1):
                    slopes[:, at], slopes[:, at + 1] = way, 1j * way
                nuisance = np.stack(
                    [received, 1j * received, -1j * hertz / hertz.max() * received]
                    + [1j * antenna * received, antenna * received],
                    axis=1,
                )
                across = 2 * (slopes.conj().T @ precision @ nuisance).real
                inner = 2 * (nuisance.conj().T @ precision @ nuisance).real + beside
                whole = 2 * (slopes.conj().T @ precision @ slopes).real
                information += packets * (whole - across @ np.linalg.solve(inner, across.T))
        covariance = np.linalg.inv(information)
        degrees, newtons = [], []
        model, step = wiforce.load_sensor(SENSOR), 1e-3
        at = model.phases_deg(FORCE_N, LOCATION_MM)
        moved = ((FORCE_N + step, LOCATION_MM), (FORCE_N, LOCATION_MM + step))
        slopes = [(model.phases_deg(*each) - at) / step for each in moved]
        force = np.linalg.inv(np.stack(np.array(slopes).reshape(2, 2), axis=1))[0]
        for which in range(len(groups)):
            turn = np.zeros((2, size))
            for end in (0, 1):
                at = 4 * count + 2 + 4 * which + 2 * end
                r, r0 = self.pressed[end], self.untouched[end]
                turn[end, at : at + 2] = -(r.imag), r.real
                if end == 1:
                    turn[end, 4 * count : 4 * count + 2] = r0.imag, -r0.real
            own = turn @ covariance @ turn.T * np.degrees(1) ** 2
            degrees.append(np.sqrt(np.diag(own)))
            newtons.append(np.sqrt(force @ own @ force))
        return groups, np.array(degrees), np.array(newtons)


def rows(path, line_db, seeds, period_s, reference_s, repeats=1):
    """A row of figures per tag."""
    for seed in seeds:
        tag = TagInFile(path, line_db, seed, period_s, reference_s, repeats)
        groups, degrees, newtons = tag.bounds()
        start = f"{Path(path).name} {line_db:g} dB tag {seed}: bound {np.median(degrees):.2f} deg"
        start += f" {np.median(newtons):.3f} N"
        try:
            found = tag.readings()
        except InputError as error:
            print(f"{start}; refused: {error}", flush=True)
            continue
        found["group"] = np.rint(found["time_s"] / period_s - 0.5).astype(int)
        steady = found[found["group"].isin(groups)].set_index("group")
        clear = steady[steady["flags"] == ""]
        error = (clear["force_n"] - FORCE_N).abs()
        stds = error / clear["force_std_n"]
        allowed = steady.index.isin(groups[degrees.max(axis=1) < 1])
        flags = steady["flags"].str.split(" ").explode().value_counts().to_dict()
        flags.pop("", None)
        print(
            f"{start}; clear {len(clear)} of {len(steady)} ({allowed.sum()} below 1 deg), "
            f"rms {np.sqrt(np.mean(error**2)):.3f} N, worst {error.max():.3f} N, {stds.max():.2f} "
            f"std, stated {clear['force_std_n'].mean():.3f} N, touch {(clear['touch'] == 1).all()}"
            f", flags {flags}",
            flush=True,
        )


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("files", nargs="+")
    parser.add_argument("--line-db", type=float, nargs="+", default=[22.0, 29.0])
    parser.add_argument("--seeds", type=int, nargs="+", default=list(range(1, 9)))
    parser.add_argument("--period-s", type=float, default=0.1)
    parser.add_argument("--reference-s", type=float, default=0.5)
    parser.add_argument("--repeats", type=int, default=1)
    asked = parser.parse_args()
    for path in asked.files:
        for line_db in asked.line_db:
            rows(path, line_db, asked.seeds, asked.period_s, asked.reference_s, asked.repeats)


if __name__ == "__main__":
    main()
