# SPDX-License-Identifier: GPL-3.0-or-later
"""Phase estimation: tone weights, tag clocks, separation of the ends, and the bound. Numpy only."""
