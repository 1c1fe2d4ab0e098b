# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce check FILE`` of channel snapshots: what they are, and whether a tag is seen."""

from dataclasses import asdict

import numpy as np
from gnuradio.wiforce.estimation.packets.antenna_states import (
    FOREIGN,
    LEAST_STEP,
    TAG_STEP,
    find_states,
)
from gnuradio.wiforce.estimation.packets.packet_survey import (
    find_tag,
    phase_std_deg,
    snapshot_snr_db,
)
from gnuradio.wiforce.io.capture.channel_snapshots import CLOCK_STEP_S
from gnuradio.wiforce.signal.lines import lamp_distances_hz

# Length of a reading that errors are stated for, in s, and the error at which readings are flagged
# (`weak`), in degrees.
_READING_S, _WEAK_DEG = 0.5, 3.0
# Packets that are looked at, the first ones: states are found among all of them.
_MOST_PACKETS = 20_000
# Stamps that are multiples of these are rounded to them, in s. A tenth of a millisecond is 4
# degrees of line 1 of a clock at 120 Hz, and 17 degrees of line 4.
_GRIDS_S = (1e-3, 1e-4)
# Nearness to a multiple of 100 or 120 Hz at which a clock may be a lamp, in Hz.
_LAMP_HZ = 1.0
# Gaps that are reported, in multiples of the median interval and in s.
_GAP_INTERVALS, _GAP_S = 20, 0.1


def check_snapshots(recording, kind):
    """What a file of channel snapshots is, and what it allows.

    Returns dict: ``file``, ``timing``, ``antennas``, ``tag`` (or None), ``advice`` and ``notes``.
    ``kind``: of the file, in words.
    """
    rows = slice(0, _MOST_PACKETS)
    channel, time_s = recording.channel[rows], recording.time_s[rows]
    coarse, fine = find_states(channel, TAG_STEP), find_states(channel, LEAST_STEP)
    # A strong tag looks like states of the receiver, a weak one is hidden by them.
    states, tag = coarse, find_tag(channel, time_s, coarse)
    if tag is None:
        states, tag = fine, find_tag(channel, time_s, fine)
    timing = _timing(recording)
    answer = {
        "file": {
            "path": str(recording.path),
            "kind": kind,
            "packets": len(recording.time_s),
            "seconds": recording.span_s,
            "subcarriers": len(recording.subcarrier_hz),
            "bandwidth_hz": float(np.ptp(recording.subcarrier_hz)),
            "center_frequency_hz": recording.center_frequency_hz,
            "scene": recording.scene is not None,
        },
        "timing": timing,
        "antennas": _antennas(channel, recording.subcarrier_hz, states),
        "tag": None if tag is None else _tag(tag, recording, timing),
    }
    answer["notes"] = list(_notes(recording, states))
    answer["advice"] = list(_advice(answer)) or ["none: read it with a scene (docs/wifi.md)"]
    return answer


def _timing(recording):
    steps = np.diff(recording.time_s)
    median = float(np.median(steps))
    gaps = steps[steps > max(_GAP_S, _GAP_INTERVALS * median)]
    received_s = recording.span_s - CLOCK_STEP_S * recording.clock_steps
    stamps = recording.time_s - recording.time_s[0]
    grid = next(
        (s for s in _GRIDS_S if np.all(np.abs(stamps / s - np.rint(stamps / s)) < 1e-3)), 0.0
    )
    stretch = (stamps / _READING_S).astype(int)
    counts = np.unique(stretch, return_counts=True)[1]
    return {
        "packets_per_s": len(steps) / max(received_s, 1e-9),
        "median_interval_s": median,
        "gaps": len(gaps),
        "longest_gap_s": float(steps.max()),
        "few_packets": float(np.mean(counts < np.median(counts) / 2)),
        "clock_steps": recording.clock_steps,
        "rounded_to_s": grid,
    }


def _antennas(channel, subcarrier_hz, states):
    level = np.median(np.mean(np.abs(channel) ** 2, axis=1), axis=0)
    level_db = 10 * np.log10(level / level.max())
    return {
        "count": channel.shape[2],
        "level_db": level_db.round(1).tolist(),
        "snr_db": np.round(snapshot_snr_db(channel, subcarrier_hz), 1).tolist(),
        "states": states.count,
        "changes": int(np.count_nonzero(np.diff(states.label))),
        "phase_std_deg": phase_std_deg(channel, states) if channel.shape[2] > 1 else None,
    }


