#!/usr/bin/env bash
# SPDX-License-Identifier: GPL-3.0-or-later
set -ex

# Explicitly with the blocks, so that the build fails where GNU Radio is not found.
cmake -S . -B build-conda ${CMAKE_ARGS} \
    -DCMAKE_BUILD_TYPE=Release \
    -DCMAKE_INSTALL_PREFIX="$PREFIX" \
    -DCMAKE_INSTALL_LIBDIR=lib \
    -DPYTHON_EXECUTABLE="$PYTHON" \
    -DWIFORCE_GNURADIO=ON \
    -DBUILD_TESTING=OFF
cmake --build build-conda --parallel "${CPU_COUNT}"
cmake --install build-conda
