# SPDX-License-Identifier: GPL-3.0-or-later
"""Generated documentation is up to date with its sources."""

import doctest
import json
import re
import shlex
import statistics
import subprocess
import sys
from pathlib import Path

import make_block_pages as block_pages
import numpy as np
import pytest
import yaml
from command_runs import run_command, succeeded

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"


# What the programs of docs/ write whose names are given, {program: {path: text}}.
GENERATE = """
import importlib, json, sys
files = {name: importlib.import_module(name).files() for name in sys.argv[1:]}
print(json.dumps({name: {str(path): files[name][path] for path in files[name]} for name in files}))
"""
PROGRAMS = ("make_block_pages", "make_reference", "make_man_page")
PROGRAMS += ("make_architecture_drawings", "make_setup_drawings", "make_tag_drawings")


def test_generated_files_are_those_of_their_programs():
    # In a process of its own, because imports of other tests must not change the pages.
    command = [sys.executable, "-c", GENERATE, *PROGRAMS]
    done = subprocess.run(command, cwd=DOCS, stdout=subprocess.PIPE, check=True, timeout=60)
    generated = json.loads(done.stdout)
    for program, files in generated.items():
        for path, text in files.items():
            hint = f"run: build/run python3 docs/{program}.py"
            assert Path(path).read_text(encoding="utf-8") == text, hint
    # Every page beside them is of something that is gone.
    pages = {
        str(path) for folder in ("blocks", "reference") for path in DOCS.glob(f"{folder}/*.md")
    }
    assert pages <= {path for files in generated.values() for path in files}


def test_block_parameters_shared_with_grc_are_documented():
    """A single model in force_inversion and output files exist in GRC only."""
    own = {"model", "more_models", "output", "mode", "gui_hint", "file", "sliders"}
    for description in block_pages.descriptions():
        _, known = block_pages.source_text(block_pages.name_of(description))
        for parameter in description.get("parameters", []):
            if parameter["id"] not in own:
                assert known.get(parameter["id"]), (description["id"], parameter["id"])


@pytest.mark.parametrize(
    ("typed", "expected"),
    [
        ("re", "plain,read"),
        ("plan tablet", "plain,tabletop\nplain,tabletop_two"),
        ("plan ./my", "file,./my"),
        ("invert --sensor wiforce-900mhz", "plain,wiforce-900mhz"),
    ],
)
def test_shell_completes_subcommands_scenes_and_sensors(typed, expected, monkeypatch):
    monkeypatch.setenv("_GR_WIFORCE_COMPLETE", "bash_complete")
    monkeypatch.setenv("COMP_WORDS", f"gr-wiforce {typed}")
    monkeypatch.setenv("COMP_CWORD", str(len(typed.split())))
    done = run_command()
    assert done.stdout.strip() == expected
    assert done.stderr == ""  # it would appear on the line that is typed


def code_blocks(page, language):
    """Code of a page in ``docs/``, block by block."""
    text = (DOCS / page).read_text(encoding="utf-8")
    return re.findall(rf"```{language}\n(.*?)```", text, re.DOTALL)


README = (ROOT / "README.md").read_text(encoding="utf-8")
WRITTEN = sorted(DOCS.glob("*.md"))
BESIDE = ("README.md", "CONTRIBUTING.md", "SECURITY.md", "packaging/README.md", "CHANGELOG.md")
PAGES = [*WRITTEN, *DOCS.glob("*/*.md"), *(ROOT / name for name in BESIDE)]
PAGES += [ROOT / "examples/README.md", ROOT / "ros2/README.md"]


@pytest.fixture(scope="module")
def press(tmp_path_factory, demo):
    """A folder as README's lines leave it up to its first lines of Python."""
    folder = tmp_path_factory.mktemp("readme")
    simulate, read = readme_commands("simulate", "read")
    assert simulate == ["simulate", "demo", "press"]  # what the demo has simulated already
    for name in ("press.sigmf-meta", "press.sigmf-data", "sensor.yaml"):
        (folder / name).symlink_to(demo[0] / name.replace("press", "demo"))
    succeeded(*read, cwd=folder)
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


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_to_files_and_headings(page):
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    for target, heading in re.findall(r"\]\(([^)#\s]*)#?([^)\s]*)\)", text):
        if target.startswith("https:"):
            continue
        found = page.parent / target if target else page
        assert found.exists(), target
        if heading:
            titles = re.findall(r"^#+ (.+)$", found.read_text(encoding="utf-8"), re.MULTILINE)
            anchors = [re.sub(r"[^\w-]", "", t.lower().replace(" ", "-")) for t in titles]
            assert heading in anchors, f"{target}#{heading}"


