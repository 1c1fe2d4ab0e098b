#!/usr/bin/env bash
# SPDX-License-Identifier: GPL-3.0-or-later
# Uses what is installed, as a user and without a network.
set -euo pipefail
! python3 -m pip --version >/dev/null 2>&1 || { echo "pip is installed" >&2; exit 1; }
mkdir work
cd work
gr-wiforce --version
gr-wiforce demo
gr-wiforce simulate tabletop press
gr-wiforce read press --scene tabletop -o press.csv --plot press.png
test "$(grep -c '^' press.csv)" -gt 20
gr-wiforce plan demo >plan.txt
examples=/usr/share/doc/gr-wiforce/examples
python3 $examples/headless/read_recording.py press flowgraph.csv tabletop
test "$(grep -c '^' flowgraph.csv)" -eq "$(grep -c '^' press.csv)"
# Every block in Companion's platform, and a flowgraph with a window that runs for ten seconds.
python3 - <<'PYTHON'
from pathlib import Path

from gnuradio import gr
from gnuradio.grc.core.platform import Platform

version = (gr.major_version(), gr.api_version(), gr.minor_version())
platform = Platform(version=gr.version(), version_parts=version, prefs=gr.prefs())
platform.build_library()
found = {name for name in platform.blocks if "wiforce" in name}
files = Path("/usr/share/gnuradio/grc/blocks").glob("*wiforce*.block.yml")
expected = {path.name.removesuffix(".block.yml") for path in files}
assert len(expected) > 15 and found == expected, found ^ expected
print(f"Companion knows {len(found)} blocks")
PYTHON
grcc $examples/press_simulation.grc
xvfb-run --auto-servernum bash -euo pipefail -c '
    python3 press_simulation.py &
    flowgraph=$!
    until xwininfo -root -tree | grep -q "WiForce: press a sensor"; do
        sleep 1
        kill -0 "$flowgraph"  # fails if it has ended
    done
    sleep 10
    kill -TERM "$flowgraph"
    wait "$flowgraph"
    echo "the flowgraph with a window ran for ten seconds"'
for test in /packages/tests/*; do
    if [ -x "$test" ]; then
        echo "autopkgtest $(basename "$test")"
        AUTOPKGTEST_TMP=$(mktemp -d) "$test"
    fi
done
