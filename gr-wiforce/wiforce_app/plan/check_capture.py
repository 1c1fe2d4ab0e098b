# SPDX-License-Identifier: GPL-3.0-or-later
"""``check CAPTURE``: levels, frames and clocks of samples, and what to change."""

import hashlib
import math
from dataclasses import asdict
from statistics import NormalDist

import numpy as np
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.estimation.capture.frame import measure_levels, whole_frames
from gnuradio.wiforce.estimation.capture.recorded_frames import first_frame
from gnuradio.wiforce.estimation.groups import Groups
from gnuradio.wiforce.io.capture import open_capture
from gnuradio.wiforce.io.capture.names import second_antenna
from gnuradio.wiforce.io.capture.samples import CLIPPED, likely_datatype
from gnuradio.wiforce.planning.findings import measure_tags, other_clocks, wrong_clocks
from gnuradio.wiforce.planning.plan import plan
from gnuradio.wiforce.receiver.recording import RecordingReader
from gnuradio.wiforce.scene import scene_of

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


def advice_on_sensors(tags, scene, others_hz, wrong):
    """What to change because of measured tags, other clocks, and wrong ones by sensor."""
    others = other_clocks(others_hz)
    for tag, sensor in zip(tags, scene.sensors, strict=False):
        yield from _of_sensor(tag, sensor, others, wrong.get(sensor.name, ""))


def _of_sensor(tag, sensor, others, wrong):
    if tag.clock_offset_ppm is None:
        check = (
            f"none is within clock_tolerance_ppm ({sensor.clock_tolerance_ppm:g}) of it; check "
            "that it is on and near enough, and clock_hz in the scene"
        )
        cause = wrong or others or check
        yield f"{sensor.name}: no tag detected at {sensor.clock_hz:g} Hz: {cause}"
        return
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
_PART_BYTES = 1 << 20


def check_capture(path, scene_path, datatype=None):
    """Verify a capture by its own or a scene; what was found, and the same for a terminal.

    ``files``, ``first_frame``, ``levels``, ``sensors``, ``advice``, ``notes``, ``warnings``.
    """
    capture = open_capture(path, datatype)
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
    advice = [*advice_on_levels(levels), *advice_on_sensors(tags, scene, *clocks)]
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
        "peak_dbfs": _db(parts.max(initial=0)),
        "mean_dbfs": _db(np.sqrt(2 * np.mean(parts**2)) if parts.size else 0.0),
        "dc_dbfs": _db(np.abs(samples.mean()) if parts.size else 0.0),
        "clipped": float(np.mean(np.any(parts >= CLIPPED, axis=1))) if parts.size else 0.0,
        "not_finite": float(np.mean(~finite)) if parts.size else 0.0,
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
    note = "without a scene frames, and thus a tag, cannot be looked for; name one with --scene"
    advice = advice or ["none on levels"]
    found = {"file": file, "levels": levels, "tag": None, "notes": [note], "advice": advice}
    powers = "peak {peak_dbfs:.1f} dBFS, mean {mean_dbfs:.1f}".format(**levels)
    lines = [
        *_file_lines(file),
        ("levels", f"{powers}, {100 * levels['clipped']:.3g} % clipped"),
        ("DC offset", f"{levels['dc_dbfs']:.1f} dBFS"),
    ]
    return found, labelled(lines, found)


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
    _verify(capture)
    rate = rate_hz if capture.sample_rate_hz is None else capture.sample_rate_hz
    return {
        "path": str(capture.path),
        "datatype": capture.datatype,
        "sample_rate_hz": rate,
        "center_frequency_hz": capture.center_frequency_hz,
        "samples": capture.samples,
        "seconds": None if rate is None else capture.span / rate,
        "gaps": len(capture.segments) - 1,
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
    if capture.sha512 is None:
        return
    digest = hashlib.sha512()
    with open(capture.path, "rb") as stream:
        while part := stream.read(_PART_BYTES):
            digest.update(part)
    found = digest.hexdigest()
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
    noise = levels["noise_dbfs"]
    return [
        ("peak", f"{levels['peak_dbfs']:.1f} dBFS, {100 * levels['clipped']:.3g} % clipped"),
        ("preamble", f"{levels['preamble_dbfs']:.1f} dBFS"),
        ("noise", "unknown" if noise is None else f"{noise:.1f} dBFS"),
        ("DC offset", f"{levels['dc_dbfs']:.1f} dBFS"),
        ("phase", _phase_noise(levels["phase_noise_dbc_hz"])),
    ]


def _phase_noise(density_dbc_hz):
    if density_dbc_hz is None:
        return "noise of the synthesizers is hidden by other noise"
    return f"noise of the synthesizers {density_dbc_hz:.0f} dBc/Hz"
