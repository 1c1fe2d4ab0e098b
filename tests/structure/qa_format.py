# SPDX-License-Identifier: GPL-3.0-or-later
"""Sources: format, lint, types, names of tags in both languages."""

import importlib.util
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from gnuradio.wiforce.blocks import names

ROOT = Path(__file__).resolve().parents[2]
# Every version breaks some lines in other places; this is that of Debian 12.
CLANG_FORMAT = 14
CPP_FOLDERS = ("include", "lib", "python", "tests")


def run(*command):
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300)
    return done.returncode, done.stdout + done.stderr


@pytest.mark.parametrize("arguments", [("check",), ("format", "--check")])
def test_python_sources_pass_ruff(arguments):
    assert shutil.which("ruff"), "ruff is missing: ./bootstrap installs it"
    status, output = run("ruff", *arguments, "--no-cache", ".")
    assert status == 0, output


def test_cpp_sources_pass_clang_format():
    files = [p for folder in CPP_FOLDERS for p in (ROOT / folder).rglob("*")]
    sources = [str(p) for p in files if p.suffix in (".cc", ".h")]
    assert len(sources) > 10
    version = re.search(r"version (\d+)", run("clang-format", "--version")[1])
    if int(version[1]) != CLANG_FORMAT:
        pytest.skip(f"needs clang-format {CLANG_FORMAT}, found {version[1]}")
    status, output = run("clang-format", "--dry-run", "-Werror", *sources)
    assert status == 0, output


HEADER = ROOT / "include/gnuradio/wiforce/names.h"


def test_both_languages_use_the_same_names():
    in_cpp = dict(re.findall(r'constexpr char (\w+)\[\] = "([^"]*)";', HEADER.read_text()))
    in_python = {k: v for k, v in vars(names).items() if k.isupper()}
    assert in_cpp == in_python
    assert len(in_cpp) >= 9


def test_every_tag_and_port_has_a_row_in_the_table():
    table = (ROOT / "docs/architecture.md").read_text().split("### Tags, ports and keys")[1]
    rows = [
        row.split("|")[1] for row in table.split("\n## ")[0].splitlines() if row.startswith("| `")
    ]
    found = {name for row in rows for name in re.findall("`(.*?)`", row)}
    # Keys of the messages on the ports `tare` and `warnings`.
    keys = {names.FORCE, names.TEXT}
    assert found == {v for k, v in vars(names).items() if k.isupper()} - keys


@pytest.mark.skipif(
    not np.__version__.startswith("1."), reason="the annotations of NumPy 2 have other types"
)
def test_package_annotations_pass_mypy(pytestconfig):
    """Editors complete and check calls by the annotations: wrong ones mislead."""
    # Kept from run to run: a run without changes then takes a second instead of ten.
    cache = pytestconfig.cache.mkdir("mypy")
    assert importlib.util.find_spec("mypy"), "mypy is missing: ./bootstrap installs it"
    status, output = run(sys.executable, "-m", "mypy", "--cache-dir", str(cache))
    assert status == 0, output
