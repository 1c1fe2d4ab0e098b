# SPDX-License-Identifier: GPL-3.0-or-later
"""``check FILE``: what a capture or a file of snapshots is, and what to change first."""

import math
from dataclasses import asdict, replace
from pathlib import Path
from statistics import NormalDist

import numpy as np
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.estimation.capture.frame import measure_levels, whole_frames
from gnuradio.wiforce.estimation.capture.recorded_frames import first_frame
from gnuradio.wiforce.estimation.groups import Groups
from gnuradio.wiforce.estimation.packets.antenna_states import LEAST_STEP, TAG_STEP, find_states
from gnuradio.wiforce.estimation.packets.packet_channels import AntennaCombination
from gnuradio.wiforce.estimation.packets.packet_survey import (
    TagLines,
    find_tag,
    phase_std_deg,
    snapshot_snr_db,
)
from gnuradio.wiforce.io.capture import open_capture
from gnuradio.wiforce.io.capture.channel_snapshots import ChannelSnapshots
from gnuradio.wiforce.io.capture.names import is_snapshots, second_antenna
from gnuradio.wiforce.io.capture.samples import CLIPPED, likely_datatype
from gnuradio.wiforce.io.capture.sigmf_metadata import sha512_of
from gnuradio.wiforce.io.csi_tools import tool_of
from gnuradio.wiforce.io.readings import WEAK_PHASE_DEG
from gnuradio.wiforce.planning.advice import outside_band
from gnuradio.wiforce.planning.findings import measure_tags, other_clocks, wrong_clocks
from gnuradio.wiforce.planning.plan import plan
from gnuradio.wiforce.receiver.recording_reader import RecordingReader
from gnuradio.wiforce.scene import scene_of
from gnuradio.wiforce.scene.consistency import ONE_ANTENNA, lacks_antenna
from gnuradio.wiforce.signal.lines import lamp_distances_hz

from ..read.recordings import SAMPLES_ONLY, open_recording
from ..shell.options import refuse


def check_file(path, scene_path, datatype, csi):
    """What a file of any kind is, and the same for a terminal."""
    if datatype is None and csi is None and _is_raw(path):
        datatype = likely_datatype(path)
    recording = open_recording(path, datatype, csi)
    if isinstance(recording, ChannelSnapshots):
        refuse({"--datatype": datatype, "--scene": scene_path}, SAMPLES_ONLY)
        tool = (csi or {}).get("tool") or tool_of(path)
        kind = "channel snapshots (.npz)" if tool is None else f"channel snapshots of {tool}"
        found = check_snapshots(recording, kind)
        return found, snapshots_text(found)
    if scene_path is None and recording.scene is None:
        return check_samples(recording)
    return check_capture(recording, scene_path)


def _is_raw(path):
    """Whether a file has neither metadata nor a format that is known."""
    file = Path(path)
    if not file.is_file():
        return False  # and refused where it is opened
    known = is_snapshots(path) or file.suffix in (".sigmf-data", ".sigmf-meta")
    metadata = file.with_name(f"{file.name}.sigmf-meta")
    return not known and not metadata.exists() and tool_of(path) is None


_MOST_CLIPPED = 0.99  # share of samples from which on it does not tell the level any more


def advice_on_levels(levels):
    """What to change because of levels, the fields of ``Levels``."""
    peak, clipped = levels["peak_dbfs"], levels["clipped"]
    if clipped:
        more = " or more" if clipped > _MOST_CLIPPED else ""
        yield (
            f"the receiver is saturated ({100 * clipped:.3g} % clipped): lower --rx-gain, then "
            f"--tx-gain, by {_excess_db(clipped):.0f} dB{more} in total"
        )
        return  # what was clipped has an offset of its own
    if peak > -1:
        yield f"the receiver is almost saturated (peak {peak:.1f} dBFS): lower --rx-gain by 6 dB"
    elif peak < -20:
        more = f"raise --tx-gain, then --rx-gain, by {-6 - peak:.0f} dB in total"
        yield f"the receive level is low (peak {peak:.1f} dBFS): {more}"
    if levels["dc_dbfs"] > -20:
        yield f"the DC offset is high ({levels['dc_dbfs']:.1f} dBFS): calibrate the device"


