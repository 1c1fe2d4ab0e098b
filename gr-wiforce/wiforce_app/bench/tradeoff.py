# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce bench tradeoff``: run time against error, for every scene and sensible setting."""

import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import click
from gnuradio.wiforce.errors import InputError

from ..shell.progress import progress
from ..shell.tables import Column, echo, table
from .tradeoff_points import beat_the_plan, front, measure_scene

_RUNS, _QUICK_RUNS = 2, 1


@click.command()
@click.argument("scenes", nargs=-1)
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of tables.")
@click.option("--quick", is_flag=True, help="Time each setting once instead of twice.")
@click.option(
    "--folder",
    type=click.Path(file_okay=False),
    default="tradeoff",
    show_default=True,
    help="Where results are kept; existing results are not measured again.",
)
@click.option("--fresh", is_flag=True, help="Measure everything again.")
def tradeoff(scenes, as_json, quick, folder, fresh):
    """Compare processor time with phase and force error for SCENES (default: all shipped).

    Varies group length, lines, clutter band, estimator, subcarriers, sample type, file or stream,
    and the order of the blocks, and compares with stock blocks.
    """
    from gnuradio import gr  # noqa: F401  of the flowgraphs that are timed, before any file is made
    from gnuradio.wiforce.scene import load_scene, sampled_scenes

    from ..evaluate.runs import keep_result, result_of
    from ..shell.provenance import fingerprint

    names = list(dict.fromkeys(scenes or sampled_scenes()))
    # Invalid scenes are refused before any work is done.
    for name in names:
        if load_scene(name).packets is not None:
            raise InputError(name, "is a scene of packets; only scenes of samples are compared")
    fingerprints = {name: fingerprint(load_scene(name), simulated=True) for name in names}
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    results = {
        name: None if fresh else result_of(folder, name, fingerprints[name]) for name in names
    }
    missing = [name for name in names if results[name] is None]
    with progress("measuring", len(missing)) as step:
        for name in missing:
            results[name] = _measured(name, folder, _QUICK_RUNS if quick else _RUNS)
            keep_result(folder, name, fingerprints[name], results[name])
            step(1)
    results = [results[name] for name in names]
    echo({"scenes": results}, as_json, lambda _: points_table(results), lambda _: verdicts(results))


def _measured(name, folder, runs):
    """A scene's result, from a process of its own: memory and caches are as for any other."""
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        return pool.submit(measure_scene, name, folder, runs).result()


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
