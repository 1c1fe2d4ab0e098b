# SPDX-License-Identifier: GPL-3.0-or-later
"""Many scenes as experiments: run in parallel, stored, resumed, reported."""

import json
from pathlib import Path

import click
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.io.text.textfile import check_output, write_whole
from gnuradio.wiforce.scene import load_scene, sampled_scenes, simulation_warnings

from ..shell.log import log
from ..shell.progress import progress
from ..shell.provenance import fingerprint
from ..shell.workers import run_tasks
from .causes import other_causes, paper_figures
from .report import cause_table, table, write_report

# Of the stored results; those of another one are computed again.
_FORMAT = 4


def evaluate_scenes(names, folder, jobs=None, fresh=False):
    """Run scenes (or ``all``) without a stored result, or ``fresh`` ones, and report."""
    names = list(dict.fromkeys(sampled_scenes() if "all" in names else names))
    stems = [Path(name).stem for name in names]
    for name, stem in zip(names, stems, strict=True):
        if stems.count(stem) > 1:
            raise InputError("scenes", "must have different file names", name)
    # Invalid scenes are refused before any work is done.
    scenes = {name: load_scene(name) for name in names}
    for name, scene in scenes.items():
        if scene.packets is not None:
            raise InputError(name, "is a scene of packets; only scenes of samples are evaluated")
        for warning in simulation_warnings(scene):
            log.warning(f"{name}: {warning}")
    fingerprints = {
        name: fingerprint(scene, other_causes(str(name)), _FORMAT, simulated=True)
        for name, scene in scenes.items()
    }
    inputs = [file for scene in scenes.values() for file in scene.files]
    folder.mkdir(parents=True, exist_ok=True)
    for output in ("report.md", *(f"{stem}.{kind}" for stem in stems for kind in ("json", "png"))):
        check_output(folder / output, inputs)
    missing = [
        name for name in names if fresh or result_of(folder, name, fingerprints[name]) is None
    ]
    tasks = [(name, str(folder)) for name in missing]
    with progress("evaluating", len(missing)) as step:
        for outcome in run_tasks(_run, tasks, jobs):
            name = missing[outcome.index]
            kept = {"fingerprint": fingerprints[name], "result": outcome.get()}
            write_whole(_file(folder, name), json.dumps(kept))
            step(1)
    results = [result_of(folder, name, fingerprints[name]) for name in names]
    figures = paper_figures()
    write_report(results, folder, figures)
    click.echo(table(results, figures))
    if causes := cause_table(results, figures):
        click.echo(f"\n{causes}")
    click.echo(f"\nreport: {folder / 'report.md'}")


def _run(task):
    from .experiment import run

    return run(*task)


def _file(folder, name):
    return folder / f"{Path(name).stem}.json"


def result_of(folder, name, current):
    """The stored result of a scene; None when there is none with this hash."""
    try:
        content = json.loads(_file(folder, name).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return content["result"] if content.get("fingerprint") == current else None
