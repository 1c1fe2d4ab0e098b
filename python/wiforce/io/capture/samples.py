# SPDX-License-Identifier: GPL-3.0-or-later
"""Sample types: their names in GNU Radio and SigMF, and conversion of 16-bit integers."""

import string
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ...errors import InputError


class ItemType(NamedTuple):
    """A type of complex samples.

    Attributes
    ----------
    name : str
        In GNU Radio.
    datatype : str
        In SigMF.
    sample_bytes : int
        Size of a complex sample, in bytes.
    item : numpy type, or tuple of it and a count
        In the signature of a Python block.
    """

    name: str
    datatype: str
    sample_bytes: int
    item: Any


# Bytes that a type is found by; floats of samples, whose full scale is 1 or 32768, and the share of
# them that a damaged file still has.
_LOOKED_AT, _SMALLEST, _LARGEST, _USUAL_SHARE = 1 << 16, 1e-9, 1e6, 0.95
_KINDS = (
    ItemType("fc32", "cf32_le", 8, np.complex64),
    ItemType("sc16", "ci16_le", 4, (np.int16, 2)),
)
ITEM_TYPES = {kind.name: kind for kind in _KINDS}
DATATYPES = {kind.datatype: kind for kind in _KINDS}


def item_type_named(name: str) -> ItemType:
    """The type that a block's parameter ``item_type`` names.

    Parameters
    ----------
    name : str
        ``fc32`` or ``sc16``.

    Raises
    ------
    InputError
        For another name.
    """
    if name not in ITEM_TYPES:
        raise InputError("item_type", f"must be one of {', '.join(ITEM_TYPES)}", name)
    return ITEM_TYPES[name]


FULL_SCALE = 32768


def samples_of(codes: ArrayLike) -> np.ndarray:
    """Complex samples of a converter's 16-bit integers.

    Returns ndarray of complex64, shape (n,): full scale is 1 per component.

    Parameters
    ----------
    codes : array_like of int16, shape (n, 2) or (2 n,)
        I and Q of each sample.
    """
    return (np.asarray(codes).astype(np.float32) / FULL_SCALE).view(np.complex64).ravel()


def likely_datatype(path: str | Path) -> str | None:
    """Type of raw samples, by their values.

    Parameters
    ----------
    path : str or Path

    Returns
    -------
    str or None
        None for a text, or a file that is too short.

    Notes
    -----
    Levels of floats lie within some decades of full scale. Pairs of 16-bit integers that are taken
    for floats have exponents that are spread over all that there are.

    Examples
    --------
    >>> np.arange(100, dtype="<i2").tofile("a.bin")
    >>> likely_datatype("a.bin")
    'ci16_le'
    """
    with Path(path).open("rb") as file:
        start = file.read(_LOOKED_AT)
    if len(start) < 8 or not start.translate(None, string.printable.encode()):
        return None
    values = np.frombuffer(start[: len(start) // 4 * 4], "<f4")
    return "cf32_le" if usual_share(values) > _USUAL_SHARE else "ci16_le"


def usual_share(values: ArrayLike) -> float:
    """Share of floats that have a size which samples have.

    Parameters
    ----------
    values : array_like of float
        I and Q.

    Returns
    -------
    float

    Examples
    --------
    >>> usual_share([0.5, 0.0, -1000.0, 1e30])
    0.75
    """
    sizes = np.abs(np.asarray(values))
    with np.errstate(invalid="ignore"):
        return float(np.mean((sizes == 0) | ((sizes > _SMALLEST) & (sizes < _LARGEST))))
