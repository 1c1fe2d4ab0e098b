# SPDX-License-Identifier: GPL-3.0-or-later
"""Packages and clean systems: what can be checked without building either."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import tomllib
from gnuradio.wiforce.io.optional import _PACKAGES

ROOT = Path(__file__).resolve().parents[2]
RUN = ROOT / "tests/platforms/run"
STEPS = ROOT / "tests/platforms/steps"


def test_every_script_of_a_step_is_valid_and_used():
    text = RUN.read_text()
    scripts = sorted(STEPS.glob("*.sh"))
    assert len(scripts) >= 5
    for script in scripts:
        subprocess.run(["bash", "-n", script], check=True, timeout=300)
        assert f'"{script.name}"' in text


def test_packages_contain_every_library_that_cmake_installs():
    """dh_missing would end the build after half an hour."""
    text = (ROOT / "lib/CMakeLists.txt").read_text()
    targets = re.search(r"install\(TARGETS ([\w -]+) EXPORT", text)[1].split()
    assert "gnuradio-wiforce" in targets
    listed = "".join(path.read_text() for path in (ROOT / "debian").glob("lib*.install"))
    for target in targets:
        named = re.search(rf"set_target_properties\({target}\b[^)]*OUTPUT_NAME (\S+?)\)", text)
        name = named[1] if named else target
        assert re.search(rf"^usr/lib/\*/lib{name}\.(a|so)$", listed, re.MULTILINE), name


def imported(path):
    """First names of the absolute imports of a file."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            yield node.module.partition(".")[0]


def test_packages_depend_on_what_the_code_imports():
    """`gr-wiforce read` of an installed package would end with an ImportError."""
    packages = {
        "click": "python3-click",
        "matplotlib": "python3-matplotlib",
        "numpy": "python3-numpy",
        "pandas": "python3-pandas",
        "scipy": "python3-scipy",
        "threadpoolctl": "python3-threadpoolctl",
        "yaml": "python3-yaml",
    }
    own = {"gnuradio", "pmt", "wiforce_app", "software_n210"}
    # One feature each imports these, and names what to install where it is missing; Qt comes with
    # GNU Radio, and types are for checkers alone.
    optional = _PACKAGES.keys() - packages.keys()
    optional |= {"PyQt5", "pyqtgraph", "SoapySDR", "typing_extensions"}
    found = set()
    for folder in ("python/wiforce", "gr-wiforce/wiforce_app", "gr-wiforce/software_n210"):
        for path in (ROOT / folder).rglob("*.py"):
            found |= set(imported(path))
    third_party = found - set(sys.stdlib_module_names) - own - optional
    assert third_party == set(packages)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    by_pip = {re.split("[><=]", each)[0].lower() for each in project["dependencies"]}
    assert by_pip == third_party - {"yaml"} | {"pyyaml"}
    control = (ROOT / "debian/control").read_text(encoding="utf-8")
    depends = control.split("Package: gr-wiforce\n")[1].split("Suggests:")[0]
    for package in packages.values():
        assert f" {package},\n" in depends
    recipe = (ROOT / "packaging/conda/meta.yaml").read_text(encoding="utf-8")
    run = re.search(r"^  run:\n((?:    - .+\n)+)", recipe, re.MULTILINE)[1]
    assert by_pip <= {name.removesuffix("-base") for name in re.findall(r"- (\S+)", run)}