def _excess_db(clipped):
    """How many dB a level is too high, by the share of samples of Gaussian I and Q that clip."""
    whole = math.sqrt(1 - min(clipped, _MOST_CLIPPED))  # share of I, and of Q
    deviation = 1 / NormalDist().inv_cdf((1 + whole) / 2)
    return 20 * math.log10(4 * deviation) + 6


def advice_on_sensors(tags, scene, others_hz, wrong_by_sensor):
    """What to change because of measured tags, other clocks, and wrong ones by sensor."""
    for tag, sensor in zip(tags, scene.sensors, strict=False):
        wrong = wrong_by_sensor.get(sensor.name, "")
        if tag.clock_offset_ppm is None:
            check = (
                f"none is within clock_tolerance_ppm ({sensor.clock_tolerance_ppm:g}) of it; check "
                "that it is on and near enough, and clock_hz in the scene"
            )
            cause = wrong or other_clocks(others_hz) or check
            yield f"{sensor.name}: no tag detected at {sensor.clock_hz:g} Hz: {cause}"
            continue
        if abs(tag.clock_offset_ppm) > 0.8 * sensor.clock_tolerance_ppm:
            yield (
                f"{sensor.name}: its clock offset is {tag.clock_offset_ppm:+.0f} ppm: raise "
                "clock_tolerance_ppm in the scene"
            )
        errors = tag.phase_error_deg
        if None in errors or max(errors, default=0) > 1.5:
            error = "unknown" if None in errors else f"{max(errors):.1f} deg"
            remedy = "raise --tx-gain, move the antennas closer, or use longer phase groups"
            yield f"{sensor.name}: the expected phase error is {error}: {wrong or remedy}"


LEVEL_FRAMES = 4000  # levels need no more


def check_capture(capture, scene_path):
    """Verify a capture by its own or a scene; what was found, and the same for a terminal.

    ``files``, ``first_frame``, ``levels``, ``sensors``, ``advice``, ``notes``, ``warnings``.
    """
    scene, differences = scene_of(capture, scene_path)
    antennas = [capture]
    if scene.environment.receive_antennas == 2:
        antennas.append(open_capture(second_antenna(capture.path.with_suffix(""))))
    files = []
    for antenna in antennas:
        antenna.check_against(scene)
        files.append(_file(antenna, scene.radio.sample_rate_hz))
    waveform = scene.waveform()
    first, place = first_frame(capture, waveform)
    length = waveform.frame_length
    samples = capture.read_span(first + place - place % length, LEVEL_FRAMES * length)
    frames = whole_frames(samples, length)
    finite = frames[np.isfinite(frames).all(axis=1)]
    if not len(finite):
        raise InputError(capture.path, "holds no whole frame of finite samples")
    levels = asdict(measure_levels(finite.ravel(), waveform))
    tags, clocks, reason = _tags(capture, scene)
    alone = [f"{ONE_ANTENNA}: record two antennas"] if lacks_antenna(scene) else []
    of_sensors = alone or advice_on_sensors(tags, scene, *clocks)
    advice = [*outside_band(scene), *advice_on_levels(levels), *of_sensors]
    found = {
        "files": files,
        "first_frame": first,
        "levels": levels,
        "sensors": [asdict(tag) for tag in tags],
        "advice": advice,
        "notes": reason,
        "warnings": [*differences, *_warnings(antennas, files)],
    }
    lines = [line for file in files for line in _file_lines(file)]
    lines.append(("frames", f"found; the first begins at sample {first}"))
    lines += [*level_lines(levels), *((tag.name, tag) for tag in tags)]
    ready = "none, ready to be read; only `read` can tell whether its start was untouched"
    return found, labelled(lines, {**found, "advice": advice or [ready]})


# Samples that are looked at where no scene is known, the first ones.
_MOST_SAMPLES = 4_000_000


