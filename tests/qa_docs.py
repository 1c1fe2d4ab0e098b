# SPDX-License-Identifier: GPL-3.0-or-later
"""Documentation that is made from other text is what that text says now."""

import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent


def loaded(name):
    spec = importlib.util.spec_from_file_location(name, ROOT / "docs" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def maker():
    return loaded("make_block_pages")


def test_block_pages_say_what_descriptions_and_docstrings_say(maker):
    # In a process of its own: what other tests have imported must not change what is said.
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


def test_every_parameter_that_source_and_grc_share_is_explained(maker):
    """force_inversion's single model and the files to write to are GRC's own."""
    own = {"model", "more_models", "output", "mode", "gui_hint", "file"}
    for description in maker.descriptions():
        _, known = maker.source_text(maker.name_of(description))
        for parameter in description.get("parameters", []):
            if parameter["id"] not in own:
                assert known.get(parameter["id"]), (description["id"], parameter["id"])


def test_the_man_page_says_what_the_command_does():
    maker = loaded("make_man_page")
    hint = "run: build/run python3 docs/make_man_page.py"
    assert maker.PAGE.read_text(encoding="utf-8") == maker.page(), hint


@pytest.mark.parametrize(
    ("typed", "expected"), [("re", "plain,read"), ("sim", "plain,simulate"), ("nothing", "")]
)
def test_the_shell_completes_subcommands(typed, expected):
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


def test_the_shipped_completion_asks_the_command_itself():
    for shell in ("bash", "zsh", "fish"):
        text = (ROOT / "gr-wiforce" / "completions" / f"gr-wiforce.{shell}").read_text()
        assert f"_GR_WIFORCE_COMPLETE={shell}_source" in text


def test_every_shipped_scene_is_explained():
    from gnuradio.wiforce.scene import shipped_scenes

    text = (ROOT / "docs" / "scenes.md").read_text(encoding="utf-8")
    assert [name for name in shipped_scenes() if f"`{name}`" not in text] == []
