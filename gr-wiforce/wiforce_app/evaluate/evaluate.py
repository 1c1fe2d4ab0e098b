# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce evaluate``: errors against the truth, of many scenes, and the paper's figures.

A scene is simulated, read by this receiver and by the paper's method, and scored.
"""

import json
import platform
import tempfile
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from string import Template

import click
import numpy as np
from gnuradio.wiforce._config import VERSION
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.estimation.capture.folded_groups import frame_settings
from gnuradio.wiforce.estimation.clocks.tracked_tag import WIDEST_PPM
from gnuradio.wiforce.estimation.groups import Groups
from gnuradio.wiforce.estimation.phases.off_state import corrected_phase_deg
from gnuradio.wiforce.io.capture import open_capture
from gnuradio.wiforce.io.readings import Reading
from gnuradio.wiforce.io.text.textfile import check_output, read_yaml, write_whole
from gnuradio.wiforce.planning.expected import expect
from gnuradio.wiforce.planning.plan import plan
from gnuradio.wiforce.receiver import Receiver
from gnuradio.wiforce.scene import load_scene, sampled_scenes, simulation_warnings
from gnuradio.wiforce.simulation.presses import PressedSensor
from gnuradio.wiforce.simulation.simulator import simulate
from gnuradio.wiforce.simulation.truth import score, truth_rows
from gnuradio.wiforce.wiforce_kernels import folded_reader
from scipy.fft import fft

from ..read.recordings import read_capture
from ..shell.log import log, progress
from ..shell.options import scene_names, worker_options
from ..shell.provenance import fingerprint
from ..shell.tables import Column, table
from ..shell.workers import run_tasks
from .published import FOLDER, paper, paper_figures

# The paper's method with the constant offset of the tag's clock removed.
CORRECTED = "paper, clock offset removed"
_BATCH = 64  # groups of the paper's method
# The cause that the file of a scene of the paper itself holds, in ``simulation.tags``.
OWN = "clock jitter"
# What the report says of the table of causes.
_CAUSES_TEXT = """\
The paper does not state why its phases varied. Each row of the second table adds one disturbance
to a scene, as strong as makes the paper's method, with the clock offset removed, measure what
was published. What this receiver reads depends on the cause, so only the range over the causes
can stand next to the paper's figure."""
# Of the stored results; those of another one are computed again.
_FORMAT = 8


class _PaperOrScenes(click.Group):
    """Takes ``paper``, or names of scenes."""

    def resolve_command(self, ctx, args):
        if args and args[0] in self.commands:
            return super().resolve_command(ctx, args)
        return "scenes", self.commands["scenes"], args


@click.group(cls=_PaperOrScenes, subcommand_metavar="paper | all | SCENE... [OPTIONS]")
def evaluate():
    """Compare readings with the truth and with the figures of the paper.

    paper: score the models on the published wireless trials. SCENE...: simulate, read and score
    these scenes. all: every shipped scene. Options of both: gr-wiforce evaluate all --help.
    """


evaluate.add_command(paper)


@evaluate.command(hidden=True)
@click.argument("scenes", nargs=-1, required=True, shell_complete=scene_names)
@click.option(
    "--folder",
    type=click.Path(file_okay=False),
    default="evaluation",
    help="Where results and report are kept; existing results are not computed again.",
)
@worker_options
@click.option("--fresh", is_flag=True, help="Compute all results again.")
def scenes(scenes, folder, jobs, fresh):
    """Simulate, read and score SCENES (or all), and write a report."""
    names = list(dict.fromkeys(sampled_scenes() if "all" in scenes else scenes))
    folder = Path(folder)
    files = [folder / f"{Path(name).stem}.json" for name in names]
    for name, file in zip(names, files, strict=True):
        if files.count(file) > 1:
            raise InputError("scenes", "must have different file names", name)
    loaded, hashes = load_sampled(names), []
    for name, scene in zip(names, loaded, strict=True):
        for warning in simulation_warnings(scene):
            log.warning(f"{name}: {warning}")
        hashes.append(fingerprint(scene, other_causes(str(name)), _FORMAT, simulated=True))
    folder.mkdir(parents=True, exist_ok=True)
    for output in (folder / "report.md", *files):
        check_output(output, [file for scene in loaded for file in scene.files])
    results = [None if fresh else stored(*known) for known in zip(files, hashes, strict=True)]
    missing = [i for i, result in enumerate(results) if result is None]
    with progress("evaluating", len(missing)) as step:
        for outcome in run_tasks(run, [(names[i], str(folder)) for i in missing], jobs):
            i = missing[outcome.index]
            results[i] = outcome.get()
            write_whole(files[i], json.dumps({"fingerprint": hashes[i], "result": results[i]}))
            step(1)
    figures = paper_figures()
    tables = error_table(results, figures)
    if causes := cause_table(results, figures):
        tables += f"\n\n{causes}"
    made = "\n".join(map(_origin, names, loaded))
    _write_report(names, folder, made, f"{tables}\n\n{_CAUSES_TEXT}" if causes else tables)
    click.echo(f"{tables}\n\nreport: {folder / 'report.md'}")


