# SPDX-License-Identifier: GPL-3.0-or-later
"""GNU Radio blocks, one a file: they move items and tags, and hold no mathematics.

What the chapters share is here.
"""
