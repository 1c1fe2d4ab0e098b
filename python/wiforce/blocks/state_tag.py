# SPDX-License-Identifier: GPL-3.0-or-later
"""A group's state as a stream tag."""

import dataclasses

import numpy as np
import pmt

from ..estimation.state import ClockState, GroupState


def to_pmt(state):
    """GroupState to a pmt dict; what a stage has not yet added is left out."""
    result = pmt.make_dict()
    for field in dataclasses.fields(GroupState):
        value = getattr(state, field.name)
        if value is not None:
            result = pmt.dict_add(result, pmt.intern(field.name), _value_to_pmt(value))
    return result


def from_pmt(value):
    """pmt dict to GroupState."""
    fields = {}
    for field in dataclasses.fields(GroupState):
        item = pmt.dict_ref(value, pmt.intern(field.name), pmt.PMT_NIL)
        if not pmt.is_null(item):
            fields[field.name] = _value_from_pmt(field.name, item)
    return GroupState(**fields)


def _value_to_pmt(value):
    if isinstance(value, tuple):
        return pmt.to_pmt([_plain(dataclasses.asdict(clock)) for clock in value])
    if isinstance(value, np.ndarray):
        if value.dtype == bool:
            return pmt.init_u8vector(len(value), value.astype(np.uint8).tolist())
        return pmt.init_f64vector(len(value), value.astype(float).tolist())
    return pmt.from_uint64(value)


def _plain(fields):
    """NumPy's scalars as Python's own, which is all that pmt takes."""
    return {k: v.item() if isinstance(v, np.generic) else v for k, v in fields.items()}


def _value_from_pmt(name, item):
    if name == "clocks":
        return tuple(ClockState(**clock) for clock in pmt.to_python(item))
    if pmt.is_u8vector(item):
        return np.array(pmt.u8vector_elements(item), bool)
    if pmt.is_f64vector(item):
        return np.array(pmt.f64vector_elements(item))
    return pmt.to_uint64(item)
