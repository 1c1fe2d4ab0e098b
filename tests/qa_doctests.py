# SPDX-License-Identifier: GPL-3.0-or-later
"""Examples in docstrings: all of them run, and documented folders have one for each public name."""

import doctest
import importlib
import inspect
import pkgutil

import pytest
from gnuradio import wiforce

# These load GNU Radio's runtime or Qt: an example of theirs is a flowgraph or a window.
WITHOUT_EXAMPLES = ("blocks", "gui", "bindings")
# Not yet complete: what examples they have are run, but none is demanded.
INCOMPLETE = ("estimation", "scene", "sensor", "io.yamlfile")


def module_names():
    """Names of the package's modules that need NumPy only, relative to it."""
    prefix = f"{wiforce.__name__}."
    for module in pkgutil.walk_packages(wiforce.__path__, prefix):
        name = module.name.removeprefix(prefix)
        compiled = module.name.rpartition(".")[2].startswith(("wiforce_", "_"))
        if not compiled and not name.startswith(WITHOUT_EXAMPLES):
            yield name


MODULES = tuple(module_names())


def loaded(name):
    return importlib.import_module(f"{wiforce.__name__}.{name}")


def public_objects(module):
    """Functions and classes that a module defines for others."""
    for name, value in vars(module).items():
        is_own = getattr(value, "__module__", None) == module.__name__
        if (
            is_own
            and not name.startswith("_")
            and (inspect.isfunction(value) or inspect.isclass(value))
        ):
            yield name, value


@pytest.mark.parametrize("name", MODULES)
def test_examples_executed_give_output_shown(name, tmp_path, monkeypatch):
    """Users start from an example: one that fails costs them their first hour."""
    monkeypatch.chdir(tmp_path)
    result = doctest.testmod(loaded(name))
    assert result.failed == 0, f"{result.failed} of {result.attempted} examples, shown above"


@pytest.mark.parametrize("name", [name for name in MODULES if not name.startswith(INCOMPLETE)])
def test_public_objects_documented_have_example(name):
    """A signature alone does not show how to call a function."""
    missing = [
        public
        for public, value in public_objects(loaded(name))
        if ">>> " not in (inspect.getdoc(value) or "")
    ]
    assert missing == []
