# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce bench tradeoff``: run time against error, for every scene and sensible setting."""

import dataclasses
import multiprocessing
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import click
import numpy as np
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.estimation.groups import Groups
from gnuradio.wiforce.io.capture import open_capture
from gnuradio.wiforce.planning.expected import MEDIAN, phase_std_deg
from gnuradio.wiforce.planning.plan import HARMONICS, plan
from gnuradio.wiforce.receiver import Receiver
from gnuradio.wiforce.scene import load_scene
from gnuradio.wiforce.signal.carrier import wrap_deg
from gnuradio.wiforce.simulation.channel import AirChannel
from gnuradio.wiforce.simulation.simulator import simulate
from gnuradio.wiforce.simulation.truth import read_truth, score, write_truth

from ..evaluate.error_summary import calibration_bias_deg
from ..evaluate.experiment import with_mean_phases
from ..shell.progress import progress
from ..shell.tables import Column, echo, table
from .recording import GROUP_LENGTH, WAVEFORM, Recording

_GROUP_LENGTHS = (125, 250, 625, 1250)
_CLUTTER_HZ = (0.0, 250.0)
_BATCH = 64  # groups
_PART_FC32 = 10_000_000  # samples converted at a time


@dataclass(frozen=True)
class Setting:
    """One setting: scene and plan with one change from the planner's choice."""

    name: str
    plan: object
    source: str = "file-sc16"
    order: str = "tones first"


def settings_of(scene):
    """Settings of a scene; the first one is the planner's choice."""
    chosen = plan(scene)
    found = [Setting("plan", chosen)]

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
            varied.check_lines()
        except InputError:
            return
        found.append(Setting(name, varied))

    for length in _GROUP_LENGTHS:
        if length != chosen.group_length:
            vary(f"N_g {length}", group={"snapshots": length})
    for harmonics in HARMONICS:
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
        found.append(Setting(source, chosen, source))
    for order in ("block by block", "channel first"):
        found.append(Setting(order, chosen, "stream-fc32", order))
    if chosen.waveform.frame_length == WAVEFORM.frame_length and (
        chosen.waveform.name == WAVEFORM.name and chosen.group_length == GROUP_LENGTH
    ):
        found.append(Setting("stock blocks", chosen, "stream-fc32", "stock"))
    if scene.environment.receive_antennas == 2:
        # The ratio of two antennas is taken from folded frames, which only files provide here.
        return [setting for setting in found if setting.source.startswith("file")]
    return found


def _thinned(waveform, step):
    kept = slice(None, None, step)
    return dataclasses.replace(
        waveform, subcarriers=waveform.subcarriers[kept], reference=waveform.reference[kept]
    )


def measure_scene(name, runs):
    """Simulate a scene and read it with all its settings; times are the least of runs.

    Gives plain values: ``scene``, ``signal_s`` and ``points`` (a dict per setting).
    """
    from gnuradio import gr

    gr.logging().set_default_level(gr.log_levels.off)
    scene = load_scene(name)
    with tempfile.TemporaryDirectory(prefix="wiforce-tradeoff-") as place:
        place = Path(place)
        written = simulate(scene, place / "capture")
        captures = [open_capture(path) for path in written if path.suffix == ".sigmf-meta"]
        recordings = [_both_types(capture) for capture in captures]
        signal_s = recordings[0].samples / scene.radio.sample_rate_hz
        scene_run = _SceneRun(recordings, place / "truth.csv", signal_s, runs)
        points = scene_run.measure(settings_of(scene))
    return {"scene": str(name), "signal_s": signal_s, "points": points}


