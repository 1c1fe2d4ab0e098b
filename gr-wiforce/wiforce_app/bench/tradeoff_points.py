# SPDX-License-Identifier: GPL-3.0-or-later
"""One scene under every sensible setting: what each costs, and how far its readings are off."""

import dataclasses
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from gnuradio.wiforce.angles import wrap_deg
from gnuradio.wiforce.capture import open_capture
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.readout import Readout
from gnuradio.wiforce.scene import load_scene
from gnuradio.wiforce.scene.channel import AirChannel
from gnuradio.wiforce.scene.expected import MEDIAN, expect
from gnuradio.wiforce.scene.plan import plan
from gnuradio.wiforce.scene.score import read_truth, score
from gnuradio.wiforce.scene.simulator import simulate, write_truth

from .chain import SnapshotChain
from .throughput.recording import GROUP_LENGTH, WAVEFORM, Recording

_GROUP_LENGTHS = (125, 250, 625, 1250)
_HARMONICS = (8, 12, 16, 24)
_CLUTTER_HZ = (0.0, 250.0)
_PART_FC32 = 10_000_000  # samples converted at a time


@dataclass(frozen=True)
class Setting:
    """A point of the picture: what differs from the plan's choice."""

    name: str
    scene: object
    plan: object
    source: str = "file-sc16"
    order: str = "tones first"


def settings_of(scene):
    """Settings of a scene, what its plan chose first."""
    chosen = plan(scene)
    found = [Setting("plan", scene, chosen)]

    def vary(name, group=None, environment=None, **changes):
        other = scene
        if group:
            other = dataclasses.replace(
                other, phase_group=dataclasses.replace(scene.phase_group, **group)
            )
        if environment:
            other = dataclasses.replace(
                other, environment=dataclasses.replace(scene.environment, **environment)
            )
        try:
            varied = dataclasses.replace(plan(other), **changes)
            _ = varied.table  # lines that a group cannot tell apart are refused
        except InputError:
            return
        found.append(Setting(name, other, varied))

    for length in _GROUP_LENGTHS:
        if length != chosen.group_length:
            vary(f"N_g {length}", group={"snapshots": length})
    for harmonics in _HARMONICS:
        if harmonics != chosen.harmonics:
            vary(f"lines to +-{harmonics}", harmonics=harmonics)
    for band in _CLUTTER_HZ:
        if band != chosen.clutter_hz:
            vary(f"clutter band {band:g} Hz", environment={"moving_clutter_hz": band})
    for estimator in ("sideband", "paper"):
        if estimator != chosen.estimator:
            vary(estimator, group={"estimator": estimator})
    for step, label in ((2, "every second"), (4, "every fourth")):
        vary(f"{label} subcarrier", waveform=_thinned(chosen.waveform, step))
    for source in ("file-fc32", "stream-sc16", "stream-fc32"):
        found.append(Setting(source, scene, chosen, source))
    found.append(Setting("channel first", scene, chosen, "stream-fc32", "channel first"))
    if chosen.waveform.frame_length == WAVEFORM.frame_length and (
        chosen.waveform.name == WAVEFORM.name and chosen.group_length == GROUP_LENGTH
    ):
        found.append(Setting("stock blocks", scene, chosen, "stream-fc32", "stock"))
    return found


def _thinned(waveform, step):
    kept = slice(None, None, step)
    return dataclasses.replace(
        waveform, subcarriers=waveform.subcarriers[kept], reference=waveform.reference[kept]
    )


def measure_scene(name, folder, runs, progress=lambda steps: None):
    """Simulates a scene and reads it under all its settings.

    Parameters
    ----------
    name : str
    folder : path
        For the capture while it is needed.
    runs : int
        The time of a setting is the least of so many runs.
    progress : callable
        Called with 1 after each setting.

    Returns
    -------
    dict
        ``scene``, ``signal_s``, and ``points``: a dict per setting, plain values.
    """
    scene = load_scene(name)
    with tempfile.TemporaryDirectory(dir=folder, prefix=".tradeoff-") as place:
        capture = Path(place) / "capture"
        simulate(scene, capture)
        recording = _both_types(open_capture(capture), Path(place))
        signal_s = recording.samples / scene.radio.sample_rate_hz
        models = [sensor.load_model(scene) for sensor in scene.sensors]
        points = []
        for setting in settings_of(scene):
            truth = _truth(setting.scene, Path(place) / "truth.csv")
            points.append(_measure(setting, models, recording, truth, signal_s, runs))
            progress(1)
    return {"scene": str(name), "signal_s": signal_s, "points": points}