def load_sampled(names):
    """Scenes of samples by name; refuses others before any work is done."""
    loaded = [load_scene(name) for name in names]
    for name, scene in zip(names, loaded, strict=True):
        if scene.packets is not None:
            raise InputError(name, "is a scene of packets; only scenes of samples are scored")
    return loaded


def run(task):
    """Simulate, read and score a scene, with a capture in a folder that is deleted; for JSON.

    ``causes``: rows of the first sensor with each disturbance that explains a published figure.
    Phase errors compare changes with the mean reflection of a group; calibration errors and changes
    within it are part of the others only.
    """
    scene_name, folder = task
    scene = load_scene(scene_name)
    rows, causes = _read(scene, folder), {}
    for cause, change in other_causes(scene_name).items():
        causes[cause] = _read(with_cause(scene, change), folder)[:3]
    causes = {OWN: rows[:3], **causes} if causes else {}
    return {"scene": str(scene_name), "rows": rows, "causes": causes}


@contextmanager
def simulated(scene, folder):
    """A temporary capture of a scene: the recording, and rows of truth."""
    with tempfile.TemporaryDirectory(dir=folder, prefix=".capture-") as place:
        capture = Path(place) / "capture"
        simulate(scene, capture)
        yield open_capture(capture), expected_truth(scene)


def _read(scene, folder):
    """Rows of each sensor: our errors, the paper's with and without the clock's offset, the plan's.

    The last one is of the forces' sum, where there are several sensors.
    """
    rows = []
    with simulated(scene, folder) as (recording, truth):
        readings = read_capture(recording, scene)
        changes = paper_changes(recording, scene)
    for i, (sensor, expected) in enumerate(zip(scene.sensors, expect(plan(scene)), strict=True)):
        own = score(readings, truth, sensor.name)
        ours = pooled_summary([own])
        flagged = f"{own.flagged} of {ours.get('read', 0)}"
        rows.append({"sensor": sensor.name, "method": "ours", **ours, "flagged": flagged})
        for method, detrend in (("paper", False), (CORRECTED, True)):
            rows.append({"method": method, **paper_errors(scene, i, changes, truth, detrend)})
        rows.append(_expected(scene, expected))
    if len(scene.sensors) > 1 and (force_n := _sum_of_forces(scene, readings, truth)) is not None:
        rows.append({"sensor": "sum", "method": "ours", "force_n": force_n})
    return rows


def _expected(scene, expected):
    """The row of a sensor's expected errors, with the bound for the phase's rms."""
    if expected.phase_error_deg is None:
        return {"method": "expected: not readable"}
    bound_deg = np.sqrt(np.mean(np.square(expected.phase_std_deg)))
    least = "bound" if scene.simulation.radio_noise is None else "at most"
    return {
        "method": "expected over the span",
        "phase_deg": float(np.mean(expected.phase_error_deg)),
        "phase_rms_deg": f"{bound_deg:.3g} ({least})",
        "force_n": expected.force_error_n,
        "location_mm": expected.location_error_mm,
    }


def other_causes(name):
    """Changes of ``simulation`` that replace a shipped scene's own disturbance, by cause."""
    return read_yaml(FOLDER / "causes.yaml").get(name, {})


def with_cause(scene, change):
    """A scene with other keys of ``simulation`` and, unless they have some, ideal tags."""
    content = scene.as_dict()
    content["simulation"] |= {"tags": [], **change}
    return load_scene(content)