def _tag(tag, recording, timing):
    per_reading = max(int(timing["packets_per_s"] * _READING_S), 1)
    channels = len(recording.subcarrier_hz) * max(recording.antennas - 1, 1)
    lamp_hz = float(lamp_distances_hz(tag.clock_hz, (50.0, 60.0)).min())
    return {
        **asdict(tag),
        "phase_error_deg": tag.phase_std_deg(per_reading, channels),
        "may_be_a_lamp": lamp_hz < _LAMP_HZ,
    }


def _notes(recording, states):
    yield from recording.notes
    if states.foreign:
        yield f"left out {states.foreign} x {FOREIGN}"


def _advice(found):
    timing, antennas, tag = found["timing"], found["antennas"], found["tag"]
    if antennas["count"] == 1:
        yield (
            "use a receiver with two antennas on one oscillator: with one, the phase of each "
            "packet cannot be distinguished from the tag"
        )
    if tag is None:
        yield (
            "no tag is seen: check that it is on, bring it nearer to sender or receiver, and "
            "record 1 s or more with at least 100 packets per second"
        )
    elif tag["may_be_a_lamp"]:
        yield (
            f"{tag['clock_hz']:.1f} Hz is a multiple of 100 or 120 Hz: switch the tag off to "
            "see whether it is a lamp, and use a clock between these multiples"
        )
    elif tag["phase_error_deg"] > _WEAK_DEG:
        yield "the tag is weak: bring it nearer, send more packets, or read longer groups"
    if timing["rounded_to_s"]:
        yield (
            f"time stamps are rounded to {1e3 * timing['rounded_to_s']:g} ms: store microseconds, "
            "by the clock of the card"
        )
    if timing["clock_steps"]:
        yield "the card's clock stepped back: record again, or read either part alone"
    if timing["few_packets"]:
        yield (
            f"packets come unevenly: {100 * timing['few_packets']:.0f} % of readings of "
            f"{_READING_S:g} s would hold fewer than half of the usual number, which are flagged "
            "`gap`; send them at a constant rate"
        )
    if timing["packets_per_s"] < 100:
        yield f"send more packets: {timing['packets_per_s']:.0f} per second need long readings"
    if min(antennas["level_db"]) < -20:
        yield "one antenna receives next to nothing: check its connector"


def text(found):
    """The result of :func:`check_snapshots` for a terminal."""
    file, timing, antennas, tag = (found[key] for key in ("file", "timing", "antennas", "tag"))
    carrier = file["center_frequency_hz"]
    where = "carrier unknown" if carrier is None else f"carrier {carrier / 1e6:g} MHz"
    lines = [
        f"file       {file['path']}: {file['kind']}",
        f"packets    {file['packets']} in {file['seconds']:.3g} s, "
        f"{file['subcarriers']} subcarriers over {file['bandwidth_hz'] / 1e6:.3g} MHz, {where}",
        f"timing     {timing['packets_per_s']:.0f} packets/s, median interval "
        f"{1e3 * timing['median_interval_s']:.3g} ms, {_gaps(timing)}",
        f"antennas   {antennas['count']}, levels {_list(antennas['level_db'])} dB, SNR of one "
        f"packet {_list(antennas['snr_db'])} dB",
    ]
    if antennas["count"] > 1:
        lines.append(f"phases     {_states(antennas)}")
    if tag is None:
        lines.append("tag        none is seen between 50 and 400 Hz")
    else:
        seen = "or a lamp, seen" if tag["may_be_a_lamp"] else "seen"
        lines += [
            f"tag        {seen} at {tag['clock_hz']:.2f} Hz: line 1 is {-tag['line_db']:.0f} dB "
            f"below the direct path, snr_db {tag['snr_db']:.0f}",
            f"allows     phase errors of {tag['phase_error_deg']:.2g} deg in readings of "
            f"{_READING_S:g} s, by noise alone",
        ]
    lines += [f"note       {note}" for note in found["notes"]]
    lines += [f"advice     {advice}" for advice in found["advice"]]
    return "\n".join(lines)


def _gaps(timing):
    words = f"{timing['gaps']} gaps" if timing["gaps"] else "no gaps"
    if timing["gaps"]:
        words += f" (longest {timing['longest_gap_s']:.3g} s)"
    if timing["clock_steps"]:
        words += f", clock stepped back {timing['clock_steps']} x"
    if timing["rounded_to_s"]:
        words += f", stamps rounded to {1e3 * timing['rounded_to_s']:g} ms"
    return words


def _states(antennas):
    within = f"between the antennas they vary by {antennas['phase_std_deg']:.2g} deg rms"
    if antennas["states"] == 1:
        return within
    return (
        f"{antennas['states']} states, {antennas['changes']} changes: followed; within a state, "
        f"{within}"
    )


def _list(values):
    return "/".join(f"{value:g}" for value in values)
