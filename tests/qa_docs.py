# SPDX-License-Identifier: GPL-3.0-or-later
"""Documentation that is made from other text is what that text says now."""

import importlib.util
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="module")
def maker():
    spec = importlib.util.spec_from_file_location("maker", ROOT / "docs" / "make_block_pages.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_block_pages_say_what_descriptions_and_docstrings_say(maker):
    expected = maker.pages()
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
