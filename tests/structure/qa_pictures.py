# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of docs/images, made again: they show what the programs draw today."""

import importlib.util
from functools import cache
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from command_runs import run_command
from gnuradio.wiforce.gui import ForceDisplay
from gnuradio.wiforce.io.readings import Reading
from long_cases import cases
from matplotlib import image

ROOT = Path(__file__).resolve().parents[2]
IMAGES = ROOT / "docs" / "images"
CELLS = 30, 40
# Largest mean difference of grey levels, 0 to 1, of coarse pictures: the same ones differ by up to
# 0.009, because of other fonts or titles, different ones of docs/images by 0.023 or more.
LIMIT = 0.015


@cache
def coarse(path):
    """Grey levels of a picture (30, 40), means over its cells."""
    pixels = image.imread(path)[..., :3].mean(axis=2)
    rows, columns = (
        np.arange(n + 1) * size // n for n, size in zip(CELLS, pixels.shape, strict=True)
    )
    sums = np.add.reduceat(np.add.reduceat(pixels, rows[:-1], axis=0), columns[:-1], axis=1)
    return sums / np.outer(np.diff(rows), np.diff(columns))


def difference(first, second):
    return float(np.abs(coarse(first) - coarse(second)).mean())


def maker(name):
    """A module of docs that draws a picture."""
    spec = importlib.util.spec_from_file_location(name, ROOT / "docs" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_difference_tells_pictures_apart():
    pictures = sorted(IMAGES.glob("*.png"))
    assert len(pictures) >= 10
    for first, second in combinations(pictures, 2):
        assert difference(first, second) > LIMIT, (first.name, second.name)


@pytest.mark.parametrize(
    "name",
    cases(
        "clock_spectra", "surface_picture", "tradeoff_picture", "waveforms", long=["turn_picture"]
    ),
)
def test_picture_of_a_script_is_that_of_the_documentation(name, tmp_path, monkeypatch, capsys):
    module = maker(f"make_{name}")
    kept = module.PICTURE
    monkeypatch.setattr(module, "PICTURE", tmp_path / "again.png")
    module.main()
    assert difference(tmp_path / "again.png", kept) < LIMIT


def test_picture_of_the_demo_is_that_of_the_documentation(demo):
    """A newcomer compares his first picture with that of the tutorial."""
    assert difference(demo[0] / "readings.png", IMAGES / "readings.png") < LIMIT


@pytest.mark.long
def test_picture_of_a_survey_is_that_of_the_documentation(tmp_path):
    walk = tmp_path / "walk"
    assert run_command("simulate", "somebody_walks", walk).returncode == 0
    assert run_command("survey", walk, "--plot", tmp_path / "survey.png").returncode == 0
    assert difference(tmp_path / "survey.png", IMAGES / "survey.png") < LIMIT


# Time of the begin, force and location of what docs/make_screenshots.py sets; None: flagged.
STEPS = (
    (0.0, 0.0, None),
    (1.66, 3.0, 33.0),
    (4.12, 5.5, 47.0),
    (6.62, 0.0, None),
    (8.12, 4.1, 55.0),
)


def test_force_display_looks_as_in_the_documentation(qt, tmp_path):
    path = IMAGES / "force_display.png"
    height, width = image.imread(path).shape[:2]
    display = ForceDisplay()
    display._timer.stop()
    display.resize(width, height)
    display.show()
    for time_s in np.arange(0.018, 9.95, 0.036).tolist():
        _, force_n, place = [step for step in STEPS if step[0] <= time_s][-1]
        pressed = force_n > 0
        values = (force_n, 0.065, place, 0.05) if pressed else ()
        display.add(Reading(time_s, "arm", int(pressed), *values, snr_db=15.1))
    for _ in range(5):
        display.refresh()
        qt.processEvents()
    display.grab().save(str(tmp_path / "again.png"))
    display.close()
    assert difference(tmp_path / "again.png", path) < LIMIT


@pytest.mark.long
def test_page_looks_as_in_the_documentation(tmp_path, monkeypatch):
    """A change of the page would leave the README with the former one."""
    screenshots = maker("make_screenshots")
    monkeypatch.setattr(screenshots, "IMAGES", tmp_path)
    screenshots.take_browser(tmp_path)
    taken = sorted(tmp_path.glob("*.png"))
    assert len(taken) == 4
    for path in taken:
        assert difference(path, IMAGES / path.name) < LIMIT, path.name
