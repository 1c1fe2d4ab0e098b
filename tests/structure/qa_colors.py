# SPDX-License-Identifier: GPL-3.0-or-later
"""Colours: all pictures, windows and the page use those of the palette."""

import re
from pathlib import Path

from gnuradio.wiforce.io import palette

ROOT = Path(__file__).resolve().parents[2]


def test_page_repeats_the_palette():
    """A sensor would change its colour from the window to the browser."""
    assets = ROOT / "gr-wiforce/wiforce_app/web/assets"
    script, style = (
        (assets / name).read_text(encoding="utf-8") for name in ("picture.js", "page.css")
    )
    listed = re.search(r"COLORS = \[(.+?)\]", script)[1]
    assert tuple(re.findall("#[0-9a-f]{6}", listed)) == palette.SERIES
    assert re.search('WARNING = "(.+?)"', script)[1] == palette.WARNING
    light, dark = (
        dict(re.findall("--([a-z]+): (#[0-9a-f]{6});", part)) for part in style.split("@media", 1)
    )
    assert set(dark) == set(light)
    stated = light
    assert stated == {
        "ink": palette.INK,
        "faint": palette.FAINT,
        "rule": palette.GRID,
        "warning": palette.WARNING,
        "paper": palette.PAPER,
        "beam": palette.BEAM,
        "ground": palette.GROUND,
    }


def test_windows_have_the_palette():
    from gnuradio.wiforce.gui import style

    for name in ("INK", "FAINT", "PAPER", "WARNING", "BEAM", "GROUND"):
        assert getattr(style, name).name() == getattr(palette, name)


def test_pictures_take_their_colors_from_the_palette():
    """Matplotlib's own colours are not all distinguishable without red and green."""
    own = re.compile(r"""["']C\d|["']tab:|\bC\{|cmap|["']0\.\d+["']""")
    sources = [
        path
        for folder in ("python/wiforce", "gr-wiforce", "docs")
        for path in (ROOT / folder).rglob("*.py")
        if "matplotlib" in path.read_text(encoding="utf-8")
    ]
    assert len(sources) >= 9
    found = [
        f"{path.relative_to(ROOT)}: {line.strip()}"
        for path in sources
        for line in path.read_text(encoding="utf-8").splitlines()
        if own.search(line)
    ]
    assert found == []


def test_series_styles_differ_in_color_and_marker():
    styles = [tuple(palette.series_style(number).values()) for number in range(49)]
    assert len(set(styles)) == 49
    assert len({marker for _, marker in styles[:7]}) == 7
