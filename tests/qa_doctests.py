# SPDX-License-Identifier: GPL-3.0-or-later
"""Examples in docstrings: all of them run, and documented folders have one for each public name."""

import doctest
import enum
import importlib
import inspect
import pkgutil
import re

import pytest
from gnuradio import wiforce

# The widgets' examples need a QApplication and run with the tests of the display.
WITHOUT_EXAMPLES = ("gui", "bindings")
# Not yet complete: what examples they have are run, but none is demanded.
INCOMPLETE = (
    "io.arrays",
    "io.schema",
    "io.values",
    "sensor.carrier_fit",
    "sensor.curves",
    "sensor.calibration_warnings",
    "sensor.filter_bank",
    "sensor.forward",
    "sensor.inversion",
    "sensor.location",
    "sensor.model",
    "sensor.smoother",
    "sensor.tracker",
)


def module_names():
    """Names of the package's modules relative to it; none is imported."""
    for top in pkgutil.iter_modules(wiforce.__path__):
        if top.ispkg and top.name not in WITHOUT_EXAMPLES:
            folders = [f"{folder}/{top.name}" for folder in wiforce.__path__]
            yield from (f"{top.name}.{module.name}" for module in pkgutil.iter_modules(folders))
        elif not top.ispkg and not top.name.startswith(("wiforce_", "_")):
            yield top.name


MODULES = tuple(module_names())
# Inside, a sentence with shape and unit is enough.
INTERNAL = ("estimation.", "press.")
DOCUMENTED = tuple(name for name in MODULES if not name.startswith((*INCOMPLETE, *INTERNAL)))


def loaded(name):
    return importlib.import_module(f"{wiforce.__name__}.{name}")


def public_objects(module):
    """Functions and classes that a module defines for others, by name."""
    return {
        name: value
        for name, value in vars(module).items()
        if not name.startswith("_")
        and (inspect.isfunction(value) or inspect.isclass(value))
        and value.__module__ == module.__name__
    }


@pytest.mark.parametrize("name", MODULES)
def test_examples_executed_give_output_shown(name, tmp_path, monkeypatch, numbers_without_types):
    """Users start from an example: one that fails costs them their first hour."""
    monkeypatch.chdir(tmp_path)
    result = doctest.testmod(loaded(name))
    assert result.failed == 0, f"{result.failed} of {result.attempted} examples, shown above"


@pytest.mark.parametrize("name", DOCUMENTED)
def test_public_objects_documented_have_example(name):
    """A signature alone does not show how to call a function."""
    missing = [
        public
        for public, value in public_objects(loaded(name)).items()
        if ">>> " not in (inspect.getdoc(value) or "")
    ]
    assert missing == []


@pytest.mark.parametrize("name", DOCUMENTED)
def test_public_objects_documented_list_every_parameter(name):
    """A parameter without unit and shape has to be looked up in the source."""
    missing = [
        f"{public}: {parameter}"
        for public, value in public_objects(loaded(name)).items()
        if not (inspect.isclass(value) and issubclass(value, enum.Enum))
        for parameter in inspect.signature(value).parameters
        if not re.search(rf"^(\w+, )*{parameter}(, \w+)*( :|$)", inspect.getdoc(value) or "", re.M)
    ]
    assert missing == []
