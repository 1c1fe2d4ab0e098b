#!/usr/bin/env bash
# SPDX-License-Identifier: GPL-3.0-or-later
# All tests, or pytest with the arguments that follow.
set -euo pipefail
cd gr-wiforce
./bootstrap test "$@"
