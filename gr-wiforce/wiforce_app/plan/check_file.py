# SPDX-License-Identifier: GPL-3.0-or-later
"""``check FILE``: what a capture or a file of snapshots is, and what to change first."""

from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
from gnuradio.wiforce.estimation.packets.antenna_states import (
    FOREIGN,
    LEAST_STEP,
    TAG_STEP,
    find_states,
)
from gnuradio.wiforce.estimation.packets.packet_channels import AntennaCombination
from gnuradio.wiforce.estimation.packets.packet_survey import (
    TagLines,
    find_tag,
    phase_std_deg,
    snapshot_snr_db,
)
from gnuradio.wiforce.io.capture.channel_snapshots import ChannelSnapshots
from gnuradio.wiforce.io.capture.names import is_snapshots
from gnuradio.wiforce.io.capture.samples import likely_datatype
from gnuradio.wiforce.io.csi_tools import tool_of
from gnuradio.wiforce.io.readings import WEAK_PHASE_DEG
from gnuradio.wiforce.signal.lines import lamp_distances_hz

from ..read.recordings import SAMPLES_ONLY, open_recording
from ..shell.options import refuse
from .check_capture import carrier_text, check_capture, check_samples, labelled

# Length of a reading that errors are stated for.
_READING_S = 0.5
# Tag that the error of a single antenna is stated for, in dB below the direct path: the weakest one
# that the paper could decode.
_FAR_TAG_DB = -60.0
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
    """What a file of channel snapshots, of a kind in words, is, and what it allows."""
    rows = slice(0, _MOST_PACKETS)
    channel, time_s = recording.channel[rows], recording.time_s[rows]
    coarse, fine = (
        find_states(channel, recording.subcarrier_hz, step) for step in (TAG_STEP, LEAST_STEP)
    )
    single, looks = None, [channel]
    if recording.antennas == 1:
        single = AntennaCombination(channel, recording.subcarrier_hz)
        # Where the band is narrow, a tag may show in the magnitudes alone.
        level = np.log(np.maximum(np.abs(channel), 1e-30))
        looks = [single.process(channel)[:, :, None], level - level.mean(axis=1, keepdims=True)]
    # A strong tag looks like states of the receiver, a weak one is hidden by them.
    trials = [(look, each) for look in looks for each in (coarse, fine)]
    found = ((look, each, find_tag(look, time_s, each)) for look, each in trials)
    look, states, tag = next((each for each in found if each[2]), (looks[0], fine, None))
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
        "one_antenna": None if single is None else _one_antenna(single, looks[0], timing),
    }
    if tag is not None and look is looks[0] and single:
        # What was found is what is left of the tag.
        tag = replace(tag, line_db=tag.line_db - single.kept_db, snr_db=tag.snr_db - single.kept_db)
    answer["tag"] = None if tag is None else _tag(tag, recording, answer)
    answer["notes"] = list(_notes(recording, states))
    answer["advice"] = list(_snapshot_advice(answer)) or [
        "none: read it with a scene (docs/wifi.md)"
    ]
    return answer