def check_samples(capture):
    """What a file of samples is when no scene says so, and the same for a terminal."""
    samples = capture.read(_MOST_SAMPLES)
    finite = np.isfinite(samples)
    samples[~finite] = 0
    parts = np.abs(samples.view(np.float32).reshape(-1, 2))
    levels = {
        "peak_dbfs": _db(parts.max()),
        "mean_dbfs": _db(np.sqrt(2 * np.mean(parts**2))),
        "dc_dbfs": _db(np.abs(samples.mean())),
        "clipped": float(np.mean(np.any(parts >= CLIPPED, axis=1))),
        "not_finite": float(np.mean(~finite)),
    }
    file = {**_file(capture), "likely_datatype": likely_datatype(capture.path)}
    advice, likely = [*advice_on_levels(levels)], file["likely_datatype"]
    if likely not in (None, capture.datatype):
        advice.insert(
            0, f"the values are those of {likely} rather than {capture.datatype}: check the type"
        )
    elif levels["not_finite"]:
        advice.insert(0, "some samples are NaN or infinite: check what wrote the file")
    if file["samples_lost"]:
        advice.append("samples were lost while recording: use a faster machine or larger buffers")
    tag, notes = _default_frames(capture)
    if capture.incomplete:
        notes = [f"the file {capture.incomplete}", *notes]
    advice = advice or ["none on levels"]
    found = {"file": file, "levels": levels, "tag": tag, "notes": notes, "advice": advice}
    powers = "peak {peak_dbfs:.1f} dBFS, mean {mean_dbfs:.1f}".format(**levels)
    lines = [
        *_file_lines(file),
        ("levels", f"{powers}, {100 * levels['clipped']:.3g} % clipped"),
        ("DC offset", f"{levels['dc_dbfs']:.1f} dBFS"),
    ]
    if tag is not None:
        begin = f"the first begins at sample {tag['first_frame']}"
        lines.append(("frames", f"those of the waveform '{tag['waveform']}'; {begin}"))
        clocks = " and ".join(f"{hertz:.6g} Hz" for hertz in tag["clocks_hz"])
        lines.append(("tag", f"a clock of {clocks} is received" if clocks else "none is received"))
    return found, labelled(lines, found)


def _default_frames(capture):
    """Frames of 720 samples of a default waveform with the tags' clocks, or None; and notes."""
    more = "name a scene with --scene"
    if capture.sample_rate_hz is None:
        return None, [f"without a sample rate frames and tags are not looked for; {more}"]
    for waveform in ("repeated", "wifi"):
        radio = {"sample_rate_hz": capture.sample_rate_hz}
        if capture.center_frequency_hz is not None:
            radio["center_frequency_hz"] = capture.center_frequency_hz
        # The survey finds tags on other clocks as well; any sensor near the carrier will do.
        near = 2400 if (capture.center_frequency_hz or 0.0) > 1.5e9 else 900
        sensor = {"name": "tag", "model": f"line-{near}mhz"}
        settings = {"radio": radio, "sounding": {"waveform": waveform}, "sensors": [sensor]}
        try:
            scene = scene_of(capture, settings)[0]
        except InputError:  # of a key that nobody has written, such as the default clock
            unlike = "default ones do not fit this sample rate and carrier"
            return None, [f"no scene is known, and {unlike}: frames were not looked for; {more}"]
        try:
            first, _ = first_frame(capture, scene.waveform())
        except InputError:
            continue
        tags, (others_hz, _), reason = _tags(capture, scene)
        own_hz = [
            scene.sensors[0].clock_hz * (1 + 1e-6 * tag.clock_offset_ppm)
            for tag in tags
            if tag.clock_offset_ppm is not None
        ]
        found = {"waveform": waveform, "first_frame": first, "clocks_hz": [*own_hz, *others_hz]}
        return found, [*reason, f"these are frames of the default length; to read them, {more}"]
    return None, [f"no frames of the default waveforms were found; for others, {more}"]


def _db(amplitude):
    return float(20 * np.log10(max(amplitude, 1e-15)))


