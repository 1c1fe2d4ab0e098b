#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Writes docs/blocks/: a page per block, from its GRC description and its docstring.

    build/run python3 docs/make_block_pages.py

Do not edit these pages by hand; a test compares them with their sources.
"""

import inspect
import re
from pathlib import Path

import yaml
from gnuradio import wiforce

ROOT = Path(__file__).resolve().parent.parent
PAGES = ROOT / "docs" / "blocks"
HEADERS = ROOT / "include" / "gnuradio" / "wiforce"


def descriptions():
    """GRC descriptions in the order of their file names."""
    paths = sorted((ROOT / "grc").glob("*.block.yml"))
    return [yaml.safe_load(path.read_text(encoding="utf-8")) for path in paths]


def name_of(description):
    return description["id"].replace("variable_", "").removeprefix("wiforce_")


def block_named(name):
    """The block, function or class of the package; None for a module, whose name it may share."""
    found = getattr(wiforce, name, None)
    return None if inspect.ismodule(found) else found


def parameters_in_docstring(text):
    """{name: description} of a numpy docstring's section Parameters."""
    match = re.search(r"\n\s*Parameters\n\s*-+\n(.*?)(?=\n\s*\w+\n\s*-{3,}|\Z)", text, re.S)
    found, names = {}, []
    for line in match[1].splitlines() if match else ():
        if line and not line[0].isspace():
            names = re.split(r",\s*", line.split(" : ")[0])
            found |= {name: "" for name in names}
        else:
            found |= {name: f"{found[name]} {line.strip()}".strip() for name in names}
    return found


def parameters_in_header(name):
    """{name: description} of the parameters of a compiled block's header."""
    path = HEADERS / f"{name}.h"
    text = path.read_text(encoding="utf-8") if path.is_file() else ""
    found = {}
    for comment in re.findall(r"/\*!(.*?)\*/", text, re.S):
        words = " ".join(line.strip().lstrip("*").strip() for line in comment.splitlines())
        for command in words.split("\\")[1:]:
            kind, *rest = command.split()
            if kind == "param":
                found.setdefault(rest[0], " ".join(rest[1:]))
    return found


def source_text(name):
    """(docstring, parameters) of the block, from Python or from its C++ header."""
    block = block_named(name)
    text = inspect.getdoc(block) or "" if block is not None else ""
    parameters = parameters_in_docstring("\n" + text) or parameters_in_header(name)
    return text, parameters


def defaults_of(parameter):
    value = parameter.get("default", "")
    options, labels = parameter.get("options"), parameter.get("option_labels")
    if options:
        value = value if str(value) in map(str, options) else options[0]
        names = labels or options
        value = names[list(map(str, options)).index(str(value))]
        return f"{value} (options: {', '.join(map(str, names))})"
    return f"`{value}`" if str(value) else ""


def port_rows(description):
    for direction, ports in (("in", "inputs"), ("out", "outputs")):
        for port in description.get(ports, []):
            if port.get("domain") == "message":
                yield f"| {direction} | `{port['id']}` | message |"
            else:
                kind, length = port.get("dtype", ""), port.get("vlen", 1)
                items = f"{_expression(kind)}, vector length {_expression(length)}"
                yield f"| {direction} | stream | {items} |"


def _expression(value):
    text = str(value).strip()
    return f"`{text[2:-1].strip()}`" if text.startswith("${") else text


def page(description):
    """Markdown of one block's page."""
    name = name_of(description)
    _, known = source_text(name)
    lines = [f"# {description['label']}", "", f"GRC: `{description['id']}`"]
    if block_named(name) is not None:
        lines[-1] += f", Python: `gnuradio.wiforce.{name}`"
    lines += ["", *_documentation(description["documentation"])]
    ports = list(port_rows(description))
    if ports:
        lines += ["", "## Ports", "", "| | name | items |", "|---|---|---|", *ports]
    lines += ["", "## Parameters", "", "| in GRC | in Python | default | |", "|---|---|---|---|"]
    for parameter in description.get("parameters", []):
        if parameter["id"] != "gui_hint":
            words = known.get(parameter["id"], "").replace("``", "`").replace("|", "\\|")
            # What the generated code alone uses is no argument of the block.
            named = f"`{parameter['id']}`" if parameter["id"] in known else ""
            cells = (parameter["label"], named, defaults_of(parameter), words)
            lines.append(f"| {' | '.join(cells)} |")
    rules = [_expression(rule) for rule in description.get("asserts", [])]
    if rules:
        lines += ["", "## Rules that GRC checks before a run", "", *(f"- {r}" for r in rules)]
    return re.sub(r"\n{3,}", "\n\n", "\n".join(lines)) + "\n"


def _documentation(text):
    """Lines of Markdown: headings in bold, indented lines as lists."""
    for line in text.strip().splitlines():
        if line.startswith("  "):
            yield f"- {line.strip()}"
        elif line.endswith(":"):
            yield from ("", f"**{line}**", "")
        else:
            yield line


def index(all_descriptions):
    lines = [
        "# Blocks",
        "",
        "Generated by `docs/make_block_pages.py` from the same text as the help in Companion.",
        "",
    ]
    for description in all_descriptions:
        paragraph = " ".join(description["documentation"].strip().split("\n\n")[0].splitlines())
        sentence = re.split(r"(?<=[\w)]\.) ", paragraph)[0]
        lines.append(f"- [{description['label']}]({name_of(description)}.md): {sentence}")
    return "\n".join(lines) + "\n"


def files():
    """{path: Markdown} of everything in docs/blocks."""
    found = descriptions()
    written = {PAGES / f"{name_of(d)}.md": page(d) for d in found}
    return written | {PAGES / "README.md": index(found)}


if __name__ == "__main__":
    for path, text in files().items():
        path.write_text(text, encoding="utf-8")
