#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Draws docs/images/first-capture.svg: antennas, tag and distances of a first measurement.

build/run python3 docs/make_first_capture_drawing.py
"""

import importlib.util
from pathlib import Path

HERE = Path(__file__).resolve().parent
PICTURE = HERE / "images" / "first-capture.svg"
WIDTH, HEIGHT = 850, 350


def setup_drawing():
    """The program of the other drawing, whose elements are used."""
    path = HERE / "make_setup_drawing.py"
    spec = importlib.util.spec_from_file_location("make_setup_drawing", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def distance(draw, start, end, text, at):
    """A line between two antennas with its length."""
    yield draw.line(start, end, color=draw.FAINT, width=1.5, stroke_dasharray="5 5")
    yield draw.label(*at, text, draw.FAINT, 14)


def parts(draw):
    """The elements of the drawing."""
    for x, name in ((150, "transmit antenna"), (700, "receive antenna")):
        yield from draw.antenna(x, 150)
        yield draw.label(x, 74, name, size=15)
        yield draw.line((x, 150), (x, 270), (x, 300), color=draw.COPPER, width=3)
    yield draw.box(100, 286, 650, 56)
    yield draw.label(425, 309, "one radio, both cables fixed with tape")
    yield draw.label(425, 330, "transmits and receives with one clock", draw.FAINT, 13)
    yield from draw.antenna(560, 236)
    yield draw.box(510, 236, 100, 30)
    yield draw.label(560, 256, "tag", size=14)
    yield draw.line((510, 246), (470, 246), color=draw.COPPER, width=3)
    around = (230, 246), (215, 246), (215, 262), (510, 262)
    yield draw.line(*around, color=draw.COPPER, width=3)
    yield draw.line((470, 246), (230, 246), color=draw.BEAM, width=9)
    yield draw.label(470, 279, "port 1, 0 mm", draw.FAINT, 12)
    yield draw.label(230, 279, "port 2, 80 mm", draw.FAINT, 12)
    yield draw.arrow(310, 198, 310, 240, draw.INK, 4)
    yield draw.label(290, 190, "400 g on a tip of 5 mm", size=13)
    direct = "4 m (direct path, 42 dB above the tag)"
    yield from distance(draw, (166, 112), (684, 112), direct, (425, 104))
    yield from distance(draw, (166, 124), (544, 200), "3 m", (420, 166))
    yield from distance(draw, (576, 196), (690, 124), "1 m", (652, 172))


def drawing():
    """The drawing as text."""
    draw = setup_drawing()
    marker = draw.element("path", d="M0,0 L10,5 L0,10 z", fill="context-stroke")
    head = (
        '<defs><marker id="head" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="5" '
        f'markerHeight="5" orient="auto">{marker}</marker></defs>'
    )
    paper = draw.element("rect", width=WIDTH, height=HEIGHT, fill="#ffffff")
    start = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" '
        'font-family="sans-serif">'
    )
    return "\n".join([start, head, paper, *parts(draw), "</svg>"]) + "\n"


if __name__ == "__main__":
    PICTURE.write_text(drawing(), encoding="utf-8")
