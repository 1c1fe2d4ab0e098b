# SPDX-License-Identifier: GPL-3.0-or-later
"""The complete receiver as a block, and what becomes of its readings."""
