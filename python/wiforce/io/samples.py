# SPDX-License-Identifier: GPL-3.0-or-later
"""Kinds of samples: their names in GNU Radio and SigMF, and a converter's 16-bit integers."""

from typing import NamedTuple

import numpy as np

from ..errors import InputError


class ItemType(NamedTuple):
    """Complex samples of one kind.

    Attributes
    ----------
    name : str
        GNU Radio's.
    datatype : str
        SigMF's.
    sample_bytes : int
    item : numpy type, or tuple of it and a count
        In the signature of a Python block.
    """

    name: str
    datatype: str
    sample_bytes: int
    item: object


_KINDS = (
    ItemType("fc32", "cf32_le", 8, np.complex64),
    ItemType("sc16", "ci16_le", 4, (np.int16, 2)),
)
ITEM_TYPES = {kind.name: kind for kind in _KINDS}
DATATYPES = {kind.datatype: kind for kind in _KINDS}


def item_type_named(name):
    """The ItemType of a block's parameter ``item_type``.

    Raises
    ------
    InputError
    """
    if name not in ITEM_TYPES:
        raise InputError("item_type", f"must be one of {', '.join(ITEM_TYPES)}", name)
    return ITEM_TYPES[name]


FULL_SCALE = 32768


def samples_of(codes):
    """Complex samples (n,), full scale 1 per component, of codes (n, 2) or I Q I Q (2n,)."""
    return (np.asarray(codes).astype(np.float32) / FULL_SCALE).view(np.complex64).ravel()