def test_documentation_is_small_enough_to_be_read():
    """It had 30 pages and 84 000 words, in which nobody found anything."""
    words = {page.name: len(page.read_text(encoding="utf-8").split()) for page in WRITTEN}
    assert len(words) <= 14 and sum(words.values()) <= 30_000
    for page in WRITTEN:
        if words[page.name] > 1500:
            head = page.read_text(encoding="utf-8").split("\n", 10)[2:9]
            starts = [line[:3] for line in head]
            assert starts == ["In ", "", "1. ", "2. ", "3. ", "4. ", "5. "], page.name
    assert len((ROOT / "docs/architecture.md").read_text(encoding="utf-8").splitlines()) <= 150


def test_commands_of_all_pages_exist_with_their_options():
    """A page that names an option of yesterday costs its reader the first ten minutes."""
    from wiforce_app.main import command

    lines = 0
    for page in (ROOT / "README.md", *WRITTEN):
        for block in code_blocks(page, "sh"):
            for line in block.replace("\\\n", " ").splitlines():
                for part in re.findall(r"(?<![\w/-])gr-wiforce ([^|#;)>]+)", line):
                    words = shlex.split(part.rstrip("& "))
                    each = command.get_command(None, words[0])
                    if each is None:
                        assert page.name == "install.md" and "apt" in line, line
                        continue
                    if hasattr(each, "commands") and words[1] in each.commands:
                        each = each.get_command(None, words[1])
                    known = {name for option in each.params for name in option.opts}
                    used = {word.split("=")[0] for word in words if word.startswith("-")}
                    assert used <= known | {"--help"}, line
                    lines += 1
    assert lines > 50


def named_files(page):
    """Files that a page names in backquotes, with at least a folder."""
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    return re.findall(r"`((?:[\w.-]+/)+[\w-]+\.(?:py|h|cc|md|csv|yaml|msg|rst))`", text)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_source_files_that_a_page_names_exist(page):
    """The theory sends its readers to the code of each formula."""
    inside = ("python/wiforce", "lib/kernel", "gr-wiforce", "gr-wiforce/wiforce_app")
    folders = (page.parent, ROOT, *(ROOT / each for each in inside))
    own = {"demo", "evaluation", "readings", "clients"}
    short = {"w": "python/wiforce", "app": "gr-wiforce/wiforce_app"}  # of CONTRIBUTING.md
    for name in named_files(page):
        first, rest = name.split("/", 1)
        if first not in own:
            name = f"{short.get(first, first)}/{rest}"
            assert any((folder / name).is_file() for folder in folders), name


def test_formulas_name_functions_that_exist():
    text = (ROOT / "docs/theory.md").read_text(encoding="utf-8")
    rows = text.split("## Formulas")[1].split("\n## ")[0].splitlines()
    found = [re.findall(r"`([\w/.]+\.py)`, `([\w.]+)`", row) for row in rows]
    assert sum(map(len, found)) > 8
    for file, function in sum(found, []):
        source = (ROOT / "python/wiforce" / file).read_text(encoding="utf-8")
        for name in function.split("."):
            assert re.search(rf"^\s*(def|class) {name}\b", source, re.MULTILINE), (file, function)


def test_python_of_all_pages_is_valid():
    for page in (ROOT / "README.md", *WRITTEN):
        for block in code_blocks(page, "python"):
            compile(block, page.name, "exec")


def test_readme_python_draws_the_readings_that_its_commands_wrote(press, monkeypatch, capsys):
    import matplotlib.pyplot as plt

    assert (press / "press.png").read_bytes().startswith(b"\x89PNG")
    monkeypatch.chdir(press)
    plt.close("all")
    exec(readme_code("wiforce.read("), {})
    (bars,) = plt.gcf().axes[0].containers
    force_n = bars.lines[0].get_ydata()
    plt.close("all")
    assert float(capsys.readouterr().out) == pytest.approx(max(force_n))
    assert np.sum(force_n == 0) > 20 and np.sum(force_n > 1) > 20


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
    (tmp_path / "demo").mkdir()  # where the demo writes such a table
    sensor.write_vna_csv(table, line[1])
    (columns,) = re.findall(r"calibrate .*, or yours with (\S+)", README)
    assert (tmp_path / line[1]).read_text().startswith(columns)
    succeeded(*line)
    assert sensor.load_sensor(line[-1]).location_span_mm == (20, 60)


