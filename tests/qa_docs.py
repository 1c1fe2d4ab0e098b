# SPDX-License-Identifier: GPL-3.0-or-later
"""Generated documentation is up to date with its sources."""

import doctest
import importlib.util
import json
import os
import re
import statistics
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).resolve().parent.parent


def loaded(name):
    spec = importlib.util.spec_from_file_location(name, ROOT / "docs" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def maker():
    return loaded("make_block_pages")


def test_block_pages_match_descriptions_and_docstrings(maker):
    # In a process of its own, because imports of other tests must not change the pages.
    done = subprocess.run(
        [sys.executable, "-c", "import json, make_block_pages as m; print(json.dumps(m.pages()))"],
        cwd=ROOT / "docs",
        capture_output=True,
        text=True,
        timeout=60,
    )
    expected = json.loads(done.stdout)
    assert {p.name for p in maker.PAGES.glob("*.md")} == set(expected)
    for name, text in expected.items():
        hint = "run: build/run python3 docs/make_block_pages.py"
        assert (maker.PAGES / name).read_text(encoding="utf-8") == text, hint


def test_block_parameters_shared_with_grc_are_documented(maker):
    """A single model in force_inversion and output files exist in GRC only."""
    own = {"model", "more_models", "output", "mode", "gui_hint", "file"}
    for description in maker.descriptions():
        _, known = maker.source_text(maker.name_of(description))
        for parameter in description.get("parameters", []):
            if parameter["id"] not in own:
                assert known.get(parameter["id"]), (description["id"], parameter["id"])


def test_man_page_matches_command_help():
    maker = loaded("make_man_page")
    hint = "run: build/run python3 docs/make_man_page.py"
    assert maker.PAGE.read_text(encoding="utf-8") == maker.page(), hint


@pytest.mark.parametrize(
    ("typed", "expected"), [("re", "plain,read"), ("sim", "plain,simulate"), ("nothing", "")]
)
def test_shell_completes_subcommands(typed, expected):
    done = subprocess.run(
        [sys.executable, "-c", "from wiforce_app.main import main; main()"],
        env=os.environ
        | {"_GR_WIFORCE_COMPLETE": "bash_complete", "COMP_WORDS": f"gr-wiforce {typed}"}
        | {"COMP_CWORD": "1"},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.stdout.strip() == expected


def test_completion_scripts_query_the_command():
    for shell in ("bash", "zsh", "fish"):
        text = (ROOT / "gr-wiforce" / "completions" / f"gr-wiforce.{shell}").read_text()
        assert f"_GR_WIFORCE_COMPLETE={shell}_source" in text


def test_shipped_scenes_are_documented():
    from gnuradio.wiforce.scene import shipped_scenes

    text = (ROOT / "docs" / "scenes.md").read_text(encoding="utf-8")
    assert [name for name in shipped_scenes() if f"`{name}`" not in text] == []


def code_blocks(page, language):
    """Code of a page in ``docs/``, block by block."""
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    return re.findall(rf"```{language}\n(.*?)```", text, re.DOTALL)


def test_readme_notebook_draws_presses_and_nothing_between_them(tmp_path, monkeypatch):
    """A line through the time in which nobody touches shows a force that is not there."""
    import matplotlib.pyplot as plt
    import numpy as np
    from gnuradio import wiforce

    monkeypatch.chdir(tmp_path)
    wiforce.simulate("demo", "press")
    (code,) = [c for c in code_blocks("../README.md", "python") if "wiforce.read(" in c]
    exec(code, {})
    time_s, force_n = plt.gca().get_lines()[0].get_xydata().T
    plt.close("all")
    truth = np.genfromtxt("press.truth.csv", delimiter=",", names=True)
    applied_n = np.interp(time_s, truth["time_s"], np.nan_to_num(truth["force_n"]))
    edge_s = truth["time_s"][np.flatnonzero(np.diff(truth["touch"]))]
    steady = np.abs(time_s[:, None] - edge_s).min(axis=1) > 0.1
    untouched = steady & (applied_n == 0)
    assert untouched.sum() > 20 and (steady & ~untouched).sum() > 20
    assert (force_n[untouched] == 0).all()
    assert np.median(np.abs(force_n - applied_n)[steady & ~untouched]) < 0.15


def test_page_of_many_captures_prints_a_median_for_each(tmp_path, monkeypatch, capsys):
    from gnuradio import wiforce

    monkeypatch.chdir(tmp_path)
    (tmp_path / "captures").mkdir()
    for name in ("a", "b"):
        wiforce.simulate("tabletop", f"captures/{name}")
    (code,) = code_blocks("many-captures.md", "python")
    exec(code, {})
    medians = re.findall(r"^[ab] +([\d.]+)$", capsys.readouterr().out, re.MULTILINE)
    assert len(medians) == 2 and all(1 < float(median) < 8 for median in medians)


def test_waveform_page_scene_is_planned_with_its_symbol(tmp_path, monkeypatch):
    """The page showed a section of a scene only, which `plan` refused."""
    from gnuradio import wiforce

    monkeypatch.chdir(tmp_path)
    exec(code_blocks("waveforms.md", "python")[0], {})
    (tmp_path / "scene.yaml").write_text(code_blocks("waveforms.md", "yaml")[0])
    settings = wiforce.plan("scene.yaml")
    assert settings.waveform.symbol_length == 128 and settings.scene.simulation.presses


def test_pages_of_packets_and_surfaces_hold_whole_scenes(tmp_path):
    from gnuradio import wiforce

    (tmp_path / "wifi.yaml").write_text(code_blocks("wifi.md", "yaml")[0])
    assert wiforce.load_scene(tmp_path / "wifi.yaml").simulation.snr_db == -12
    strips, presses = code_blocks("surfaces.md", "yaml")[:2]
    for name in ("low.yaml", "high.yaml"):
        strips = strips.replace(name, "line-900mhz-calibrated")
    bare = "".join(line for line in strips.splitlines(True) if "spreading_file" not in line)
    (tmp_path / "skin.yaml").write_text(bare + presses)
    scene = wiforce.load_scene(tmp_path / "skin.yaml")
    assert len(scene.surface.strips) == len(scene.simulation.surface_presses) == 2


# Put into the tutorial's program: the signal waits at 1.1 s until the sensor is pressed, which
# happens at 0.7 s, since a busy machine may run ahead of its readings.
WAITING = """
import threading
import numpy as np

class Waiting(gr.sync_block):
    def __init__(self):
        gr.sync_block.__init__(self, "waiting", [np.complex64], [np.complex64])
        self.pressed = threading.Event()

    def work(self, inputs, outputs):
        if self.nitems_written(0) + len(outputs[0]) > 1.1 * rate:
            assert self.pressed.wait(60)
        outputs[0][:] = inputs[0]
        return len(outputs[0])

waiting = Waiting()
"""


def test_tutorial_code_reads_the_press(capsys):
    """The blocks form one program; the last one connects a source of the user's own."""
    first, *others = code_blocks("tutorial.md", "python")[:-1]
    program = "\n".join([first, WAITING, *others])
    for shown, put in (
        ("sounder, head, tag", "sounder, head, waiting, tag"),
        ("tag.set_force_n(4.0)", "tag.set_force_n(4.0); waiting.pressed.set()"),
    ):
        assert program.count(shown) == 1
        program = program.replace(shown, put)
    exec(program, {})
    lines = capsys.readouterr().out.splitlines()
    locations = [float(m[1]) for line in lines if (m := re.search(r" N at ([\d.]+) \+-", line))]
    assert len(locations) > 20 and abs(statistics.median(locations) - 45) < 0.5


def test_tutorial_scene_is_valid():
    from gnuradio.wiforce.scene import load_scene

    (scene,) = code_blocks("tutorial.md", "yaml")
    assert list(load_scene(yaml.safe_load(scene)).sensor_names) == ["finger"]


def test_walkthrough_examples_give_output_shown(tmp_path, monkeypatch, numbers_without_types):
    """A reader who learns the stages from the page must see what the page shows."""
    monkeypatch.chdir(tmp_path)
    text = (ROOT / "docs" / "walkthrough.md").read_text(encoding="utf-8")
    without_fences = re.sub(r"^```.*$", "", text, flags=re.MULTILINE)
    page = doctest.DocTestParser().get_doctest(without_fences, {}, "walkthrough.md", None, 0)
    result = doctest.DocTestRunner().run(page)
    assert result.attempted > 50
    assert result.failed == 0, f"{result.failed} of {result.attempted} examples, shown above"
