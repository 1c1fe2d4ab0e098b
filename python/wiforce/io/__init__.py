# SPDX-License-Identifier: GPL-3.0-or-later
"""Files and network: captures, texts, readings; checked when read, written whole or row by row."""
