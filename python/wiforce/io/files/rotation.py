# SPDX-License-Identifier: GPL-3.0-or-later
"""When a file of readings that is written for weeks is renamed and begun anew."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

from ...errors import InputError

# Units of a limit, as fields of :class:`Rotation`, and their sizes.
_UNITS = {"s": ("every_s", 1), "min": ("every_s", 60), "h": ("every_s", 3600)}
_UNITS |= {"d": ("every_s", 86400), "kB": ("size_bytes", 1000)}
_UNITS |= {"MB": ("size_bytes", 10**6), "GB": ("size_bytes", 10**9)}
_LIMIT = re.compile(rf"([1-9][0-9]{{0,8}})({'|'.join(_UNITS)})")


@dataclass(frozen=True)
class Rotation:
    """When a file of readings is renamed, and how many renamed files are kept."""

    every_s: int | None = None  # at whole multiples of it, counted from midnight UTC of 1970-01-01
    size_bytes: int | None = None  # once the file has reached this size
    keep: int | None = None  # renamed files that are kept; None keeps all

    @classmethod
    def of(cls, limits: Iterable[str], keep: int | None = None) -> Rotation:
        """A rotation from at most one time like ``6h`` and one size like ``100MB``."""
        found: dict[str, int] = {}
        for text in limits:
            match = _LIMIT.fullmatch(text)
            if match is None:
                units = "a time in s, min, h or d, or a size in kB, MB or GB"
                raise InputError("--rotate", f"must be {units}, like 6h or 100MB", text)
            kind, size = _UNITS[match[2]]
            if kind in found:
                raise InputError("--rotate", "may be given once for time and once for size", text)
            found[kind] = int(match[1]) * size
        if keep is not None and not found:
            raise InputError("--keep", "needs --rotate", keep)
        return cls(**found, keep=keep)

    def __bool__(self) -> bool:
        return self.every_s is not None or self.size_bytes is not None
