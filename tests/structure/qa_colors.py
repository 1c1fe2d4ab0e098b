# SPDX-License-Identifier: GPL-3.0-or-later
"""Colours: people with deuteranopia can distinguish any two series; all pictures use the same."""

import importlib.util
import itertools
import re
from pathlib import Path

import numpy as np
import pytest
from gnuradio.wiforce.io import palette

ROOT = Path(__file__).resolve().parents[2]
LEAST = 15  # colour difference, CIEDE2000
# Linear RGB as seen with deuteranopia: G. M. Machado, M. M. Oliveira and L. A. F. Fernandes, IEEE
# Transactions on Visualization and Computer Graphics 15(6), 2009, table 1, severity 1.0.
DEUTERANOPIA = np.array(
    [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ]
)
# Of linear sRGB to XYZ, relative to the white point D65.
XYZ = np.array([[0.4339, 0.3762, 0.1899], [0.2127, 0.7152, 0.0722], [0.0178, 0.1095, 0.8727]])


def lab(color, seen=DEUTERANOPIA):
    """CIELAB of a colour ``#rrggbb``."""
    coded = np.array([int(color[i : i + 2], 16) for i in (1, 3, 5)]) / 255
    linear = np.where(coded <= 0.04045, coded / 12.92, ((coded + 0.055) / 1.055) ** 2.4)
    x, y, z = XYZ @ np.clip(seen @ linear, 0, 1)
    x, y, z = (np.cbrt(t) if t > 216 / 24389 else (24389 / 27 * t + 16) / 116 for t in (x, y, z))
    return 116 * y - 16, 500 * (x - y), 200 * (y - z)


def difference(first, second):
    """CIEDE2000: G. Sharma, W. Wu and E. N. Dalal, Color Research and Application 30(1), 2005."""
    (l1, a1, b1), (l2, a2, b2) = first, second
    mean_7 = ((np.hypot(a1, b1) + np.hypot(a2, b2)) / 2) ** 7
    stretch = 1.5 - np.sqrt(mean_7 / (mean_7 + 25**7)) / 2
    c1, c2 = np.hypot(stretch * a1, b1), np.hypot(stretch * a2, b2)
    h1, h2 = (np.degrees(np.arctan2(b, stretch * a)) for a, b in ((a1, b1), (a2, b2)))
    turn = (h2 - h1 + 180) % 360 - 180 if c1 * c2 else 0
    hue, chroma, light = h1 + turn / 2, (c1 + c2) / 2, (l1 + l2) / 2

    def wave(times, phase):
        return np.cos(np.radians(times * hue + phase))

    t = 1 - 0.17 * wave(1, -30) + 0.24 * wave(2, 0) + 0.32 * wave(3, 6) - 0.2 * wave(4, -63)
    dl = (l2 - l1) / (1 + 0.015 * (light - 50) ** 2 / np.sqrt(20 + (light - 50) ** 2))
    dc = (c2 - c1) / (1 + 0.045 * chroma)
    dh = 2 * np.sqrt(c1 * c2) * np.sin(np.radians(turn / 2)) / (1 + 0.015 * chroma * t)
    around = np.exp(-((((hue % 360) - 275) / 25) ** 2))
    mixed = -2 * np.sqrt(chroma**7 / (chroma**7 + 25**7)) * np.sin(np.radians(60 * around))
    return np.sqrt(dl**2 + dc**2 + dh**2 + mixed * dc * dh)


@pytest.mark.parametrize(
    ("first", "second", "expected"),
    [  # of the paper's table 1
        ((50, 2.6772, -79.7751), (50, 0, -82.7485), 2.0425),
        ((50, -1.3802, -84.2814), (50, 0, -82.7485), 1.0),
        ((50, 2.5, 0), (73, 25, -18), 27.1492),
        ((2.0776, 0.0795, -1.135), (0.9033, -0.0636, -0.5514), 0.9082),
    ],
)
def test_difference_is_that_of_the_published_pairs(first, second, expected):
    assert difference(first, second) == pytest.approx(expected, abs=1e-4)


def of_the_palette():
    return *palette.SERIES, palette.TRUTH


def of_the_drawing():
    path = ROOT / "docs/make_setup_drawings.py"
    spec = importlib.util.spec_from_file_location("make_setup_drawings", path)
    maker = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(maker)
    return maker.SENT, maker.END1, maker.END2


@pytest.mark.parametrize("colors", [of_the_palette, of_the_drawing])
def test_series_differ_with_deuteranopia(colors):
    """Whoever cannot see red and green would take one sensor for another."""
    for first, second in itertools.combinations(colors(), 2):
        assert difference(lab(first), lab(second)) > LEAST, (first, second)


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
