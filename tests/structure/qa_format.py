# SPDX-License-Identifier: GPL-3.0-or-later
"""Sources are formatted and linted as the project's configuration says."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
# Every version breaks some lines in other places; this is that of Debian 12.
CLANG_FORMAT = 14
CPP_FOLDERS = ("include", "lib", "python", "tests")


def run(*command):
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300)
    return done.returncode, done.stdout + done.stderr


@pytest.mark.parametrize("arguments", [("check",), ("format", "--check")])
def test_python_sources_pass_ruff(arguments):
    ruff = Path(sys.prefix) / "bin" / "ruff"
    command = str(ruff) if ruff.exists() else shutil.which("ruff")
    assert command, "ruff is missing: ./bootstrap installs it"
    status, output = run(command, *arguments, "--no-cache", ".")
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