def _both_types(capture, folder):
    """The capture as raw files of both sample types."""
    sc16 = Path(capture.path)
    codes = np.memmap(sc16, "<i2", "r")
    fc32 = folder / "capture.cf32"
    with open(fc32, "wb") as stream:
        for start in range(0, len(codes), _PART_FC32):
            stream.write(codes[start : start + _PART_FC32].astype("<f4") / np.float32(32768))
    return Recording(fc32, sc16, len(codes) // 2)


def _truth(scene, path):
    """Truth rows at the centres of a scene's groups, with the phases of the mean reflection."""
    air = AirChannel(scene)
    write_truth(scene, air, path)
    rows = read_truth(path)
    for row in rows:
        pressed = air.sensors[row["sensor"]].pressed
        phases = pressed.mean_phases_deg([row["time_s"]], scene.group_period_s)[0]
        row["phase1_deg"], row["phase2_deg"] = phases
    return rows


def _measure(setting, models, recording, truth, signal_s, runs):
    samples = min(_tone_seconds(setting, recording) for _ in range(runs))
    flowgraph = _flowgraph(setting, recording)
    flowgraph.run()
    tones, spent = flowgraph.tones[0], []
    for _ in range(runs):
        chain, readout = _python_part(setting, models)
        began = time.process_time()
        readings = _read(chain, readout, tones)
        spent.append(time.process_time() - began)
    groups = min(spent)
    point = {
        "setting": setting.name,
        "cpu_s_per_s": (samples + groups) / signal_s,
        "samples_s_per_s": samples / signal_s,
        "groups_s_per_s": groups / signal_s,
        "readings_per_s": 1 / setting.plan.group_period_s,
        "group_length": setting.plan.group_length,
        "bound_deg": _bound_deg(setting),
    }
    return point | _errors(setting, readings, truth)


def _bound_deg(setting):
    expected = expect(setting.scene, setting.plan)
    return float(MEDIAN * np.sqrt(np.mean([np.square(e.phase_std_deg) for e in expected])))


def _errors(setting, readings, truth):
    """Median errors over all sensors, against the untouched sensor as the reader knows it."""
    phase, force, location = [], [], []
    for i, sensor in enumerate(setting.scene.sensors):
        found = score(readings, truth, sensor.name)
        phase.append(wrap_deg(found.phase_error_deg - _calibration_bias_deg(setting.scene, i)))
        force.append(found.force_error_n)
        location.append(found.location_error_mm)
    pooled = {"phase_deg": np.concatenate([p.ravel() for p in phase])}
    pooled |= {"force_n": np.concatenate(force), "location_mm": np.concatenate(location)}
    return {"read": int(pooled["force_n"].size)} | {
        key: float(np.median(np.abs(errors))) if errors.size else None
        for key, errors in pooled.items()
    }


def _calibration_bias_deg(scene, index):
    """By how much the reader's untouched phases differ from the true ones; shape (2,)."""
    frequency = scene.radio.center_frequency_hz
    known = scene.sensors[index].load_model(scene).untouched_deg(frequency)
    true = scene.load_model(scene.simulation.tags[index].truth_model).untouched_deg(frequency)
    return wrap_deg(np.subtract(known, true))


# samples to tones: the C++ blocks, or stock ones


def _tone_seconds(setting, recording):
    flowgraph = _flowgraph(setting, recording)
    began = time.process_time()
    flowgraph.run()
    return time.process_time() - began


def _flowgraph(setting, recording):
    from gnuradio import blocks, wiforce

    from .throughput.chains import CHAINS, Flowgraph, sample_type

    table, waveform = setting.plan.table, setting.plan.waveform
    if setting.order == "stock":
        return CHAINS["stock-tuned"](recording, table.weights)
    kind, item_type = setting.source.split("-")
    path, size, datatype = sample_type(recording, item_type)
    frame = {
        "frame_length": waveform.frame_length,
        "first_averaged": waveform.first_averaged,
        "repetitions": waveform.repetitions,
    }
    group = {"weights": table.weights, "group_length": setting.plan.group_length}
    flowgraph = Flowgraph()
    if kind == "file":
        segments = [(0, 0, recording.samples)]
        chain = [wiforce.recording_source.tones(path, datatype, segments, **group, **frame)]
    else:
        source = blocks.file_source(size, path, False, 0, recording.samples)
        if setting.order == "tones first":
            chain = [source, wiforce.preamble_fold.tones(**group, **frame, item_type=item_type)]
        else:
            chain = [source, wiforce.preamble_fold(**frame, item_type=item_type)]
    factors = waveform.equalizer().astype(np.complex64)
    if setting.order == "tones first":
        rotation = table.derotation(waveform.sample_rate_hz).astype(np.complex64)
        chain.append(wiforce.ofdm_channel_estimator(factors, len(table.tones), rotation))
    else:
        chain.append(wiforce.ofdm_channel_estimator(factors, 1))
        chain.append(wiforce.phase_group_doppler(**group))
    flowgraph.top.connect(*chain)
    flowgraph.end(chain[-1])
    return flowgraph


# tones to readings: what the Python blocks of a reader compute


def _python_part(setting, models):
    """SnapshotChain and Readout of a setting, tables and all."""
    scene, settings = setting.scene, setting.plan
    sensors = zip(scene.sensors, models, strict=True)
    readout = Readout(
        [(sensor.name, model, np.asarray(sensor.off_reflection)) for sensor, model in sensors],
        scene.radio.center_frequency_hz,
        settings.group_period_s,
    )
    return SnapshotChain(settings, setting.order == "tones first"), readout


def _read(chain, readout, tones):
    readings = []
    for group, item in enumerate(tones):
        for state, ratios in chain.process_tones(group, item):
            readings += readout.process(state, ratios)
    for state, ratios in chain.flush():
        readings += readout.process(state, ratios)
    return readings + readout.flush()