def _both_types(capture):
    """The capture as raw files of both sample types."""
    sc16 = Path(capture.path)
    codes = np.memmap(sc16, "<i2", "r")
    fc32 = sc16.with_suffix(".cf32")
    with open(fc32, "wb") as stream:
        for start in range(0, len(codes), _PART_FC32):
            stream.write(codes[start : start + _PART_FC32].astype("<f4") / np.float32(32768))
    return Recording(fc32, sc16, len(codes) // 2)


def _truth(scene, path):
    """Truth at the centres of the groups, with the phases of the mean reflection."""
    write_truth(scene, AirChannel(scene), path)
    return with_mean_phases(scene, read_truth(path))


def _timed(work, *arguments):
    """Processor time of a call, and its result."""
    began = time.process_time()
    given = work(*arguments)
    return time.process_time() - began, given


def _least(times, key, spent):
    times[key] = min(spent, times.get(key, spent))


def _group_work(setting):
    """Key of the computation from tones to readings; settings with equal keys share it."""
    return id(setting.plan), setting.order in _ROTATED


class _SceneRun:
    """Measures settings on one capture; shared results are computed once."""

    def __init__(self, recordings, truth_path, signal_s, runs):
        self._recordings, self._signal_s, self._runs = recordings, signal_s, runs
        self._truth_path = truth_path
        self._known = {}

    def measure(self, settings):
        """One point per setting: times per second of signal, and errors.

        Settings run in turns, so that a temporary load of the machine affects all of them.
        """
        samples_s, groups_s, readings = {}, {}, {}
        for _ in range(self._runs):
            for setting in settings:
                flowgraph = _flowgraph(setting, self._recordings)
                spent, _ = _timed(flowgraph.run)
                _least(samples_s, setting.name, spent)
                receiver = Receiver(setting.plan, derotated=setting.order in _ROTATED)
                tones = flowgraph.tones[:, :, setting.plan.waveform.bins]
                spent, read = _timed(_readings, receiver, tones)
                _least(groups_s, _group_work(setting), spent)
                readings[setting.name] = read
        return [
            self._point(
                setting, samples_s[setting.name], groups_s[_group_work(setting)],
                readings[setting.name],
            )
            for setting in settings
        ]  # fmt: skip

    def _point(self, setting, samples_s, groups_s, readings):
        point = {
            "setting": setting.name,
            "cpu_s_per_s": (samples_s + groups_s) / self._signal_s,
            "samples_s_per_s": samples_s / self._signal_s,
            "groups_s_per_s": groups_s / self._signal_s,
            "readings_per_s": 1 / setting.plan.group_period_s,
            "group_length": setting.plan.group_length,
            "bound_deg": self._bound_deg(setting),
        }
        scene = setting.plan.scene
        return point | _errors(scene, readings, self._truth(scene))

    def _truth(self, scene):
        key = "truth", scene.phase_group.snapshots
        return self._once(key, lambda: _truth(scene, self._truth_path))

    def _bound_deg(self, setting):
        settings = setting.plan
        key = (
            "bound", settings.group_length, settings.clutter_hz, len(settings.waveform.bins),
            settings.smoothing_groups, settings.loss_db,
        )  # fmt: skip

        def bound():
            std = phase_std_deg(settings)
            return float(MEDIAN * np.sqrt(np.mean(np.square(std))))

        return self._once(key, bound)

    def _once(self, key, compute):
        if key not in self._known:
            self._known[key] = compute()
        return self._known[key]


def _errors(scene, readings, truth):
    """Median errors over all sensors, without the calibration error of the untouched phases."""
    phase, force, location = [], [], []
    for i, sensor in enumerate(scene.sensors):
        found = score(readings, truth, sensor.name)
        phase.append(wrap_deg(found.phase_error_deg - calibration_bias_deg(scene, i)))
        force.append(found.force_error_n)
        location.append(found.location_error_mm)
    pooled = {"phase_deg": np.concatenate([p.ravel() for p in phase])}
    pooled |= {"force_n": np.concatenate(force), "location_mm": np.concatenate(location)}
    return {"read": int(pooled["force_n"].size)} | {
        key: float(np.median(np.abs(errors))) if errors.size else None
        for key, errors in pooled.items()
    }


# Orders in which the tones are derotated within a symbol before the FFT.
_ROTATED = ("tones first", "block by block")


def _flowgraph(setting, recordings):
    from gnuradio import blocks, wiforce

    from .chains import CHAINS, Flowgraph, kernel_blocks, sample_type

    table, waveform = setting.plan.table, setting.plan.waveform
    if setting.order == "stock":
        return CHAINS["stock-tuned"](recordings[0], table.weights)
    kind, item_type = setting.source.split("-")
    files = [sample_type(recording, item_type) for recording in recordings]
    samples = recordings[0].samples
    flowgraph = Flowgraph()
    if kind == "file":
        folded = [
            wiforce.recording_source(path, datatype, [(0, 0, samples)], **waveform.folding)
            for path, _, datatype in files
        ]
        source = folded[:1]
        if len(folded) == 2:
            sounding = waveform.name, waveform.frame_length, waveform.sample_rate_hz
            source.append(wiforce.antenna_ratio(*sounding))
            flowgraph.top.connect(folded[1], (source[1], 1))
    else:
        ((path, size, _),) = files
        source = [blocks.file_source(size, path, False, 0, samples)]
    rotation = table.derotation(waveform.sample_rate_hz, waveform.symbol_length)
    flowgraph.row(
        *source,
        *kernel_blocks(
            setting.order,
            table.weights,
            setting.plan.group_length,
            waveform,
            item_type,
            kind == "file",
            rotation.astype(np.complex64) if setting.order in _ROTATED else None,
        ),
    )
    return flowgraph


def _readings(receiver, tones):
    """Readings of tones (G, M, K), in the batches of ``gr-wiforce read``."""
    readings = []
    for first in range(0, len(tones), _BATCH):
        batch = tones[first : first + _BATCH]
        readings += receiver.process(Groups(first + np.arange(len(batch)), batch))
    return readings + receiver.finish()


# The plan is beaten by a setting that is faster and more accurate by this factor.
_MARGIN = 1.2


def front(points):
    """Points that no other point beats in both time and phase error, in order of time.

    Errors are converted to the group length of the plan, because a group of twice the length
    halves both the variance and the rate of readings.
    """
    best, kept = float("inf"), []
    readable = [point for point in points if point["phase_deg"] is not None]
    for point in sorted(readable, key=lambda point: point["cpu_s_per_s"]):
        if (found := rated_error(points, point)) < best:
            best = found
            kept.append(point)
    return kept


def rated_error(points, point):
    """Phase error of a point, converted to the plan's rate of readings."""
    return point["phase_deg"] * (point["group_length"] / points[0]["group_length"]) ** 0.5


def beat_the_plan(points, any_length=False):
    """Names of settings that are at least 20 % faster and 20 % more accurate than the plan.

    ``any_length`` includes groups of other lengths, which give fewer or more readings per second.
    """
    chosen = points[0]
    if chosen["phase_deg"] is None:
        return []
    return [
        point["setting"]
        for point in points[1:]
        if point["phase_deg"] is not None
        and (any_length or point["group_length"] == chosen["group_length"])
        and point["cpu_s_per_s"] * _MARGIN < chosen["cpu_s_per_s"]
        and point["phase_deg"] * _MARGIN < chosen["phase_deg"]
    ]


_RUNS, _QUICK_RUNS = 2, 1


@click.command()
@click.argument("scenes", nargs=-1)
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of tables.")
@click.option("--quick", is_flag=True, help="Time each setting once instead of twice.")
def tradeoff(scenes, as_json, quick):
    """Compare processor time with phase and force error for SCENES (default: all shipped).

    Varies group length, lines, clutter band, estimator, subcarriers, sample type, file or stream,
    and the order of the blocks, and compares with stock blocks.
    """
    from gnuradio import gr  # noqa: F401  of the flowgraphs that are timed, before any file is made
    from gnuradio.wiforce.scene import load_scene, sampled_scenes

    names = list(dict.fromkeys(scenes or sampled_scenes()))
    # Invalid scenes are refused before any work is done.
    for name in names:
        if load_scene(name).packets is not None:
            raise InputError(name, "is a scene of packets; only scenes of samples are compared")
    results = []
    with progress("measuring", len(names)) as step:
        for name in names:
            results.append(_measured(name, _QUICK_RUNS if quick else _RUNS))
            step(1)
    echo({"scenes": results}, as_json, lambda _: points_table(results), lambda _: verdicts(results))


def _measured(name, runs):
    """A scene's result, from a process of its own: memory and caches are as for any other."""
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        return pool.submit(measure_scene, name, runs).result()


def _ms(seconds):
    return f"{1e3 * seconds:.1f}"


COLUMNS = (
    Column("scene", "scene"),
    Column("setting", "setting"),
    Column("ms per s", "cpu_s_per_s", _ms),
    Column("samples", "samples_s_per_s", _ms),
    Column("groups", "groups_s_per_s", _ms),
    Column("readings/s", "readings_per_s", ".0f"),
    Column("phase (deg)", "phase_deg", ".3g"),
    Column("bound", "bound_deg", ".3g"),
    Column("force (N)", "force_n", ".3g"),
    Column("location (mm)", "location_mm", ".3g"),
    Column("front", "front"),
)


def points_table(results):
    """A row per scene and setting with median errors and processor time in ms."""
    rows = []
    for result in results:
        points = result["points"]
        kept = [point["setting"] for point in front(points)]
        for point in points:
            name = Path(result["scene"]).stem if point["setting"] == "plan" else ""
            shown = "yes" if point["setting"] in kept else ""
            rows.append({**point, "scene": name, "front": shown})
    return table(rows, COLUMNS)


def verdicts(results):
    """Two sentences: what beats the plan's choice at its rate of readings, and at any rate."""
    sentences = []
    for rate, any_length in (("the same rate of readings", False), ("any rate of readings", True)):
        found = {Path(r["scene"]).stem: beat_the_plan(r["points"], any_length) for r in results}
        beaten = [f"{scene} ({', '.join(names)})" for scene, names in found.items() if names]
        sentences.append(
            f"At least 20 % faster and 20 % more accurate in phase than the plan, at {rate}: "
            f"{'; '.join(beaten) or 'none'}."
        )
    return "\n\n".join(sentences)
