# SPDX-License-Identifier: GPL-3.0-or-later
"""docs/first-capture.md: what it prints is so, and its drawing is that of its program."""

import importlib.util
import re
from pathlib import Path

import yaml
from gnuradio import wiforce

DOCS = Path(__file__).resolve().parents[2] / "docs"
PAGE = (DOCS / "first-capture.md").read_text(encoding="utf-8")


def test_page_is_read_in_minutes():
    assert len(PAGE.split()) <= 1500


def test_scene_of_the_page_can_be_planned():
    (scene,) = re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)
    plan = wiforce.plan(yaml.safe_load(scene))
    assert [sensor.name for sensor in plan.sensors] == ["arm"]


def test_drawing_is_that_of_its_program():
    path = DOCS / "make_first_capture_drawing.py"
    spec = importlib.util.spec_from_file_location(path.stem, path)
    maker = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(maker)
    hint = "run: build/run python3 docs/make_first_capture_drawing.py"
    assert maker.PICTURE.read_text(encoding="utf-8") == maker.drawing(), hint
