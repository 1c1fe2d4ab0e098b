# SPDX-License-Identifier: GPL-3.0-or-later
"""Compiles flowgraphs, and prints where Companion draws blocks, ports and wires, as JSON.

    build/run python3 tests/helpers/grc_layout.py FOLDER FLOWGRAPH.grc...

The programs go to FOLDER, as those of grcc do. Needs no screen. Companion's own code computes the
sizes, in a process of its own because parts of GTK are replaced.
"""

import contextlib
import json
import re
import sys
from pathlib import Path
from types import SimpleNamespace

import cairo
import gi

gi.require_version("Gtk", "3.0")
gi.require_version("PangoCairo", "1.0")
from gi.repository import Gtk, PangoCairo  # noqa: E402

OWN = Path(__file__).resolve().parents[2] / "grc"
DOMAINS = ("stream.domain.yml", "message.domain.yml")
# Points on the curved part of a wire.
CURVE_POINTS = 40


class Paper:
    """Lays out text as a Gtk.DrawingArea does, without a screen."""

    _context = cairo.Context(cairo.ImageSurface(cairo.FORMAT_ARGB32, 8, 8))

    def create_pango_layout(self, text):
        layout = PangoCairo.create_layout(self._context)
        layout.set_text(text, -1)
        return layout


def without_screen():
    """Replace the parts of GTK and of Companion that need a screen and have no size."""
    Gtk.StyleContext.add_provider_for_screen = lambda *_: None
    Gtk.Application.get_default = lambda: SimpleNamespace(get_windows=list)
    Gtk.DrawingArea = Paper
    from gnuradio.grc.gui.Platform import Platform  # noqa: F401  Actions cannot come first
    from gnuradio.grc.gui import Actions  # isort: skip
    from gnuradio.grc.gui.canvas import flowgraph

    flowgraph._ContextMenu = lambda window: None
    # As Companion begins, without preferences.
    Actions.TOGGLE_SHOW_PARAMETER_EXPRESSION.set_active(False)
    Actions.TOGGLE_SHOW_PARAMETER_EVALUATION.set_active(True)
    for toggle in (Actions.TOGGLE_SHOW_BLOCK_IDS, Actions.TOGGLE_SHOW_FLOWGRAPH_COMPLEXITY):
        toggle.set_active(False)


def platform_for(flowgraphs):
    """Companion's platform with the blocks of these flowgraphs; all blocks take many seconds."""
    without_screen()
    from gnuradio import gr
    from gnuradio.grc.gui.Platform import Platform

    platform = Platform(
        version=gr.version(),
        version_parts=(gr.major_version(), gr.api_version(), gr.minor_version()),
        prefs=gr.prefs(),
        install_prefix=gr.prefix(),
    )
    used = {"options"}
    for path in flowgraphs:
        used.update(re.findall(r"^  id: (\S+)$", path.read_text(), re.M))
    files = []
    for folder in map(Path, platform.config.block_paths):
        if folder.is_dir() and folder.resolve() != OWN:
            files += [folder / name for name in DOMAINS if (folder / name).is_file()]
            for path in folder.rglob("*.block.yml"):
                found = re.search(r"^id: *(\S+)", path.read_text(), re.M)
                # A name that Python reserves has an underscore there, but not in flowgraphs.
                if found and found[1].rstrip("_") in used:
                    files.append(path)
    platform.build_library([*map(str, files), str(OWN)])
    return platform


def curve(points):
    """Points on a wire: a line, a Bezier curve and a line, as Companion draws them."""
    start, *control, last = points
    drawn = [start]
    for step in range(CURVE_POINTS + 1):
        t = step / CURVE_POINTS
        weights = (1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t**2 * (1 - t), t**3
        drawn.append([sum(w * p[i] for w, p in zip(weights, control, strict=True)) for i in (0, 1)])
    return [*drawn, last]


def wire(connection):
    """A connection as points on the canvas."""
    x, y = connection.source_port.connector_coordinate_absolute
    x_end, y_end = connection.sink_port.connector_coordinate_absolute
    first, second, third, fourth, last = connection._rel_points
    near = [(0, 0), first, second]
    far = [(x_end - x + dx, y_end - y + dy) for dx, dy in (third, fourth, last)]
    path = [near[0], near[1], near[2], far[0], far[1], far[2]]
    start, control, end = path[0], path[1:5], path[5]
    return [[x + px, y + py] for px, py in curve([start, *control, end])]


def geometry(flowgraph):
    """Boxes (left, top, right, bottom) of blocks with their comments and ports, and wires."""
    blocks, comments, ports, wires = {}, {}, {}, []
    for block in flowgraph.blocks:
        x, y = block.coordinate
        width, height = (block.width, block.height)[:: 1 if block.is_horizontal() else -1]
        box = [x, y, x + width, y + height]
        blocks[block.name] = box
        if block._comment_layout:
            comments[block.name] = list(block.get_extents_comment())
        for port in block.active_ports():
            left, top = (a + b for a, b in zip(port.coordinate, block.coordinate, strict=True))
            box = [left, top, left + port.width, top + port.height]
            ports[f"{block.name} {port.name}"] = box
    for connection in flowgraph.connections:
        source, sink = connection.source_block.name, connection.sink_block.name
        wires.append({"from": source, "to": sink, "points": wire(connection)})
    return {"blocks": blocks, "comments": comments, "ports": ports, "wires": wires}


def main(folder, paths):
    paths = [Path(path).resolve() for path in paths]
    found = {}
    with contextlib.redirect_stdout(sys.stderr):
        platform = platform_for(paths)
        platform.config.hier_block_lib_dir = folder
        for path in paths:
            flowgraph = platform.make_flow_graph(str(path))
            flowgraph.rewrite()
            flowgraph.validate()
            if not flowgraph.is_valid():
                sys.exit(f"{path.name}: {[*flowgraph.iter_error_messages()]}")
            platform.Generator(flowgraph, folder).write()
            for part in ("create_labels", "create_shapes"):
                for element in (*flowgraph.blocks, *flowgraph.connections):
                    getattr(element, part)()
            found[path.stem] = geometry(flowgraph)
    print(json.dumps(found))


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])
