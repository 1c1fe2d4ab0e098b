# SPDX-License-Identifier: GPL-3.0-or-later
"""The programs of docs/outputs.md run, and the page names what the code has."""

import re
from pathlib import Path

import pytest
from command_runs import run_command
from gnuradio.wiforce.io.network.lsl_outlets import CHANNELS
from gnuradio.wiforce.io.ros_messages import topics_of

PAGE = (Path(__file__).resolve().parents[3] / "docs/outputs.md").read_text(encoding="utf-8")


def test_examples_run_on_a_press(tmp_path, monkeypatch, capsys):
    """In their order, as one program, on the scene that is simulated fastest."""
    monkeypatch.chdir(tmp_path)
    assert run_command("simulate", "tabletop", "press").returncode == 0
    words = ["read", "press", "-o", "press.parquet", "--mcap", "press.mcap"]
    assert run_command(*words).returncode == 0
    # The stream of LSL is a live one, and its test is with the live run; a folder of captures is
    # read in qa_docs.py.
    elsewhere = ("pylsl", 'read("captures")')
    blocks = [
        block
        for block in re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
        if not any(part in block for part in elsewhere)
    ]
    assert len(blocks) == 4
    names = {}
    exec("\n".join(blocks), names)
    error_n, reference_s, *forces = capsys.readouterr().out.split("max")[1].splitlines()[1:]
    assert float(error_n) < 0.2 and float(reference_s) > 0 and len(forces) > 50
    assert len(names["both"]) == len(names["clear"]) == len(forces)


@pytest.mark.parametrize("name", [*(name for name, *_ in CHANNELS), "mcap-ros2-support"])
def test_page_names_channels_and_packages(name):
    assert f"`{name}`" in PAGE


def test_page_names_all_topics():
    assert all(f"`{topic}`" in PAGE for topic in topics_of(["SENSOR"]))
