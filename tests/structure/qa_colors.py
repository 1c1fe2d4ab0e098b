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
