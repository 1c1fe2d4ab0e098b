# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of the common CSI tools, as channel snapshots."""

from importlib import import_module
from typing import Any

__all__ = ["check_tool", "convert", "open_csi"]


def __getattr__(name: str) -> Any:
    """Import what reads such files on first use: every reading asks what kind a file is."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(".conversion", __name__), name)
