#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Draws docs/images/chapters.svg and docs/images/signal_path.svg.

build/run python3 docs/make_architecture_drawings.py
"""

from make_setup_drawings import FAINT, IMAGES, INK, arrow, box, element, label, svg

# The layers of python/wiforce, from the top; the names in a layer do not import each other.
CHAPTERS = (
    ({"blocks": "GNU Radio blocks"}, "#f4f4f4"),
    ({"receiver": "the stages in their order, from a file, a radio or a Wi-Fi card"}, "#e3eef6"),
    ({"press": "what may have happened"}, "#fbe9dd"),
    ({"planning": "settings, errors, advice"}, "#f4f4f4"),
    ({"simulation": "rooms, tags, presses"}, "#f4f4f4"),
    ({"scene": "the scene file", "gui": "Qt widgets"}, "#f4f4f4"),
    ({"calibration": "sensor files from presses"}, "#f4f4f4"),
    ({"estimation": "phases", "sensor": "models", "surface": "skins"}, "#fbe9dd"),
    ({"io": "files and sockets"}, "#f4f4f4"),
    ({"signal": "frames, switches, weights, bound"}, "#f4f4f4"),
)
KERNELS = "lib/kernel (C++): from folding samples to weighing presses"
# Of the stages: name, what leaves it, its rate, where it is.
STAGES = (
    ("samples", "from the radio", "12.5 M/s", "io, blocks"),
    ("fold", "snapshots of 64", "17 361/s", "lib/kernel/fold"),
    ("tones", "lines of the tags", "27.8/s", "lib/kernel/doppler"),
    ("separation", "channels of the ends", "27.8/s", "lib/kernel/separation"),
    ("difference", "change of each end", "27.8/s", "estimation/phases"),
    ("average", "ratio R of each end", "27.8/s", "estimation/phases"),
    ("press", "what happened", "27.8/s", "press, lib/kernel/press"),
    ("readout", "force, location, flags", "27.8/s", "press, lib/kernel/inversion"),
)


def chapters():
    """The package's layers, each of which imports what is below it."""
    width, row, parts = 760, 46, []
    for number, (layer, color) in enumerate(CHAPTERS):
        y, each = 10 + number * row, (width - 120) / len(layer)
        for place, (name, role) in enumerate(layer.items()):
            x = 20 + place * each
            parts.append(box(x, y, each - 10, row - 8, fill=color))
            parts.append(label(x + (each - 10) / 2, y + 17, name, font_weight="bold"))
            parts.append(label(x + (each - 10) / 2, y + 33, role, FAINT, 12))
    y = 10 + len(CHAPTERS) * row
    parts += [
        box(20, y, width - 130, row - 8, fill="#e8e8e8"),
        label(335, y + 24, KERNELS, size=13),
    ]
    parts += [
        arrow(width - 70, 14, width - 70, y + 30, INK),
        label(width - 40, 28, "imports", FAINT, 12),
    ]
    return svg(width, y + row + 2, parts)


def signal_path():
    """What becomes of the samples of a capture or a stream."""
    parts, width, step = [], 960, 232
    for number, (name, what, rate, where) in enumerate(STAGES):
        line, place = divmod(number, 4)
        x, y = 20 + place * step, 20 + line * 130
        fill = "#e8e8e8" if number < 3 else "#e3eef6" if number in (4, 5) else "#fbe9dd"
        parts.append(box(x, y, 190, 92, fill=fill))
        parts.append(label(x + 95, y + 24, name, size=17, font_weight="bold"))
        parts.append(label(x + 95, y + 44, what, size=13))
        parts.append(label(x + 95, y + 62, rate, FAINT, 13))
        parts.append(label(x + 95, y + 80, where, FAINT, 12))
        if place < 3:
            parts.append(arrow(x + 190, y + 46, x + step - 2, y + 46, INK))
    end, down = 20 + 3 * step + 95, 131
    path = f"M{end},112 L{end},{down} L115,{down} L115,148"
    parts.append(
        element("path", d=path, fill="none", stroke=INK, stroke_width=2.5, marker_end="url(#head)")
    )
    parts.append(
        label(
            20,
            268,
            "grey: C++; blue: arrays of a batch, in NumPy and C++; red: group after group; "
            "the last five are the stages of Receiver",
            FAINT,
            13,
            "start",
        )
    )
    return svg(width, 282, parts)


def files():
    """{path: SVG} of both pictures."""
    return {IMAGES / "chapters.svg": chapters(), IMAGES / "signal_path.svg": signal_path()}


if __name__ == "__main__":
    for path, text in files().items():
        path.write_text(text, encoding="utf-8")
