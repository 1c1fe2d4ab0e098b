# SPDX-License-Identifier: GPL-3.0-or-later
"""The build tree: its launchers where shells interpret a path, and its tests."""

import json
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def test_run_in_a_checkout_with_an_unusual_path_finds_its_packages(tmp_path):
    """A `$` in the path was expanded, and every command failed for lack of its packages."""
    source = tmp_path / 'cost $HOME it\'s `here`, a "quoted" name'
    source.mkdir()
    for part in ("cmake", "python", "gr-wiforce"):
        (source / part).symlink_to(ROOT / part)
    interpreter = source / ".venv" / "bin" / "python3"
    interpreter.parent.mkdir(parents=True)
    (source / ".venv" / "lib" / "python3.11" / "site-packages").mkdir(parents=True)
    interpreter.write_text('#!/bin/sh\necho "interpreter of $(dirname "$0")"\n')
    interpreter.chmod(0o755)
    build = source / "build"
    (source / "CMakeLists.txt").write_text(
        "cmake_minimum_required(VERSION 3.16)\n"
        "project(tree VERSION 0.1 LANGUAGES NONE)\n"
        "list(APPEND CMAKE_MODULE_PATH ${PROJECT_SOURCE_DIR}/cmake)\n"
        "include(BuildTree)\n"
    )
    command = ["cmake", "-S", source, "-B", build, f"-DPYTHON_EXECUTABLE={sys.executable}"]
    subprocess.run(command, check=True, timeout=60, stdout=subprocess.DEVNULL)
    printed = subprocess.run(
        [build / "run", "sh", "-c", 'echo "$PATH"; echo "$PYTHONPATH"; python3'],
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
    )
    path, packages, used = printed.stdout.splitlines()
    assert path.split(":")[:2] == [f"{build}/bin", f"{source}/.venv/bin"]
    assert packages.split(":")[:2] == [
        f"{build}/python",
        f"{source}/.venv/lib/python3.11/site-packages",
    ]
    assert used == f"interpreter of {source}/.venv/bin"


def test_ctest_runs_the_python_tests_too_but_bootstrap_once():
    """`make test` passed when only C++ had been tested."""
    command = ["ctest", "--test-dir", ROOT / "build", "--show-only=json-v1"]
    (excluded,) = re.findall(r"--exclude-regex '(.*?)'", (ROOT / "bootstrap").read_text())
    listed, left = (
        {test["name"]: test["command"] for test in json.loads(shown.stdout)["tests"]}
        for shown in (
            subprocess.run(
                [*command, *more], capture_output=True, text=True, check=True, timeout=60
            )
            for more in ([], ["--exclude-regex", excluded])
        )
    )
    assert listed["python"][:3] == [str(ROOT / "build/run"), "pytest", "tests"]
    assert listed.keys() - left.keys() == {"python"} and "qa_timeline" in left