@pytest.mark.long
def test_readme_accuracy_is_what_its_command_prints(tmp_path):
    """A table that nobody can reproduce is an advertisement."""
    rows = re.findall(
        r"^\| `((?:evaluate|bench) .+?)` \|.*\| (.+) \| (.+) \|$", README, re.MULTILINE
    )
    assert [row[0].split()[0] for row in rows] == ["evaluate", "evaluate", "evaluate", "bench"]
    done = run_command(*rows[1][0].split(), cwd=tmp_path)
    (span,) = re.findall(r"range of ours \|.*?\|.*?\| (.+?) \| (.+?) \|", done.stdout)
    for (_, here, _), unit, printed in zip(rows[1:], ("N", "mm"), span, strict=False):
        stated = [float(value) for value in here.removesuffix(f" {unit}").split(" to ")]
        found = [float(value) for value in printed.split(" to ")]
        assert stated == pytest.approx(found, rel=0.2)


def test_page_of_many_captures_prints_a_median_for_each(press, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "captures").mkdir()
    (tmp_path / "captures/sensor.yaml").symlink_to(press / "sensor.yaml")
    for name in ("a", "b"):
        for suffix in ("sigmf-meta", "sigmf-data"):
            (tmp_path / f"captures/{name}.{suffix}").symlink_to(press / f"press.{suffix}")
    (code,) = [code for code in code_blocks("outputs.md", "python") if "groupby" in code]
    exec(code, {})
    medians = re.findall(r"^[ab] +([\d.]+)$", capsys.readouterr().out, re.MULTILINE)
    assert len(medians) == 2 and all(1 < float(median) < 8 for median in medians)


def test_pages_hold_whole_scenes(tmp_path, monkeypatch):
    """Of a waveform, a first capture, packets, a surface and the tutorial; sections are refused."""
    from gnuradio import wiforce

    monkeypatch.chdir(tmp_path)
    exec(code_blocks("radios.md", "python")[0], {})
    pages = {name: code_blocks(f"{name}.md", "yaml") for name in ("radios", "wifi", "tutorial")}
    (tmp_path / "scene.yaml").write_text(pages["radios"][1])
    settings = wiforce.plan("scene.yaml")
    assert settings.waveform.symbol_length == 128 and settings.scene.simulation.presses
    for text, name in ((pages["radios"][-1], "arm"), (pages["tutorial"][0], "finger")):
        assert [sensor.name for sensor in wiforce.plan(yaml.safe_load(text)).sensors] == [name]
    (tmp_path / "wifi.yaml").write_text(pages["wifi"][0])
    assert wiforce.load_scene("wifi.yaml").simulation.snr_db == -12
    line, strips, presses = code_blocks("sensors.md", "yaml")[:3]
    (tmp_path / "line.yaml").write_text(line)
    assert wiforce.load_sensor("line.yaml").kind == "line"
    for name in ("low.yaml", "high.yaml"):
        strips = strips.replace(name, "line-900mhz-calibrated")
    bare = "".join(line for line in strips.splitlines(True) if "spreading_file" not in line)
    (tmp_path / "skin.yaml").write_text(bare + presses)
    scene = wiforce.load_scene("skin.yaml")
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
    """The blocks form one program."""
    first, *others = code_blocks("tutorial.md", "python")
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


def test_lines_of_design_on_their_page_are_those_of_the_command():
    page = (ROOT / "docs/build-a-tag.md").read_text(encoding="utf-8")
    printed = run_command("design", "--clock-hz", "1035").stdout
    shown = re.findall(r"^(?:line|impedance|matched|carrier|firmware)  .*\n", page, re.MULTILINE)
    assert "".join(shown) == printed


def test_walkthrough_examples_give_output_shown(tmp_path, monkeypatch, numbers_without_types):
    """A reader who learns the stages from the page must see what the page shows."""
    monkeypatch.chdir(tmp_path)
    shown = "\n".join(code_blocks("tutorial.md", "pycon"))
    page = doctest.DocTestParser().get_doctest(shown, {}, "tutorial.md", None, 0)
    result = doctest.DocTestRunner().run(page)
    assert result.attempted > 50
    assert result.failed == 0, f"{result.failed} of {result.attempted} examples, shown above"
