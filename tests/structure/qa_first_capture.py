# SPDX-License-Identifier: GPL-3.0-or-later
"""First capture and tag to build: what their pages print is so, drawings are their programs'."""

import re
from pathlib import Path

import yaml
from command_runs import run_command
from gnuradio import wiforce

DOCS = Path(__file__).resolve().parents[2] / "docs"
PAGE = (DOCS / "radios.md").read_text(encoding="utf-8").split("## The first capture\n")[1]


def test_scene_of_the_page_can_be_planned():
    (scene,) = re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)
    plan = wiforce.plan(yaml.safe_load(scene))
    assert [sensor.name for sensor in plan.sensors] == ["arm"]


def test_lines_of_design_on_the_page_are_those_of_the_command():
    page = (DOCS / "build-a-tag.md").read_text(encoding="utf-8")
    assert len(page.split()) <= 1500
    printed = run_command("design", "--clock-hz", "1035").stdout
    shown = re.findall(r"^(?:line|impedance|matched|carrier|firmware)  .*\n", page, re.MULTILINE)
    assert "".join(shown) == printed
