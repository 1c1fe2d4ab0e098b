# SPDX-License-Identifier: GPL-3.0-or-later
"""The documentation site: its pages, their links, and its notebook. Sphinx is not needed."""

import json

import make_site as maker
import pytest
from make_site import DOCS


def test_site_every_page_is_in_the_table_of_contents():
    """A page that is not listed cannot be found, and ends the build of the site."""
    listed = {
        name for each in maker.contents((DOCS / "index.md").read_text()).values() for name in each
    }
    pages = {name.removesuffix(".md") for name in maker.pages() if name.endswith(".md")}
    blocks = {name for name in pages if name.startswith("blocks/")}
    assert len(blocks) > 10 and (DOCS / "site" / "api.rst").is_file()
    assert pages - blocks - {"index"} | {"blocks/README", "api", maker.NOTEBOOK} == listed


@pytest.mark.parametrize(
    ("text", "source", "name", "expected"),
    [
        ("[a](docs/live.md#read)", "README.md", "readme.md", "[a](live.md#read)"),
        ("![a](docs/images/x.png)", "README.md", "readme.md", "![a](images/x.png)"),
        ("[a](../live.md)", "docs/blocks/r.md", "blocks/r.md", "[a](../live.md)"),
        ("see [the code](../lib/x.cc).", "docs/live.md", "live.md", "see the code."),
    ],
)
def test_site_links_point_to_pages_of_the_site(text, source, name, expected):
    """A link that works in the repository would lead nowhere on the site."""
    names = {DOCS / "live.md": "live.md", DOCS / "images" / "x.png": "images/x.png"}
    assert maker.relinked(text, DOCS.parent / source, name, names) == expected


def test_notebook_executes_and_reads_what_was_applied(tmp_path, monkeypatch, capsys):
    """The first thing that a researcher tries would fail."""
    from matplotlib import pyplot

    cells = json.loads((DOCS / f"{maker.NOTEBOOK}.ipynb").read_text())["cells"]
    assert not any(cell.get("outputs") for cell in cells), "store the notebook without outputs"
    monkeypatch.chdir(tmp_path)
    (tmp_path / "press.sigmf-data").touch()  # of a run before
    pyplot.close("all")
    found = {}
    for cell in cells:
        if cell["cell_type"] == "code":
            exec("".join(cell["source"]), found)
    said = capsys.readouterr().out
    assert len(found["joined"]) > 80 and found["errors_n"].median() < 0.15
    drawn = [axis for number in (1, 2) for axis in pyplot.figure(number).axes]
    assert len(drawn) == 6 and all(axis.get_lines() for axis in drawn)
    pyplot.close("all")
    assert (tmp_path / "my-sensor.yaml").is_file() and "warning" not in said
    force_n, location_mm = found["found"].force_n[0], found["found"].location_mm[0]
    assert force_n == pytest.approx(4.3, abs=0.2) and location_mm == pytest.approx(45, abs=0.5)
