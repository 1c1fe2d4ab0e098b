# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce bench tradeoff``: run time against error, for every scene and sensible setting."""

import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path

import click
import numpy as np
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.estimation.groups import Groups
from gnuradio.wiforce.io.capture import open_capture
from gnuradio.wiforce.planning.expected import MEDIAN, phase_std_deg
from gnuradio.wiforce.planning.plan import HARMONICS, Plan, plan
from gnuradio.wiforce.receiver import Receiver
from gnuradio.wiforce.scene import load_scene
from gnuradio.wiforce.simulation.channel import AirChannel
from gnuradio.wiforce.simulation.simulator import simulate
from gnuradio.wiforce.simulation.truth import read_truth, write_truth

from ..evaluate.experiment import pooled_summary, scored, with_mean_phases
from ..shell.log import progress
from ..shell.tables import Column, echo, table
from .recording import GROUP_LENGTH, WAVEFORM, with_floats

_GROUP_LENGTHS = (125, 250, 625, 1250)
_CLUTTER_HZ = (0.0, 250.0)
_BATCH = 64  # groups
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
    # Invalid scenes are refused before any work is done.
    for name in names:
        if load_scene(name).packets is not None:
            raise InputError(name, "is a scene of packets; only scenes of samples are compared")
    results = []
    with progress("measuring", len(names)) as step:
        for name in names:
            results.append(measure_scene(name))
            step(1)
    echo({"scenes": results}, as_json, lambda _: points_table(results), lambda _: verdict(results))


@dataclass(frozen=True)
class Setting:
    """One setting: scene and plan with one change from the planner's choice."""

    name: str
    plan: Plan
    source: str = "file-sc16"
    order: str = "tones first"

    @property
    def derotated(self):
        """Whether tones are derotated within a symbol, before the FFT."""
        return self.order in ("tones first", "block by block")

    @property
    def work(self):
        """Settings with an equal value share the computation from tones to readings."""
        return id(self.plan), self.derotated


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
    for source in ("file-fc32", "stream-sc16", "stream-fc32"):
        found.append(Setting(source, chosen, source))
    for order in ("block by block", "channel first"):
        found.append(Setting(order, chosen, "stream-fc32", order))
    sent = chosen.waveform.name, chosen.waveform.frame_length, chosen.group_length
    if sent == (WAVEFORM.name, WAVEFORM.frame_length, GROUP_LENGTH):
        found.append(Setting("stock blocks", chosen, "stream-fc32", "stock"))
    if scene.environment.receive_antennas == 2:
        # The ratio of two antennas is taken from folded frames, which only files provide here.
        return [setting for setting in found if setting.source.startswith("file")]
    return found


def measure_scene(name):
    """Simulate a scene and read it with all settings: ``scene``, ``signal_s``, ``points``."""
    from .chains import CHAINS, planned

    scene = load_scene(name)
    settings = settings_of(scene)
    samples_s, groups_s, readings = {}, {}, {}
    with tempfile.TemporaryDirectory(prefix="wiforce-tradeoff-") as place:
        written = simulate(scene, Path(place) / "capture")
        captures = [open_capture(path) for path in written if path.suffix == ".sigmf-meta"]
        recordings = [with_floats(capture.path) for capture in captures]
        signal_s = recordings[0].samples / scene.radio.sample_rate_hz
        for setting in settings:
            if setting.order == "stock":
                flowgraph = CHAINS["stock-tuned"](recordings[0], setting.plan.table.weights)
            else:
                way = setting.source, setting.order
                flowgraph = planned(setting.plan, recordings, *way, derotated=setting.derotated)
            samples_s[setting.name], _ = _timed(flowgraph.run)
            receiver = Receiver(setting.plan, derotated=setting.derotated)
            tones = flowgraph.tones[:, :, setting.plan.waveform.bins]
            spent, readings[setting.name] = _timed(_readings, receiver, tones)
            groups_s[setting.work] = min(spent, groups_s.get(setting.work, spent))
    points = []
    for setting in settings:
        times_s = samples_s[setting.name] / signal_s, groups_s[setting.work] / signal_s
        points.append(
            {
                "setting": setting.name,
                "cpu_s_per_s": sum(times_s),
                "samples_s_per_s": times_s[0],
                "groups_s_per_s": times_s[1],
                "readings_per_s": 1 / setting.plan.group_period_s,
                "group_length": setting.plan.group_length,
                "bound_deg": float(MEDIAN * np.sqrt(np.mean(phase_std_deg(setting.plan) ** 2))),
                **_errors(setting.plan.scene, readings[setting.name]),
            }
        )
    return {"scene": str(name), "signal_s": signal_s, "points": points}


def _timed(work, *arguments):
    """Processor time of a call, and its result."""
    began = time.process_time()
    given = work(*arguments)
    return time.process_time() - began, given


def _readings(receiver, tones):
    """Readings of tones (G, M, K), in the batches of ``gr-wiforce read``."""
    readings = []
    for first in range(0, len(tones), _BATCH):
        batch = tones[first : first + _BATCH]
        readings += receiver.process(Groups(first + np.arange(len(batch)), batch))
    return readings + receiver.finish()


def _errors(scene, readings):
    """Median errors over all sensors, against the truth at the centres of the groups."""
    with tempfile.NamedTemporaryFile(suffix=".csv") as file:
        write_truth(scene, AirChannel(scene), file.name)
        truth = with_mean_phases(scene, read_truth(file.name))
    nothing = {"read": 0, "phase_deg": None, "force_n": None, "location_mm": None}
    return nothing | pooled_summary(scored(scene, readings, truth))


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
