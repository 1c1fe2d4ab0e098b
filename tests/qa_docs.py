# SPDX-License-Identifier: GPL-3.0-or-later
"""Generated documentation is up to date with its sources."""

import doctest
import importlib.util
import json
import os
import re
import shlex
import statistics
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from command_runs import run_command

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


README = (ROOT / "README.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def press(tmp_path_factory):
    """The folder in which README's lines have run up to its first lines of Python."""
    folder = tmp_path_factory.mktemp("readme")
    for line in readme_commands("simulate", "read"):
        done = run_command(*line, cwd=folder)
        assert done.returncode == 0, done.stderr
    return folder


def readme_commands(*names):
    """README's lines that run these subcommands, as words behind ``gr-wiforce``."""
    lines = re.findall(r"^build/run gr-wiforce (.+)$", README, re.MULTILINE)
    words = [shlex.split(line, comments=True) for line in lines]
    found = [line for line in words if line[0] in names]
    assert {line[0] for line in found} == set(names)
    return found


def readme_code(part):
    (code,) = [code for code in code_blocks("../README.md", "python") if part in code]
    return code


def test_readme_is_read_in_minutes_and_its_links_lead_somewhere():
    assert len(README.splitlines()) <= 80 and len(README.split()) <= 750
    targets = re.findall(r"\]\(([^)#]+)#?([^)]*)\)", README)
    for target, heading in targets:
        if not target.startswith("https:"):
            assert (ROOT / target).exists(), target
        if heading:
            page = (ROOT / target).read_text(encoding="utf-8")
            titles = re.findall(r"^#+ (.+)$", page, re.MULTILINE)
            assert heading in [re.sub(r"[^\w-]", "", t.lower().replace(" ", "-")) for t in titles]
    assert {f"docs/{p.name}" for p in (ROOT / "docs").glob("results.md")} < {t for t, _ in targets}


def test_readme_commands_write_readings_and_a_picture(press):
    assert (press / "press.png").read_bytes().startswith(b"\x89PNG")
    assert len((press / "press.csv").read_text().splitlines()) > 80


def test_readme_python_draws_presses_and_nothing_between_them(press, monkeypatch, capsys):
    """A line through the time in which nobody touches shows a force that is not there."""
    import matplotlib.pyplot as plt

    monkeypatch.chdir(press)
    plt.close("all")
    exec(readme_code("wiforce.read("), {})
    (bars,) = plt.gcf().axes[0].containers
    time_s, force_n = bars.lines[0].get_data()
    plt.close("all")
    assert float(capsys.readouterr().out) == pytest.approx(max(force_n))
    truth = np.genfromtxt("press.truth.csv", delimiter=",", names=True)
    applied_n = np.interp(time_s, truth["time_s"], np.nan_to_num(truth["force_n"]))
    edge_s = truth["time_s"][np.flatnonzero(np.diff(truth["touch"]))]
    steady = np.abs(time_s[:, None] - edge_s).min(axis=1) > 0.1
    untouched = steady & (applied_n == 0)
    assert untouched.sum() > 20 and (steady & ~untouched).sum() > 20
    assert (force_n[untouched] == 0).all()
    assert np.median(np.abs(force_n - applied_n)[steady & ~untouched]) < 0.15


def test_readme_flowgraph_prints_what_the_command_reads(press, monkeypatch, capsys):
    monkeypatch.chdir(press)
    exec(readme_code("file_source"), {})
    lines = capsys.readouterr().out.splitlines()
    rows = (press / "press.csv").read_text().splitlines()[1:]
    assert len(lines) == len(rows) and sum(" N at " in line for line in lines) > 20


def test_readme_calibration_of_a_table_gives_a_sensor(tmp_path, monkeypatch):
    from gnuradio.wiforce import sensor

    monkeypatch.chdir(tmp_path)
    (line,) = readme_commands("calibrate")
    table = sensor.measure_vna(
        sensor.load_sensor("line-900mhz"), [20, 30, 40, 50, 60], np.arange(1, 8.5, 0.5), 0.1
    )
    sensor.write_vna_csv(table, line[1])
    (columns,) = re.findall(r"calibrate .*# of (\S+)", README)
    assert (tmp_path / line[1]).read_text().startswith(columns)
    assert run_command(*line).returncode == 0
    assert sensor.load_sensor(line[-1]).location_span_mm == (20, 60)


def test_readme_accuracy_is_what_its_command_prints(tmp_path):
    """A table that nobody can reproduce is an advertisement."""
    rows = re.findall(
        r"^\| `((?:evaluate|bench) .+?)` \|.*\| (.+) \| (.+) \|$", README, re.MULTILINE
    )
    assert [row[0].split()[0] for row in rows] == ["evaluate", "evaluate", "evaluate", "bench"]
    done = run_command(*rows[0][0].split(), cwd=tmp_path)
    (span,) = re.findall(r"range of ours \|.*?\|.*?\| (.+?) \| (.+?) \|", done.stdout)
    for (_, here, _), unit, printed in zip(rows, ("N", "mm"), span, strict=False):
        stated = [float(value) for value in here.removesuffix(f" {unit}").split(" to ")]
        found = [float(value) for value in printed.split(" to ")]
        assert stated == pytest.approx(found, rel=0.2)


def test_drawing_of_the_set_up_is_that_of_its_program():
    maker = loaded("make_setup_drawing")
    hint = "run: build/run python3 docs/make_setup_drawing.py"
    assert maker.PICTURE.read_text(encoding="utf-8") == maker.drawing(), hint


def test_animation_takes_ten_seconds():
    from PIL import Image

    with Image.open(ROOT / "docs/images/press.gif") as animation:
        assert animation.n_frames * animation.info["duration"] == 10_000


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
