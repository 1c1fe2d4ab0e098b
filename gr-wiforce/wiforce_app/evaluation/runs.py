# SPDX-License-Identifier: GPL-3.0-or-later
"""Many scenes as experiments: run in parallel, stored, resumed, reported."""

import hashlib
import json
import multiprocessing
import os
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

import click
from gnuradio.wiforce._config import VERSION
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.io.textfile import check_output, write_whole
from gnuradio.wiforce.scene import load_scene, shipped_scenes, simulation_warnings
from gnuradio.wiforce.sensor.file import sensor_to_dict

from ..progress import progress
from .causes import other_causes, paper_figures
from .report import cause_table, table, write_report


def evaluate_scenes(names, folder, jobs=None, fresh=False):
    """Run the scenes without a stored result, and write ``report.md`` and a picture per scene.

    Parameters
    ----------
    names : sequence of str
        Scenes; ``all`` means every shipped scene.
    folder : Path
    jobs : int, optional
        Number of parallel processes.
    fresh : bool
        Compute stored results again.
    """
    if "all" in names:
        names = shipped_scenes()
    names = list(dict.fromkeys(names))
    stems = [Path(name).stem for name in names]
    for name, stem in zip(names, stems, strict=True):
        if stems.count(stem) > 1:
            raise InputError("scenes", "must have different file names", name)
    marks = {
        name: mark_of(name) for name in names
    }  # refuses invalid scenes before any work is done
    inputs = [file for name in names for file in load_scene(name).files]
    for name in names:
        for warning in simulation_warnings(load_scene(name)):
            click.echo(f"gr-wiforce: warning: {name}: {warning}", err=True)
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        for output in (_file(folder, name), _file(folder, name).with_suffix(".png")):
            check_output(output, inputs)
    check_output(folder / "report.md", inputs)
    missing = [name for name in names if fresh or result_of(folder, name, marks[name]) is None]
    jobs = min(jobs or os.cpu_count() or 1, max(len(missing), 1))
    # A fork is safe: this process has not started any flowgraph, and so no threads.
    context = multiprocessing.get_context("fork")
    with progress("evaluating", len(missing)) as step, ProcessPoolExecutor(jobs, context) as pool:
        waiting = {pool.submit(_run, name, str(folder)): name for name in missing}
        try:
            for done in as_completed(waiting):
                name = waiting[done]
                keep_result(folder, name, marks[name], done.result())
                step(1)
        except BaseException:
            # Leaving the pool waits for the scenes that are being evaluated, but not for others.
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    results = [result_of(folder, name, marks[name]) for name in names]
    figures = paper_figures()
    write_report(results, folder, figures)
    click.echo(table(results, figures))
    if causes := cause_table(results, figures):
        click.echo(f"\n{causes}")
    click.echo(f"\nreport: {folder / 'report.md'}")


def _run(name, folder):
    from .experiment import run

    return run(name, folder)


def mark_of(name):
    """Hash of everything a result depends on: the scene, its causes, sensors and this version."""
    scene = load_scene(name)
    used = {sensor.model for sensor in scene.sensors}
    used |= {tag.truth_model for tag in scene.simulation.tags} if scene.simulation else set()
    sensors = [sensor_to_dict(scene.load_model(model)) for model in sorted(used)]
    content = json.dumps(
        [VERSION, scene.as_dict(), other_causes(str(name)), sensors], sort_keys=True
    )
    return hashlib.sha256(content.encode()).hexdigest()


def _file(folder, name):
    return folder / f"{Path(name).stem}.json"


def result_of(folder, name, mark):
    """The stored result of a scene; None when there is none with this hash."""
    try:
        content = json.loads(_file(folder, name).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return content["result"] if content.get("mark") == mark else None


def keep_result(folder, name, mark, result):
    """Write a result atomically."""
    write_whole(_file(folder, name), json.dumps({"mark": mark, "result": result}))
