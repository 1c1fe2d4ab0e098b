# SPDX-License-Identifier: GPL-3.0-or-later
"""Python files that are in no package, as modules: programs of docs/ and generated flowgraphs."""

import importlib.util


def module_of(path):
    """The module that a file holds, executed."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
