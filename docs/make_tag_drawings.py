#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Draws docs/images/tag_schematic.svg and tag_layout.svg: a tag and its line to build.

build/run python3 docs/make_tag_drawings.py
"""

import make_setup_drawings as draw
from gnuradio.wiforce.sensor.microstrip import Microstrip

LINE = Microstrip()
# Board of the layout: FR-4 of 0.8 mm, its permittivity at 1 to 3 GHz (IPC-4101, usual laminates).
BOARD_MM, BOARD_PERMITTIVITY = (36.0, 24.0), 4.4
BOARD_HEIGHT_MM = 0.8
SCALE = 8  # pixels per mm
BEAM_MM = 10.0  # width and thickness, a guess to begin with (docs/build-a-tag.md)


def wire(*points, color=draw.INK):
    return draw.line(*points, color=color, width=1.6)


def part(x, y, width, height, name, value):
    """A box with a name and a value inside."""
    yield draw.box(x, y, width, height, rx=3)
    middle = x + width / 2
    yield draw.label(middle, y + height / 2 - 2, name, size=13, font_weight="bold")
    yield draw.label(middle, y + height / 2 + 15, value, draw.FAINT, 12)


def ground(x, y):
    """The sign of ground below a point."""
    yield wire((x, y), (x, y + 8))
    for half, down in ((9, 8), (6, 12), (3, 16)):
        yield wire((x - half, y + down), (x + half, y + down))


def dot(x, y):
    return draw.element("circle", cx=x, cy=y, r=3.2, fill=draw.INK)


def resistor(x, y, name, value):
    """A resistor from a point down to ground, labelled to its right."""
    yield wire((x, y), (x, y + 10))
    yield draw.box(x - 6, y + 10, 12, 30, rx=0, fill="#ffffff")
    yield wire((x, y + 40), (x, y + 46))
    yield from ground(x, y + 46)
    yield draw.label(x + 13, y + 22, name, size=12, anchor="start")
    yield draw.label(x + 13, y + 37, value, draw.FAINT, 12, "start")


def capacitor(x, y, name, value):
    """A capacitor from a point down to ground, labelled to its right."""
    yield wire((x, y), (x, y + 20))
    for plate in (20, 27):
        yield draw.line((x - 11, y + plate), (x + 11, y + plate), width=2.5)
    yield wire((x, y + 27), (x, y + 40))
    yield from ground(x, y + 40)
    yield draw.label(x + 15, y + 20, name, size=12, anchor="start")
    yield draw.label(x + 15, y + 35, value, draw.FAINT, 12, "start")


def switch(y, name, color, port, pin):
    """An SPDT switch between splitter, line and termination; its control comes from below."""
    yield draw.box(340, y - 34, 110, 92, rx=3)
    yield draw.label(395, y - 16, name, size=13, font_weight="bold")
    yield wire((340, y), (368, y))
    yield draw.line((368, y), (420, y), color=color, width=2.5)
    for x, height in ((368, 0), (422, 0), (422, 34)):
        yield draw.element("circle", cx=x, cy=y + height, r=3.5, fill=draw.INK)
    yield draw.label(362, y + 18, "RFC", draw.FAINT, 11)
    yield draw.label(408, y + 51, "RF2", draw.FAINT, 11)
    yield draw.label(408, y + 16, "RF1", draw.FAINT, 11)
    yield wire((422, y + 34), (500, y + 34))
    yield from resistor(500, y + 34, f"R{port}", "50 ohm")
    yield draw.line((422, y), (680, y), color=color, width=2.5)
    yield draw.label(565, y - 8, f"J{port + 3}, cable, J{port + 1}: port {port}", color, 13)
    yield wire((360, y + 58), (360, y + 74), (pin, y + 74), color=color)
    yield draw.label(366, y + 70, "CTRL", draw.FAINT, 11, "start")


def schematic():
    """Elements of the schematic."""
    yield from draw.antenna(60, 190)
    yield wire((60, 190), (130, 190))
    yield draw.label(60, 124, "antenna, 50 ohm", draw.FAINT, 12)
    yield draw.label(95, 182, "J1", size=12)
    yield from part(130, 155, 110, 70, "U4", "splitter, 2 ways")
    for y in (90, 290):
        side = 172 if y < 190 else 208
        yield wire((240, side), (285, side), (285, y), (340, y))
    yield from switch(90, "U2, SPDT", draw.END1, 1, 300)
    yield from switch(290, "U3, SPDT", draw.END2, 2, 316)
    # The line stands upright between the ports.
    yield draw.element("rect", x=680, y=76, width=44, height=228, fill="#e9ddd0")
    yield draw.element("rect", x=692, y=76, width=20, height=228, fill=draw.COPPER)
    yield draw.label(738, 168, "line, 80 mm", anchor="start")
    yield draw.label(738, 188, "trace 2.5 mm over ground 6 mm,", draw.FAINT, 12, "start")
    yield draw.label(738, 205, "0.63 mm of air, soft beam on top", draw.FAINT, 12, "start")
    yield draw.label(702, 66, "0 mm", draw.FAINT, 12)
    yield draw.label(702, 322, "80 mm", draw.FAINT, 12)
    yield from controller()


def controller():
    """The microcontroller, its crystal and its supply."""
    left, top, right = 400, 420, 560
    yield draw.box(left, top, right - left, 130, rx=3)
    yield draw.label((left + right) / 2, top + 154, "U1, ATtiny85", size=14, font_weight="bold")
    yield draw.label((left + right) / 2, top + 172, "examples/tag_firmware", draw.FAINT, 12)
    for y, text, x, color in (
        (445, "5 PB0", 300, draw.END1),
        (470, "6 PB1", 316, draw.END2),
    ):
        yield wire((left, y), (x, y), (x, 164 if x == 300 else 364), color=color)
        yield draw.label(left + 8, y + 4, text, size=12, anchor="start")
    yield draw.label(288, 436, "clock 1, fs", draw.END1, 12, "end")
    yield draw.label(304, 490, "clock 2, 2 fs", draw.END2, 12, "end")
    yield draw.label(left + 8, 529, "4 GND", size=12, anchor="start")
    yield wire((left, 525), (370, 525), (370, 540))
    yield from ground(370, 540)
    for y, text, x in ((485, "2 XTAL1", 600), (515, "3 XTAL2", 690)):
        yield draw.label(right - 8, y + 4, text, size=12, anchor="end")
        yield wire((right, y), (x, y), (x, 540))
        yield from capacitor(x, 540, f"C{1 if x == 600 else 2}", "18 pF")
    # Between the two wires, at their right ends.
    yield dot(600, 485)
    yield dot(690, 515)
    yield wire((600, 485), (655, 485))
    yield draw.line((657, 473), (657, 497), width=2.5)
    yield draw.box(663, 473, 12, 24, rx=0, fill="#ffffff")
    yield draw.line((681, 473), (681, 497), width=2.5)
    yield wire((683, 485), (690, 485), (690, 515))
    yield draw.label(669, 464, "Y1, 4 MHz", size=12)
    yield draw.label(right - 8, 449, "8 VCC", size=12, anchor="end")
    yield wire((right, 445), (860, 445), (860, 470))
    yield dot(755, 445)
    yield from capacitor(755, 445, "C3", "100 nF")
    yield from part(825, 470, 70, 46, "BT1", "3 V")
    yield wire((860, 516), (860, 530))
    yield from ground(860, 530)
    yield draw.label(860, 432, "also to U2, U3 (100 nF each)", draw.FAINT, 12)


TRACE_MM = 0.3  # of slow signals


def trace_width_mm():
    """Width of a trace of 50 ohm on the board."""
    line = Microstrip(1.0, ground_mm=1000.0, permittivity=BOARD_PERMITTIVITY).matched()
    return BOARD_HEIGHT_MM / line.height_mm


def to_scale(x, y, width, height, **style):
    """A rectangle by the millimetres of its corner and sides."""
    style = {"fill": "#d9d9d9", "stroke": draw.INK, "stroke_width": 1} | style
    sides = {"x": x, "y": y, "width": width, "height": height}
    sides = {key: round(SCALE * value, 2) for key, value in sides.items()}
    return draw.element("rect", **sides, **style)


def named(x, y, text, size=12, color=draw.INK, anchor="middle"):
    return draw.label(round(SCALE * x, 1), round(SCALE * y, 1), text, color, size, anchor)


def dimension(x1, x2, y, text):
    """A length between two places, in millimetres."""
    ends = (round(SCALE * x, 1) for x in (x1, x2))
    start, stop = ends
    yield draw.arrow(start, SCALE * y, stop, SCALE * y, draw.FAINT, 1.2)
    yield draw.arrow(stop, SCALE * y, start, SCALE * y, draw.FAINT, 1.2)
    yield named((x1 + x2) / 2, y - 0.7, text, color=draw.FAINT)


def layout():
    """Elements of the layout, in scale."""
    yield named(4, 4, "line from above", 15, anchor="start")
    left, middle = 18.0, 12.0
    yield to_scale(left, middle - LINE.ground_mm / 2, LINE.length_mm, LINE.ground_mm,
                   fill="#e9ddd0")  # fmt: skip
    yield to_scale(left, middle - BEAM_MM / 2, LINE.length_mm, BEAM_MM, fill="none",
                   stroke=draw.FAINT, stroke_dasharray="6 4")  # fmt: skip
    yield to_scale(left, middle - LINE.width_mm / 2, LINE.length_mm, LINE.width_mm,
                   fill=draw.COPPER)  # fmt: skip
    for x, port in ((left, 1), (left + LINE.length_mm, 2)):
        yield to_scale(x - 1.5, middle - 1.5, 3, 3, fill="#ffffff")
        yield named(x, middle - 6, f"J{port + 1}, port {port}: tag, or VNA")
    yield named(
        left + 40, middle - 6, f"outline of the beam, 80 x {BEAM_MM:g} mm", color=draw.FAINT
    )
    yield from dimension(left, left + LINE.length_mm, 22.2, f"{LINE.length_mm:g} mm")
    for millimetre in range(0, 81, 10):
        x = left + millimetre
        yield wire(*((round(SCALE * x, 1), SCALE * y) for y in (17.3, 18.0)))
        yield named(x, 19.4, f"{millimetre}", 11, draw.FAINT)
    yield from section(81.0, 33.5)
    yield from board(8.0, 29.0)


def section(x, y):
    """Cross-section of the line, enlarged four times."""
    zoom, height = 4, LINE.height_mm
    half = zoom * BEAM_MM / 2
    yield named(x - half, y - 6.5, "cross-section, 4 : 1", 15, anchor="start")
    yield to_scale(x - half, y - 5, 2 * half, 5, fill="#c8c8c8")
    yield named(x, y - 2.1, f"soft beam, {BEAM_MM:g} mm wide, {BEAM_MM:g} mm thick (cut)")
    yield to_scale(x - zoom * LINE.width_mm / 2, y, zoom * LINE.width_mm, 0.6, fill=draw.COPPER)
    base = y + 0.6 + zoom * height
    yield to_scale(x - zoom * LINE.ground_mm / 2, base, zoom * LINE.ground_mm, 0.6,
                   fill=draw.COPPER)  # fmt: skip
    yield to_scale(x - half, base + 0.6, 2 * half, 3, fill="#f4f4f4")
    yield named(x, base + 2.7, "rigid carrier")
    for side in (-half, half - 4):
        yield to_scale(x + side, y, 4, base + 0.6 - y, fill="#f4f4f4")
    yield named(x + half + 0.5, y + 2.0, "spacer", 11, anchor="start")
    yield named(x, base - 0.8, f"gap {height:g} mm, air", color=draw.FAINT)
    yield from dimension(x - 2 * LINE.width_mm, x + 2 * LINE.width_mm, y + 7.6, "")
    yield named(x, y + 9.2, f"trace {LINE.width_mm:g} mm", color=draw.FAINT)
    yield from dimension(x - 2 * LINE.ground_mm, x + 2 * LINE.ground_mm, y + 11.2, "")
    yield named(x, y + 12.8, f"ground {LINE.ground_mm:g} mm", color=draw.FAINT)


def board(x, y):
    """The tag's board from above; the whole other side is ground."""
    width, height = BOARD_MM
    strip = trace_width_mm()
    yield named(x, y - 1.5, f"board, {width:g} x {height:g} mm", 15, anchor="start")
    yield to_scale(x, y, width, height, fill="#eef3ea", rx=4)
    middle = y + height / 2
    copper = {"fill": draw.COPPER, "stroke": "none"}
    yield to_scale(x + 3, middle - strip / 2, 6, strip, **copper)
    for sign in (-1, 1):
        row = middle + sign * 7
        yield to_scale(x + 10 - strip / 2, min(row, middle) - strip / 2 * (sign < 0), strip,
                       7 + strip / 2, **copper)  # fmt: skip
        yield to_scale(x + 10 - strip / 2, row - strip / 2, 9, strip, **copper)
        yield to_scale(x + 19, row - strip / 2, 15, strip, **copper)
        yield to_scale(x + 18, row - 0.65, 2, 1.3, fill="#ffffff")
        yield to_scale(x + 18.5, row + sign * 1.6 - 0.5, 1, 1, fill="#ffffff")
        yield to_scale(x + 32.5, row - 1.5, 3, 3, fill="#ffffff")
        end = 1 if sign < 0 else 2
        yield named(x + 21.6, row - sign * 1.7 + 0.5, f"U{end + 1}")
        # Control of the switch, and its capacitor.
        yield to_scale(x + 18.3, min(row, middle), TRACE_MM, 7, **copper)
        yield to_scale(x + 15.6, row - sign * 1.9 - 0.35, 1.2, 0.7, fill="#ffffff")
        yield to_scale(x + 16.8, row - sign * 1.9 - TRACE_MM / 2, 1.3, TRACE_MM, **copper)
        yield named(x + 14.5, row - sign * 1.9 + 0.5, "C3", 11)
        # One side of the crystal, with its capacitor.
        side = middle + sign * 1.1
        yield to_scale(x + 21.9, side - TRACE_MM / 2, 5.1, TRACE_MM, **copper)
        yield to_scale(x + 27 - TRACE_MM / 2, min(side, side + sign * 1.9), TRACE_MM, 1.9, **copper)
        yield to_scale(x + 26.4, side + sign * 1.9 - 0.35, 1.2, 0.7, fill="#ffffff")
        yield named(x + 28.9, side + sign * 1.9 + 0.5, f"C{end}", 11)
        yield named(x + 21.2, row + sign * 2.0 + 0.5, f"R{end}", 11)
        yield named(x + 33, row + sign * 3 + 0.5, f"J{end + 3}, to J{end + 1}", 11)
    yield to_scale(x + 8.4, middle - 0.8, 3.2, 1.6, fill="#ffffff")
    yield named(x + 13.2, middle + 0.5, "U4")
    yield to_scale(x + 0.5, middle - 1.5, 3, 3, fill="#ffffff")
    yield named(x + 2, middle + 3.2, "J1", 11)
    yield to_scale(x + 17, middle - 2, 4.9, 3.9, fill="#ffffff")
    yield named(x + 19.4, middle + 0.5, "U1")
    yield to_scale(x + 14.4, middle + 2.2, 1.2, 0.7, fill="#ffffff")
    yield to_scale(x + 15.6, middle + 2.55 - TRACE_MM / 2, 3, TRACE_MM, **copper)
    yield to_scale(x + 18.4, middle + 1.5, TRACE_MM, 1.2, **copper)
    yield named(x + 13.2, middle + 3.05, "C3", 11)
    yield to_scale(x + 24.5, middle - 1.6, 5, 3.2, fill="#ffffff")
    yield named(x + 27, middle + 0.5, "Y1")
    note = f"traces {strip:.1f} mm wide: 50 ohm on {BOARD_HEIGHT_MM:g} mm of FR-4; the two arms"
    yield named(x, y + height + 2, note, color=draw.FAINT, anchor="start")
    note = "and the cables to J2 and J3 are equally long. Other side: ground, BT1, supply by vias"
    yield named(x, y + height + 3.8, note, color=draw.FAINT, anchor="start")


def files():
    """{path: SVG} of both drawings."""
    return {
        draw.IMAGES / "tag_schematic.svg": draw.svg(960, 620, schematic()),
        draw.IMAGES / "tag_layout.svg": draw.svg(880, 480, layout()),
    }


if __name__ == "__main__":
    for path, text in files().items():
        path.write_text(text, encoding="utf-8")
