#!/usr/bin/env bash
# SPDX-License-Identifier: GPL-3.0-or-later
# README's commands. The last shows a window, which must stay open for ten seconds.
set -euo pipefail
cd gr-wiforce
./bootstrap demo
./bootstrap
sudo DEBIAN_FRONTEND=noninteractive apt-get install -q -y --no-install-recommends \
    xvfb xauth x11-utils >/dev/null
xvfb-run --auto-servernum bash -euo pipefail -c '
    build/run gnuradio-companion examples/press_simulation.grc &
    companion=$!
    shown=
    for _ in $(seq 60); do
        sleep 1
        kill -0 "$companion"
        if xwininfo -root -tree | grep -q "press_simulation"; then shown=yes; break; fi
    done
    test "$shown"
    sleep 10
    kill "$companion"  # fails if it has ended by itself
    echo "Companion showed press_simulation.grc"'