def _tags(capture, scene):
    """The scene's tags in a capture's first groups, others, and wrong clocks; or the reason."""
    groups = []
    try:
        reader = RecordingReader(capture, plan(scene), on_groups=groups.append)
        next(iter(reader))
    except InputError as error:
        return [], ([], {}), [f"tags were not looked for: {error}"]
    seen = groups[0] if groups else Groups(np.zeros(0, np.int64))
    others_hz = [clock.clock_hz for clock in reader.plan.others]
    clocks = others_hz, wrong_clocks(reader.survey, reader.plan)
    return measure_tags(reader.plan, seen), clocks, []


def _file(capture, rate_hz=None):
    """What a file is; its rate, where it states none, is that of a scene."""
    if capture.sha512 is not None:
        _verify(capture)
    rate = rate_hz if capture.sample_rate_hz is None else capture.sample_rate_hz
    return {
        "path": str(capture.path),
        "datatype": capture.datatype,
        "sample_rate_hz": rate,
        "center_frequency_hz": capture.center_frequency_hz,
        "samples": capture.samples,
        "seconds": None if rate is None else capture.span / rate,
        "gaps": capture.gaps,
        "samples_lost": capture.span - capture.samples,
        "checksum": "none" if capture.sha512 is None else "verified",
    }


def _file_lines(file):
    rate, long = "rate unknown", "length unknown"
    if file["sample_rate_hz"] is not None:
        rate, long = f"{file['sample_rate_hz'] / 1e6:g} Msps", f"{file['seconds']:.3f} s"
    lost = f"{file['samples_lost']} samples lost in {file['gaps']} gaps"
    return [
        ("capture", f"{file['path']}: {file['datatype']}, {rate}, {carrier_text(file)}"),
        ("length", f"{long}, {file['samples']} samples, {lost}"),
        ("checksum", file["checksum"]),
    ]


def _verify(capture):
    found = sha512_of(capture.path)
    if found != capture.sha512.lower():
        rule = (
            "must have the checksum that its metadata state (core:sha512 "
            f"{capture.sha512[:12]}...): the samples were changed, or the file is incomplete"
        )
        raise InputError(capture.path, rule, f"{found[:12]}...")


def _warnings(antennas, files):
    for file in files:
        if file["checksum"] == "none":
            yield f"{file['path']}: no checksum is known; changed samples go unnoticed"
    for antenna in antennas:
        if antenna.incomplete:
            yield f"{antenna.path}: {antenna.incomplete}"
    antennas = sorted(antennas, key=lambda capture: capture.span)
    if antennas[0].span != antennas[-1].span:
        lacking = antennas[-1].span - antennas[0].span
        yield f"{antennas[0].path}: ends {lacking} samples before {antennas[-1].path}"


def labelled(lines, found):
    """Lines for a terminal: labels and texts, then advice, notes and warnings."""
    for key, label in (("advice", "advice"), ("notes", "note"), ("warnings", "warning")):
        lines = [*lines, *((label, text) for text in found.get(key, ()))]
    return "\n".join(f"{label:10s} {text}" for label, text in lines)


def carrier_text(file):
    """The carrier of a file, in words."""
    hertz = file["center_frequency_hz"]
    return "unknown carrier" if hertz is None else f"carrier {hertz / 1e6:g} MHz"


def level_lines(levels):
    """The fields of :class:`Levels` as labels and texts."""
    noise, density = levels["noise_dbfs"], levels["phase_noise_dbc_hz"]
    phase = "is hidden by other noise" if density is None else f"{density:.0f} dBc/Hz"
    return [
        ("peak", f"{levels['peak_dbfs']:.1f} dBFS, {100 * levels['clipped']:.3g} % clipped"),
        ("preamble", f"{levels['preamble_dbfs']:.1f} dBFS"),
        ("noise", "unknown" if noise is None else f"{noise:.1f} dBFS"),
        ("DC offset", f"{levels['dc_dbfs']:.1f} dBFS"),
        ("phase", f"noise of the synthesizers {phase}"),
    ]


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
    answer["notes"] = [*recording.notes, *states.notes]
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