def expected_truth(scene):
    """Rows of truth with the phases that a reader without noise would state.

    They are of the mean reflection of a group, not of its centre, from the untouched phases of the
    reader's model on.
    """
    frequency, bias_deg, pressed = scene.radio.center_frequency_hz, {}, {}
    for i, (sensor, tag) in enumerate(zip(scene.sensors, scene.simulation.tags, strict=True)):
        pressed[sensor.name] = PressedSensor(scene, i)
        known, true = sensor.load_model(scene), scene.load_model(tag.truth_model)
        known_deg, true_deg = (model.untouched_deg(frequency) for model in (known, true))
        bias_deg[sensor.name] = np.subtract(known_deg, true_deg)
    truth = [row for row in truth_rows(scene) if row["sensor"] in bias_deg]
    for row in truth:
        name, times_s = row["sensor"], [row["time_s"]]
        mean_deg = pressed[name].mean_phases_deg(times_s, scene.group_period_s)[0]
        row["phase1_deg"], row["phase2_deg"] = mean_deg + bias_deg[name]
    return truth


def _sum_of_forces(scene, readings, truth):
    """Median error of the sum of all forces while all sensors are touched; None without."""
    names = scene.sensor_names
    known = {(round(row["time_s"], 4), row["sensor"]): row["force_n"] for row in truth}
    by_time = {}
    for reading in readings:
        if reading.touch == 1 and reading.force_n is not None and not reading.flags:
            by_time.setdefault(round(reading.time_s, 4), {})[reading.sensor] = reading.force_n
    errors = [
        sum(forces.values()) - sum(known[time, name] for name in names)
        for time, forces in by_time.items()
        if len(forces) == len(names)
    ]
    return float(np.median(np.abs(errors))) if errors else None


def paper_changes(recording, scene):
    """Accumulated changes (groups, 2S) by Fourier sums at lines 1 and 4 (paper, section 3.3).

    Of all snapshots, as the paper: without those that interference hit, the sums would leak.
    """
    # Clocks that are known worse would need a survey.
    sensors = [
        replace(sensor, clock_tolerance_ppm=min(sensor.clock_tolerance_ppm, WIDEST_PPM))
        for sensor in scene.sensors
    ]
    environment = replace(scene.environment, receive_antennas=1)
    alone = replace(scene, sensors=tuple(sensors), environment=environment)
    settings, changes = plan(alone, estimator="paper"), []
    receiver = Receiver(
        settings, derotated=False, on_groups=lambda groups: changes.append(groups.ratios)
    )
    length, waveform = settings.group_length, settings.waveform
    factors = waveform.equalizer().astype(np.complex64)
    frames, first = folded_reader(**frame_settings(recording, waveform, frame_offset=0)), 0
    while count := len(folded := frames.read(_BATCH * length)["folded"]) // length:
        channels = (fft(folded[: count * length], axis=1) * factors)[:, waveform.bins]
        tones = settings.table.weights @ channels.reshape(count, length, -1)
        receiver.process(Groups(first + np.arange(count), tones))
        first += count
    receiver.finish()
    return np.concatenate(changes)


def paper_errors(scene, index, changes, truth, detrend):
    """Errors of the paper's method under steady touches; ``detrend`` removes a clock's offset."""
    sensor = scene.sensors[index]
    times = [row["time_s"] for row in truth if row["sensor"] == sensor.name]
    angles = np.unwrap(np.angle(changes[: len(times), 2 * index : 2 * index + 2]), axis=0)
    if detrend:
        angles = _detrended(angles, int(scene.reference_s / scene.group_period_s))
    model, frequency = sensor.load_model(scene), scene.radio.center_frequency_hz
    phases, _ = corrected_phase_deg(
        np.exp(1j * angles), model.untouched_deg(frequency), sensor.off_reflection
    )
    found = model.invert(phases, frequency_hz=frequency)
    # Steady touches are known from the truth; where nothing is found, force and location are NaN.
    readings = [
        Reading(time, sensor.name, 1, force, None, location, None, *pair)
        for time, force, location, pair in zip(
            times, found.force_n, found.location_mm, phases, strict=False
        )
    ]
    return pooled_summary([score(readings, truth, sensor.name)])


def _detrended(angles, reference_groups):
    """Angles (groups, 2) less the straight line through the reference groups."""
    times = np.arange(len(angles))
    reference = times < reference_groups
    if np.count_nonzero(reference) <= 2:
        return angles
    slope, start = np.polyfit(times[reference], angles[reference], 1)
    return angles - np.outer(times, slope) - start


