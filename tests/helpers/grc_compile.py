# SPDX-License-Identifier: GPL-3.0-or-later
"""Compiles flowgraphs as grcc does, with the descriptions of their own blocks only.

    build/run python3 tests/helpers/grc_compile.py FOLDER FLOWGRAPH.grc...

The programs go to FOLDER. All descriptions of GNU Radio take many seconds.
"""

import re
import sys
from pathlib import Path

from gnuradio import gr
from gnuradio.grc.core.platform import Platform

OWN = Path(__file__).resolve().parents[2] / "grc"
DOMAINS = ("stream.domain.yml", "message.domain.yml")


def descriptions(folders, flowgraphs):
    """Files that describe the blocks of these flowgraphs."""
    used = {"options"}
    for path in flowgraphs:
        used.update(re.findall(r"^  id: (\S+)$", path.read_text(), re.M))
    for folder in map(Path, folders):
        if folder.is_dir() and folder.resolve() != OWN:
            yield from (folder / name for name in DOMAINS if (folder / name).is_file())
            for path in folder.rglob("*.block.yml"):
                found = re.search(r"^id: *(\S+)", path.read_text(), re.M)
                # A name that Python reserves has an underscore there, but not in flowgraphs.
                if found and found[1].rstrip("_") in used:
                    yield path


def platform_for(flowgraphs=()):
    """Companion's platform with our blocks, and of all others those in these flowgraphs."""
    platform = Platform(
        version=gr.version(),
        version_parts=(gr.major_version(), gr.api_version(), gr.minor_version()),
        prefs=gr.prefs(),
    )
    files = descriptions(platform.config.block_paths, flowgraphs)
    platform.build_library([*map(str, files), str(OWN)])
    return platform


def main(folder, paths):
    paths = [Path(path).resolve() for path in paths]
    platform = platform_for(paths)
    platform.config.hier_block_lib_dir = folder
    for path in paths:
        flowgraph, program = platform.load_and_generate_flow_graph(str(path), folder)
        if program is None:
            sys.exit(f"{path.name}: {[*flowgraph.iter_error_messages()] if flowgraph else ''}")


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])