def _timing(recording):
    steps = np.diff(recording.time_s)
    median = float(np.median(steps))
    gaps = steps[steps > max(_GAP_S, _GAP_INTERVALS * median)]
    received_s = recording.received_s
    stamps = recording.time_s - recording.time_s[0]
    grid = next(
        (s for s in _GRIDS_S if np.all(np.abs(stamps / s - np.rint(stamps / s)) < 1e-3)), 0.0
    )
    return {
        "packets_per_s": len(steps) / max(received_s, 1e-9),
        "median_interval_s": median,
        "gaps": len(gaps),
        "longest_gap_s": float(steps.max()),
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


def _tag(tag, recording, found):
    alone = found["one_antenna"]
    if alone is None:
        channels = len(recording.subcarrier_hz) * (recording.antennas - 1)
        error = tag.phase_std_deg(_packets_of_a_reading(found["timing"]), channels)
    else:
        error = alone["phase_error_deg"] * 10 ** ((alone["tag_db"] - tag.line_db) / 20)
    lamp_hz = float(lamp_distances_hz(tag.clock_hz, (50.0, 60.0)).min())
    return {**asdict(tag), "phase_error_deg": error, "may_be_a_lamp": lamp_hz < _LAMP_HZ}


def _packets_of_a_reading(timing):
    return max(int(timing["packets_per_s"] * _READING_S), 1)


def _one_antenna(single, free, timing):
    """What one antenna leaves of a tag, and its error, by packets (n, K, 1) over static paths."""
    noise = np.mean(np.abs(np.diff(free, axis=0)) ** 2) / 2
    snr_db = _FAR_TAG_DB + single.kept_db - 10 * float(np.log10(max(noise, 1e-30)))
    far = TagLines(0.0, _FAR_TAG_DB, snr_db, 0.0)
    error = far.phase_std_deg(_packets_of_a_reading(timing), free.shape[1])
    return {"kept_db": single.kept_db, "tag_db": _FAR_TAG_DB, "phase_error_deg": error}


def _notes(recording, states):
    yield from recording.notes
    if states.foreign:
        yield f"left out {states.foreign} x {FOREIGN}"


def _snapshot_advice(found):
    timing, antennas, tag = found["timing"], found["antennas"], found["tag"]
    if antennas["count"] == 1 and (tag or found["one_antenna"])["phase_error_deg"] > WEAK_PHASE_DEG:
        yield (
            "use a receiver with two antennas on one oscillator, or a wider band: with one "
            "antenna, what varies over the subcarriers as the direct path does is lost"
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
    elif tag["phase_error_deg"] > WEAK_PHASE_DEG:
        yield "the tag is weak: bring it nearer, send more packets, or read longer groups"
    if timing["rounded_to_s"]:
        yield (
            f"time stamps are rounded to {1e3 * timing['rounded_to_s']:g} ms: store microseconds, "
            "by the clock of the card"
        )
    if timing["clock_steps"]:
        yield "the card's clock stepped back: record again, or read either part alone"
    if timing["packets_per_s"] < 100:
        yield f"send more packets: {timing['packets_per_s']:.0f} per second need long readings"
    if min(antennas["level_db"]) < -20:
        yield "one antenna receives next to nothing: check its connector"


def snapshots_text(found):
    """The result of :func:`check_snapshots` for a terminal."""
    file, timing, antennas, tag = (found[key] for key in ("file", "timing", "antennas", "tag"))
    level_db, snr_db = ("/".join(f"{v:g}" for v in antennas[k]) for k in ("level_db", "snr_db"))
    size = f"{file['packets']} in {file['seconds']:.3g} s, {file['subcarriers']} subcarriers over"
    rate = f"{timing['packets_per_s']:.0f} packets/s"
    interval = f"median interval {1e3 * timing['median_interval_s']:.3g} ms"
    snr = f"SNR of one packet {snr_db} dB"
    lines = [
        ("file", f"{file['path']}: {file['kind']}"),
        ("packets", f"{size} {file['bandwidth_hz'] / 1e6:.3g} MHz, {carrier_text(file)}"),
        ("timing", f"{rate}, {interval}, {_gaps(timing)}"),
        ("antennas", f"{antennas['count']}, levels {level_db} dB, {snr}"),
    ]
    reading = f"in readings of {_READING_S:g} s"
    if antennas["count"] > 1:
        changes = f"{antennas['states']} states, {antennas['changes']} changes: followed; "
        within = f"between the antennas they vary by {antennas['phase_std_deg']:.2g} deg rms"
        several = antennas["states"] > 1
        lines.append(("phases", f"{changes}within a state, {within}" if several else within))
    if alone := found["one_antenna"]:
        part = f"{alone['kept_db']:.1f} dB of a tag beside the phases of the packets"
        error = f"errors of {alone['phase_error_deg']:.2g} deg {reading}"
        far = f"for one {-alone['tag_db']:.0f} dB below the direct path"
        lines.append(("left", f"{part}, as there is one antenna: {error} {far}"))
    if tag is None:
        lines.append(("tag", "none is seen between 50 and 400 Hz"))
    else:
        seen = "or a lamp, seen" if tag["may_be_a_lamp"] else "seen"
        below = f"line 1 is {-tag['line_db']:.0f} dB below the direct path"
        error = f"phase errors of {tag['phase_error_deg']:.2g} deg {reading}, by noise alone"
        at = f"{seen} at {tag['clock_hz']:.2f} Hz: {below}, snr_db {tag['snr_db']:.0f}"
        lines += [("tag", at), ("allows", error)]
    return labelled(lines, found)


def _gaps(timing):
    words = f"{timing['gaps']} gaps" if timing["gaps"] else "no gaps"
    if timing["gaps"]:
        words += f" (longest {timing['longest_gap_s']:.3g} s)"
    if timing["clock_steps"]:
        words += f", clock stepped back {timing['clock_steps']} x"
    if timing["rounded_to_s"]:
        words += f", stamps rounded to {1e3 * timing['rounded_to_s']:g} ms"
    return words


def check_file(path, scene_path, datatype, csi):
    """What a file of any kind is, and the same for a terminal; the options say what it may be."""
    if datatype is None and csi is None and _is_raw(path):
        datatype = likely_datatype(path)
    recording = open_recording(path, datatype, csi)
    if isinstance(recording, ChannelSnapshots):
        refuse({"--datatype": datatype, "--scene": scene_path}, SAMPLES_ONLY)
        found = check_snapshots(recording, _kind(path, csi))
        return found, snapshots_text(found)
    if scene_path is None and recording.scene is None:
        return check_samples(recording)
    return check_capture(path, scene_path, datatype)


def _is_raw(path):
    """Whether a file has neither metadata nor a format that is known."""
    file = Path(path)
    if not file.is_file():
        return False  # and refused where it is opened
    known = is_snapshots(path) or file.suffix in (".sigmf-data", ".sigmf-meta")
    metadata = file.with_name(f"{file.name}.sigmf-meta")
    return not known and not metadata.exists() and tool_of(path) is None


def _kind(path, csi):
    tool = (csi or {}).get("tool") or tool_of(path)
    if tool is None:
        return "channel snapshots (.npz)"
    return f"channel snapshots of {tool}"