def pooled_summary(scores):
    """Medians, 90th percentiles, phase rms and number of all errors of scores; empty without."""
    names = ("phase_error_deg", "force_error_n", "location_error_mm")
    phase, force, location = (np.concatenate([getattr(s, name) for s in scores]) for name in names)
    if not len(phase):
        return {}
    known = np.isfinite(force)
    found = {
        "phase_deg": float(np.median(np.abs(phase))),
        "phase_rms_deg": float(np.sqrt(np.mean(phase**2))),
        "read": int(known.sum()),
    }
    for name, error in (("force_n", force[known]), ("location_mm", location[known])):
        if len(error):
            found[name] = float(np.median(np.abs(error)))
            found[f"{name}_90"] = float(np.percentile(np.abs(error), 90))
    return found


def stored(file, current):
    """The result that a file holds; None when there is none with this hash."""
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return content["result"] if content.get("fingerprint") == current else None


_ERRORS = (
    Column("force (N)", "force_n", ".3g"),
    Column("90 %", "force_n_90", ".3g"),
    Column("location (mm)", "location_mm", ".3g"),
    Column("90 %", "location_mm_90", ".3g"),
    Column("flagged", "flagged"),
)
_COLUMNS = (
    Column("scene", "scene"),
    Column("sensor", "sensor"),
    Column("method", "method"),
    Column("phase (deg)", "phase_deg", ".3g"),
    Column("phase rms", "phase_rms_deg", ".3g"),
    *_ERRORS,
    Column("paper's figure", "published"),
)
_CAUSES = (
    Column("scene", "scene"),
    Column("published", "published"),
    Column("cause", "cause"),
    Column("paper's method", "papers"),
    Column("phase rms of ours", "phase_rms_deg", ".3g"),
    *_ERRORS[::2],
)


def error_table(results, figures):
    """Markdown: rows per scene, sensor and method; medians unless titled rms or 90 %."""
    rows = []
    for result in results:
        name = Path(result["scene"]).stem
        for row in result["rows"]:
            more = {}
            if "sensor" in row:
                more = {"scene": name, "published": figures.get(name, {}).get("text")}
            if "flagged" in row and result["causes"]:
                more["phase_rms_deg"] = _ranges(result["causes"])["phase_rms_deg"]
            rows.append(row | more)
    return table(rows, _COLUMNS)


def cause_table(results, figures):
    """Markdown: a row per cause that explains a published figure, and one with our range."""
    rows = []
    for result in results:
        if not (causes := result["causes"]):
            continue
        name = Path(result["scene"]).stem
        figure = figures[name]
        key, unit = ("phase_rms_deg", "deg") if "phase_rms_deg" in figure else ("force_n", "N")
        # Error bars, where the paper has some.
        bar = figure.get("error_bar")
        ends = [figure[key]] if bar is None else [figure[key] - bar, figure[key] + bar]
        first = {"scene": name, "published": f"{' to '.join(f'{end:.3g}' for end in ends)} {unit}"}
        for cause, (ours, _, corrected) in causes.items():
            papers = f"{corrected[key]:.3g} {unit}" if key in corrected else ""
            rows.append({**ours, **first, "cause": cause, "papers": papers})
            first = {}
        rows.append({"cause": "range of ours", **_ranges(causes)})
    return table(rows, _CAUSES) if rows else ""


def _ranges(causes):
    """Least and largest of our errors over the causes, as texts."""
    ranges = {}
    for key in ("phase_rms_deg", "force_n", "location_mm"):
        ours = [rows[0].get(key) for rows in causes.values()]
        values = [value for value in ours if value is not None]
        ranges[key] = f"{min(values):.3g} to {max(values):.3g}" if values else ""
    return ranges


def _origin(name, scene):
    """Markdown: the seed of a scene, and the models by which its sensors are pressed and read."""
    sensors = [
        f"{sensor.name} pressed as {tag.truth_model}, read by {sensor.model}"
        for sensor, tag in zip(scene.sensors, scene.simulation.tags, strict=True)
    ]
    return f"- `{name}`: seed {scene.simulation.seed}; {'; '.join(sensors)}"


def _write_report(names, folder, made, tables):
    """Write ``report.md``: the tables, and how they came about."""
    import scipy

    template = Template(Path(__file__).with_name("report.md").read_text(encoding="utf-8"))
    page = template.substitute(
        command=f"gr-wiforce evaluate {' '.join(map(str, names))}",
        version=VERSION,
        python=platform.python_version(),
        numpy=np.__version__,
        scipy=scipy.__version__,
        made=made,
        tables=tables,
    )
    # Names of scenes may hold bytes that are no text.
    (folder / "report.md").write_text(page, encoding="utf-8", errors="backslashreplace")
