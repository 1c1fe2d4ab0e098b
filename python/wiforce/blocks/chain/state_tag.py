# SPDX-License-Identifier: GPL-3.0-or-later
"""State of one group, all arrays but its vectors, as a stream tag."""

import dataclasses
from typing import Any

import numpy as np
import pmt

from ...estimation.groups import Array, Groups

# Arrays that are the stream's items, or are not sent.
_ITEMS = {"tones", "snapshot_weights", "ends", "changes", "ratios"}
_NAMES = [item.name for item in dataclasses.fields(Groups) if item.name not in _ITEMS]


def to_pmt(group: Groups) -> Any:
    """Convert a batch of one group to a pmt dict.

    Parameters
    ----------
    group : Groups
        Of length 1.

    Returns
    -------
    pmt
        Dict with a row of each array that is not None, by the names in Groups.

    Examples
    --------
    >>> from_pmt(to_pmt(Groups([7], missing=np.array([3])))).missing.tolist()
    [3]
    """
    result = pmt.make_dict()
    for name in _NAMES:
        values = getattr(group, name)
        if values is not None:
            result = pmt.dict_add(result, pmt.intern(name), _to_pmt(values[0]))
    return result


def from_pmt(value: Any) -> Groups:
    """Convert a pmt dict to a batch of one group.

    Parameters
    ----------
    value : pmt
        See :func:`to_pmt`.

    Returns
    -------
    Groups

    Examples
    --------
    >>> len(from_pmt(to_pmt(Groups([7]))))
    1
    """
    arrays = {}
    for name in _NAMES:
        item = pmt.dict_ref(value, pmt.intern(name), pmt.PMT_NIL)
        if not pmt.is_null(item):
            arrays[name] = _from_pmt(item)[None]
    return Groups(**arrays)


def _to_pmt(row: Array) -> Any:
    if np.ndim(row) == 0:
        if row.dtype == bool:
            return pmt.from_bool(bool(row))
        return pmt.from_double(float(row)) if row.dtype == float else pmt.from_uint64(int(row))
    if row.dtype == bool:
        return pmt.init_u8vector(row.size, row.astype(np.uint8).tolist())
    if np.iscomplexobj(row):
        return pmt.init_c64vector(row.size, row.astype(complex).tolist())
    return pmt.init_f64vector(row.size, row.astype(float).tolist())


def _from_pmt(item: Any) -> Array:
    if pmt.is_bool(item):
        return np.array(pmt.to_bool(item))
    if pmt.is_u8vector(item):
        return np.array(pmt.u8vector_elements(item), bool)
    if pmt.is_c64vector(item):
        return np.array(pmt.c64vector_elements(item))
    if pmt.is_f64vector(item):
        return np.array(pmt.f64vector_elements(item))
    if pmt.is_real(item):
        return np.array(pmt.to_double(item))
    return np.array(pmt.to_uint64(item))
