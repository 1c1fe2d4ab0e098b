# SPDX-License-Identifier: GPL-3.0-or-later
"""Files that other systems read: catalogues, package managers, citation and code hosting."""

import re
import subprocess
from pathlib import Path

import pytest
import tomllib
import yaml

ROOT = Path(__file__).resolve().parents[2]
VERSION = re.search(
    r"project\(gr-wiforce VERSION ([0-9.]+)", (ROOT / "CMakeLists.txt").read_text()
)[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
ON_CONDA = {"matplotlib": "matplotlib-base"}


def loaded(name):
    return yaml.safe_load((ROOT / name).read_text(encoding="utf-8"))


def test_manifest_states_the_supported_gnuradio_as_text():
    """The number 3.10 is 3.1, which catalogues would print."""
    front, _, body = (ROOT / "MANIFEST.md").read_text(encoding="utf-8").partition("\n---\n")
    manifest = yaml.safe_load(front)
    assert manifest["gr_supported_version"] == ["3.10"]
    assert manifest["title"] == "gr-wiforce" and manifest["license"] == PROJECT["license"]["text"]
    texts = ("title", "brief", "license")
    lists = ("tags", "author", "copyright_owner", "dependencies", "gr_supported_version")
    assert set(manifest) == {*texts, *lists}
    assert all(isinstance(manifest[key], str) for key in texts)
    for key in lists:
        assert manifest[key] and all(isinstance(each, str) for each in manifest[key])
    assert len(body) > 200


def test_citation_has_what_its_format_requires():
    """The keys that the schema of version 1.2.0 requires, their kinds, and no others of ours."""
    citation = loaded("CITATION.cff")
    assert citation["cff-version"] == "1.2.0" and citation["type"] == "software"
    assert citation["version"] == VERSION and citation["license"] == PROJECT["license"]["text"]
    for reference in (citation, *citation["references"]):
        assert isinstance(reference["title"], str) and reference["authors"]
        for author in reference["authors"]:
            assert set(author) in ({"name"}, {"family-names", "given-names"})
    known = "authors cff-version license message references title type version date-released"
    assert set(citation) <= {*known.split(), "repository-code", "abstract", "keywords", "doi"}


def conda_recipe():
    """The recipe for Linux, its templates replaced by their arguments."""
    text = (ROOT / "packaging" / "conda" / "meta.yaml").read_text(encoding="utf-8")
    expression = re.search(r'regex_pattern="(.+?)"', text)[1]
    found = re.search(expression, (ROOT / "CMakeLists.txt").read_text())[1]
    text = re.sub(r"{%.*?%}\n?", "", text, flags=re.DOTALL)
    text = text.replace("{{ name|lower }}", "gnuradio-wiforce").replace("{{ version }}", found)
    text = re.sub(r"{{ (\w+)\('([\w.-]+)'.*?\) }}", r"\1-\2", text)
    return yaml.safe_load(re.sub(r"{{ (\w+) }}", r"\1", text))


def test_conda_recipe_has_the_version_and_the_dependencies_of_the_build():
    recipe = conda_recipe()
    assert recipe["package"] == {"name": "gnuradio-wiforce", "version": VERSION}
    needed = {re.split(r"[><= ]", each)[0].lower() for each in PROJECT["dependencies"]}
    runs = {each.split()[0] for each in recipe["requirements"]["run"]}
    assert {ON_CONDA.get(name, name) for name in needed} <= runs
    assert {"gnuradio-core", "pybind11", "fftw"} <= set(recipe["requirements"]["host"])
    assert recipe["about"]["license"] == PROJECT["license"]["text"]
    for command in recipe["test"]["commands"]:
        block = re.search(r"blocks/(\S+)", command)
        assert block is None or (ROOT / "grc" / block[1]).is_file()
    build = ROOT / "packaging" / "conda" / "build.sh"
    subprocess.run(["bash", "-n", build], check=True)
    assert "-DWIFORCE_GNURADIO=ON" in build.read_text()


def test_workflows_call_ci_in_both_containers():
    jobs = loaded(".github/workflows/tests.yml")["jobs"]
    debian = jobs["debian"]
    assert debian["strategy"]["matrix"]["image"] == ["debian:12", "debian:13"]
    assert debian["steps"][-1]["run"] == "bash .ci/run" and (ROOT / ".ci" / "run").is_file()
    pythons = jobs["without-gnuradio"]["strategy"]["matrix"]["python"]
    assert pythons == ["3.10", "3.11", "3.12", "3.13"]
    assert f">={pythons[0]}" == PROJECT["requires-python"]
    wheels = loaded(".github/workflows/wheels.yml")["jobs"]["manylinux"]
    programs = [step["run"].split()[0] for step in wheels["steps"] if "run" in step]
    assert programs == ["packaging/build-wheels"]
    # `on` is a boolean in YAML 1.1, as which GitHub and this test read it.
    for path in (ROOT / ".github" / "workflows").glob("*.yml"):
        assert loaded(path).keys() == {"name", True, "permissions", "jobs"}


@pytest.mark.parametrize("page", ["CONTRIBUTING.md", "SECURITY.md", "packaging/README.md"])
def test_files_that_a_page_names_exist(page):
    """Contributors are sent to files that were moved."""
    text = (ROOT / page).read_text(encoding="utf-8")
    named = re.findall(r"`((?:python|gr-wiforce|tests|docs|packaging|lib|grc)/[\w./-]*)`", text)
    for path in named:
        assert (ROOT / path).exists(), path
