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
_FORMAT = 6


def evaluate_scenes(names, folder, jobs=None, fresh=False):
    """Run scenes (or ``all``) without a stored result, or ``fresh`` ones, and report."""
    names = list(dict.fromkeys(sampled_scenes() if "all" in names else names))
    files = [folder / f"{Path(name).stem}.json" for name in names]
    for name, file in zip(names, files, strict=True):
        if files.count(file) > 1:
            raise InputError("scenes", "must have different file names", name)
    # Invalid scenes are refused before any work is done.
    scenes = [load_scene(name) for name in names]
    hashes = []
    for name, scene in zip(names, scenes, strict=True):
        if scene.packets is not None:
            raise InputError(name, "is a scene of packets; only scenes of samples are evaluated")
        for warning in simulation_warnings(scene):
            log.warning(f"{name}: {warning}")
        hashes.append(fingerprint(scene, other_causes(str(name)), _FORMAT, simulated=True))
    folder.mkdir(parents=True, exist_ok=True)
    for output in (folder / "report.md", *files):
        check_output(output, [file for scene in scenes for file in scene.files])
    results = [None if fresh else stored(*known) for known in zip(files, hashes, strict=True)]
    missing = [i for i, result in enumerate(results) if result is None]
    with progress("evaluating", len(missing)) as step:
        for outcome in run_tasks(_run, [(names[i], str(folder)) for i in missing], jobs):
            i = missing[outcome.index]
            results[i] = outcome.get()
            write_whole(files[i], json.dumps({"fingerprint": hashes[i], "result": results[i]}))
            step(1)
    figures = paper_figures()
    write_report(results, folder, figures)
    click.echo(table(results, figures))
    if causes := cause_table(results, figures):
        click.echo(f"\n{causes}")
    click.echo(f"\nreport: {folder / 'report.md'}")


def _run(task):
    from .experiment import run

    return run(*task)


def stored(file, current):
    """The result that a file holds; None when there is none with this hash."""
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return content["result"] if content.get("fingerprint") == current else None
