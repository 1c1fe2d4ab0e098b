# SPDX-License-Identifier: GPL-3.0-or-later
"""Sample types: their names in GNU Radio and SigMF, and conversion of 16-bit integers."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..errors import InputError


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
