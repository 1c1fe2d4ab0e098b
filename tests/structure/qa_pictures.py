# SPDX-License-Identifier: GPL-3.0-or-later
"""Programs of docs/ that draw its pictures: they still run."""

import importlib

import pytest
from matplotlib import image


@pytest.mark.parametrize(
    "name", ["clock_spectra", "surface_picture", "tradeoff_picture", "waveforms"]
)
def test_program_of_a_picture_draws_one_of_its_size(name, tmp_path, monkeypatch):
    module = importlib.import_module(f"make_{name}")
    kept = image.imread(module.PICTURE).shape
    monkeypatch.setattr(module, "PICTURE", tmp_path / "again.png")
    module.main()
    assert image.imread(tmp_path / "again.png").shape == kept
