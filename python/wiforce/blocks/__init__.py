# SPDX-License-Identifier: GPL-3.0-or-later
"""GNU Radio blocks: they move items and tags, and hold no mathematics."""
