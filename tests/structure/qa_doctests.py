# SPDX-License-Identifier: GPL-3.0-or-later
"""Examples in docstrings: all of them run, and every public name has one."""

import dataclasses
import doctest
import importlib
import inspect
import os
import re
from pathlib import Path

import pytest
from gnuradio import wiforce

# The widgets' examples need a QApplication and run with the tests of the display.
WITHOUT_EXAMPLES = ("gui", "bindings")


def module_names():
    """Names of the package's modules relative to it, in all folders; none is imported."""
    # Folders of the build tree are links.
    for root in wiforce.__path__:
        for folder, _, files in os.walk(root, followlinks=True):
            place = Path(folder).relative_to(root).parts
            for name in sorted(files):
                parts = *place, name.removesuffix(".py")
                hidden = parts[0] in WITHOUT_EXAMPLES or parts[0].startswith(("wiforce_", "_"))
                if name.endswith(".py") and name != "__init__.py" and not hidden:
                    yield ".".join(parts)


MODULES = tuple(module_names())
DOCS = Path(__file__).resolve().parents[2] / "docs"


def public_names():
    """Stable names: those that docs/install.md lists, and those of the library's page."""
    listed = (DOCS / "install.md").read_text(encoding="utf-8").split("```python")[1]
    page = (DOCS / "site/api.rst").read_text(encoding="utf-8")
    names = re.findall(r"\bwiforce\.(\w+)", listed.split("```")[0])
    return sorted({*names, *re.findall(r"auto(?:function|class):: gnuradio\.wiforce\.(\S+)", page)})


PUBLIC = public_names()


def loaded(name):
    return importlib.import_module(f"{wiforce.__name__}.{name}")


@pytest.mark.parametrize("name", MODULES)
def test_examples_executed_give_output_shown(name, tmp_path, monkeypatch, numbers_without_types):
    """Users start from an example: one that fails costs them their first hour."""
    monkeypatch.chdir(tmp_path)
    result = doctest.testmod(loaded(name))
    assert result.failed == 0, f"{result.failed} of {result.attempted} examples, shown above"


def documented(name):
    folder, _, last = name.rpartition(".")
    return getattr(loaded(folder) if folder else wiforce, last)


def test_public_names_are_found():
    assert len(PUBLIC) > 25 and "sensor.write_sensor" in PUBLIC and "ForceDisplay" in PUBLIC


@pytest.mark.parametrize("name", PUBLIC)
def test_public_objects_have_an_example_and_document_every_parameter(name):
    """A parameter without unit and shape has to be looked up in the source."""
    public = documented(name)
    text = inspect.getdoc(public)
    assert ">>> " in text
    parameters = inspect.signature(public).parameters
    if dataclasses.is_dataclass(public):  # also a mapping, which takes its keys by name
        parameters = [field.name for field in dataclasses.fields(public) if field.init]
    missing = [
        parameter
        for parameter in parameters
        if not re.search(rf"^(\w+, )*{parameter}(, \w+)*( :|$)", text, re.M)
    ]
    assert missing == []
