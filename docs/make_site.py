#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Builds the documentation site from docs/, with Sphinx, into build/docs/html.

    ./bootstrap docs

The pages of docs/ are copied to build/docs/source, where the notebook is executed. A warning of
Sphinx ends the build.
"""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
# Pages from outside of docs/, and their names on the site.
OTHERS = {
    ROOT / "README.md": "readme.md",
    ROOT / "examples" / "README.md": "examples.md",
    ROOT / "ros2" / "README.md": "ros2.md",
    ROOT / "CHANGELOG.md": "changelog.md",
}
# The list of blocks is also their table of contents.
BLOCKS = "blocks/README.md"
CONTENTS = "\n```{toctree}\n:hidden:\n:glob:\n\n*\n```\n"
NOTEBOOK = "first_readings"
INDEX = "index.md"
# Beside the pages that the index lists, under the same headings at the site's edge.
REFERENCE = (
    "api",
    "blocks/README",
    "reference/scenes",
    "reference/sensor-files",
    "reference/commands",
)
BESIDE = ("readme", NOTEBOOK, "examples", "ros2", "changelog")
LINK = re.compile(r"(!?)\[([^\]]*)\]\(([^)\s]+)\)")


def pages():
    """{name on the site: file} of all pages and pictures."""
    inside = [path for each in ("", "blocks/", "reference/") for path in DOCS.glob(f"{each}*.md")]
    inside += [*DOCS.glob("images/*"), *DOCS.glob("data/*")]
    named = {str(path.relative_to(DOCS)): path for path in inside}
    return named | {name: path for path, name in OTHERS.items()}


def contents(index):
    """{heading: pages} of the site, in the order in which the index lists its pages."""
    listed = re.findall(r"^\| \[.+?\]\(([\w-]+)\.md\) \|", index, re.MULTILINE)
    return {"Pages": listed, "Reference": REFERENCE, "Beside": BESIDE}


def relinked(text, source, name, names):
    """A page with its links to files, from ``source``, as links of the page ``name``.

    Parameters
    ----------
    text : str
    source : Path
        File of the page.
    name : str
        Name of the page on the site.
    names : dict
        {file: name on the site}.

    Returns
    -------
    str
        Links to files that are not on the site are plain text.
    """
    up = "../" * name.count("/")

    def link(match):
        picture, words, target = match.groups()
        if re.match(r"[a-z]+:|#", target):
            return match[0]
        file, mark, heading = target.partition("#")
        found = names.get((source.parent / file).resolve())
        if found is None:
            return words
        return f"{picture}[{words}]({up}{found}{mark}{heading})"

    return LINK.sub(link, text)


def write_sources(folder):
    """Write everything that Sphinx reads but the notebook's page."""
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(DOCS / "site", folder)
    found = pages()
    names = {path.resolve(): name for name, path in found.items()}
    names[(DOCS / f"{NOTEBOOK}.ipynb").resolve()] = f"{NOTEBOOK}.md"
    for name, path in found.items():
        target = folder / name
        target.parent.mkdir(parents=True, exist_ok=True)
        if path.suffix == ".md":
            text = path.read_text(encoding="utf-8")
            text = relinked(text, path, name, names) + (CONTENTS if name == BLOCKS else "")
            if name == INDEX:
                for heading, listed in contents(path.read_text(encoding="utf-8")).items():
                    lines = [f"\n```{{toctree}}\n:hidden:\n:caption: {heading}\n", *listed, "```\n"]
                    text += "\n".join(lines)
            target.write_text(text, encoding="utf-8")
        else:
            shutil.copy(path, target)


def execute_notebook(folder):
    """Execute the notebook and write it as a page with its pictures."""
    command = [sys.executable, "-m", "nbconvert", "--execute", "--to", "markdown"]
    command += ["--log-level", "WARN", f"{NOTEBOOK}.ipynb"]
    shutil.copy(DOCS / f"{NOTEBOOK}.ipynb", folder)
    # What its debugger says of itself at the start is of no interest here.
    environment = os.environ | {"PYDEVD_DISABLE_FILE_VALIDATION": "1"}
    subprocess.run(command, cwd=folder, env=environment, check=True)


def main():
    build = ROOT / "build" / "docs"
    source = build / "source"
    write_sources(source)
    execute_notebook(source)
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-b", "html"]
    command += ["-d", str(build / "doctrees"), str(source), str(build / "html")]
    done = subprocess.run(command)
    if done.returncode == 0:
        print(f"documentation: {build / 'html' / 'index.html'}")
    sys.exit(done.returncode)


if __name__ == "__main__":
    main()
