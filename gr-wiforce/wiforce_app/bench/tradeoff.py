# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce bench tradeoff``: run time against error, for every scene and sensible setting."""

import tempfile
import time
from dataclasses import dataclass, replace
from itertools import takewhile
from pathlib import Path

import click
import numpy as np
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.estimation.groups import Groups
from gnuradio.wiforce.io.capture import open_capture
from gnuradio.wiforce.planning.expected import MEDIAN, phase_std_deg
from gnuradio.wiforce.planning.plan import HARMONICS, Plan, plan
from gnuradio.wiforce.receiver import Receiver
from gnuradio.wiforce.receiver.recording_reader import groups_of
from gnuradio.wiforce.scene import load_scene
from gnuradio.wiforce.simulation.simulator import simulate
from gnuradio.wiforce.simulation.truth import score

from ..evaluate.evaluate import expected_truth, load_sampled, pooled_summary
from ..shell.log import progress
from ..shell.tables import Column, echo, table
from .chains import DATATYPE, GROUP_LENGTH, WAVEFORM, Recording, planned, stock

_GROUP_LENGTHS = (125, 250, 625, 1250)
_CLUTTER_HZ = (0.0, 250.0)
_BATCH = 256  # groups, as of recordings
# The plan is beaten by a setting that is faster and more accurate by this factor.
_MARGIN = 1.2


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
)


@click.command()
@click.argument("scenes", nargs=-1)
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of tables.")
def tradeoff(scenes, as_json):
    """Compare processor time with phase and force error for SCENES (default: all shipped).

    Varies group length, lines, clutter band, estimator, subcarriers, sample type, file or stream,
    and the order of the blocks, and compares with stock blocks.
    """
    from gnuradio import gr
    from gnuradio.wiforce.scene import sampled_scenes

    gr.logging().set_default_level(gr.log_levels.off)

    names = list(dict.fromkeys(scenes or sampled_scenes()))
    load_sampled(names)
    results = []
    with progress("measuring", len(names)) as step:
        for name in names:
            results.append(measure_scene(name))
            step(1)
    echo({"scenes": results}, as_json, lambda _: points_table(results), lambda _: verdict(results))


@dataclass(frozen=True)
class Setting:
    """One setting: scene and plan with one change from the planner's choice.

    Without an ``order`` of blocks, the recording is read as by ``gr-wiforce read``.
    """

    name: str
    plan: Plan
    item_type: str = "sc16"
    order: str | None = None


def settings_of(scene):
    """Settings of a scene; the first one is the planner's choice."""
    chosen = plan(scene)
    found = [Setting("plan", chosen)]

    def vary(name, part=None, changes=None, **changed):
        other = scene
        if part:
            other = replace(scene, **{part: replace(getattr(scene, part), **changes)})
        try:
            varied = replace(plan(other), **changed)
            varied.check_lines()
        except InputError:
            return
        found.append(Setting(name, varied))

    for length in sorted({*_GROUP_LENGTHS} - {chosen.group_length}):
        vary(f"N_g {length}", "phase_group", {"snapshots": length})
    for harmonics in sorted({*HARMONICS} - {chosen.harmonics}):
        vary(f"lines to +-{harmonics}", harmonics=harmonics)
    for band in sorted({*_CLUTTER_HZ} - {chosen.clutter_hz}):
        vary(f"clutter band {band:g} Hz", "environment", {"moving_clutter_hz": band})
    for estimator in (e for e in ("sideband", "paper") if e != chosen.estimator):
        vary(estimator, "phase_group", {"estimator": estimator})
    for step, label in ((2, "every second"), (4, "every fourth")):
        waveform = chosen.waveform
        kept = {key: getattr(waveform, key)[::step] for key in ("subcarriers", "reference")}
        vary(f"{label} subcarrier", waveform=replace(waveform, **kept))
    found.append(Setting("file-fc32", chosen, "fc32"))
    if scene.environment.receive_antennas == 2:
        # The ratio of two antennas is taken from folded frames, which only files provide here.
        return found
    found += [Setting(f"stream-{kind}", chosen, kind, "tones first") for kind in ("sc16", "fc32")]
    found += [Setting(name, chosen, "fc32", name) for name in ("block by block", "channel first")]
    sent = chosen.waveform.name, chosen.waveform.frame_length, chosen.group_length
    if sent == (WAVEFORM.name, WAVEFORM.frame_length, GROUP_LENGTH):
        found.append(Setting("stock blocks", chosen, "fc32", "stock"))
    return found


