#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Draws docs/images/setup.svg and first-capture.svg: the parts, and distances for a measurement.

build/run python3 docs/make_setup_drawings.py
"""

from html import escape
from pathlib import Path

from gnuradio.wiforce.io.palette import SERIES

IMAGES = Path(__file__).resolve().parent / "images"
INK, FAINT, BEAM, COPPER = "#222222", "#767676", "#595959", "#b87333"
SENT, END1, END2 = INK, *SERIES[:2]


def element(name, text=None, **attributes):
    """An element; underscores in the names of attributes stand for hyphens."""
    words = "".join(f' {key.replace("_", "-")}="{value}"' for key, value in attributes.items())
    return f"<{name}{words}/>" if text is None else f"<{name}{words}>{escape(text)}</{name}>"


def label(x, y, text, color=INK, size=15, anchor="middle", **more):
    return element("text", text, x=x, y=y, fill=color, font_size=size, text_anchor=anchor, **more)


def line(*points, color=INK, width=2, **more):
    path = "M" + " L".join(f"{x},{y}" for x, y in points)
    return element("path", d=path, fill="none", stroke=color, stroke_width=width, **more)


def arrow(x1, y1, x2, y2, color, width=2.5, **more):
    return line((x1, y1), (x2, y2), color=color, width=width, marker_end="url(#head)", **more)


def box(x, y, width, height, **more):
    style = {"rx": 8, "fill": "#f4f4f4", "stroke": INK, "stroke_width": 1.5}
    return element("rect", x=x, y=y, width=width, height=height, **style | more)


def antenna(x, y):
    return [
        line((x, y), (x, y - 40)),
        line((x - 13, y - 56), (x, y - 40), (x + 13, y - 56), (x - 13, y - 56)),
    ]


def reader():
    yield label(115, 36, "reader", size=18, font_weight="bold")
    yield label(115, 58, "radio and computer", FAINT, 13)
    yield box(30, 160, 170, 100)
    yield label(115, 200, "software-defined")
    yield label(115, 219, "radio, 12.5 Msps")
    for x, name in ((75, "TX"), (155, "RX")):
        yield from antenna(x, 160)
        yield label(x, 96, name, FAINT, 12)
    yield arrow(115, 260, 115, 292, INK)
    yield label(115, 312, "force, location, flags")


def air():
    yield label(325, 106, "OFDM preambles", SENT, 13)
    yield arrow(225, 116, 425, 116, SENT)
    yield arrow(425, 146, 225, 146, END1)
    yield label(325, 164, "from end 1, shifted by fs", END1, 13)
    yield arrow(425, 184, 225, 184, END2, stroke_dasharray="9 4")
    yield label(325, 202, "from end 2, shifted by 4 fs", END2, 13)


def tag():
    yield label(515, 36, "tag", size=18, font_weight="bold")
    yield label(515, 58, "no transmitter", FAINT, 13)
    yield from antenna(515, 160)
    yield box(445, 160, 140, 100)
    yield label(515, 180, "two RF switches", size=13)
    yield line((480, 202), (480, 194), (550, 194), (550, 202))
    yield line((515, 187), (515, 194))
    # Never both are closed.
    for x, color, name, aside in ((480, END1, "switch 1", 0), (550, END2, "switch 2", 11)):
        yield line((x, 204), (x + aside, 219 - aside / 3), color=color)
        for y in (204, 222):
            yield element("circle", cx=x, cy=y, r=3, fill=color)
        yield label(x, 250, name, color, 13)


def sensor():
    left, right, beam, copper, press = 650, 910, 168, 196, 756
    middle = (left + right) / 2
    yield label(middle, 36, "sensor", size=18, font_weight="bold")
    yield label(middle, 58, "soft beam over a microstrip line of 80 mm", FAINT, 13)
    dip = copper - 6
    curve = f"M{left},{beam} C{press - 55},{beam} {press - 32},{dip} {press - 12},{dip} "
    curve += f"L{press + 12},{dip} C{press + 32},{dip} {press + 55},{beam} {right},{beam}"
    yield element("path", d=curve, fill="none", stroke=BEAM, stroke_width=9)
    yield line((left, copper), (right, copper), color=COPPER, width=5)
    yield arrow(press, 92, press, beam - 2, INK, 5)
    yield label(press + 14, 112, "force F at location l", anchor="start")
    for place, color in ((press - 14, END1), (press + 14, END2)):
        yield line((place, dip), (place, copper + 44), color=color, width=1.5)
    yield arrow(left, 232, press - 16, 232, END1, 1.5)
    yield arrow(right, 232, press + 16, 232, END2, 1.5, stroke_dasharray="9 4")
    yield label((left + press) / 2 - 6, 252, "phase 1", END1, 13)
    yield label((right + press) / 2 + 6, 252, "phase 2", END2, 13)
    # From the switches to the ends of the line.
    yield line((480, 220), (480, 232), (615, 232), (615, copper), (left, copper), color=END1)
    yield line(
        *((550, 220), (600, 220), (600, 286), (932, 286), (932, copper), (right, copper)),
        color=END2,
        stroke_dasharray="9 4",
    )
    yield label(left, copper + 19, "port 1", FAINT, 12, "start")
    yield label(right, copper + 19, "port 2", FAINT, 12, "end")


def distance(start, end, text, at):
    """A line between two antennas with its length."""
    yield line(start, end, color=FAINT, width=1.5, stroke_dasharray="5 5")
    yield label(*at, text, FAINT, 14)


def first_capture():
    """The elements of antennas, tag and distances."""
    for x, name in ((150, "transmit antenna"), (700, "receive antenna")):
        yield from antenna(x, 150)
        yield label(x, 74, name, size=15)
        yield line((x, 150), (x, 270), (x, 300), color=COPPER, width=3)
    yield box(100, 286, 650, 56)
    yield label(425, 309, "one radio, both cables fixed with tape")
    yield label(425, 330, "transmits and receives with one clock", FAINT, 13)
    yield from antenna(560, 236)
    yield box(510, 236, 100, 30)
    yield label(560, 256, "tag", size=14)
    yield line((510, 246), (470, 246), color=COPPER, width=3)
    around = (230, 246), (215, 246), (215, 262), (510, 262)
    yield line(*around, color=COPPER, width=3)
    yield line((470, 246), (230, 246), color=BEAM, width=9)
    yield label(470, 279, "port 1, 0 mm", FAINT, 12)
    yield label(230, 279, "port 2, 80 mm", FAINT, 12)
    yield arrow(310, 198, 310, 240, INK, 4)
    yield label(290, 190, "400 g on a tip of 5 mm", size=13)
    direct = "4 m (direct path, 42 dB above the tag)"
    yield from distance((166, 112), (684, 112), direct, (425, 104))
    yield from distance((166, 124), (544, 200), "3 m", (420, 166))
    yield from distance((576, 196), (690, 124), "1 m", (652, 172))


def svg(width, height, parts):
    """A drawing as text."""
    head = element("path", d="M0,0 L10,5 L0,10 z", fill="context-stroke")
    marker = (
        '<defs><marker id="head" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="5" '
        f'markerHeight="5" orient="auto">{head}</marker></defs>'
    )
    paper = element("rect", width=width, height=height, fill="#ffffff")
    start = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" '
        'font-family="sans-serif">'
    )
    return "\n".join([start, marker, paper, *parts, "</svg>"]) + "\n"


def files():
    """{path: SVG} of both drawings."""
    return {
        IMAGES / "setup.svg": svg(960, 330, [*reader(), *air(), *tag(), *sensor()]),
        IMAGES / "first-capture.svg": svg(850, 350, first_capture()),
    }


if __name__ == "__main__":
    for path, text in files().items():
        path.write_text(text, encoding="utf-8")
