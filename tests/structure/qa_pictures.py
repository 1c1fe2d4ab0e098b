# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of docs/images, made again: they show what the programs draw today."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from long_cases import cases
from matplotlib import image
from modules import module_of

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
    return module_of(ROOT / "docs" / f"{name}.py")


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
