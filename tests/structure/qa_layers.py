# SPDX-License-Identifier: GPL-3.0-or-later
"""Package layout of docs/architecture.md: imports point downward."""

import ast
import re
from graphlib import TopologicalSorter
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import pytest
from make_architecture_drawings import CHAPTERS

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "python/wiforce"
APPLICATION = ROOT / "gr-wiforce"

# From the top, as the drawing of docs/architecture.md has them, and what stands below all.
LAYERS = [layer for layer, _ in CHAPTERS]
LAYERS += [{"errors", "_config", "wiforce_kernels", "wiforce_python"}]
RANK = {unit: rank for rank, layer in enumerate(LAYERS) for unit in layer}


def modules_of(package):
    """The file of each module of a package, by the parts of its dotted name."""
    modules = {}
    for path in package.rglob("*.py"):
        parts = path.relative_to(package).with_suffix("").parts
        modules[parts[:-1] if parts[-1] == "__init__" else parts] = path
    return modules


def imports_of(path):
    """Import statements that are executed, those inside functions included."""
    pending = [ast.parse(path.read_text(encoding="utf-8"))]
    while pending:
        node = pending.pop()
        if isinstance(node, (ast.Import, ast.ImportFrom)):
            yield node
        if not (isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)):
            pending.extend(ast.iter_child_nodes(node))


def own_imports(modules):
    """Modules of the package that each of its modules imports."""
    found = {}
    for parts, path in modules.items():
        found[parts] = set()
        folder = parts if path.name == "__init__.py" else parts[:-1]
        for node in imports_of(path):
            if isinstance(node, ast.Import) or not node.level:
                continue
            base = folder[: len(folder) - node.level + 1]
            base += tuple(node.module.split(".")) if node.module else ()
            for name in node.names:
                inner = (*base, name.name)
                found[parts].add(inner if inner in modules or not base else base)
    return found


@pytest.fixture(scope="module")
def imports():
    return own_imports(modules_of(PACKAGE))


def test_package_imports_point_downward(imports):
    """An import that points upward makes a low folder unusable without the high ones."""
    assert {parts[0] for parts in imports if parts} <= set(RANK)
    upward = [
        f"{'.'.join(importer)} imports {'.'.join(imported)}"
        for importer, targets in imports.items()
        for imported in targets
        if importer and importer[0] != imported[0] and RANK[importer[0]] >= RANK[imported[0]]
    ]
    assert upward == []


def test_imports_have_no_cycle(imports):
    # Raises CycleError, which lists the modules of a cycle.
    TopologicalSorter(imports).prepare()
    TopologicalSorter(own_imports(modules_of(APPLICATION / "wiforce_app"))).prepare()


def test_folders_of_kernels_have_no_cycle():
    kernels = ROOT / "lib/kernel"
    TopologicalSorter(
        {
            folder.name: set(
                re.findall(
                    r'#include "\.\./(\w+)/', "".join(map(Path.read_text, folder.glob("*.*")))
                )
            )
            for folder in kernels.iterdir()
            if folder.is_dir()
        }
    ).prepare()


# Folders, their files, and what none of them may import or include.
APART = (
    # ``wiforce.read`` and the planning would load GNU Radio's runtime.
    ("python/wiforce", "*.py", r"^\s*(from|import)\b.*\b(gnuradio|pmt|wiforce_python)\b"),
    ("lib/kernel", "*.*", r"#include <(gnuradio|pmt|volk)/"),
    ("gr-wiforce/wiforce_app", "*.py", r"^\s*(from|import)\b.*\bsoftware_n210\b"),
    ("gr-wiforce/software_n210", "*.py", r"^\s*(from|import)\b.*\bwiforce_app\b"),
)


@pytest.mark.parametrize("folder, files, forbidden", APART)
def test_folder_does_not_import_what_it_stands_apart_from(folder, files, forbidden):
    paths = set((ROOT / folder).rglob(files)) - set((PACKAGE / "blocks").rglob("*"))
    assert len(paths) > 5
    for path in paths:
        assert not re.search(forbidden, path.read_text(encoding="utf-8"), re.MULTILINE), path


def test_process_of_a_radio_loads_no_other_part_of_the_command():
    """A process starts for each device that is opened, and must react within milliseconds."""
    imports = own_imports(modules_of(APPLICATION / "wiforce_app"))
    others = {
        module
        for parts, modules in imports.items()
        if parts and parts[0] == "radio"
        for module in modules
        if module[0] != "radio"
    }
    assert others == {("shell", "workers")}


def scripts():
    """Python files beside the packages: examples, tools of the documentation, and of the tests."""
    for folder in ("docs", "examples", "ros2", "tests"):
        for path in filter(Path.is_file, (ROOT / folder).rglob("*")):
            if path.suffix == ".py" or (not path.suffix and b"python3" in path.read_bytes()[:30]):
                yield path


def is_there(module, name):
    """Whether a module has a name, or a module of that name."""
    if hasattr(import_module(module), name):
        return True
    return hasattr(import_module(module), "__path__") and find_spec(f"{module}.{name}") is not None


def test_names_that_scripts_import_exist():
    """Tools that no test runs ended with an ImportError after a name was changed."""
    missing = [
        f"{path.relative_to(ROOT)}: {node.module}.{each.name}"
        for path in scripts()
        for node in imports_of(path)
        if isinstance(node, ast.ImportFrom) and not node.level
        if re.match(r"(gnuradio\.wiforce|wiforce_app)\b", node.module)
        for each in node.names
        if not is_there(node.module, each.name)
    ]
    assert not missing
