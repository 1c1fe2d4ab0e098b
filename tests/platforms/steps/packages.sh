#!/usr/bin/env bash
# SPDX-License-Identifier: GPL-3.0-or-later
# Builds the packages, and has lintian check them.
set -euo pipefail
cd gr-wiforce
./bootstrap package
sudo DEBIAN_FRONTEND=noninteractive apt-get install -q -y --no-install-recommends lintian >/dev/null
lintian --info --fail-on error,warning build/packages/*.changes
echo "lintian: no errors or warnings"
