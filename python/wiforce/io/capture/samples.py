# SPDX-License-Identifier: GPL-3.0-or-later
"""Sample types: their names in GNU Radio and SigMF, and conversion of 16-bit integers."""

import string
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ...errors import InputError


class ItemType(NamedTuple):
    """A type of complex samples: names in GNU Radio and SigMF, bytes, items of a Python block."""

    name: str
    datatype: str
    sample_bytes: int
    item: Any


# Bytes that a type is found by; floats of samples, whose full scale is 1 or 32768, and the share of
# them that a damaged file still has.
_LOOKED_AT, _SMALLEST, _LARGEST, _FLOAT_SHARE = 1 << 16, 1e-9, 1e6, 0.95
_KINDS = (
    ItemType("fc32", "cf32_le", 8, np.complex64),
    ItemType("sc16", "ci16_le", 4, (np.int16, 2)),
)
ITEM_TYPES = {kind.name: kind for kind in _KINDS}
DATATYPES = {kind.datatype: kind for kind in _KINDS}


def item_type_named(name: str) -> ItemType:
    """The type that a block's parameter ``item_type`` names: ``fc32`` or ``sc16``."""
    if name not in ITEM_TYPES:
        raise InputError("item_type", f"must be one of {', '.join(ITEM_TYPES)}", name)
    return ITEM_TYPES[name]


FULL_SCALE = 32768
# Share of it from which on a sample counts as clipped: the last code of a 12-bit converter.
CLIPPED = 1 - 2**-11


def samples_of(codes: ArrayLike) -> np.ndarray:
    """Complex samples (n,), full scale 1 per component, of 16-bit integers I and Q."""
    scaled = np.multiply(codes, np.float32(1 / FULL_SCALE), dtype=np.float32)
    return scaled.view(np.complex64).ravel()


def likely_datatype(path: str | Path) -> str | None:
    """Type of raw samples, by the exponents that they have as floats; None where unknown."""
    start = _start_of(path)
    if len(start) < 8 or _is_text(start):
        return None
    values = np.frombuffer(start[: len(start) // 4 * 4], "<f4")
    return "cf32_le" if plausible_share(values) > _FLOAT_SHARE else "ci16_le"


def holds_text(path: str | Path) -> bool:
    """Whether a file begins with text, as readings and tables do; not where it is unreadable."""
    try:
        return _is_text(_start_of(path))
    except OSError:
        return False


def _start_of(path: str | Path) -> bytes:
    with Path(path).open("rb") as file:
        return file.read(_LOOKED_AT)


def _is_text(start: bytes) -> bool:
    return start != b"" and not start.translate(None, string.printable.encode())


def plausible_share(values: ArrayLike) -> float:
    """Share of floats that have a size which samples have."""
    sizes = np.abs(np.asarray(values))
    with np.errstate(invalid="ignore"):
        return float(np.mean((sizes == 0) | ((sizes > _SMALLEST) & (sizes < _LARGEST))))
