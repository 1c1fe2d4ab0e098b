# SPDX-License-Identifier: GPL-3.0-or-later
"""Version and supported GNU Radio, in every file of other systems that states them."""

import re
from pathlib import Path
from xml.etree import ElementTree

import pytest
import tomllib
import yaml
from command_runs import run_command

ROOT = Path(__file__).resolve().parents[2]


def text(name):
    return (ROOT / name).read_text(encoding="utf-8")


def package_version(name):
    return ElementTree.fromstring(text(name)).findtext("version")


VERSION = re.search(r"^project\(gr-wiforce VERSION (\S+)", text("CMakeLists.txt"), re.MULTILINE)[1]
STATED = {
    "CITATION.cff": lambda name: str(yaml.safe_load(text(name))["version"]),
    "debian/changelog": lambda name: re.match(r"gr-wiforce \((.+?)\) ", text(name))[1],
    "CHANGELOG.md": lambda name: re.search(r"^## \[(\d.+?)\]", text(name), re.MULTILINE)[1],
    "docs/gr-wiforce.1": lambda name: re.search(r'^\.TH .*"gr-wiforce (.+)"$', text(name), re.M)[1],
    "ros2/wiforce_msgs/package.xml": package_version,
    "ros2/wiforce_ros/package.xml": package_version,
}


@pytest.mark.parametrize("name", STATED)
def test_version_of_a_file_is_that_of_cmake(name):
    """Bug reports and citations would name a version that does not exist."""
    assert re.fullmatch(r"\d+\.\d+\.\d+", VERSION)
    assert STATED[name](name) == VERSION, f"change {name}"


@pytest.mark.parametrize("name", ["pyproject.toml", "packaging/conda/meta.yaml"])
def test_version_of_a_build_is_taken_from_cmake(name):
    if name == "pyproject.toml":
        project = tomllib.loads(text(name))
        source = project["tool"]["scikit-build"]["metadata"]["version"]
        assert "version" in project["project"]["dynamic"] and source["input"] == "CMakeLists.txt"
        expression = source["regex"]
    else:
        assert "load_file_regex(" in text(name) and 'load_file="CMakeLists.txt"' in text(name)
        expression = re.search(r'regex_pattern="(.+?)"', text(name))[1]
    assert re.search(expression, text("CMakeLists.txt"))[1] == VERSION


def test_manifest_states_the_supported_gnuradio_as_text():
    """The number 3.10 is 3.1, which catalogues would print."""
    manifest = yaml.safe_load(text("MANIFEST.md").partition("\n---\n")[0])
    assert manifest["gr_supported_version"] == ["3.10"] and manifest["title"] == "gr-wiforce"


def test_version_is_printed_by_the_command_and_stored_by_the_package():
    from gnuradio.wiforce._config import VERSION as built

    assert built == VERSION, "run: cmake build"
    assert run_command("--version").stdout == f"gr-wiforce {VERSION}\n"


def test_library_package_has_the_name_of_its_soname():
    """Two versions could not be installed beside each other, or the wrong one would be loaded."""
    assert re.search(
        r"SOVERSION \$\{PROJECT_VERSION_MAJOR\}\.\$\{PROJECT_VERSION_MINOR\}\)",
        text("lib/CMakeLists.txt"),
    )
    soname = VERSION.rpartition(".")[0]
    assert f"Package: libgnuradio-wiforce{soname}\n" in text("debian/control")
    others = re.findall(r"libgnuradio-wiforce(\d[\d.]*)", text("debian/control"))
    assert set(others) == {soname}
    assert (ROOT / f"debian/libgnuradio-wiforce{soname}.install").is_file()
    assert f"`libgnuradio-wiforce{soname}`" in text("docs/install.md")


def test_debian_documentation_holds_the_files_beside_docs_that_it_links():
    """Readers of the installed pages ended at a file that was not there."""
    pages = "README.md", *(f"docs/{path.name}" for path in (ROOT / "docs").glob("*.md"))
    links = re.findall(r"\]\((?:\.\./)?([A-Z]+\.(?:md|cff))", "".join(map(text, pages)))
    assert set(links) <= set(text("debian/gr-wiforce-doc.docs").split())
