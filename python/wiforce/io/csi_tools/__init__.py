# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of the common CSI tools, as channel snapshots."""

from .conversion import check_tool, convert, open_csi

__all__ = ["check_tool", "convert", "open_csi"]