def measure_scene(name):
    """Simulate a scene and read it with all settings: ``scene``, ``signal_s``, ``points``."""
    scene = load_scene(name)
    with tempfile.TemporaryDirectory(prefix="wiforce-tradeoff-") as place:
        captures = {}
        for item_type, datatype in DATATYPE.items():
            simulate(scene, Path(place) / item_type, datatype)
            captures[item_type] = open_capture(Path(place) / item_type)
        signal_s = captures["sc16"].samples / scene.radio.sample_rate_hz
        settings = settings_of(scene)
        # The first one that is read pays for what a process does once, up to twice its own time.
        points = [
            _point(setting, captures[setting.item_type], signal_s)
            for setting in (settings[0], *settings)
        ][1:]
    return {"scene": str(name), "signal_s": signal_s, "points": points}


def _point(setting, capture, signal_s):
    """The errors of a setting, and its processor time per second of signal."""
    receiver = Receiver(setting.plan, derotated=setting.order not in ("channel first", "stock"))
    times_s = [time.process_time()]
    batches = _tones(setting, capture)
    times_s.append(time.process_time())
    readings = [reading for batch in batches for reading in receiver.process(batch)]
    readings += receiver.finish()
    times_s.append(time.process_time())
    samples_s, groups_s = (np.diff(times_s) / signal_s).tolist()
    scene = setting.plan.scene
    truth = expected_truth(scene)
    nothing = {"read": 0, "phase_deg": None, "force_n": None, "location_mm": None}
    return {
        "setting": setting.name,
        "cpu_s_per_s": samples_s + groups_s,
        "samples_s_per_s": samples_s,
        "groups_s_per_s": groups_s,
        "readings_per_s": 1 / setting.plan.group_period_s,
        "group_length": setting.plan.group_length,
        "bound_deg": float(MEDIAN * np.sqrt(np.mean(phase_std_deg(setting.plan) ** 2))),
        **nothing,
        **pooled_summary([score(readings, truth, name) for name in scene.sensor_names]),
    }


def _tones(setting, capture):
    """Batches of Groups of a capture."""
    settings = setting.plan
    if setting.order is None:
        source = groups_of(capture, settings, 0)
        return list(takewhile(len, iter(source.read, None)))
    recording = Recording(capture.path, capture.path, capture.samples)
    if setting.order == "stock":
        flowgraph = stock(recording, settings.table.weights)
    else:
        derotated = setting.order != "channel first" and settings.waveform.is_derotated
        order = setting.item_type, setting.order
        flowgraph = planned(settings, recording, *order, derotated=derotated)
    flowgraph.run()
    tones = flowgraph.tones[:, :, settings.waveform.bins]
    firsts = range(0, len(tones), _BATCH)
    batches = (tones[first : first + _BATCH] for first in firsts)
    return [
        Groups(first + np.arange(len(batch)), batch)
        for first, batch in zip(firsts, batches, strict=True)
    ]


def beat_the_plan(points):
    """Settings that are 20 % faster and 20 % more accurate than the plan, with its groups."""
    chosen, *others = points
    if chosen["phase_deg"] is None:
        return []
    return [
        point["setting"]
        for point in others
        if point["phase_deg"] is not None
        and point["group_length"] == chosen["group_length"]
        and point["cpu_s_per_s"] * _MARGIN < chosen["cpu_s_per_s"]
        and point["phase_deg"] * _MARGIN < chosen["phase_deg"]
    ]


def points_table(results):
    """A row per scene and setting with median errors and processor time in ms."""
    rows = []
    for result in results:
        for number, point in enumerate(result["points"]):
            name = "" if number else Path(result["scene"]).stem
            rows.append({**point, "scene": name})
    return table(rows, COLUMNS)


def verdict(results):
    """What beats the plan's choice."""
    found = {Path(result["scene"]).stem: beat_the_plan(result["points"]) for result in results}
    beaten = [f"{scene} ({', '.join(names)})" for scene, names in found.items() if names]
    return (
        "At least 20 % faster and 20 % more accurate in phase than the plan, at the same rate of "
        f"readings: {'; '.join(beaten) or 'none'}."
    )
